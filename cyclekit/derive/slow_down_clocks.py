"""Clocks of trackers that nothing else relates to the robot's, by the slow-downs of all sessions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.alignment.clocks import (
    ASSUMED,
    REACH_S,
    ClockFit,
    LagEvidence,
    fit_lags,
    rough_lag,
    speed_changes,
)
from cyclekit.alignment.clocks.slow_downs import AMBIGUOUS, AROUND_S, FINE_S
from cyclekit.dataset.cards import note
from cyclekit.dataset.unknown_height import in_plane
from cyclekit.people.activity import person_tracks
from cyclekit.people.tracks import at_times
from cyclekit.segmentation.stored_run import pieces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.alignment.clocks import Lag
    from cyclekit.config import Source
    from cyclekit.dataset.cards import RecordingCard
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read
    from cyclekit.derive.over_sessions import Passes
    from cyclekit.people.tracks import PersonTrack
    from cyclekit.schema import Floats, Points, Vector
    from cyclekit.segmentation.stored_run import Run

STEP_S = 0.1
"""Step of the rough search, s."""
MAX_CHANGES = 300
"""Maximum number of changes of speed of a session."""
MAX_PEOPLE = 8
"""Maximum number of people at once: a crowd tells nothing."""
BRIDGE_S = 0.3
"""Maximum gap in a track that is bridged, s."""


@dataclass(frozen=True)
class _Unaligned:
    """A log of people of unknown clock, and the runs of its session's robot."""

    log: RecordingCard
    runs: Sequence[Run]


def with_slow_down_clocks(
    passes: Passes,
    sessions: Sequence[Session],
    runs: Sequence[Run],
    sources: Mapping[str, Source | None],
    read: Read,
    *,
    asked: bool,
) -> list[Session]:
    """Return the sessions, their trackers of unknown clock aligned by the slow-downs.

    Args:
        passes: Runs the work on the sessions.
        sessions: The sessions.
        runs: All runs of the robot, with logged or inferred scaling.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table).
        asked: Use every lag that was found, and of clocks said to be synchronised those with which that is wrong for
            certain; else only those with which a common start is.
    """
    methods = (ASSUMED, "epoch") if asked else (ASSUMED,)
    left = [
        _Unaligned(log, [runs[number] for number in session.runs])
        for session in sessions
        for log in session.recordings
        if "people" in log.tables and log.clock.method in methods and log.clock.same_as is None and session.runs
    ]
    if not left:
        return list(sessions)
    evidence = passes.over(partial(_evidence, sources=sources, read=read), left, "speed", "clocks")
    fits = {
        one.log.id: fit
        for one, seen, lag in zip(left, evidence, fit_lags(evidence), strict=True)
        if (fit := _fit(one.log, seen, lag, asked=asked)) is not None
    }
    return [_with_clocks(session, fits) for session in sessions]


