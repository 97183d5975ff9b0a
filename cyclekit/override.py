"""Infer the speed override of a log that did not record it.

The source paper: "the ratio between the measured velocity and the velocity obtained from a run without the human
presence". Here that ratio is the rate at which the path's nominal time advances: for each task the fastest repetition
(or a run recorded without the operator) gives nominal time as a function of the place on the path, and the scaling of
another repetition is how fast it runs through that. This is the plain estimator: no plateaus are fitted, so values
near a change of level are blurred over one window. Where the levels are is the business of `steps`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.motion import RobotRun, Run
    from cyclekit.segment import Execution

    Vector = NDArray[np.float64]
    Parts = list[tuple[int, Vector]]

WINDOW_S = 0.04
"""Nominal time is differenced over this window: five controller cycles at 125 Hz."""
FLOOR_M_S = 0.02
"""Where the reference itself is slower than this, the ratio is noise over noise: unknown, not zero."""

HALT_S, HALT_M = 0.2, 2e-4
"""A robot that gets no farther than this in this time is halted; what its position does then is jitter."""


@dataclass(frozen=True)
class Reference:
    """Nominal time along one task's path.

    Attributes:
        phase: Fraction of the path's length, shape (K,), from 0 to 1, strictly increasing.
        nominal_s: Time at that phase at scaling 1, shape (K,), seconds.
        speed_m_s: Speed there, shape (K,), m/s.
        repetitions: How many runs of the task it was chosen from.
    """

    phase: Vector
    nominal_s: Vector
    speed_m_s: Vector
    repetitions: int


def infer_overrides(
    runs: Sequence[Run], executions: Sequence[Execution], reference_runs: Sequence[int] = ()
) -> tuple[list[Parts], dict[str, Reference]]:
    """Return the scaling of each run where the robot was on its way and a reference exists.

    Args:
        runs: Runs without scaling.
        executions: Their executions, from `segment`.
        reference_runs: Numbers of runs recorded with nobody in the cell; where a task occurs there, its fastest
            repetition in them is the reference, otherwise the fastest anywhere (if it occurs at least twice).

    Returns:
        Of each run, first row and values of every task with a reference; and the reference used per task.
    """
    legs: dict[str, list[tuple[int, int, int]]] = {}
    for execution in executions:
        for start, goal in pairwise(execution.visits):
            legs.setdefault(f"{start.place}->{goal.place}", []).append((execution.run, start.last, goal.first))
    references = {task: ref for task, rows in legs.items() if (ref := _reference(runs, rows, set(reference_runs)))}
    scaling: list[Parts] = [[] for _ in runs]
    for task, reference in references.items():
        for number, a, b in legs[task]:
            scaling[number].append((a, scaling_along(runs[number], a, b, reference)))
    return scaling, references


def _reference(runs: Sequence[Run], legs: list[tuple[int, int, int]], without: set[int]) -> Reference | None:
    among = [leg for leg in legs if leg[0] in without] or (legs if len(legs) > 1 else [])
    if not among:
        return None
    number, a, b = min(among, key=lambda leg: _lasts(runs[leg[0]], leg[1], leg[2]))
    part = runs[number].window(a, b)
    phase = path_phase(part)
    keep = np.concatenate([[True], np.diff(phase) > 0])
    return Reference(phase[keep], (part.t_s - part.t_s[0])[keep], part.speed_m_s[keep], len(legs))


def _lasts(run: Run, a: int, b: int) -> float:
    return run.time_at(b) - run.time_at(a)


def path_phase(part: RobotRun) -> Vector:
    """Return the fraction of the path's length covered at the rows of a window, shape (T,), from 0 to 1."""
    xyz = part.xyz_m
    step = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    half = max(1, round(HALT_S / 2 / max(float(np.median(np.diff(part.t_s))), 1e-4))) if len(step) else 1
    row = np.arange(len(step))
    moved = xyz[np.minimum(row + half, len(step))] - xyz[np.maximum(row - half, 0)]
    step[np.linalg.norm(moved, axis=1) < HALT_M] = 0.0  # else the jitter of a halted robot adds up to a way
    length = np.concatenate([[0.0], np.cumsum(step)])
    return np.asarray(length / max(float(length[-1]), 1e-12))


def scaling_along(run: Run, a: int, b: int, reference: Reference) -> Vector:
    """Return the scaling at rows a..b, shape (b - a + 1,), in [0, 1]; NaN where the reference is too slow to tell."""
    part = run.window(a, b)
    phase, t = path_phase(part), part.t_s
    nominal = np.interp(phase, reference.phase, reference.nominal_s)
    half = max(1, round(WINDOW_S / 2 / max(float(np.median(np.diff(t))), 1e-4)))
    row = np.arange(len(t))
    after, before = np.minimum(row + half, len(t) - 1), np.maximum(row - half, 0)
    ratio = (nominal[after] - nominal[before]) / np.maximum(t[after] - t[before], 1e-9)
    slow = np.interp(phase, reference.phase, reference.speed_m_s) < FLOOR_M_S
    return np.where(slow, np.nan, np.clip(ratio, 0.0, 1.0))
