"""Kinematics of known arms, for a named arm or for one recognised from the log.

A log names its joints but rarely the arm. So each known arm of Universal Robots is tried: the arm is the one whose
computed tool point follows the logged one; if none does, none is drawn. Used by `replay` to draw the arm, and by
`ingest` to compute the TCP of a log with joint angles only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

AGREES_M = 0.05
"""Maximum distance, m, between computed and logged tool point (95 % quantile) for a recognised arm."""

LONGEST_TOOL_M = 0.35
_MOVED_M = 0.1
_HALF_PI = np.pi / 2
_TURNED = np.array([-1.0, -1.0, 1.0])
"""A turn by 180 degrees about z, as factors of the coordinates."""


class ArmLink(NamedTuple):
    """One link by standard Denavit-Hartenberg parameters: d, a, alpha, and the offset of the joint angle."""

    d_m: float
    a_m: float
    alpha_rad: float
    theta_rad: float = 0.0


@dataclass(frozen=True)
class Arm:
    """An arm with the parameters published by its manufacturer."""

    name: str
    links: tuple[ArmLink, ...]


def _ur(name: str, d1_m: float, a2_m: float, a3_m: float, d4_m: float, d5_m: float, d6_m: float) -> Arm:
    first, last = ArmLink(d1_m, 0.0, _HALF_PI), ArmLink(d6_m, 0.0, 0.0)
    upper, lower = ArmLink(0.0, a2_m, 0.0), ArmLink(0.0, a3_m, 0.0)
    return Arm(name, (first, upper, lower, ArmLink(d4_m, 0.0, _HALF_PI), ArmLink(d5_m, 0.0, -_HALF_PI), last))


def _iiwa(name: str, shoulder_m: float, upper_m: float, lower_m: float, wrist_m: float) -> Arm:
    heights, turns = (shoulder_m, 0.0, upper_m, 0.0, lower_m, 0.0, wrist_m), (-1, 1, 1, -1, -1, 1, 0)
    return Arm(name, tuple(ArmLink(d_m, 0.0, turn * _HALF_PI) for d_m, turn in zip(heights, turns, strict=True)))


_PANDA = (
    ArmLink(0.333, 0.0, -_HALF_PI),
    ArmLink(0.0, 0.0, _HALF_PI),
    ArmLink(0.316, 0.0825, _HALF_PI),
    ArmLink(0.0, -0.0825, -_HALF_PI),
    ArmLink(0.384, 0.0, _HALF_PI),
    ArmLink(0.0, 0.088, _HALF_PI),
    ArmLink(0.107, 0.0, 0.0),
)
ARMS = (
    _ur("UR5e", 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    _ur("UR3e", 0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    _ur("UR10e", 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    _ur("UR16e", 0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    _ur("UR20", 0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543),
    _ur("UR30", 0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543),
    _ur("UR5", 0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    _ur("UR3", 0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    _ur("UR10", 0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
)
"""e-Series first. From Universal Robots' article "DH Parameters for calculations of kinematics and dynamics"; UR30 from
`config/ur30/default_kinematics.yaml` of their ROS 2 description."""
MODELS = {
    arm.name: arm
    for arm in (
        *ARMS,
        Arm("Panda", _PANDA),
        Arm("FR3", _PANDA),
        _iiwa("iiwa 7", 0.34, 0.4, 0.4, 0.126),
        _iiwa("iiwa 14", 0.36, 0.42, 0.4, 0.126),
    )
}
"""Arms that a cell file can name. Panda and FR3 have one kinematic chain, published by Franka in "Control Interface
Specification and Robot Limits" (there in Craig's convention, with the flange at 0.107 m). The iiwa: Kuka
Sunrise Toolbox, `constDhDataOf14R820.m` (in Craig's convention, from KUKA's manual of the media flange); the axes of
the iiwa 7 in the documentation of Exp[licit] are the same."""


def model_by_joints(names: Sequence[str]) -> str | None:
    """Return the model that the names of joints begin with, as in ROS: `fr3_joint1`, `ur10e_elbow_joint`."""
    words = [set(name.lower().split("_")) for name in names]
    common = set[str].intersection(*words) if words else set[str]()
    return next((model for model in MODELS if model.lower().replace(" ", "") in common), None)


@dataclass(frozen=True)
class FittedArm:
    """An arm recognised from the log.

    Attributes:
        arm: The arm.
        tool_m: Tool point in the flange frame, shape (3,), m.
        error_m: 95 % quantile of the distance between computed and logged tool points, m.
        turned: Whether the log's base frame is the arm's turned by 180 degrees about z: `base_link` of Universal
            Robots' ROS description, whose `base` is the frame of the parameters.
    """

    arm: Arm
    tool_m: NDArray[np.float64]
    error_m: float
    turned: bool = False

    def points(self, joints_rad: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return points and flange rotation as `joint_points` does, in the log's base frame."""
        return points_in_base(self.arm, joints_rad, turned=self.turned)