def _evidence(one: _Unaligned, *, sources: Mapping[str, Source | None], read: Read) -> LagEvidence:
    tracks = person_tracks([one.log], sources, read)
    t_s, tcp_m, scaling = _motion(one.runs)
    none = LagEvidence(None, np.zeros(1), np.empty((2, 1, 0)), np.empty(0, np.int64))
    if not tracks or len(t_s) < 2:
        return none
    grid_s = np.arange(t_s[0], t_s[-1], STEP_S)
    rows = np.clip(np.searchsorted(t_s, grid_s, side="right") - 1, 0, len(t_s) - 1)
    fresh = grid_s - t_s[rows] <= STEP_S
    people = people_at_once(tracks, np.arange(t_s[0], one.log.span_s[1], STEP_S))
    if len(people) > MAX_PEOPLE:
        return none
    rough = rough_lag(people, tcp_m[rows], np.where(fresh, scaling[rows], np.nan), step_s=STEP_S)
    if rough is None:
        return none
    changes = speed_changes(t_s, scaling)
    some = slice(None, None, max(1, -(-len(changes.t_s) // MAX_CHANGES)))
    around_s = rough.lag_s + np.arange(-AROUND_S, AROUND_S + FINE_S / 2, FINE_S)
    lags_s = np.append(around_s, 0.0)
    at_s = changes.t_s[some]
    here_m = np.column_stack([np.interp(at_s, t_s, axis) for axis in tcp_m.T])
    return LagEvidence(rough, lags_s, _apart(tracks, here_m, at_s, lags_s), changes.kind[some])


def people_at_once(tracks: Sequence[PersonTrack], at_s: Vector) -> list[Points]:
    """Return where people are at each time, (N, 3) each, m: as many as are there at once; the same one may change."""
    found: list[Points] = []
    until: list[int] = []
    for track in sorted((one for one in tracks if len(one.t_s)), key=lambda track: float(track.t_s[0])):
        ends_s = track.t_s[[0, -1]] + np.array([-BRIDGE_S, BRIDGE_S])
        first, last = np.searchsorted(at_s, ends_s).tolist()
        number = next((n for n, end in enumerate(until) if end <= first), len(found))
        if number == len(found):
            found.append(np.full((len(at_s), 3), np.nan))
            until.append(0)
        found[number][first:last] = at_times(track, at_s[first:last], bridge_s=BRIDGE_S)
        until[number] = last
        if len(found) > MAX_PEOPLE:
            break
    return found


def _motion(runs: Sequence[Run]) -> tuple[Vector, Points, Vector]:
    """Return time (T,), TCP (T, 3) and scaling (T,) of rows about FINE_S apart."""
    times: list[Vector] = [np.empty(0)]
    tcp: list[Points] = [np.empty((0, 3))]
    scaling: list[Vector] = [np.empty(0)]
    for period_s, part in ((run.period_s, part) for run in runs for _, part in pieces(run)):
        some = slice(None, None, max(1, round(FINE_S / period_s)))
        times.append(part.t_s[some])
        tcp.append(part.xyz_m[some])
        scaling.append(np.asarray(part.scaling[some], float))
    return np.concatenate(times), np.concatenate(tcp), np.concatenate(scaling)


def _apart(tracks: Sequence[PersonTrack], tcp_m: Points, at_s: Vector, lags_s: Vector) -> Floats:
    """Return the distance to the nearest person at each change and lag, on the floor and in space, (2, L, K), m."""
    apart = np.full((2, len(lags_s), len(at_s)), np.inf)
    asked_s = (at_s[None] - lags_s[:, None]).ravel()
    order = np.argsort(asked_s)
    for track in tracks:
        in_order = np.empty((len(asked_s), 3))
        in_order[order] = at_times(track, asked_s[order], bridge_s=BRIDGE_S)
        where = in_order.reshape(*apart.shape[1:], 3)
        off = in_plane(np.broadcast_to(tcp_m, where.shape), where) - tcp_m
        apart = np.fmin(apart, np.stack([np.hypot(off[..., 0], off[..., 1]), np.linalg.norm(off, axis=-1)]))
    return np.where(np.isinf(apart), np.nan, apart)


def _fit(log: RecordingCard, evidence: LagEvidence, lag: Lag | None, *, asked: bool) -> ClockFit | None:
    """Return the new clock of a log; None if it stays."""
    clock, rough = ClockFit.of(log.clock), evidence.rough
    if lag is None or rough is None:
        return replace(clock, warnings=(note("clock-not-coarse", reach_s=REACH_S), *clock.warnings)) if asked else None
    if not (lag.certain or (asked and log.clock.method == ASSUMED)):
        return None
    warnings = [note("clock-coarse")]
    doubt = None if rough.second is None else rough.second / rough.peak
    if doubt is not None and doubt >= AMBIGUOUS and lag.spread_m is None and rough.second_s is not None:
        warnings.append(note("clock-coarse-ambiguous", away_s=rough.second_s - rough.lag_s))
    return ClockFit(
        "coarse",
        clock.offset_s + lag.lag_s,
        clock.rate,
        tuple(warnings),
        residual_s=lag.residual_s,
        events=len(evidence.kind) if lag.spread_m is not None else None,
        correlation=round(rough.peak, 4),
        second_best=None if doubt is None else round(doubt, 4),
        second_best_s=None if rough.second_s is None else rough.second_s - rough.lag_s,
    )


def _with_clocks(session: Session, fits: Mapping[str, ClockFit]) -> Session:
    """Return a session with other clocks of some logs, and of those that share them."""
    fits = dict(fits)
    for log in session.recordings:
        if log.clock.same_as in fits:
            fits[log.id] = replace(fits[log.clock.same_as], same_as=log.clock.same_as)
    if not any(log.id in fits for log in session.recordings):
        return session
    logs = tuple(
        structs.replace(log, clock=fits[log.id].card(log.clock.kind)) if log.id in fits else log
        for log in session.recordings
    )
    starts, ends = zip(*(log.span_s for log in logs), strict=True)
    return replace(session, recordings=logs, span_s=(min(starts), max(ends)))
