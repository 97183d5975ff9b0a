"""Draws a time chart: blocks of lanes, one per cycle, stacked on a common time axis.

A block has a title, the expected progress (tasks done over time, with a band for single cycles), a lane per agent with
bars for tasks and hatched bars for waits, and a lane of shares for an agent of which only these are known. Of each
label the longest text that fits is drawn, or none, so that labels never overlap.
"""

from __future__ import annotations

import unicodedata
import warnings
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from cyclekit.plots import colours
from cyclekit.plots.canvas import canvas
from cyclekit.text.numbers import given

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Tip = Callable[[Figure, Artist, str, str], None]

_WIDTH_IN = 11.0
_LEFT_IN, _RIGHT_IN, _FOOT_IN, _KEY_IN = 0.82, 0.16, 0.5, 0.2
_TITLE_IN, _COURSE_IN, _LABEL_IN, _BAR_IN, _GAP_IN = 0.27, 0.5, 0.17, 0.24, 0.09
_TITLE_PT, _LABEL_PT, _NAME_PT = 9.0, 8.0, 8.5
_HINTED = 1.05
"""Maximum factor by which text rendered on whole pixels is wider than its nominal width."""
_INK, _MUTED, _RULE, _BAND, _HATCH = "#1c232b", "#55606c", "#d9dee4", "#b9c8db", "#9aa5b1"


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        lane: Index of the lane in its block, 0 = top.
        start_s, end_s: Start and end, s.
        colour: `#rrggbb`.
        waits: Whether it is a wait, drawn hatched.
        tip: Text of its tooltip; `row`: task to which it belongs.
    """

    lane: int
    start_s: float
    end_s: float
    colour: str
    waits: bool = False
    tip: str = ""
    row: str = ""


@dataclass(frozen=True)
class BarLabel:
    """A name above the bars of a lane from `start_s` to `end_s`: the first of `texts` that fits, or none."""

    lane: int
    start_s: float
    end_s: float
    texts: tuple[str, ...]


@dataclass(frozen=True)
class Arrow:
    """Arrow from the end of one bar to the start of another one that waited for it: lanes and times, s.

    `seldom`: in fewer than half of the cycles; it is dotted.
    """

    from_lane: int
    to_lane: int
    from_s: float
    to_s: float
    seldom: bool = False


@dataclass(frozen=True)
class TaskEnds:
    """Ends of the tasks: mean, and range in single cycles; s, ascending, empty = unknown."""

    ends_s: tuple[float, ...]
    low_s: tuple[float, ...] = ()
    high_s: tuple[float, ...] = ()
    tips: tuple[str, ...] = ()


@dataclass(frozen=True)
class Layer:
    """Share of cycles in which an agent does something, in equal parts of the time until `end_s`."""

    parts: tuple[float, ...]
    end_s: float
    colour: str
    tip: str = ""


@dataclass(frozen=True)
class Block:
    """One cycle.

    Attributes:
        titles: Versions of the title, longest first; the first that fits is drawn.
        lanes: Names of the lanes from the top.
        bars, labels, arrows: Contents of the lanes.
        course: Progress, drawn above the lanes; None = not drawn.
        layers: Stacked shares, drawn in a lane below the others; empty = no such lane.
        layers_name: Name of that lane.
    """

    titles: tuple[str, ...]
    lanes: tuple[str, ...]
    bars: tuple[Bar, ...]
    labels: tuple[BarLabel, ...] = ()
    arrows: tuple[Arrow, ...] = ()
    course: TaskEnds | None = None
    layers: tuple[Layer, ...] = ()
    layers_name: str = ""

    @property
    def end_s(self) -> float:
        """End of the last bar or of the longest single cycle, s."""
        course = (self.course.high_s or self.course.ends_s) if self.course else ()
        return max((*(bar.end_s for bar in self.bars), *course), default=1.0)

    @property
    def lane_tops_in(self) -> list[float]:
        """Distance from the top of the block to the bars of each lane, inches; the last is that of the layers."""
        first = _TITLE_IN + (_COURSE_IN if self.course else 0.0)
        count = len(self.lanes) + bool(self.layers)
        return [first + number * (_LABEL_IN + _BAR_IN + _GAP_IN) + _LABEL_IN for number in range(count)]

    @property
    def height_in(self) -> float:
        """Height, inches."""
        return (self.lane_tops_in[-1] if self.lane_tops_in else _TITLE_IN) + _BAR_IN + 2 * _GAP_IN


def draw_gantt(path: Path, blocks: Sequence[Block], legend: Mapping[str, str], takt_s: float | None = None) -> None:
    """Draw a time chart.

    Args:
        path: File to write, `.svg`, `.png` or `.pdf`.
        blocks: The cycles from the top.
        legend: Colour by meaning.
        takt_s: Takt time, drawn as a line across all blocks, s; None = no line.
    """
    with canvas(path, _WIDTH_IN, height_in(blocks, legend, _WIDTH_IN)) as axes:
        draw_blocks(axes, blocks, legend, takt_s)


def height_in(blocks: Sequence[Block], legend: Mapping[str, str], width_in: float) -> float:
    """Return the height of a chart, inches."""
    return sum(block.height_in for block in blocks) + _FOOT_IN + _KEY_IN * len(_key_rows(legend, width_in)) + 0.06


def draw_blocks(
    axes: Axes,
    blocks: Sequence[Block],
    legend: Mapping[str, str],
    takt_s: float | None = None,
    tip: Tip = lambda _figure, _artist, _text, _row: None,
    *,
    like: Sequence[Block] = (),
) -> None:
    """Draw a time chart on axes that fill a figure of `height_in`.

    Args:
        axes: Where to draw.
        blocks: The cycles, the top one first.
        legend: Colour by meaning.
        takt_s: A line across all of them, s.
        tip: Called with figure, artist, text and task of everything that has a tooltip.
        like: Cycles with which the chart shares its time axis and left margin; by default its own.
    """
    figure: Figure = axes.figure  # type: ignore[assignment]  # no subfigure
    figure.set_layout_engine("none")
    width_in, all_in = figure.get_size_inches().tolist()
    body_in = sum(block.height_in for block in blocks)
    left_in = _left_in(like or blocks, width_in)
    axes.set_position((left_in / width_in, _FOOT_IN / all_in, 1 - (left_in + _RIGHT_IN) / width_in, body_in / all_in))
    end_s = 1.01 * max(max((block.end_s for block in like or blocks), default=1.0), takt_s or 0.0)
    axes.set(xlim=(0.0, end_s), ylim=(body_in, 0.0))
    axes.set_xlabel("time, s")
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.grid(visible=True, axis="x", color=_RULE, linewidth=0.6)
    axes.set_axisbelow(True)
    s_per_in = end_s / (width_in - left_in - _RIGHT_IN)
    top_in, names = 0.0, dict[float, str]()
    for block in blocks:
        names |= _Drawing(axes, block, top_in, s_per_in, tip).draw()
        top_in += block.height_in
    axes.set_yticks(list(names), [fitting((text,), left_in - 0.1, _NAME_PT, cut=True) for text in names.values()])
    axes.tick_params(axis="y", length=0, labelsize=_NAME_PT)
    if takt_s is not None:
        line = axes.axvline(takt_s, color=colours.SCALING_ANCHORS[0][1], linewidth=1.3, linestyle=(0, (5, 2)), zorder=4)
        tip(figure, line, f"takt {given(takt_s)} s", "")
    _draw_key(figure, legend, width_in, all_in)


def _left_in(blocks: Sequence[Block], width_in: float) -> float:
    """Return the width for the names of the lanes, inches: at most a sixth of the chart."""
    longest_in = max((_text_in(name, _NAME_PT) for block in blocks for name in block.lanes), default=0.0)
    return min(max(_LEFT_IN, longest_in + 0.12), max(_LEFT_IN, width_in / 6))


class _Drawing:
    """Draws one block; `top_in` is the distance of its top from that of the axes, inches."""

    def __init__(self, axes: Axes, block: Block, top_in: float, s_per_in: float, tip: Tip) -> None:
        self._axes, self._block, self._top_in, self._s_per_in, self._tip = axes, block, top_in, s_per_in, tip
        self._bars_in = [top_in + part for part in block.lane_tops_in]

    def draw(self) -> dict[float, str]:
        """Draw the block; return the names of its lanes by position, inches."""
        block, names = self._block, dict[float, str]()
        room_in = self._axes.get_xlim()[1] / self._s_per_in
        title = fitting(block.titles, room_in, _TITLE_PT, cut=True, weight="bold")
        at_in = self._top_in + _TITLE_IN - 0.06
        self._write(0.0, at_in, title, _TITLE_PT, weight="bold")
        if block.course is not None:
            names[self._draw_course(block.course)] = "tasks done"
        for bar in block.bars:
            self._draw_bar(bar)
        for label in block.labels:
            self._draw_label(label)
        for arrow in block.arrows:
            self._draw_arrow(arrow)
        self._draw_layers()
        lanes = [*block.lanes, *([block.layers_name] if block.layers else [])]
        middles = (top + _BAR_IN / 2 for top in self._bars_in)
        return names | dict(zip(middles, lanes, strict=True))

    def _draw_course(self, course: TaskEnds) -> float:
        foot_in, high_in = self._top_in + _TITLE_IN + _COURSE_IN - 0.03, _COURSE_IN - 0.08
        count = max(len(course.ends_s), 1)
        done_in = [foot_in - high_in * number / count for number in range(count + 1)]
        if course.low_s:
            low, high = (0.0, *course.low_s), (0.0, *course.high_s)
            self._axes.fill_betweenx(done_in, low, high, color=_BAND, linewidth=0.0, zorder=2)
        self._axes.plot((0.0, *course.ends_s), done_in, color=colours.NOMINAL, linewidth=1.1, zorder=3)
        for at_s, at_in, text in zip(course.ends_s, done_in[1:], course.tips, strict=False):
            (dot,) = self._axes.plot([at_s], [at_in], ".", color=colours.NOMINAL, markersize=3.5, zorder=3)
            self._tip(self._axes.figure, dot, text, "")  # type: ignore[arg-type]  # no subfigure
        return foot_in - high_in / 2

    def _draw_bar(self, bar: Bar) -> None:
        at_in, long_s = self._bars_in[bar.lane] + _BAR_IN / 2, bar.end_s - bar.start_s
        edge = _HATCH if bar.waits else "white"
        drawn = self._axes.barh(
            at_in, long_s, left=bar.start_s, height=_BAR_IN, color=bar.colour, edgecolor=edge, linewidth=0.5, zorder=3
        )
        if bar.waits:
            across_in, down_in = _hatching(long_s / self._s_per_in, _BAR_IN)
            at_s = [bar.start_s + x_in * self._s_per_in for x_in in across_in]
            at_y = [self._bars_in[bar.lane] + y_in for y_in in down_in]
            self._axes.plot(at_s, at_y, color=_HATCH, linewidth=0.8, zorder=3.5)
        if bar.tip:
            self._tip(self._axes.figure, drawn.patches[0], bar.tip, bar.row)  # type: ignore[arg-type]

    def _draw_label(self, label: BarLabel) -> None:
        arrives = any((arrow.to_lane, arrow.to_s) == (label.lane, label.start_s) for arrow in self._block.arrows)
        beside_in = 0.07 if arrives else 0.0
        room_in = (label.end_s - label.start_s) / self._s_per_in
        if text := fitting(label.texts, room_in - 0.03 - beside_in, _LABEL_PT):
            at_in = self._bars_in[label.lane] - 0.04
            self._write(label.start_s + beside_in * self._s_per_in, at_in, text, _LABEL_PT)

    def _write(self, at_s: float, at_in: float, text: str, size_pt: float, weight: str = "normal") -> None:
        """Write text on white, so that neither grid nor takt line crosses it."""
        self._axes.text(
            at_s, at_in, text, fontsize=size_pt, fontweight=weight, color=_INK, va="baseline", zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4},
        )  # fmt: skip

    def _draw_arrow(self, arrow: Arrow) -> None:
        below = arrow.from_lane < arrow.to_lane
        ends = self._bars_in[arrow.from_lane] + below * _BAR_IN, self._bars_in[arrow.to_lane] + (not below) * _BAR_IN
        look = {"arrowstyle": "->", "color": colours.ROBOT, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}
        look |= {"linestyle": (0, (1, 1.5))} if arrow.seldom else {}
        self._axes.annotate("", xy=(arrow.to_s, ends[1]), xytext=(arrow.from_s, ends[0]), arrowprops=look, zorder=5)

    def _draw_layers(self) -> None:
        layers = self._block.layers
        below = [self._bars_in[-1] + _BAR_IN] * (len(layers[0].parts) + 1) if layers else []
        for layer in layers:
            edges = [layer.end_s * number / len(layer.parts) for number in range(len(below))]
            parts = (*layer.parts, layer.parts[-1])
            above = [low - (_BAR_IN + _LABEL_IN - 0.04) * part for low, part in zip(below, parts, strict=True)]
            area = self._axes.fill_between(
                edges, below, above, step="post", color=layer.colour, linewidth=0.0, zorder=3
            )
            self._tip(self._axes.figure, area, layer.tip, "")  # type: ignore[arg-type]  # no subfigure
            below = above


def _key_rows(legend: Mapping[str, str], width_in: float) -> list[list[str]]:
    """Return the entries of the legend, split into rows that fit."""
    rows: list[list[str]] = [[]]
    used_in = 0.0
    for text in legend:
        needs_in = _text_in(text, _NAME_PT) + 0.36
        if rows[-1] and used_in + needs_in > width_in - 0.1:
            rows.append([])
            used_in = 0.0
        rows[-1].append(text)
        used_in += needs_in
    return rows if legend else []


def _draw_key(figure: Figure, legend: Mapping[str, str], width_in: float, all_in: float) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    for number, row in enumerate(_key_rows(legend, width_in)):
        at_in, foot_in = 0.06, all_in - _KEY_IN * (number + 1) + 0.06
        for text in row:
            square = (at_in / width_in, foot_in / all_in), 0.12 / width_in, 0.1 / all_in
            figure.add_artist(Rectangle(*square, facecolor=legend[text], linewidth=0.0))
            if legend[text] == colours.WAIT:
                across_in, down_in = _hatching(0.12, 0.1, 0.04)
                lines_in = (
                    [(at_in + x_in) / width_in for x_in in across_in],
                    [(foot_in + 0.1 - y_in) / all_in for y_in in down_in],
                )
                figure.add_artist(Line2D(*lines_in, color=_HATCH, linewidth=0.8))
            place = (at_in + 0.17) / width_in, (foot_in - 0.005) / all_in
            figure.text(*place, text, fontsize=_NAME_PT, color=_MUTED, va="baseline")
            at_in += _text_in(text, _NAME_PT) + 0.36


def fitting(texts: Sequence[str], room_in: float, size_pt: float, *, cut: bool = False, weight: str = "normal") -> str:
    """Return the first text that fits; if none does, the last one shortened with `cut`, else an empty text."""
    for text in texts:
        if _text_in(text, size_pt, weight) <= room_in:
            return text
    short = texts[-1] if cut and texts else ""
    while short and _text_in(f"{short}…", size_pt, weight) > room_in:
        short = short[:-1]
    return f"{short.rstrip()}…" if short else ""


def _hatching(wide_in: float, high_in: float, apart_in: float = 0.07) -> tuple[list[float], list[float]]:
    """Return slanted lines in a rectangle, x and y from its top left, inches; NaN between two lines.

    Browsers print matplotlib's hatches as pixels, 0.1 MB for each bar; so lines are used.
    """
    across, down = list[float](), list[float]()
    foot = -high_in + apart_in / 2
    while foot < wide_in:  # each line rises from (foot, bottom) to the right
        left, right = max(foot, 0.0), min(foot + high_in, wide_in)
        across += [left, right, float("nan")]
        down += [high_in - (left - foot), high_in - (right - foot), float("nan")]
        foot += apart_in
    return across, down


@cache
def _text_in(text: str, size_pt: float, weight: str = "normal") -> float:
    """Return the maximum width of a text, inches: DejaVu Sans is wider than the fonts of the page."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextToPath

    wide = sum(unicodedata.east_asian_width(letter) in "WF" for letter in text)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a character that DejaVu lacks; browsers have it
        font = FontProperties(size=size_pt, weight=weight)
        width_pt, _, _ = TextToPath().get_text_width_height_descent(text, font, ismath=False)
    return float(_HINTED * (width_pt + 0.5 * size_pt * wide) / 72.0)
