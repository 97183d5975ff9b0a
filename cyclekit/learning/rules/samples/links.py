"""Distance of the nearest link, for logs with joint angles from which the arm is recognised."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.config.arms import recognise_arm
from cyclekit.dataset.cards.rule import PoseCard
from cyclekit.learning.rules.samples.distances import to_links

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import polars as pl
    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset

_JOINTS = 6
ANGLES = tuple(f"q{joint}_rad" for joint in range(_JOINTS + 1))
"""Columns of joint angles to read: those of an arm, and one more that it must not have."""
CUBE_M, MAX_POSES = 0.04, 2000
"""Edge length, m, of cubes of TCP positions that share a pose, and maximum number of poses stored."""
_NEAR, _MIN_M = 4, 1e-3
"""Number of nearest poses that are averaged with weights 1 / distance, and the offset of that distance, m."""
_ENOUGH = 400
"""Number of samples by which the arm is recognised."""


class ArmPoses:
    """Positions of the links for a position of the TCP, interpolated between logged poses."""

    def __init__(self, poses: Sequence[PoseCard]) -> None:
        """Store logged poses; at least one."""
        from scipy.spatial import cKDTree  # slow to import

        self._tree = cKDTree([pose.tcp_m for pose in poses])
        self._joints_m = np.array([pose.joints_m for pose in poses])

    def points(self, robot_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints from base to TCP, shape (N, J, 3), m, for positions of the TCP, shape (N, 3), m."""
        apart, near = self._tree.query(robot_m, k=min(_NEAR, self._tree.n))
        apart, near = apart.reshape(len(robot_m), -1), near.reshape(len(robot_m), -1)
        weight = 1.0 / (apart + _MIN_M)
        joints = np.einsum("nk,nkjx->njx", weight / weight.sum(axis=1, keepdims=True), self._joints_m[near])
        return np.concatenate([joints, robot_m[:, None]], axis=1)


def poses_of(dataset: Dataset, executions: Sequence[str]) -> tuple[PoseCard, ...]:
    """Return the arm's mean pose in each small cube of TCP positions; empty if the arm is not recognised."""
    frame = dataset.samples(list(executions)).drop_nulls(["robot_x_m", "robot_y_m", "robot_z_m"])
    robot_m = frame.select("robot_x_m", "robot_y_m", "robot_z_m").to_numpy()
    points = arm_points(dataset, frame["execution"].to_numpy(), frame["t_s"].to_numpy(), robot_m)
    if points is None:
        return ()
    known = np.isfinite(points).all(axis=(1, 2))
    points = points[known]
    side = CUBE_M
    while True:
        _, cube, count = np.unique(np.floor(points[:, -1] / side), axis=0, return_inverse=True, return_counts=True)
        if len(count) <= MAX_POSES:
            break
        side *= 1.5
    total = np.zeros((len(count), *points.shape[1:]))
    np.add.at(total, cube.ravel(), points)
    mean = np.round(total / count[:, None, None], 4)
    return tuple(
        PoseCard(tcp_m=tuple(pose[-1].tolist()), joints_m=tuple(tuple(joint) for joint in pose[:-1].tolist()))
        for pose in mean
    )


def to_nearest_link(
    dataset: Dataset,
    executions: NDArray[np.object_],
    t_s: NDArray[np.float64],
    robot_m: NDArray[np.float64],
    human_m: NDArray[np.float64],
    log_of: Callable[[str], pl.DataFrame | None] | None = None,
) -> NDArray[np.float64] | None:
    """Return the distance of the nearest link at each sample, shape (N,), m; None if the arm is not recognised.

    Args:
        dataset: As in `arm_points`.
        executions: As in `arm_points`.
        t_s: As in `arm_points`.
        robot_m: As in `arm_points`.
        human_m: The operator, shape (N, 3), m.
        log_of: As in `arm_points`.
    """
    points = arm_points(dataset, executions, t_s, robot_m, log_of)
    return None if points is None else to_links(points, human_m)


def arm_points(
    dataset: Dataset,
    executions: NDArray[np.object_],
    t_s: NDArray[np.float64],
    robot_m: NDArray[np.float64],
    log_of: Callable[[str], pl.DataFrame | None] | None = None,
) -> NDArray[np.float64] | None:
    """Return the joints from base to TCP at each sample, shape (N, J, 3), m; None if the arm is not recognised.

    Args:
        dataset: Dataset with joint angles at their native rate.
        executions: Execution of each sample, shape (N,), grouped.
        t_s: Session times, shape (N,), s.
        robot_m: The TCP, shape (N, 3), m, used to recognise the arm.
        log_of: Reads the robot's log of an execution with its `ANGLES`; None: from the dataset.
    """
    first = np.flatnonzero(np.concatenate([[True], executions[1:] != executions[:-1]]))
    angles = np.full((len(t_s), _JOINTS), np.nan)
    *names, beyond = ANGLES
    for begin, end in zip(first.tolist(), [*first[1:].tolist(), len(t_s)], strict=True):
        name = str(executions[begin])
        joints = dataset.native_robot(name, ("t_s",), if_there=ANGLES) if log_of is None else log_of(name)
        if joints is None or not set(names) <= set(joints.columns) or beyond in joints.columns:
            return None
        known = joints.drop_nulls(names)
        if known.height > 1:
            at = known["t_s"].to_numpy()
            angles[begin:end] = np.column_stack([np.interp(t_s[begin:end], at, known[name]) for name in names])
    some = np.linspace(0, len(t_s) - 1, min(_ENOUGH, len(t_s))).astype(np.int64)
    arm = recognise_arm(angles[some], robot_m[some])
    if arm is None:
        return None
    points, _ = arm.points(angles)
    return np.concatenate([points, robot_m[:, None]], axis=1)
