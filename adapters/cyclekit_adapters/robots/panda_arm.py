"""Flange position of a Franka arm from joint angles: the public kinematics of Panda and FR3.

Both arms share one table of Denavit-Hartenberg parameters in Craig's (modified) convention, published by the maker
("Robot and interface specifications", section Denavit-Hartenberg parameters). The last row is the flange; no hand,
finger or tool is included.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_QUARTER = math.pi / 2
_A_D_ALPHA = (  # m, m, rad
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -_QUARTER),
    (0.0, 0.316, _QUARTER),
    (0.0825, 0.0, _QUARTER),
    (-0.0825, 0.384, -_QUARTER),
    (0.0, 0.0, _QUARTER),
    (0.088, 0.0, _QUARTER),
)
_FLANGE_M = 0.107  # along the axis of joint 7
JOINTS = len(_A_D_ALPHA)


def flange_position_m(q_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the position of the flange in the base frame.

    Args:
        q_rad: Joint angles, shape (T, 7), rad.

    Returns:
        Positions, shape (T, 3), m; NaN where an angle is NaN.
    """
    # From the flange inwards, with a point instead of matrices: each link transforms the point of the next outer link.
    point = np.zeros((len(q_rad), 3))
    point[:, 2] = _FLANGE_M
    for joint in reversed(range(JOINTS)):
        a, d, alpha = _A_D_ALPHA[joint]
        cos_q, sin_q = np.cos(q_rad[:, joint]), np.sin(q_rad[:, joint])
        x = cos_q * point[:, 0] - sin_q * point[:, 1] + a
        y = sin_q * point[:, 0] + cos_q * point[:, 1]
        z = point[:, 2] + d
        point = np.stack(
            [x, math.cos(alpha) * y - math.sin(alpha) * z, math.sin(alpha) * y + math.cos(alpha) * z], axis=1
        )
    return point
