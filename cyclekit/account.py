"""Where every second of an execution goes: nominal motion, safety loss, process dwell, waiting.

A task is the motion from one place to the next and the stand at its goal. While it moves, the path's nominal time
advances at the scaling s, so nominal = integral of s, safety loss = integral of (1 - s). A robot that has done its work
at a place and is not allowed to leave stands there at s = 0: that tail of the stand is safety loss of the next motion,
as far as the stand exceeds the place's usual dwell. A halt that begins a hair before the goal is told likewise.
Which places and executions there are is found by `segment`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.steps import find_staircase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.motion import Run
    from cyclekit.segment import Execution, Visit

    Vector = NDArray[np.float64]

TAIL_S = 0.2
"""At low scaling a jerk-limited motion is too slow to be seen for so long at its start and its end."""
BLOCKED = 1e-6
"""Scaling at or below this is a halt."""
REST_M = 1e-5
"""Farther than this (or three times its jitter) from where it rests, a standing robot is still or again on its way."""

LEAVING_S = 2.0
"""How soon after a departure the scaling must be known to say whether the robot left slowed."""

SPARSE = 10
"""Levels are looked for in every tenth row: they are held for seconds."""
_LONG_ROWS = 1 << 18


@dataclass(frozen=True)
class Leg:
    """One executed task, all times in session seconds; see table TASKS of `schema` for the split.

    Attributes:
        start_row, arrival_row: Rows of the run between which the robot was on its way.
    """

    start_place: str
    goal_place: str
    start_s: float
    arrival_s: float
    end_s: float
    nominal_s: float | None
    safety_loss_s: float | None
    dwell_s: float
    wait_s: float
    start_row: int
    arrival_row: int


def stand_s(run: Run, visit: Visit) -> float:
    """Return how long a stand lasted, seconds."""
    return run.time_at(visit.last) - run.time_at(visit.first)


def halted_s(run: Run, visit: Visit) -> tuple[float, float]:
    """Return how long safety halted the robot at the beginning and at the end of a stand, seconds; 0 where unknown.

    At the beginning the robot is halted a hair before its goal: it stands away from where it rests afterwards. At the
    end it is not allowed to leave, or was halted a hair after it left. Of a stand of many minutes, which no halt fills,
    the first and the last minutes are looked at.
    """
    if visit.last - visit.first >= _LONG_ROWS:
        before, _ = halted_s(run, replace(visit, last=visit.first + _LONG_ROWS // 2))
        return before, halted_s(run, replace(visit, first=visit.last - _LONG_ROWS // 2))[1]
    stand = run.window(visit.first, visit.last)
    t = stand.t_s
    zero = stand.scaling <= BLOCKED  # NaN compares false
    if not zero.any():
        return 0.0, 0.0
    leaving = _halt_from_end(-t[::-1], zero[::-1])
    if zero.all():
        return 0.0, leaving
    there = _at_rest(stand.xyz_m, ~zero)
    arrived, left = int(there[0]), int(there[-1])
    before = float(t[arrived] - t[0]) if zero[:arrived].any() else 0.0
    after = float(t[-1] - t[left]) if zero[left:].any() else 0.0
    leaving = max(leaving, after)
    if before == leaving == 0.0:  # nearer to its goal than can be seen
        before = _halt_from_end(t, zero)
    return before, leaving


def _at_rest(xyz_m: NDArray[np.float64], free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rows of a stand, positions (T, 3), at which the robot is where it stands when it is `free` (T,) to move."""
    off = np.linalg.norm(xyz_m - np.median(xyz_m[free], axis=0), axis=1)
    return np.flatnonzero(off <= max(REST_M, 3.0 * float(np.median(off[free]))))


def _halt_from_end(t: NDArray[np.float64], zero: NDArray[np.bool_]) -> float:
    """Length of the halt that begins within TAIL_S of the first of `t` (ascending), counted from that first instant."""
    starts = np.flatnonzero(zero[: int(np.searchsorted(t, t[0] + TAIL_S, side="right"))])
    if not len(starts):
        return 0.0
    free = np.flatnonzero(~zero[int(starts[0]) :])
    end = int(starts[0]) + int(free[0]) if len(free) else len(t) - 1
    return float(t[end] - t[0])


def usual_dwells(runs: Sequence[Run], executions: Sequence[Execution]) -> dict[str, float]:
    """Return the usual dwell per place, seconds: short (the lowest tenth) among the stands that no halt prolonged.

    A stand is process and then, at times, waiting; so the process shows in the short ones. The first and last stand of
    an execution are not counted: there the robot waits for the next cycle.
    """
    stands: dict[str, list[tuple[bool, float]]] = {}
    for execution in executions:
        run = runs[execution.run]
        for visit in execution.visits[1:-1]:
            stand = stand_s(run, visit)
            stands.setdefault(visit.place, []).append((any(halted_s(run, visit)), stand))
    dwells = {}
    for place, seen in stands.items():
        unhindered = [stand for blocked, stand in seen if not blocked]
        dwells[place] = float(np.quantile(unhindered, 0.1)) if unhindered else min(stand for _, stand in seen)
    return dwells


