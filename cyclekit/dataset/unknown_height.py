"""People whose height no log tells: floor tracks, laser scanners and pedestrian tables know x and y only.

Such a person is taken to be as high as the TCP is at that instant, whenever the two are set in relation. Their distance
is then the one in the plane; any fixed height would add a difference that nobody measured, which changes with the
height of the TCP. In tables the height stays unknown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from numpy.typing import NDArray

Points = TypeVar("Points", bound="NDArray[np.floating[Any]]")

_ROBOT, _HUMAN = slice(0, 3), slice(3, 6)
HUMAN_Z_IN_PLANE = pl.col("human_z_m").fill_null(pl.col("robot_z_m"))
"""Column human_z_m of SAMPLES, with the height of the TCP where it is unknown."""


def is_flat(human_m: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Tell of positions, shape (..., 3), where somebody is seen whose height is unknown, shape (...)."""
    return np.asarray(np.isnan(human_m[..., 2]) & np.isfinite(human_m[..., 0]) & np.isfinite(human_m[..., 1]))


def in_plane(robot_m: NDArray[np.floating[Any]], human_m: Points) -> Points:
    """Return operator positions, shape (..., 3), m, with unknown heights replaced by those of the TCP beside them.

    Args:
        robot_m: The TCP, shape (..., 3), m.
        human_m: The operator, shape (..., 3), m; z is NaN where his height is unknown. It is not changed.
    """
    flat = is_flat(human_m)
    if not flat.any():
        return human_m
    placed = human_m.copy()
    placed[..., 2] = np.where(flat, robot_m[..., 2], placed[..., 2])
    return placed


def inputs_in_plane(X: Points) -> Points:
    """Return inputs of a network, shape (..., F) of x_r, x_h and others, with unknown heights replaced likewise."""
    human_m = X[..., _HUMAN]
    placed = in_plane(X[..., _ROBOT], human_m)
    if placed is human_m:
        return X
    inputs = X.copy()
    inputs[..., _HUMAN] = placed
    return inputs


def said_of_height(samples: pl.DataFrame) -> list[str]:
    """Say in how many samples the height of the operator is unknown; nothing where it is always known.

    Args:
        samples: Columns human_x_m and human_z_m of SAMPLES.
    """
    seen = samples.filter(pl.col("human_x_m").is_not_null())
    flat = seen["human_z_m"].null_count()
    if not flat:
        return []
    part = f"{flat / seen.height:.0%} of the samples that see him" if flat < seen.height else "all samples"
    return [f"the height of the operator is unknown in {part}: distances to him are those in the plane there"]
