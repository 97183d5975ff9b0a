"""Finds the stretches in which prediction and log differ most.

A single sample at a change of speed may differ by a whole level without effect, so stretches are ranked by the
integrated error, in seconds. Each is described by its worst sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.replay.execution import ReplayedExecution

MIN_DIFFERENCE = 0.05
"""Minimum difference of the scaling that counts."""


@dataclass(frozen=True)
class Miss:
    """A stretch in which prediction and log differ.

    Attributes:
        t_s: Worst sample, seconds of the execution.
        start_s, end_s: First and last sample, seconds of the execution.
        logged, predicted: Scaling at the worst sample.
        seconds: Integral of |predicted - logged|, s: the error of an estimate in this stretch.
        distance_m: Distance at the worst sample, m.
        robot_task: Task of the robot.
    """

    t_s: float
    start_s: float
    end_s: float
    logged: float
    predicted: float
    seconds: float
    distance_m: float
    robot_task: str | None


def prediction_errors(run: ReplayedExecution, most: int = 10) -> list[Miss]:
    """Return the stretches in which prediction and log of the moving robot differ most, largest error first."""
    if run.predicted is None or not len(run.t_s):
        return []
    off = np.abs(run.predicted - run.scaling)
    off[np.isnan(off) | np.array([moving is False for moving in run.moving], dtype=np.bool_)] = 0.0
    step_s = np.minimum(np.diff(run.t_s, append=run.t_s[-1] + run.period_s), 2 * run.period_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], off > MIN_DIFFERENCE, [False]]).astype(int)))
    found = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        worst = first + int(np.argmax(off[first:end]))
        found.append(
            Miss(
                t_s=float(run.t_s[worst]),
                start_s=float(run.t_s[first]),
                end_s=float(run.t_s[end - 1]),
                logged=float(run.scaling[worst]),
                predicted=float(run.predicted[worst]),
                seconds=float(np.sum(off[first:end] * step_s[first:end])),
                distance_m=float(run.distance_m[worst]),
                robot_task=run.robot_task[worst],
            )
        )
    return sorted(found, key=lambda miss: (-miss.seconds, miss.t_s))[:most]
