"""A time chart: lanes one above the other on a common time axis, bars for tasks, hatched bars for waits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cyclekit.plots.canvas import canvas

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

_LANE_IN, _HEAD_IN, _WIDTH_IN = 0.42, 1.1, 11.0
_LETTER_PART, _LEAST_LETTERS = 0.007, 4
"""A letter is so wide, as part of the axis; fewer letters tell nothing."""


@dataclass(frozen=True)
class Bar:
    """One bar of a time chart.

    Attributes:
        lane: Number of the lane, 0 = the top one.
        start_s, end_s: From when to when, s.
        colour: `#rrggbb`.
        text: Written into it where there is room.
        waits: Drawn hatched: nothing is done.
    """

    lane: int
    start_s: float
    end_s: float
    colour: str
    text: str = ""
    waits: bool = False


@dataclass(frozen=True)
class Arrow:
    """From the end of one bar to the start of another one, which waited for it: lanes and times, s."""

    from_lane: int
    to_lane: int
    from_s: float
    to_s: float


def draw_gantt(
    path: Path, lanes: Sequence[str], bars: Sequence[Bar], arrows: Sequence[Arrow] = (), legend: Mapping[str, str] = {}
) -> None:
    """Draw a time chart.

    Args:
        path: File to write, `.svg`, `.png` or `.pdf`.
        lanes: Their names, the top one first.
        bars: All bars.
        arrows: From what a wait ended with to what waited.
        legend: Colour by meaning; a colour with an empty text is left out.
    """
    with canvas(path, _WIDTH_IN, height_in(lanes)) as (axes,):
        draw_bars(axes, lanes, bars, arrows, legend)


def height_in(lanes: Sequence[str]) -> float:
    """Return the height of a chart of these lanes, inches."""
    return _HEAD_IN + _LANE_IN * len(lanes)


def draw_bars(
    axes: Axes, lanes: Sequence[str], bars: Sequence[Bar], arrows: Sequence[Arrow], legend: Mapping[str, str]
) -> None:
    """Draw a time chart on axes; arguments as of `draw_gantt`."""
    from matplotlib.patches import Patch

    end_s = max((bar.end_s for bar in bars), default=1.0)
    letter_s = _LETTER_PART * end_s * _WIDTH_IN / float(axes.figure.get_figwidth())  # type: ignore[union-attr]
    for bar in bars:
        style: dict[str, Any] = {"hatch": "////", "edgecolor": "#9aa5b1"} if bar.waits else {"edgecolor": "white"}
        long_s = bar.end_s - bar.start_s
        axes.barh(bar.lane, long_s, left=bar.start_s, height=0.72, color=bar.colour, linewidth=0.6, **style)
        text = _fitting(bar.text, int(long_s / letter_s))
        axes.text(bar.start_s + long_s / 2, bar.lane, text, ha="center", va="center", fontsize=8, color="white")
    for arrow in arrows:
        axes.annotate(
            "",
            xy=(arrow.to_s, arrow.to_lane),
            xytext=(arrow.from_s, arrow.from_lane),
            arrowprops={"arrowstyle": "->", "color": "#2b3440", "linewidth": 0.9},
        )
    axes.set_yticks(range(len(lanes)), lanes)
    axes.set_ylim(len(lanes) - 0.45, -0.55)
    axes.set_xlim(0.0, 1.02 * end_s)
    axes.set_xlabel("time, s")
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="y", length=0)
    if legend:
        axes.legend(
            handles=[Patch(facecolor=colour, label=text) for text, colour in legend.items()],
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=len(legend),
            frameon=False,
            fontsize=8,
        )


def _fitting(text: str, letters: int) -> str:
    """Return a text cut to so many letters; nothing where too few are left to tell."""
    if len(text) <= letters:
        return text
    return f"{text[: letters - 1]}…" if letters >= _LEAST_LETTERS else ""
