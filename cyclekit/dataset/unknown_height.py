"""People of unknown height: floor tracks, laser scanners and pedestrian tables log only x and y.

Wherever such a person's position is compared with the TCP, it gets the height of the TCP at that instant. Their
distance is then the one in the plane; a fixed height would add an unmeasured difference that changes with the height of
the TCP. In tables the height stays unknown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import polars as pl

from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from numpy.typing import NDArray

Points = TypeVar("Points", bound="NDArray[np.floating[Any]]")

_ROBOT, _HUMAN = slice(0, 3), slice(3, 6)
HUMAN_Z_IN_PLANE = pl.col("human_z_m").fill_null(pl.col("robot_z_m"))
"""Column human_z_m of SAMPLES, with the height of the TCP if unknown."""


def is_flat(human_m: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return which positions, shape (..., 3), are known except for their height, shape (...)."""
    return np.asarray(np.isnan(human_m[..., 2]) & np.isfinite(human_m[..., 0]) & np.isfinite(human_m[..., 1]))


def in_plane(robot_m: NDArray[np.floating[Any]], human_m: Points) -> Points:
    """Return operator positions, shape (..., 3), m, with unknown heights replaced by that of the TCP.

    Args:
        robot_m: The TCP, shape (..., 3), m.
        human_m: The operator, shape (..., 3), m; z is NaN if his height is unknown. The array is not changed.
    """
    flat = is_flat(human_m)
    if not flat.any():
        return human_m
    placed = human_m.copy()
    placed[..., 2] = np.where(flat, robot_m[..., 2], placed[..., 2])
    return placed


def inputs_in_plane(X: Points) -> Points:
    """Return inputs of a network, shape (..., F) of x_r, x_h and others, with unknown heights replaced by the TCP's."""
    human_m = X[..., _HUMAN]
    placed = in_plane(X[..., _ROBOT], human_m)
    if placed is human_m:
        return X
    inputs = X.copy()
    inputs[..., _HUMAN] = placed
    return inputs


def height_notes(samples: pl.DataFrame) -> list[str]:
    """Return a sentence on the share of samples in which the operator's height is unknown; nothing if always known.

    Args:
        samples: Columns human_x_m and human_z_m of SAMPLES.
    """
    seen = samples.filter(pl.col("human_x_m").is_not_null())
    flat = seen["human_z_m"].null_count()
    if not flat:
        return []
    part = f"{percent(flat / seen.height)} of the samples that see him" if flat < seen.height else "all samples"
    return [f"the height of the operator is unknown in {part}: distances to him are those in the plane there"]
