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

    from cyclekit.segment import Execution, RobotRun, Visit

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


def halted_s(run: RobotRun, visit: Visit) -> tuple[float, float]:
    """Return how long safety halted the robot at the beginning and at the end of a stand, seconds; 0 where unknown.

    At the beginning the robot is halted a hair before its goal: it stands away from where it rests afterwards. At the
    end it is not allowed to leave, or was halted a hair after it left.
    """
    t = run.t_s[visit.first : visit.last + 1]
    zero = run.scaling[visit.first : visit.last + 1] <= BLOCKED  # NaN compares false
    if not zero.any():
        return 0.0, 0.0
    leaving = _halt_from_end(-t[::-1], zero[::-1])
    if zero.all():
        return 0.0, leaving
    there = _at_rest(run.xyz_m[visit.first : visit.last + 1], ~zero)
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


def usual_dwells(runs: Sequence[RobotRun], executions: Sequence[Execution]) -> dict[str, float]:
    """Return the usual dwell per place, seconds: short (the lowest tenth) among the stands that no halt prolonged.

    A stand is process and then, at times, waiting; so the process shows in the short ones. The first and last stand of
    an execution are not counted: there the robot waits for the next cycle.
    """
    stands: dict[str, list[tuple[bool, float]]] = {}
    for execution in executions:
        run = runs[execution.run]
        for visit in execution.visits[1:-1]:
            stand = float(run.t_s[visit.last] - run.t_s[visit.first])
            stands.setdefault(visit.place, []).append((any(halted_s(run, visit)), stand))
    dwells = {}
    for place, seen in stands.items():
        unhindered = [stand for blocked, stand in seen if not blocked]
        dwells[place] = float(np.quantile(unhindered, 0.1)) if unhindered else min(stand for _, stand in seen)
    return dwells


def with_halts_at_places(runs: Sequence[RobotRun], executions: Sequence[Execution]) -> list[RobotRun]:
    """Return runs of inferred scaling with scaling 0 where a stand was prolonged by a halt rather than by waiting.

    From motion alone both look alike. But who halted the robot is still near when it may leave, so it leaves at the
    lowest speed there is; a robot that waited for a part leaves at whatever speed is allowed. A cell that knows only
    halt and full speed cannot be told apart so: there the excess stays waiting.
    """
    slowest = _slowest_speed(runs)
    usual = usual_dwells(runs, executions)
    scaling = [run.scaling.copy() for run in runs]
    for execution in executions:
        run, values = runs[execution.run], scaling[execution.run]
        for visit in execution.visits[1:-1]:
            stand = float(run.t_s[visit.last] - run.t_s[visit.first])
            if _dwell_and_wait(stand, usual[visit.place])[1] == 0.0:
                continue
            end = int(np.searchsorted(run.t_s, run.t_s[visit.last] + LEAVING_S))
            leaving = values[visit.last : end]
            known = leaving[np.isfinite(leaving)]
            if len(known) and float(known[0]) < slowest:
                begin = int(np.searchsorted(run.t_s, run.t_s[visit.first] + usual[visit.place]))
                values[begin : visit.last + 1] = 0.0
    return [replace(run, scaling=values) for run, values in zip(runs, scaling, strict=True)]


def _slowest_speed(runs: Sequence[RobotRun]) -> float:
    """Return a bound between the lowest and the next level above halt; 0 where there are not two of them."""
    levels = find_staircase(np.concatenate([run.scaling[::SPARSE] for run in runs])).levels
    moving = [float(level) for level in levels if level > 0.02]
    return 0.5 * (moving[0] + moving[1]) if len(moving) > 1 else 0.0


def account(run: RobotRun, execution: Execution, dwells: Mapping[str, float]) -> list[Leg]:
    """Return the tasks of one execution, in order; they follow each other without a gap."""
    visits = execution.visits
    legs = []
    departure = float(run.t_s[visits[0].last])
    home = visits[0].place
    for before, visit in pairwise(visits):
        final = visit is visits[-1]
        stand = float(run.t_s[visit.last] - run.t_s[visit.first])
        usual = dwells.get(visit.place, 0.0 if final else stand)
        before_goal, before_leaving = halted_s(run, visit)
        head = before_goal if final else min(before_goal, max(0.0, stand - usual))
        tail = 0.0 if final else min(before_leaving, max(0.0, stand - head - usual))
        arrival_row = int(np.searchsorted(run.t_s, run.t_s[visit.first] + head - 1e-9))
        arrival, stand = float(run.t_s[arrival_row]), stand - head
        if final:
            stand = 0.0 if visit.place == home else min(stand, usual)
        dwell, wait = _dwell_and_wait(stand - tail, usual)
        start_row = int(np.searchsorted(run.t_s, departure, side="right")) - 1
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


def nominal_time(run: RobotRun, start_s: float, start_row: int, end_row: int) -> float | None:
    """Return the integral of the scaling from `start_s` to row `end_row`, seconds; None where it is mostly unknown.

    The scaling of a row holds until the next row. Short unknown stretches take the nearest known value.
    """
    s = run.scaling[start_row:end_row]
    known = np.flatnonzero(np.isfinite(s))
    if len(s) == 0 or len(known) < 0.5 * len(s):
        return None
    filled = fill_nearest(s, known)
    t = run.t_s[start_row : end_row + 1].copy()
    t[0] = start_s
    return float(filled @ np.diff(t))


def fill_nearest(s: NDArray[np.float64], known: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return `s` (T,) with every unknown entry replaced by the nearest of the `known` ones (indices, ascending)."""
    row = np.arange(len(s))
    right = np.minimum(np.searchsorted(known, row), len(known) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.where(np.abs(known[left] - row) <= np.abs(known[right] - row), known[left], known[right])
    return np.asarray(s[nearer])