def halts_at_places(
    runs: Sequence[Run], executions: Sequence[Execution], slowest: float
) -> list[list[tuple[int, Vector]]]:
    """Return where the inferred scaling of each run is 0, since a stand was prolonged by a halt and not by waiting.

    From motion alone both look alike. But who halted the robot is still near when it may leave, so it leaves at the
    lowest speed there is; a robot that waited for a part leaves at whatever speed is allowed. A cell that knows only
    halt and full speed cannot be told apart so: there the excess stays waiting.

    Args:
        runs: Runs of inferred scaling.
        executions: Their executions.
        slowest: Speeds below this are the lowest there is, from `slowest_speed`.

    Returns:
        Of each run, first row and zeros.
    """
    usual = usual_dwells(runs, executions)
    halts: list[list[tuple[int, Vector]]] = [[] for _ in runs]
    for execution in executions:
        run = runs[execution.run]
        for visit in execution.visits[1:-1]:
            if _dwell_and_wait(stand_s(run, visit), usual[visit.place])[1] == 0.0:
                continue
            end = int(run.row_at(np.array([run.time_at(visit.last) + LEAVING_S]))[0])
            leaving = run.window(visit.last, end).scaling
            known = leaving[np.isfinite(leaving)]
            if len(known) and float(known[0]) < slowest:
                begin = int(run.row_at(np.array([run.time_at(visit.first) + usual[visit.place]]))[0])
                halts[execution.run].append((begin, np.zeros(visit.last + 1 - begin)))
    return halts


def slowest_speed(scaling: Sequence[Vector]) -> float:
    """Return a bound between the lowest and the next level above halt; 0 where there are not two of them.

    Args:
        scaling: Scaling of stretches of motion, in the order of time.
    """
    levels = find_staircase(np.concatenate([values[::SPARSE] for values in scaling] or [np.empty(0)])).levels
    moving = [float(level) for level in levels if level > 0.02]
    return 0.5 * (moving[0] + moving[1]) if len(moving) > 1 else 0.0


def account(run: Run, execution: Execution, dwells: Mapping[str, float]) -> list[Leg]:
    """Return the tasks of one execution, in order; they follow each other without a gap."""
    visits = execution.visits
    legs = []
    departure = run.time_at(visits[0].last)
    home = visits[0].place
    for before, visit in pairwise(visits):
        final = visit is visits[-1]
        stand = stand_s(run, visit)
        usual = dwells.get(visit.place, 0.0 if final else stand)
        before_goal, before_leaving = halted_s(run, visit)
        head = before_goal if final else min(before_goal, max(0.0, stand - usual))
        tail = 0.0 if final else min(before_leaving, max(0.0, stand - head - usual))
        arrival_row = _first_row_at(run, visit, head)
        arrival, stand = run.time_at(arrival_row), stand - head
        if final:
            stand = 0.0 if visit.place == home else min(stand, usual)
        dwell, wait = _dwell_and_wait(stand - tail, usual)
        start_row = int(run.row_at(np.array([departure]))[0])
        nominal = nominal_time(run, departure, start_row, arrival_row)
        legs.append(
            Leg(
                start_place=before.place,
                goal_place=visit.place,
                start_s=departure,
                arrival_s=arrival,
                end_s=arrival + dwell + wait,
                nominal_s=nominal,
                safety_loss_s=None if nominal is None else arrival - departure - nominal,
                dwell_s=dwell,
                wait_s=wait,
                start_row=start_row,
                arrival_row=arrival_row,
            )
        )
        departure = arrival + dwell + wait
    return legs


def _dwell_and_wait(stand: float, usual: float) -> tuple[float, float]:
    """Split an unhindered stand: up to half as much again as usual is process, what is beyond is waiting."""
    return (stand, 0.0) if stand <= 1.5 * usual + 0.2 else (usual, stand - usual)


def _first_row_at(run: Run, visit: Visit, head_s: float) -> int:
    """Return the first row of a stand that lies `head_s` or more behind its begin."""
    if head_s <= 0.0:
        return visit.first
    stand = run.window(visit.first, min(visit.last, visit.first + _LONG_ROWS))
    return visit.first + min(int(np.searchsorted(stand.t_s, stand.t_s[0] + head_s - 1e-9)), stand.rows - 1)


def nominal_time(run: Run, start_s: float, start_row: int, end_row: int) -> float | None:
    """Return the integral of the scaling from `start_s` to row `end_row`, seconds; None where it is mostly unknown.

    The scaling of a row holds until the next row. Short unknown stretches take the nearest known value.
    """
    part = run.window(start_row, end_row)
    s = part.scaling[:-1]
    known = np.flatnonzero(np.isfinite(s))
    if len(s) == 0 or len(known) < 0.5 * len(s):
        return None
    filled = fill_nearest(s, known)
    t = part.t_s.copy()
    t[0] = start_s
    return float(filled @ np.diff(t))


def fill_nearest(s: NDArray[np.float64], known: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return `s` (T,) with every unknown entry replaced by the nearest of the `known` ones (indices, ascending)."""
    row = np.arange(len(s))
    right = np.minimum(np.searchsorted(known, row), len(known) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.where(np.abs(known[left] - row) <= np.abs(known[right] - row), known[left], known[right])
    return np.asarray(s[nearer])
