"""Logs on the even grids on which their clocks are tested: where people are, states of signals, motion of the robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.alignment.clocks.explained import STEP_S, Instants, cells_of
from cyclekit.alignment.clocks.response_lag import FINE_S
from cyclekit.dataset.signals import SignalChanges, values_of
from cyclekit.people.tracks import at_times
from cyclekit.segmentation.stored_run import pieces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards import RecordingCard
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.people.tracks import PersonTrack
    from cyclekit.schema import Floats, Ints, Points, Vector
    from cyclekit.segmentation.stored_run import Run

MAX_PEOPLE, MAX_SIGNALS = 8, 8
"""Maximum number of people at once, as a crowd tells nothing, and of signals of a log: limits of time. Half and twice
of the signals find the same lag of a PLC's trace to 0.01 s."""
BRIDGE_S = 0.3
"""Maximum gap in a track that is bridged, s; half and twice of it find the same lags in ten simulated pairs."""
NOBODY = 1 << 60
"""Label of an instant at which nobody is seen."""


def where_people_are(
    tracks: Sequence[PersonTrack],
    spans_s: Sequence[tuple[float, float]],
    step_s: float,
    cell_m: float,
    moved: tuple[float, float] = (0.0, 0.0),
) -> tuple[Ints, int]:
    """Return the cells of people at each instant (K, N), NOBODY where nobody is seen, and the first instant's number.

    Outside of the logs nothing is known.
    """
    first, last = min(span[0] for span in spans_s), max(span[1] for span in spans_s)
    begin = int(np.ceil(first / step_s))
    at_s: Vector = np.arange(begin, int(last / step_s) + 1).astype(np.float64) * step_s
    label = np.array(
        [cells_of(one[:, :2], cell_m, moved) for one in people_at_once(tracks, at_s)] or [np.full(len(at_s), -1)]
    )
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


def signals_of(log: RecordingCard, read: Read, stored: Stored) -> dict[str, SignalChanges]:
    """Return the values over time of the signals of a log, session time: those that change most, but stay a while."""
    told = {
        name: one._replace(t_s=one.t_s * log.clock.rate + log.clock.offset_s)
        for name, one in values_of(log, read, stored).items()
        if 1 < len(one.t_s) < log.duration_s / STEP_S
    }
    return dict(sorted(told.items(), key=lambda item: -len(item[1].t_s))[:MAX_SIGNALS])


def states_of(
    told: Sequence[tuple[tuple[float, float], Mapping[str, SignalChanges]]],
    codes: Mapping[tuple[str, str], int],
    step_s: float,
) -> tuple[Ints, int]:
    """Return the state of each signal at each instant (K, N), negative = unknown, and the first instant's number."""
    first, last = min(span[0] for span, _ in told), max(span[1] for span, _ in told)
    begin = int(np.ceil(first / step_s))
    at_s = np.arange(begin, int(last / step_s) + 1) * step_s
    names = sorted({name for name, _ in codes})
    label = np.full((len(names), len(at_s)), -1)
    for span, mine in told:
        logged = (at_s >= span[0]) & (at_s <= span[1])
        for name, one in mine.items():
            numbers = np.array([-1, *(codes[name, value] for value in one.value.tolist())])
            label[names.index(name), logged] = numbers[np.searchsorted(one.t_s, at_s[logged], side="right")]
    return label, begin


def motion_of(runs: Sequence[Run]) -> tuple[Vector, Points, Vector]:
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


def on_grid(t_s: Vector, rows: Floats, step_s: float) -> tuple[Floats, int]:
    """Return the nearest rows (N, C) at the instants of a grid, NaN where none is near, and the first instant's number.

    The row before an instant would make the level late by half of the time between rows.
    """
    begin, period_s = int(np.ceil(t_s[0] / step_s)), float(np.median(np.diff(t_s)))
    at_s = np.arange(begin, int(t_s[-1] / step_s) + 1) * step_s
    nearest = np.searchsorted(t_s, at_s + period_s / 2.0, side="right") - 1
    near = at_s - t_s[nearest] <= max(0.1, 2.0 * period_s)
    return np.where(near[:, None], rows[nearest], np.nan), begin


def with_equal_rows(sessions: Sequence[Instants]) -> list[Instants]:
    """Return the sessions with one number of rows of people."""
    most = max(len(one.label) for one in sessions)
    return [
        one._replace(label=np.pad(one.label, ((0, most - len(one.label)), (0, 0)), constant_values=-1))
        for one in sessions
    ]