def joint_points(arm: Arm, joints_rad: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the positions of the joints and the rotation of the flange (forward kinematics).

    Args:
        arm: The arm, with J links.
        joints_rad: Joint angles, shape (T, J).

    Returns:
        Points from base to flange, shape (T, J + 1, 3), m, base frame; flange rotation, shape (T, 3, 3).
    """
    count = len(joints_rad)
    turn = np.broadcast_to(np.eye(3), (count, 3, 3))
    point = np.zeros((count, 3))
    points = [point]
    for axis, (d_m, a_m, alpha, theta) in enumerate(arm.links):
        cos, sin = np.cos(joints_rad[:, axis] + theta), np.sin(joints_rad[:, axis] + theta)
        step = np.stack([a_m * cos, a_m * sin, np.full(count, d_m)], axis=1)
        point = point + np.einsum("tij,tj->ti", turn, step)
        turn = turn @ _link_turn(cos, sin, alpha)
        points.append(point)
    return np.stack(points, axis=1), turn


def _link_turn(cos: NDArray[np.float64], sin: NDArray[np.float64], alpha: float) -> NDArray[np.float64]:
    """Return the rotation of one link, shape (T, 3, 3): about z by the joint angle, then about x by `alpha`."""
    zero = np.zeros_like(cos)
    ca, sa = np.cos(alpha), np.sin(alpha)
    rows = [[cos, -sin * ca, sin * sa], [sin, cos * ca, -cos * sa], [zero, zero + sa, zero + ca]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def recognise_arm(joints_rad: NDArray[np.float64], tcp_m: NDArray[np.float64]) -> FittedArm | None:
    """Find the arm whose tool point follows the logged one.

    Tools tried: none (tool point at the flange) and, if the arm moved enough, one fixed offset. Each also with the base
    turned by 180 degrees.

    Args:
        joints_rad: Joint angles, shape (T, 6).
        tcp_m: Logged tool centre point, shape (T, 3), m, base frame. Rows with NaN are ignored.

    Returns:
        The arm that fits best; None if none agrees within `AGREES_M`.
    """
    known = np.isfinite(joints_rad).all(axis=1) & np.isfinite(tcp_m).all(axis=1)
    joints_rad, tcp_m = joints_rad[known], tcp_m[known]
    if not len(tcp_m):
        return None
    either = (False, True)
    fitted = [fit for arm in ARMS for turned in either for fit in _fits(arm, joints_rad, tcp_m, turned=turned)]
    return min(fitted, key=lambda fit: fit.error_m, default=None)


def points_in_base(
    arm: Arm, joints_rad: NDArray[np.float64], *, turned: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return `joint_points` in the base frame, or with `turned` in the one turned by 180 degrees about z."""
    points, turn = joint_points(arm, joints_rad)
    return (points * _TURNED, turn * _TURNED[:, None]) if turned else (points, turn)


def _fits(arm: Arm, joints_rad: NDArray[np.float64], tcp_m: NDArray[np.float64], *, turned: bool) -> list[FittedArm]:
    points, turn = points_in_base(arm, joints_rad, turned=turned)
    miss = tcp_m - points[:, -1]
    tool = np.einsum("tji,tj->ti", turn, miss).mean(axis=0)
    moved = bool(np.ptp(tcp_m, axis=0).max() > _MOVED_M)
    candidates = [np.zeros(3)]
    if moved and float(np.linalg.norm(tool)) <= LONGEST_TOOL_M:
        candidates.append(tool)
    found = []
    for offset in candidates:
        left = np.linalg.norm(miss - np.einsum("tij,j->ti", turn, offset), axis=1)
        error_m = float(np.quantile(left, 0.95))
        if error_m <= AGREES_M:
            found.append(FittedArm(arm, offset, error_m, turned))
    return found
