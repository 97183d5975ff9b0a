"""Charts of rows on the page: cycle times, and what time was lost to.

Each function draws one figure for a width in inches and leaves out what does not fit a phone. Numbers come from
`findings` and the estimates; `pictures` turns a figure into SVG.
"""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator

from cyclekit.plots import colours
from cyclekit.plots.style import INK, MUTED, tip
from cyclekit.report.pictures import WIDE_IN
from cyclekit.text.numbers import fixed, given, span

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from cyclekit.estimate.result import CycleEstimate

FEW_ROWS, MANY_ROWS = 9, 16
_ROW_IN, _LOW_ROW_IN, _LOWEST_ROW_IN = 0.42, 0.31, 0.25
_KEY_ROW_IN = 0.2
_WIDER, _LETTER_IN = 0.12, 0.08
"""Part by which the page's font may draw a name wider than measured, and width of a letter, inches."""


def cycle_times(
    width_in: float, estimates: Sequence[CycleEstimate], labels: Mapping[str, str], takt_s: float | None = None
) -> Figure:
    """One row per sequence: 5 % to 95 % of cycles as a bar, the mean a dot, nominal time a tick, the takt a line."""
    low, high = _levels(estimates)
    entries = [
        ("o", colours.NOMINAL, labels["mean"]),
        ("s", "#b9c8db", labels["cycles"].format(low=low, high=high)),
        ("|", MUTED, labels["without"]),
    ]
    if takt_s is not None:
        entries.append(("|", colours.SCALING_ANCHORS[0][1], labels["takt"]))
    columns = _columns(entries, width_in)
    figure, axes = _rows(width_in, len(estimates), bottom_in=0.75 + _KEY_ROW_IN * math.ceil(len(entries) / columns))
    for row, each in enumerate(estimates):
        quantiles = sorted(each.quantiles_s.items())
        if quantiles:
            low_s, high_s = quantiles[0][1], quantiles[-1][1]
            (bar,) = axes.plot(
                [low_s, high_s], [row, row], color="#b9c8db", linewidth=9, solid_capstyle="butt", zorder=1
            )
            text = labels["tip"].format(
                name=each.name,
                mean=fixed(each.expected_s, 1),
                span=span(low_s, high_s, 1),
                safety=fixed(each.safety_loss_s, 1),
            )
            tip(figure, bar, text, each.name)
        axes.plot([each.expected_low_s, each.expected_high_s], [row, row], color=colours.NOMINAL, linewidth=3, zorder=2)
        axes.plot([each.expected_s], [row], "o", color=colours.NOMINAL, markersize=6, zorder=3)
        floor_s = each.expected_s - each.safety_loss_s
        axes.plot([floor_s, floor_s], [row - 0.25, row + 0.25], color=MUTED, linewidth=1.4, zorder=2)
    if takt_s is not None:
        axes.axvline(takt_s, color=colours.SCALING_ANCHORS[0][1], linewidth=1.4, linestyle=(0, (5, 2)), zorder=2)
    _name_rows(axes, [each.name for each in estimates], width_in)
    axes.set_xlabel(labels["seconds"])
    axes.margins(x=0.06)
    axes.grid(axis="x")
    _key(figure, axes, entries, columns)
    return figure


def causes(width_in: float, rows: Sequence[tuple[str, float, str]], labels: Mapping[str, str]) -> Figure:
    """One bar per cause of lost time: name, seconds and colour."""
    figure, axes = _rows(width_in, len(rows), bottom_in=0.6)
    most = max((value for _, value, _ in rows), default=1.0)
    for number, (name, value, colour) in enumerate(rows):
        bar = axes.barh(number, value, height=0.62, color=colour)
        tip(figure, bar.patches[0], f"{name}: {fixed(value, 1)} s", name)
        axes.text(value + 0.01 * most, number, fixed(value, 1), va="center", color=INK, fontsize=8.5)
    _name_rows(axes, [name for name, _, _ in rows], width_in)
    axes.set_xlim(0, most * 1.12)
    axes.set_xlabel(labels["seconds"])
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    return figure


def _rows(width_in: float, count: int, *, bottom_in: float) -> tuple[Figure, Axes]:
    """A figure with room for `count` horizontal rows, the first on top."""
    crowded = count > MANY_ROWS and width_in == WIDE_IN  # on a phone a name takes two lines
    row_in = _ROW_IN if count <= FEW_ROWS else _LOWEST_ROW_IN if crowded else _LOW_ROW_IN
    figure = Figure(figsize=(width_in, bottom_in + row_in * max(count, 1)), layout="constrained")
    axes = figure.add_subplot()
    axes.set_ylim(max(count, 1) - 0.45, -0.55)
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    return figure, axes


def _name_rows(axes: Axes, names: Sequence[str], width_in: float) -> None:
    longest = 34 if width_in == WIDE_IN else 18
    shown = [_two_lines(name, longest) for name in names]
    axes.set_yticks(range(len(names)), shown, color=INK, linespacing=0.95)
    _reserve(axes, [line for name in shown for line in name.split("\n")], width_in)
    axes.xaxis.set_major_locator(MaxNLocator(8 if width_in == WIDE_IN else 4, steps=[1, 2, 5, 10]))


def _reserve(axes: Axes, lines: Sequence[str], width_in: float) -> None:
    """Leave room at the left: the page's font draws some names wider than they are measured here."""
    engine = axes.figure.get_layout_engine()
    left = _WIDER * max(map(len, lines), default=0) * _LETTER_IN / width_in
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(left, 0.0, 1.0 - left, 1.0))


def _two_lines(name: str, longest: int) -> str:
    """Break a name into at most two lines of that length."""
    lines = textwrap.wrap(name, longest) or [""]
    return "\n".join(lines[:2]) + ("…" if len(lines) > 2 else "")


def _columns(entries: Sequence[tuple[str, str, str]], width_in: float) -> int:
    """Return the number of columns of the legend: one line on a wide screen, one or two columns on a phone."""
    short = max(len(text) for _, _, text in entries) <= 16
    return len(entries) if width_in == WIDE_IN else 2 if len(entries) > 3 and short else 1


def _key(figure: Figure, axes: Axes, entries: Sequence[tuple[str, str, str]], columns: int) -> None:
    """Draw a legend above the plot."""
    handles = [
        axes.plot([], [], marker, color=colour, markersize=7, markeredgewidth=1.4 if marker == "|" else 0)[0]
        for marker, colour, _ in entries
    ]
    figure.legend(
        handles,
        [text for _, _, text in entries],
        loc="outside upper left",
        ncols=columns,
        handletextpad=0.3,
        columnspacing=1.4,
        borderpad=0.1,
    )


def _levels(estimates: Sequence[CycleEstimate]) -> tuple[str, str]:
    levels = sorted(estimates[0].quantiles_s) if estimates else []
    return (given(100 * levels[0]), given(100 * levels[-1])) if levels else ("5", "95")
