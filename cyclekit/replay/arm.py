"""The links of a Universal Robots arm from its joint angles, where the log proves that it is such an arm.

A log names its joints but rarely the arm. So each known arm is tried: the one whose computed tool point follows the
logged tool point is the arm, and if none does, none is drawn. Drawing is the business of `scene`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

AGREES_M = 0.05
"""A computed tool point within this of the logged one (95 % of instants) belongs to the same arm."""

LONGEST_TOOL_M = 0.35
_MOVED_M = 0.1
_HALF_PI = np.pi / 2


@dataclass(frozen=True)
class Arm:
    """Lengths of a six-axis arm as its maker publishes them (Denavit-Hartenberg parameters), metres."""

    name: str
    d1_m: float
    a2_m: float
    a3_m: float
    d4_m: float
    d5_m: float
    d6_m: float


ARMS = (
    Arm("UR5e", 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    Arm("UR3e", 0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    Arm("UR10e", 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    Arm("UR16e", 0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    Arm("UR5", 0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    Arm("UR3", 0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    Arm("UR10", 0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
)
"""Universal Robots' published parameters, e-Series first."""


@dataclass(frozen=True)
class FittedArm:
    """An arm that follows the log.

    Attributes:
        arm: Which one.
        tool_m: Tool point in the flange frame, shape (3,), metres.
        error_m: 95 % of the computed tool points lie within it of the logged ones.
    """

    arm: Arm
    tool_m: NDArray[np.float64]
    error_m: float


def joint_points(arm: Arm, joints_rad: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the joints are and how the flange is turned.

    Args:
        arm: The arm's lengths.
        joints_rad: Joint angles, shape (T, 6).

    Returns:
        Points from base to flange, shape (T, 7, 3), metres, base frame; flange rotation, shape (T, 3, 3).
    """
    lengths = (
        (arm.d1_m, 0.0, _HALF_PI),
        (0.0, arm.a2_m, 0.0),
        (0.0, arm.a3_m, 0.0),
        (arm.d4_m, 0.0, _HALF_PI),
        (arm.d5_m, 0.0, -_HALF_PI),
        (arm.d6_m, 0.0, 0.0),
    )
    count = len(joints_rad)
    turn = np.broadcast_to(np.eye(3), (count, 3, 3))
    point = np.zeros((count, 3))
    points = [point]
    for axis, (d_m, a_m, alpha) in enumerate(lengths):
        cos, sin = np.cos(joints_rad[:, axis]), np.sin(joints_rad[:, axis])
        step = np.stack([a_m * cos, a_m * sin, np.full(count, d_m)], axis=1)
        point = point + np.einsum("tij,tj->ti", turn, step)
        turn = turn @ _link_turn(cos, sin, alpha)
        points.append(point)
    return np.stack(points, axis=1), turn


def _link_turn(cos: NDArray[np.float64], sin: NDArray[np.float64], alpha: float) -> NDArray[np.float64]:
    """Rotation of one link, shape (T, 3, 3): about its joint by the angle, then about x by `alpha`."""
    zero = np.zeros_like(cos)
    ca, sa = np.cos(alpha), np.sin(alpha)
    rows = [[cos, -sin * ca, sin * sa], [sin, cos * ca, -cos * sa], [zero, zero + sa, zero + ca]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def recognise_arm(joints_rad: NDArray[np.float64], tcp_m: NDArray[np.float64]) -> FittedArm | None:
    """Find the arm whose tool point follows the logged one.

    First with the tool point at the flange; then, if the arm moved enough to prove it, with one fixed tool.

    Args:
        joints_rad: Joint angles, shape (T, 6).
        tcp_m: Logged tool centre point, shape (T, 3), metres, base frame. Rows with NaN are left out.

    Returns:
        The arm that fits best, or None when none agrees within `AGREES_M`.
    """
    known = np.isfinite(joints_rad).all(axis=1) & np.isfinite(tcp_m).all(axis=1)
    joints_rad, tcp_m = joints_rad[known], tcp_m[known]
    if not len(tcp_m):
        return None
    fitted = [fit for arm in ARMS for fit in _fits(arm, joints_rad, tcp_m)]
    return min(fitted, key=lambda fit: fit.error_m, default=None)


def _fits(arm: Arm, joints_rad: NDArray[np.float64], tcp_m: NDArray[np.float64]) -> list[FittedArm]:
    points, turn = joint_points(arm, joints_rad)
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
            found.append(FittedArm(arm, offset, error_m))
    return found
