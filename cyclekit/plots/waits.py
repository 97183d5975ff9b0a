"""Draws who waits for whom: places of the robot on the left, of the operator on the right, an arrow for each wait.

An arrow leads from what is waited for to the place where an agent waits; the wider, the longer the wait.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.plots import colours
from cyclekit.plots.gantt import fitting
from cyclekit.plots.style import INK, MUTED

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Tip = Callable[[Figure, Artist, str, str], None]

_ROW_IN, _BOX_IN, _HEAD_IN, _FOOT_IN = 0.72, 0.36, 0.34, 0.06
_BESIDE_IN = 0.13
"""Half the distance of two opposite arrows, inches."""
_BOX_PART = 0.31
"""Width of a box as a share of the figure."""
_TEXT_PT = 8.5
_COLOURS = {"robot": colours.NOMINAL, "operator": colours.OPERATOR, "signal": colours.UNKNOWN}


@dataclass(frozen=True)
class WaitArrow:
    """One wait condition.

    Attributes:
        agent: The agent that waits; `place`: where.
        of_agent: Whose event it waits for: `robot`, `operator` or `signal`; `of_place`: its place, or the signal.
        text: Label of the arrow.
        weight: Width of the arrow relative to others, 0 to 1.
        tip: Text of its tooltip.
    """

    agent: str
    place: str
    of_agent: str
    of_place: str
    text: str
    weight: float = 0.0
    tip: str = ""

    @property
    def ends(self) -> tuple[tuple[bool, str, str], tuple[bool, str, str]]:
        """The boxes where the arrow begins and ends: whether on the right, whose, and what."""
        right = self.agent == "operator"
        return (not right, self.of_agent, self.of_place), (right, self.agent, self.place)


def height_in(arrows: Sequence[WaitArrow]) -> float:
    """Return the height of the picture, inches."""
    return _HEAD_IN + _FOOT_IN + _ROW_IN * max(map(len, _columns(arrows)), default=0)


def draw_waits(axes: Axes, arrows: Sequence[WaitArrow], heads: tuple[str, str], tip: Tip) -> None:
    """Draw the arrows on axes that fill a figure of `height_in`; `heads` are the titles of both columns."""
    figure: Figure = axes.figure  # type: ignore[assignment]  # no subfigure
    figure.set_layout_engine("none")
    width_in, all_in = figure.get_size_inches().tolist()
    axes.set_position((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, width_in), ylim=(all_in, 0.0))
    axes.axis("off")
    box_in, columns = _BOX_PART * width_in, _columns(arrows)
    for right, head in enumerate(heads):
        at_in = width_in - box_in / 2 - 0.02 if right else box_in / 2 + 0.02
        text = fitting((head,), box_in * 1.3, _TEXT_PT, cut=True)
        axes.text(at_in, 0.2, text, ha="center", color=MUTED, fontsize=_TEXT_PT)
    middle_in = {}
    for column in columns:
        for row, box in enumerate(column):
            middle_in[box] = _HEAD_IN + _ROW_IN * (row + 0.5)
            _draw_box(axes, box, middle_in[box], width_in)
    both = {arrow.ends for arrow in arrows}
    for arrow in arrows:
        begin, end = arrow.ends
        beside_in = _BESIDE_IN * (1 if end[0] else -1) if (end, begin) in both else 0.0
        _draw_arrow(axes, arrow, middle_in[begin] + beside_in, middle_in[end] + beside_in, width_in, tip)


def _columns(arrows: Sequence[WaitArrow]) -> tuple[list[tuple[bool, str, str]], list[tuple[bool, str, str]]]:
    """Return the boxes of the left and of the right column, from the top."""
    boxes = list(dict.fromkeys(box for arrow in arrows for box in reversed(arrow.ends)))
    return [box for box in boxes if not box[0]], [box for box in boxes if box[0]]


def _draw_box(axes: Axes, whose: tuple[bool, str, str], middle_in: float, width_in: float) -> None:
    from matplotlib.patches import FancyBboxPatch

    right, agent, name = whose
    box_in, colour = _BOX_PART * width_in, _COLOURS[agent]
    left_in = width_in - box_in - 0.02 if right else 0.02
    corner, look = (left_in, middle_in - _BOX_IN / 2), "round,pad=0,rounding_size=0.05"
    box = FancyBboxPatch(corner, box_in, _BOX_IN, boxstyle=look, facecolor="white", edgecolor=colour, linewidth=1.4)
    axes.add_patch(box).set_zorder(3)
    text = fitting((name,), box_in - 0.1, _TEXT_PT, cut=True)
    at = left_in + box_in / 2, middle_in
    axes.text(*at, text, color=INK, fontsize=_TEXT_PT, ha="center", va="center", zorder=4)


def _draw_arrow(axes: Axes, arrow: WaitArrow, from_in: float, to_in: float, width_in: float, tip: Tip) -> None:
    box_in = _BOX_PART * width_in + 0.04
    left_in, right_in = box_in, width_in - box_in
    to_right = arrow.ends[1][0]
    begin_in, end_in = (left_in, right_in) if to_right else (right_in, left_in)
    colour, wide = _COLOURS[arrow.agent], 1.0 + 3.0 * arrow.weight
    look = {"arrowstyle": "-|>", "color": colour, "linewidth": wide, "mutation_scale": 11, "shrinkA": 0, "shrinkB": 0}
    drawn = axes.annotate("", xy=(end_in, to_in), xytext=(begin_in, from_in), arrowprops=look, zorder=2)
    if drawn.arrow_patch is not None and arrow.tip:
        tip(axes.figure, drawn.arrow_patch, arrow.tip, "")  # type: ignore[arg-type]
    at = 0.5 if from_in == to_in else 0.62  # nearer to who waits, where arrows cross
    where = begin_in + at * (end_in - begin_in), from_in + at * (to_in - from_in)
    text = fitting((arrow.text, arrow.text.partition(",")[0]), right_in - left_in - 0.3, _TEXT_PT)
    back = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
    axes.text(*where, text, ha="center", va="center", color=INK, fontsize=_TEXT_PT, zorder=5, bbox=back)
