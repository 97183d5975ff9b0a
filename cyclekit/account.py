"""Where every second of an execution goes: nominal motion, safety loss, process dwell, waiting.

A task is the motion from one place to the next and the stand at its goal. While it moves, the path's nominal time
advances at the scaling s, so nominal = integral of s, safety loss = integral of (1 - s); an operator's speed slider
takes its own share, and a paused program waits. A robot that has done its work at a place and is not allowed to leave
stands there at s = 0: that tail of the stand is safety loss of the next motion,
as far as the stand exceeds the place's usual dwell. A halt that begins a hair before the goal is told likewise.
Which places and executions there are is found by `segment`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.motion import Part, RobotRun, moving_slider
from cyclekit.steps import find_staircase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.motion import Run
    from cyclekit.segment import Execution, Visit

    Vector = NDArray[np.float64]

UNSEEN_S = TAIL_S = 0.5
"""At low scaling a jerk-limited motion is too slow to be seen for up to so long at its start and its end."""
SLOW = 0.05
"""At a lower scaling the speed does not tell how a motion began."""
SEEN = 9.0
"""The beginning of a motion is followed from the lowest speed that is seen to so many times that."""
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
    slider_loss_s: float | None
    safety_loss_s: float | None
    dwell_s: float
    wait_s: float
    start_row: int
    arrival_row: int


def stand_s(run: Run, visit: Visit) -> float:
    """Return how long a stand lasted, seconds."""
    return left_s(run, visit) - arrived_s(run, visit)


def left_s(run: Run, visit: Visit) -> float:
    """Return when the robot left, session time: a little before the first row in which it is seen to move."""
    first, last = _rows_around(run, run.time_at(visit.last))
    return _began(run.window(first, last), visit.last - first)


def arrived_s(run: Run, visit: Visit) -> float:
    """Return when the robot arrived, session time: a little behind the last row in which it is seen to move."""
    first, last = _rows_around(run, run.time_at(visit.first))
    part = run.window(first, last)
    back = RobotRun(-part.t_s[::-1], part.xyz_m[::-1], part.speed_m_s[::-1], part.scaling[::-1])
    return -_began(back, last - visit.first)


def _rows_around(run: Run, t_s: float) -> tuple[int, int]:
    first, last = run.row_at(np.array([t_s - UNSEEN_S, t_s + UNSEEN_S])).tolist()
    return first, min(last + 1, run.rows - 1)


def _began(part: RobotRun, at: int) -> float:
    """Return when a motion began of which row `at` is the last one at rest.

    At its beginning the speed of a jerk-limited motion grows with the square of nominal time, that is, the root of
    speed over scaling grows linearly. What is seen of it, from the lowest speed that is told from noise to nine times
    that, is followed back to zero.
    """
    t, known = part.t_s, np.flatnonzero(np.isfinite(part.scaling))
    s = fill_nearest(part.scaling, known) if len(known) else np.ones(len(t))
    nominal = np.concatenate([[0.0], np.cumsum(s[:-1] * np.diff(t))])
    speed = part.speed_m_s / np.maximum(s, SLOW)
    after = np.flatnonzero(speed[at + 1 :] > SEEN * speed[min(at + 1, len(t) - 1)])
    seen = np.arange(at + 1, at + 1 + int(after[0]) if len(after) else at + 1)
    seen = seen[s[seen] > SLOW]
    if len(seen) < 3:  # it jumped to its speed
        return float(t[at])
    slope, level = np.polyfit(nominal[seen], np.sqrt(speed[seen]), 1)
    if slope <= 0.0:
        return float(t[at])
    begin = float(np.interp(-level / slope, nominal, t)) if nominal[-1] > 0.0 else float(t[at])
    return min(begin, float(t[at + 1]))


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


def halts_at_places(runs: Sequence[Run], executions: Sequence[Execution], slowest: float) -> list[list[Part]]:
    """Return where the inferred scaling of each run is 0, since a stand was prolonged by a halt and not by waiting.

    From motion alone both look alike. But who halted the robot is still near when it may leave, so it leaves at the
    lowest speed there is; a robot that waited for a part leaves at whatever speed is allowed. A cell that knows only
    halt and full speed cannot be told apart so: there the excess stays waiting.

    Args:
        runs: Runs of inferred scaling.
        executions: Their executions.
        slowest: Speeds below this are the lowest there is, from `slowest_speed`.

    Returns:
        Of each run, the rows at which it was halted so.
    """
    usual = usual_dwells(runs, executions)
    halts: list[list[Part]] = [[] for _ in runs]
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
                none = np.zeros(visit.last + 1 - begin)
                halts[execution.run].append(Part(begin, none, none, none.astype(np.int8)))
    return halts


def slowest_speed(scaling: Sequence[NDArray[np.floating[Any]]]) -> float:
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
    departure = left_s(run, visits[0])
    home = visits[0].place
    for before, visit in pairwise(visits):
        final = visit is visits[-1]
        stand = stand_s(run, visit)
        usual = dwells.get(visit.place, 0.0 if final else stand)
        before_goal, before_leaving = halted_s(run, visit)
        head = before_goal if final else min(before_goal, max(0.0, stand - usual))
        tail = 0.0 if final else min(before_leaving, max(0.0, stand - head - usual))
        if tail > 0.0 and stand - head - tail - usual < UNSEEN_S:  # halted before it was seen to move
            tail = stand - head - usual
        arrival, stand = max(departure, arrived_s(run, visit) + head), stand - head
        if final:
            stand = 0.0 if visit.place == home else min(stand, usual)
        dwell, wait = _dwell_and_wait(stand - tail, usual)
        start_row, arrival_row = run.row_at(np.array([departure, arrival])).tolist()
        motion = motion_time(run, departure, arrival)
        legs.append(
            Leg(
                start_place=before.place,
                goal_place=visit.place,
                start_s=departure,
                arrival_s=arrival,
                end_s=arrival + dwell + wait,
                nominal_s=motion.nominal_s,
                slider_loss_s=motion.slider_loss_s,
                safety_loss_s=motion.safety_loss_s,
                dwell_s=dwell,
                wait_s=wait + motion.paused_s,
                start_row=start_row,
                arrival_row=arrival_row,
            )
        )
        departure = arrival + dwell + wait
    return legs


def _dwell_and_wait(stand: float, usual: float) -> tuple[float, float]:
    """Split an unhindered stand: up to half as much again as usual is process, what is beyond is waiting."""
    return (stand, 0.0) if stand <= 1.5 * usual + 0.2 else (usual, stand - usual)


@dataclass(frozen=True)
class Motion:
    """How long a motion takes at full speed and what it lost, seconds; None where the scaling is mostly unknown."""

    nominal_s: float | None
    slider_loss_s: float | None
    safety_loss_s: float | None
    paused_s: float


def motion_time(run: Run, start_s: float, end_s: float) -> Motion:
    """Return where the time of a motion went, from `start_s` to `end_s`; the parts add up to it.

    What a row says holds until the next row. Short unknown stretches take the nearest known scaling. While the program
    is paused nobody is slowed down. A motion at scaling s and slider f advances by s f: what it loses to safety is the
    integral of 1 - s, and to the slider that of s (1 - f).
    """
    first, last = run.row_at(np.array([start_s, end_s])).tolist()
    part = run.window(first, last)
    lasts = np.diff(np.append(part.t_s, end_s))
    lasts[0] -= start_s - part.t_s[0]
    paused = np.zeros(len(lasts), np.bool_)
    for halt in run.halts:
        paused[max(halt.first - first, 0) : max(halt.last + 1 - first, 0)] = True
    paused_s = float(lasts[paused].sum())
    s, lasts = part.scaling[~paused], lasts[~paused]
    known = np.flatnonzero(np.isfinite(s))
    if len(s) == 0 or len(known) < 0.5 * len(s):
        return Motion(None, None, None, paused_s)
    s = fill_nearest(s, known)
    slider = moving_slider(run.slider_at(first, last), last + 1 - first)[~paused]
    slider_loss = float((s * (1.0 - slider)) @ lasts)
    safety_loss = float((1.0 - s) @ lasts)
    return Motion(end_s - start_s - paused_s - slider_loss - safety_loss, slider_loss, safety_loss, paused_s)


def fill_nearest(s: NDArray[np.float64], known: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return `s` (T,) with every unknown entry replaced by the nearest of the `known` ones (indices, ascending)."""
    row = np.arange(len(s))
    right = np.minimum(np.searchsorted(known, row), len(known) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.where(np.abs(known[left] - row) <= np.abs(known[right] - row), known[left], known[right])
    return np.asarray(s[nearer])
