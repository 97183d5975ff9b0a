"""Detection of the vertical axis from people in a log: their heads are above their feet.

Motion-capture files without a stated vertical axis are often read with the wrong one, so that heights become widths.
Markers of heads and feet are found by name. The adapters decide what to do without a result.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

FRAMES_USED = 200
"""Number of frames used."""
_SIDE = "(?:left|right|l|r)?"
_HIGH = re.compile(
    rf"{_SIDE}(?:head|tophead|nose|neck|eye|ear|fhd|bhd|shoulder|should|sho|acr|acromion|c7|cv7|sjn)(?:l|r)?"
)
_LOW = re.compile(rf"{_SIDE}(?:ankle|ank|heel|hee|toe|bigtoe|smalltoe|calc|mall|met|fcc|fal|tam|fm[125])(?:l|r)?")
_PLAIN = re.compile(r"_study$|[\s._-]+")
_EARTH_M = 1e7  # a marker farther away is a garbled number
_BODY_M = 0.3
"""Minimum distance between heads and feet along an axis, m; below it no person is upright."""


def vertical_axis(names: Sequence[str], points_m: NDArray[np.float64]) -> Literal["y", "z", "neither", ""]:
    """Return the axis along which heads are above feet, "neither" for another direction, "" if unknown.

    Args:
        names: M names of markers, with or without subject.
        points_m: Positions, shape (N, M, 3), m, NaN = not seen.
    """
    plain = [_PLAIN.sub("", name.rpartition(":")[2].strip().lower()) for name in names]
    heads = [i for i, name in enumerate(plain) if _HIGH.fullmatch(name)]
    feet = [i for i, name in enumerate(plain) if _LOW.fullmatch(name)]
    if not heads or not feet:
        return ""
    above = _middle(points_m[:, heads]) - _middle(points_m[:, feet])
    above = above[np.isfinite(above).all(axis=1)]
    if not len(above):
        return ""
    way = np.median(above, axis=0)
    axis = int(np.argmax(np.abs(way)))
    if abs(way[axis]) < _BODY_M:
        return ""
    if way[axis] < 0.0 or axis == 0:
        return "neither"
    return "y" if axis == 1 else "z"


def _middle(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the centre of the visible points, (N, M, 3) to (N, 3), NaN if none is visible."""
    seen = (np.abs(points) < _EARTH_M).all(axis=2, keepdims=True)  # NaN compares false
    count = seen.sum(axis=1)
    total = np.where(seen, points, 0.0).sum(axis=1)
    middle: NDArray[np.float64] = np.full_like(total, np.nan)
    np.divide(total, count, out=middle, where=count > 0)
    return middle
