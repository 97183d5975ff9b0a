"""Clocks tested by the logs: the place of anybody tells the robot's level of speed, but only at the true lag.

The clock of every tracker is tested, assumed or stated. An assumed one is aligned if the logs leave no doubt; a stated
one is contradicted, and aligned on request. Logs that share one offset are tested together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import structs

from cyclekit.alignment.clocks import ASSUMED, ClockFit
from cyclekit.alignment.clocks.explained import STEP_S, FoundLag, Instants, cells_of, find_lag, numbered
from cyclekit.alignment.clocks.response_lag import FINE_S, PlacesAndLevel, RefinedLag, refine_lag
from cyclekit.alignment.recording_clocks import of_one_kind
from cyclekit.dataset.cards import ClockTest, note
from cyclekit.people.activity import person_tracks
from cyclekit.people.tracks import at_times
from cyclekit.segmentation.stored_run import pieces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config import Source
    from cyclekit.dataset.cards import RecordingCard
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read
    from cyclekit.derive.over_sessions import Passes
    from cyclekit.people.tracks import PersonTrack
    from cyclekit.schema import Floats, Ints, Points, Vector
    from cyclekit.segmentation.stored_run import Run

MAX_PEOPLE = 8
"""Maximum number of people at once: a crowd tells nothing."""
BRIDGE_S = 0.3
"""Maximum gap in a track that is bridged, s."""
REACTION_S = (-0.3, 0.8)
"""A lag between these may be the reaction time of the safety function (0.5 s in UR's reduced mode, and a scanner's),
and contradicts no clock, s."""
GRIDS = ((0.0, 0.0), (0.25, 0.5), (0.5, 0.25), (0.75, 0.75))
"""By how many widths of a cell the grids of the refinement are moved along the axes of the floor: a lattice."""
NOBODY = 1 << 60
"""Label of an instant at which nobody is seen."""


@dataclass(frozen=True)
class _SameClock:
    """Logs of people that share one unknown offset: those of each session, with the runs of its robot."""

    sessions: tuple[tuple[tuple[RecordingCard, ...], tuple[Run, ...]], ...]

    @property
    def logs(self) -> list[RecordingCard]:
        return [log for logs, _ in self.sessions for log in logs]


class _Tested(NamedTuple):
    """What the logs say about a clock."""

    found: FoundLag
    refined: RefinedLag | None

    @property
    def lag_s(self) -> float:
        return self.found.lag_s if self.refined is None else self.refined.lag_s

    @property
    def contradicts(self) -> bool:
        """Whether the clock is wrong for certain."""
        return self.found.certain and not REACTION_S[0] <= self.lag_s <= REACTION_S[1]


def with_tested_clocks(
    passes: Passes,
    sessions: Sequence[Session],
    runs: Sequence[Run],
    sources: Mapping[str, Source | None],
    read: Read,
    *,
    asked: bool,
) -> list[Session]:
    """Return the sessions, their trackers' clocks tested by the logs, and those that are wrong aligned or named.

    Args:
        passes: Runs the work on the sessions.
        sessions: The sessions.
        runs: All runs of the robot, with logged or inferred scaling.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table).
        asked: Use the lag of every assumed clock, certain or not, and of stated clocks that the logs contradict.
    """
    test = partial(_tested, sources=sources, read=read, asked=asked)
    groups = _groups(sessions, runs, sources)
    tested = passes.over(test, groups, "speed", "clocks") if groups else []
    together = _assumed_together(groups, tested, sources)
    again = passes.over(test, together, "speed", "clocks") if together else []
    own = [log for session in sessions for log in session.recordings if log.clock.method == "own"]
    began_s = {log.session: log.first_s for log in own}
    fits: dict[str, ClockFit] = {}
    for group, found in zip([*groups, *together], [*tested, *again], strict=True):
        if group in together and not (found is not None and found.found.certain):
            continue
        fits |= {log.id: _fit(log, found, began_s[log.session], asked=asked) for log in group.logs}
    fits |= _in_other_parts(sessions, fits)
    return [_with_clocks(session, fits) for session in sessions]


def _in_other_parts(sessions: Sequence[Session], fits: Mapping[str, ClockFit]) -> dict[str, ClockFit]:
    """Return clocks that put a log of several parts of a robot's log outside of those to which nothing relates it.

    Only the first part may be assumed to start with the log: nobody knows how long a restart took.
    """
    first: set[str] = set()
    away: dict[str, ClockFit] = {}
    for session in sessions:
        for log in session.recordings:
            if log.id in fits and log.shown in first and fits[log.id].method == ASSUMED:
                end_s = max(one.span_s[1] for one in session.recordings if "people" not in one.tables)
                said = (note("clock-part-unknown"), *fits[log.id].warnings[1:])
                away[log.id] = replace(fits[log.id], offset_s=end_s + 1.0 - log.first_s, warnings=said)
        first |= {log.shown for log in session.recordings}
    return away


def _groups(sessions: Sequence[Session], runs: Sequence[Run], sources: Mapping[str, Source | None]) -> list[_SameClock]:
    """Return the logs of people to test: stated clocks by source, assumed ones by session and clock."""
    stated: dict[tuple[str, ...], list[tuple[tuple[RecordingCard, ...], tuple[Run, ...]]]] = {}
    alone: list[_SameClock] = []
    for session in sessions:
        mine = tuple(runs[number] for number in session.runs)
        kinds: dict[tuple[str, ...], list[RecordingCard]] = {}
        for log in session.recordings:
            known = log.clock.method in ("own", "same-log") or log.clock.same_as is not None
            if mine and "people" in log.tables and not known:
                kinds.setdefault((log.clock.method, *of_one_kind(log, sources)), []).append(log)
        for kind, logs in kinds.items():
            spans = sorted(log.span_s for log in logs)
            if kind[0] != ASSUMED:
                stated.setdefault(kind, []).append((tuple(logs), mine))
            elif all(before[1] <= after[0] for before, after in pairwise(spans)):
                alone.append(_SameClock(((tuple(logs), mine),)))
            else:
                alone += [_SameClock((((log,), mine),)) for log in logs]
    return [*(_SameClock(tuple(parts)) for parts in stated.values()), *alone]


def _assumed_together(
    groups: Sequence[_SameClock], tested: Sequence[_Tested | None], sources: Mapping[str, Source | None]
) -> list[_SameClock]:
    """Return the assumed clocks of each source that are not certain alone, as one: devices may be started together."""
    left: dict[tuple[str, ...], list[_SameClock]] = {}
    for group, found in zip(groups, tested, strict=True):
        if group.logs[0].clock.method == ASSUMED and not (found is not None and found.found.certain):
            left.setdefault(of_one_kind(group.logs[0], sources), []).append(group)
    return [_SameClock(tuple(part for one in some for part in one.sessions)) for some in left.values() if len(some) > 1]


def _tested(group: _SameClock, *, sources: Mapping[str, Source | None], read: Read, asked: bool) -> _Tested | None:
    """Return what the logs say about a clock; None if they say nothing."""
    seen, coarse = [], []
    for logs, runs in group.sessions:
        tracks, (t_s, tcp_m, level) = person_tracks(logs, sources, read), _motion(runs)
        if not tracks or len(t_s) < 2:
            continue
        seen.append((tracks, [log.span_s for log in logs], t_s, tcp_m, level))
        label, label_at = _where_people_are(*seen[-1][:2], STEP_S)
        robot, robot_at = _on_grid(t_s, level[:, None], STEP_S)
        coarse.append(Instants(label, label_at, robot.T, robot_at))
    if not coarse or any(len(one.label) > MAX_PEOPLE for one in coarse) or (found := find_lag(_equal(coarse))) is None:
        return None
    robots = [_on_grid(t_s, np.column_stack([tcp_m[:, :2], level]), FINE_S) for _, _, t_s, tcp_m, level in seen]

    def in_cells(moved: tuple[float, float]) -> list[PlacesAndLevel]:
        people = [_where_people_are(*one[:2], FINE_S, moved) for one in seen]
        labels = numbered([*(label for label, _ in people), *(cells_of(rows[:, :2], moved) for rows, _ in robots)])
        return [
            PlacesAndLevel(labels[number], people[number][1], labels[len(people) + number], rows[:, 2], at)
            for number, (rows, at) in enumerate(robots)
        ]

    first = [in_cells(GRIDS[0])]
    tested = _Tested(found, refine_lag(first, found.lag_s))
    if tested.refined is None or not (asked or tested.contradicts):
        return tested  # the clock stays as it is
    return _Tested(found, refine_lag([*first, *map(in_cells, GRIDS[1:])], found.lag_s))


def _equal(sessions: Sequence[Instants]) -> list[Instants]:
    """Return the sessions with one number of rows of people."""
    most = max(len(one.label) for one in sessions)
    return [
        one._replace(label=np.pad(one.label, ((0, most - len(one.label)), (0, 0)), constant_values=-1))
        for one in sessions
    ]


def _where_people_are(
    tracks: Sequence[PersonTrack],
    spans_s: Sequence[tuple[float, float]],
    step_s: float,
    moved: tuple[float, float] = (0.0, 0.0),
) -> tuple[Ints, int]:
    """Return the cells of people at each instant (K, N), NOBODY where nobody is seen, and the first instant's number.

    Outside of the logs nothing is known.
    """
    first, last = min(span[0] for span in spans_s), max(span[1] for span in spans_s)
    begin = int(np.ceil(first / step_s))
    at_s: Vector = np.arange(begin, int(last / step_s) + 1).astype(np.float64) * step_s
    label = np.array([cells_of(one[:, :2], moved) for one in people_at_once(tracks, at_s)] or [np.full(len(at_s), -1)])
    logged = np.any([(at_s >= span[0]) & (at_s <= span[1]) for span in spans_s], axis=0)
    label[0] = np.where(logged & (label < 0).all(axis=0), NOBODY, label[0])
    return label, begin


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
    """Return time (T,), TCP (T, 3) and scaling (T,) of rows about 0.02 s apart."""
    times: list[Vector] = [np.empty(0)]
    tcp: list[Points] = [np.empty((0, 3))]
    scaling: list[Vector] = [np.empty(0)]
    for period_s, part in ((run.period_s, part) for run in runs for _, part in pieces(run)):
        some = slice(None, None, max(1, round(0.4 * FINE_S / period_s)))
        times.append(part.t_s[some])
        tcp.append(part.xyz_m[some])
        scaling.append(np.asarray(part.scaling[some], float))
    return np.concatenate(times), np.concatenate(tcp), np.concatenate(scaling)


def _on_grid(t_s: Vector, rows: Floats, step_s: float) -> tuple[Floats, int]:
    """Return the nearest rows (N, C) at the instants of a grid, NaN where none is near, and the first instant's number.

    The row before an instant would make the level late by half of the time between rows.
    """
    begin, period_s = int(np.ceil(t_s[0] / step_s)), float(np.median(np.diff(t_s)))
    at_s = np.arange(begin, int(t_s[-1] / step_s) + 1) * step_s
    nearest = np.searchsorted(t_s, at_s + period_s / 2.0, side="right") - 1
    near = at_s - t_s[nearest] <= max(0.1, 2.0 * period_s)
    return np.where(near[:, None], rows[nearest], np.nan), begin


def _fit(log: RecordingCard, tested: _Tested | None, began_s: float, *, asked: bool) -> ClockFit:
    """Return the clock of a log, with what the logs say about it; the robot's time begins at `began_s`."""
    clock, assumed = ClockFit.of(log.clock), log.clock.method == ASSUMED
    if tested is None:
        return _warned(clock, "clock-not-by-logs") if asked and assumed else clock
    found, lag_s = tested.found, tested.lag_s
    test = ClockTest(
        lag_s=lag_s, explained=found.explained, next_best=found.next_best, here=found.here, certain=found.certain
    )
    clock = replace(clock, test=test)
    if not (tested.contradicts or (asked and assumed)):
        return clock
    values = {"lag_s": lag_s, "explained": found.explained, "next_best": found.next_best}
    line = _line(clock, tested)
    if not (assumed or asked):
        rate = {} if line.rate == 1.0 else {"rate": line.rate}
        here = {} if found.here is None else {"here": found.here}
        return _warned(clock, "clock-contradicted", offset_s=line.offset_s + began_s, **values, **rate, **here)
    code = "clock-by-logs" if found.certain else "clock-by-logs-unsure"
    return replace(line, warnings=(note(code, **values, away_s=found.next_s - found.lag_s),))


def _line(clock: ClockFit, tested: _Tested) -> ClockFit:
    """Return the clock with the lag that the logs show."""
    refined = tested.refined or RefinedLag(tested.lag_s, 0.0, 0.0, STEP_S)
    return replace(
        clock,
        method="logs",
        offset_s=clock.offset_s * (1.0 + refined.drift) + refined.lag_s - refined.drift * refined.about_s,
        rate=clock.rate * (1.0 + refined.drift),
        residual_s=refined.residual_s,
    )


def _warned(clock: ClockFit, code: str, **values: float) -> ClockFit:
    return replace(clock, warnings=(note(code, **values), *clock.warnings))


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
