"""Draws the levels of a speed scaling: over time, and the share of time on each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from cyclekit.plots import colours
from cyclekit.plots.canvas import write_figure
from cyclekit.plots.style import INK, RULE, plain_style
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from cyclekit.plots.drawing import Drawing

_SHOWN_S = 120.0
"""Duration of the stretch drawn over time, s."""


class FoundLevels(Protocol):
    """Interface of a staircase, as of `cyclekit.scaling.levels.Staircase`."""

    @property
    def levels(self) -> NDArray[np.float64]:
        """Levels, shape (P,), ascending."""

    @property
    def label(self) -> NDArray[np.int32]:
        """Level of each sample, shape (T,); -1 = none."""

    @property
    def share(self) -> NDArray[np.float64]:
        """Share of the samples on each level, shape (P,)."""

    @property
    def slider(self) -> NDArray[np.float64] | None:
        """Speed slider set by the operator, shape (T,); None = not used."""


def levels_figure(scaling: NDArray[np.float64], found: FoundLevels, *, rate_hz: float) -> Drawing:
    """Return a figure of a stretch of the scaling with its levels, and of the share of time on each level.

    Args:
        scaling: Speed scaling in which the staircase was found, shape (T,); NaN = unknown.
        found: The staircase.
        rate_hz: Rate of the samples, Hz.
    """
    from matplotlib.ticker import PercentFormatter

    from cyclekit.plots.drawing import Drawing

    with plain_style():
        figure = Drawing(9.0, 3.6)
        over_time, shares = figure.subplots(1, 2, sharey=True, width_ratios=(5, 2))
        _over_time(over_time, scaling if found.slider is None else scaling / found.slider, found, rate_hz)
        _shares(shares, found)
        for axes in (over_time, shares):
            for level in found.levels:
                axes.axhline(level, color=RULE, linewidth=0.8, zorder=0)
        over_time.set(ylim=(-0.08, 1.08), yticks=found.levels if found.levels.size <= 8 else np.linspace(0, 1, 5))
        over_time.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None if found.levels.size <= 8 else 0))
    return figure


def _over_time(axes: Axes, values: NDArray[np.float64], found: FoundLevels, rate_hz: float) -> None:
    """Draw the samples of the stretch with most change in the colour of their speed; transitions are small and grey."""
    part = slice(*_liveliest(values, round(_SHOWN_S * rate_hz)))
    at_s, shown = np.arange(part.stop - part.start) / rate_hz, values[part]
    axes.plot(at_s, shown, color=colours.UNKNOWN, linewidth=0.7, zorder=1)
    held = found.label[part] >= 0
    axes.scatter(at_s[held], shown[held], s=9, color=colours.scaling_rgb(shown[held]) / 255, linewidth=0, zorder=2)
    axes.scatter(at_s[~held], shown[~held], s=4, color=INK, linewidth=0, zorder=3, label="in transition")
    if (~held & np.isfinite(shown)).any():
        axes.legend(loc="lower right")
    axes.set(
        xlabel="time, s", ylabel="robot speed (scaling)", title=f"{fixed(at_s[-1] if at_s.size else 0, 0)} s of the log"
    )


def _shares(axes: Axes, found: FoundLevels) -> None:
    """Draw a bar per level: its share of all samples."""
    share = 100 * np.asarray(found.share)
    gaps = np.diff(found.levels)
    high = min(0.1, 0.6 * float(gaps.min())) if gaps.size else 0.1
    paint = [colours.scaling_hex(level) for level in found.levels.tolist()]
    axes.barh(found.levels, share, height=high, color=paint)
    for level, part in zip(found.levels.tolist(), share.tolist(), strict=True):
        axes.annotate(
            f"{fixed(part, 0)} %", (part, level), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8.5
        )
    axes.set(xlim=(0, 1.25 * max(float(share.max(initial=0.0)), 1.0)), xlabel="part of the samples, %")
    rest = max(0.0, 100 - float(share.sum()))
    axes.set_title(f"{found.levels.size} levels;\n{fixed(rest, 0)} % in transition or unknown", loc="left")


def draw_levels(path: Path, scaling: NDArray[np.float64], found: FoundLevels, *, rate_hz: float) -> None:
    """Write the figure of `levels_figure` to `path`, `.svg`, `.png` or `.pdf`; other arguments as there."""
    write_figure(path, levels_figure(scaling, found, rate_hz=rate_hz))


def _liveliest(values: NDArray[np.float64], shown: int) -> tuple[int, int]:
    """Return start and end of the stretch of `shown` samples in which the scaling changes most."""
    steps = np.abs(np.diff(np.nan_to_num(values), prepend=0.0))
    if values.size <= shown:
        return 0, values.size
    total = np.concatenate([[0.0], np.cumsum(np.minimum(steps, 1.0))])
    first = int(np.argmax(total[shown:] - total[:-shown]))
    return first, first + shown
