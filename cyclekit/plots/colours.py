"""Colour scale of the speed scaling for replay, plots and report.

Speed 0 is dark red, full speed dark blue, half speed light amber: red and blue are distinguishable with every common
colour blindness, and both ends are dark on paper. Unknown is grey, never the colour of a level.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

SCALING_ANCHORS: tuple[tuple[float, str], ...] = (
    (0.00, "#a3123a"),
    (0.25, "#e2643b"),
    (0.50, "#f2b53c"),
    (0.75, "#62a9d6"),
    (1.00, "#1f5a9d"),
)
"""Colours at five scaling values; interpolated linearly in sRGB."""

UNKNOWN = "#8b929a"
ROBOT = "#2b3440"
OPERATOR = "#0f7b6c"
PREDICTED = "#7a3fa0"
NOMINAL, SAFETY, DWELL, WAIT = "#1f5a9d", "#e2643b", "#9aa5b1", "#d7dce1"
"""Colours of the four parts of a cycle; safety loss has that of a slowed robot."""
CAUSES = {
    "person": "#e2643b",
    "slider": "#7a3fa0",
    "input": "#b8860b",
    "limits": "#1c9a86",
    "wait": "#9aa5b1",
    "pause": "#5b6673",
    "stop": "#a3123a",
    "unknown": "#8b929a",
}
"""Colours of the causes of lost time."""


def to_rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a `#rrggbb` colour."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def scaling_rgb(scaling: ArrayLike) -> NDArray[np.uint8]:
    """Return the colour of each scaling value.

    Args:
        scaling: Speed scaling in [0, 1], any shape S; NaN = unknown. Values outside are clipped.

    Returns:
        Red, green, blue, shape (*S, 3), 0 to 255; grey where unknown.
    """
    values = np.asarray(scaling, dtype=np.float64)
    known = np.where(np.isnan(values), 0.0, values)
    at = [anchor for anchor, _ in SCALING_ANCHORS]
    anchors = np.array([to_rgb(colour) for _, colour in SCALING_ANCHORS], dtype=np.float64)
    rgb = np.stack([np.interp(known, at, anchors[:, channel]) for channel in range(3)], axis=-1)
    rgb[np.isnan(values)] = to_rgb(UNKNOWN)
    return np.rint(rgb).astype(np.uint8)


def scaling_hex(scaling: float) -> str:
    """Return the `#rrggbb` colour of one scaling value; NaN = unknown."""
    red, green, blue = scaling_rgb(scaling).tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"
