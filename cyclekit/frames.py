"""One base frame: turn positions of a log's own frame into the robot base frame.

Trackers stand somewhere in the cell and some count y upwards. Where a tracker stands is said by the cell file; fitting
that from points touched by both is not done here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.config import Frame


def to_base(points_m: NDArray[np.float64], frame: Frame | None, *, up: Literal["y", "z"] = "z") -> NDArray[np.float64]:
    """Return positions in the robot base frame.

    Args:
        points_m: Positions in the log's frame, shape (N, 3), metres; NaN stays NaN.
        frame: Where the log's frame stands; None leaves it where it is.
        up: Axis that points up in the log. For "y" (OptiTrack's convention) the frame is first turned by +90 deg
            about x, so that (x, y, z) becomes (x, -z, y): right-handed and z up.

    Returns:
        Positions, shape (N, 3), metres.

    Raises:
        ShapeError: `points_m` is not (N, 3).
    """
    if points_m.ndim != 2 or points_m.shape[1] != 3:
        msg = f"points_m {points_m.shape} must be (N, 3)"
        raise ShapeError(msg)
    turned = np.column_stack([points_m[:, 0], -points_m[:, 2], points_m[:, 1]]) if up == "y" else points_m
    if frame is None:
        return turned.copy()
    placed: NDArray[np.float64] = turned @ np.asarray(frame.rotation).T + np.asarray(frame.xyz_m)
    return placed
