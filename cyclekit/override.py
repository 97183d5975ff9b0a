"""Infer the speed override of a log that did not record it.

The source paper: "the ratio between the measured velocity and the velocity obtained from a run without the human
presence". Here that ratio is the rate at which the path's nominal time advances: for each task the fastest repetition
(or a run recorded without the operator) gives nominal time as a function of the place on the path, and the scaling of
another repetition is how fast it runs through that. This is the plain estimator: no plateaus are fitted, so values
near a change of level are blurred over one window. Where the levels are is the business of `steps`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.segment import Execution, RobotRun

    Vector = NDArray[np.float64]

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
    runs: Sequence[RobotRun], executions: Sequence[Execution], reference_runs: Sequence[int] = ()
) -> tuple[list[RobotRun], dict[str, Reference]]:
    """Return the runs with `scaling` filled in where the robot was on its way and a reference exists.

    Args:
        runs: Runs without scaling.
        executions: Their executions, from `segment`.
        reference_runs: Numbers of runs recorded with nobody in the cell; where a task occurs there, its fastest
            repetition in them is the reference, otherwise the fastest anywhere (if it occurs at least twice).

    Returns:
        The runs, and the reference used per task. Dwells, and tasks without a reference, stay NaN.
    """
    legs: dict[str, list[tuple[int, int, int]]] = {}
    for execution in executions:
        for start, goal in pairwise(execution.visits):
            legs.setdefault(f"{start.place}->{goal.place}", []).append((execution.run, start.last, goal.first))
    references = {task: ref for task, rows in legs.items() if (ref := _reference(runs, rows, set(reference_runs)))}
    scaling = [np.full(len(run.t_s), np.nan) for run in runs]
    for task, reference in references.items():
        for number, a, b in legs[task]:
            scaling[number][a : b + 1] = scaling_along(runs[number], a, b, reference)
    return [replace(run, scaling=values) for run, values in zip(runs, scaling, strict=True)], references


def _reference(runs: Sequence[RobotRun], legs: list[tuple[int, int, int]], without: set[int]) -> Reference | None:
    among = [leg for leg in legs if leg[0] in without] or (legs if len(legs) > 1 else [])
    if not among:
        return None
    number, a, b = min(among, key=lambda leg: float(runs[leg[0]].t_s[leg[2]] - runs[leg[0]].t_s[leg[1]]))
    run = runs[number]
    phase = path_phase(run, a, b)
    keep = np.concatenate([[True], np.diff(phase) > 0])
    t = run.t_s[a : b + 1] - run.t_s[a]
    return Reference(phase[keep], t[keep], run.speed_m_s[a : b + 1][keep], len(legs))


def path_phase(run: RobotRun, a: int, b: int) -> Vector:
    """Return the fraction of the path's length covered at rows a..b, shape (b - a + 1,), from 0 to 1."""
    xyz = run.xyz_m[a : b + 1]
    step = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    half = max(1, round(HALT_S / 2 / max(float(np.median(np.diff(run.t_s[a : b + 1]))), 1e-4))) if len(step) else 1
    row = np.arange(len(step))
    moved = xyz[np.minimum(row + half, len(step))] - xyz[np.maximum(row - half, 0)]
    step[np.linalg.norm(moved, axis=1) < HALT_M] = 0.0  # else the jitter of a halted robot adds up to a way
    length = np.concatenate([[0.0], np.cumsum(step)])
    return np.asarray(length / max(float(length[-1]), 1e-12))


def scaling_along(run: RobotRun, a: int, b: int, reference: Reference) -> Vector:
    """Return the scaling at rows a..b, shape (b - a + 1,), in [0, 1]; NaN where the reference is too slow to tell."""
    phase = path_phase(run, a, b)
    t = run.t_s[a : b + 1]
    nominal = np.interp(phase, reference.phase, reference.nominal_s)
    half = max(1, round(WINDOW_S / 2 / max(float(np.median(np.diff(t))), 1e-4)))
    row = np.arange(len(t))
    after, before = np.minimum(row + half, len(t) - 1), np.maximum(row - half, 0)
    ratio = (nominal[after] - nominal[before]) / np.maximum(t[after] - t[before], 1e-9)
    slow = np.interp(phase, reference.phase, reference.speed_m_s) < FLOOR_M_S
    return np.where(slow, np.nan, np.clip(ratio, 0.0, 1.0))
