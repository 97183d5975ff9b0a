"""The distance of the nearest link, where the log holds joint angles and they prove which arm it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.config.arms import joint_points, recognise_arm
from cyclekit.learning.rules.distances import to_links

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset

_JOINTS = 6
_ENOUGH = 400
"""So many samples tell which arm it is."""


def to_nearest_link(
    dataset: Dataset,
    executions: NDArray[np.object_],
    t_s: NDArray[np.float64],
    robot_m: NDArray[np.float64],
    human_m: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Return the distance of the nearest link at each sample, shape (N,), m; None where the arm is not known.

    Args:
        dataset: Whose joint angles at their native rate.
        executions: Execution of each sample, shape (N,), those of one together.
        t_s: Session times, shape (N,).
        robot_m: The TCP, shape (N, 3), m, by which the arm is recognised.
        human_m: The operator, shape (N, 3), m.
    """
    first = np.flatnonzero(np.concatenate([[True], executions[1:] != executions[:-1]]))
    angles = np.full((len(t_s), _JOINTS), np.nan)
    for begin, end in zip(first.tolist(), [*first[1:].tolist(), len(t_s)], strict=True):
        joints = dataset.native_robot(str(executions[begin]))
        names = [f"q{i}_rad" for i in range(_JOINTS)]
        if joints is None or not set(names) <= set(joints.columns) or f"q{_JOINTS}_rad" in joints.columns:
            return None
        known = joints.drop_nulls(names)
        if known.height > 1:
            at = known["t_s"].to_numpy()
            angles[begin:end] = np.column_stack([np.interp(t_s[begin:end], at, known[name]) for name in names])
    some = np.linspace(0, len(t_s) - 1, min(_ENOUGH, len(t_s))).astype(np.int64)
    arm = recognise_arm(angles[some], robot_m[some])
    if arm is None:
        return None
    points, _ = joint_points(arm.arm, angles)
    points = np.concatenate([points, robot_m[:, None]], axis=1)
    return to_links(points, human_m)
