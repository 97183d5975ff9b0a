"""The levels of a speed scaling: how often each value occurs, and where the levels were found."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.time_grid import USUAL_HZ, samples_in
from cyclekit.plots import colours
from cyclekit.plots.canvas import canvas

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.scaling.levels import Staircase

_SHOWN_S = 120.0
"""Length of the stretch that is drawn over time."""


def draw_levels(path: Path, scaling: NDArray[np.float64], found: Staircase, *, rate_hz: float = USUAL_HZ) -> None:
    """Draw a stretch of the scaling with its levels, and beside it the histogram of all values (logarithmic).

    Args:
        path: File to write, `.svg`, `.png` or `.pdf`.
        scaling: What the staircase was found in, shape (T,); NaN = unknown.
        found: The staircase.
        rate_hz: Rate of the samples.
    """
    values = scaling if found.slider is None else scaling / found.slider
    part = slice(*_liveliest(values, samples_in(_SHOWN_S, rate_hz)))
    at = np.arange(part.stop - part.start) / rate_hz
    moving = found.label[part] < 0
    with canvas(path, 9.0, 3.4, columns=2) as (over_time, histogram):
        over_time.plot(at, values[part], color=colours.NOMINAL, linewidth=1.0)
        over_time.plot(at[moving], values[part][moving], ".", color=colours.SAFETY, markersize=3, label="in transition")
        over_time.set(xlabel="time, s", ylabel="speed scaling")
        if moving.any():
            over_time.legend(loc="best", frameon=False)
        known = values[np.isfinite(values)]
        histogram.hist(known, bins=200, orientation="horizontal", color=colours.NOMINAL, log=True)
        histogram.set_xlabel("samples")
        for axes in (over_time, histogram):
            for level in found.levels:
                axes.axhline(level, color=colours.SAFETY, linewidth=0.7, zorder=0)
        histogram.set_title(f"P = {found.levels.size}")


def _liveliest(values: NDArray[np.float64], shown: int) -> tuple[int, int]:
    """Return first and end of the stretch of `shown` samples in which the scaling changes most."""
    steps = np.abs(np.diff(np.nan_to_num(values), prepend=0.0))
    if values.size <= shown:
        return 0, values.size
    total = np.concatenate([[0.0], np.cumsum(np.minimum(steps, 1.0))])
    first = int(np.argmax(total[shown:] - total[:-shown]))
    return first, first + shown
