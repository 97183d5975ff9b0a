"""The four pictures of the page: cycle times, where the time goes, scaling against distance, the floor plan.

Each function draws one figure for a width in inches and leaves out what does not fit a phone. Numbers come from
`findings` and the estimates; turning a figure into SVG is the business of `pictures`.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator, PercentFormatter

from cyclekit import colours
from cyclekit.labels import place_labels
from cyclekit.report.pictures import INK, MUTED, RULE, WIDE_IN

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from cyclekit.dataset import Place
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.findings import FloorPlan, SafetyFunction, Share

PARTS = (
    ("nominal_s", "nominal", colours.NOMINAL),
    ("safety_s", "safety", colours.SAFETY),
    ("dwell_s", "dwell", colours.DWELL),
    ("wait_s", "wait", colours.WAIT),
)
"""Parts of a cycle in drawing order: field of `Share`, key of its text, colour."""

FEW_ROWS = 9
_ROW_IN, _LOW_ROW_IN = 0.42, 0.31


def cycle_times(width_in: float, estimates: Sequence[CycleEstimate], labels: Mapping[str, str]) -> Figure:
    """One row per sequence: 5 % to 95 % of cycles as a bar, the mean as a dot, nominal time as a tick."""
    figure, axes = _rows(width_in, len(estimates), bottom_in=0.95)
    for row, each in enumerate(estimates):
        quantiles = sorted(each.quantiles_s.items())
        if quantiles:
            low_s, high_s = quantiles[0][1], quantiles[-1][1]
            axes.plot([low_s, high_s], [row, row], color="#b9c8db", linewidth=9, solid_capstyle="butt", zorder=1)
        axes.plot([each.expected_low_s, each.expected_high_s], [row, row], color=colours.NOMINAL, linewidth=3, zorder=2)
        axes.plot([each.expected_s], [row], "o", color=colours.NOMINAL, markersize=6, zorder=3)
        floor_s = each.expected_s - each.safety_loss_s
        axes.plot([floor_s, floor_s], [row - 0.25, row + 0.25], color=MUTED, linewidth=1.4, zorder=2)
    _name_rows(axes, [each.name for each in estimates], width_in)
    axes.set_xlabel(labels["seconds"])
    axes.margins(x=0.06)
    axes.grid(axis="x")
    low, high = _levels(estimates)
    _key(
        figure,
        axes,
        [
            ("o", colours.NOMINAL, labels["mean"]),
            ("s", "#b9c8db", labels["cycles"].format(low=low, high=high)),
            ("|", MUTED, labels["without"]),
        ],
        width_in,
    )
    return figure


def shares(width_in: float, rows: Sequence[Share], labels: Mapping[str, str]) -> Figure:
    """One stacked bar per task or sequence: nominal motion, safety loss, dwell, wait."""
    figure, axes = _rows(width_in, len(rows), bottom_in=0.95)
    longest = max((row.total_s for row in rows), default=1.0)
    for number, row in enumerate(rows):
        start = 0.0
        for field, _, colour in PARTS:
            value = max(0.0, getattr(row, field))
            if value <= 0:
                continue
            axes.barh(number, value, left=start, height=0.62, color=colour, edgecolor="white", linewidth=0.6)
            if value > 0.09 * longest * (WIDE_IN / width_in):
                ink = "white" if colour == colours.NOMINAL else INK
                axes.text(start + value / 2, number, f"{value:.1f}", ha="center", va="center", color=ink, fontsize=8.5)
            start += value
    _name_rows(axes, [row.name for row in rows], width_in)
    axes.set_xlim(0, longest * 1.02)
    axes.set_xlabel(labels["seconds"])
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    shown = [(field, key, colour) for field, key, colour in PARTS if any(getattr(row, field) > 0 for row in rows)]
    _key(figure, axes, [("s", colour, labels[key]) for _, key, colour in shown], width_in)
    return figure


def staircase(width_in: float, found: SafetyFunction, levels: Sequence[float], labels: Mapping[str, str]) -> Figure:
    """Scaling against distance: samples as dots in the scaling's colour, mean of the log, mean of the model."""
    figure = Figure(figsize=(width_in, 3.5 if width_in == WIDE_IN else 3.2), layout="constrained")
    axes = figure.add_subplot()
    for level in levels:
        axes.axhline(level, color=RULE, linewidth=0.8, zorder=0)
    rng = np.random.default_rng(0)
    narrow = width_in != WIDE_IN
    keep = slice(0, len(found.distance_m) // 2 if narrow else None)
    jitter = rng.uniform(-0.022, 0.022, size=len(found.scaling))
    axes.scatter(
        found.distance_m[keep],
        (found.scaling + jitter)[keep],
        s=5,
        linewidths=0,
        alpha=0.55,
        color=colours.scaling_rgb(found.scaling[keep]) / 255.0,
        rasterized=True,
        zorder=1,
    )
    axes.plot(
        found.bin_m, found.logged, drawstyle="steps-mid", color=INK, linewidth=1.8, label=labels["logged"], zorder=3
    )
    if found.predicted is not None:
        axes.plot(
            found.bin_m,
            found.predicted,
            label=labels["predicted"],
            zorder=4,
            color=colours.PREDICTED,
            linewidth=1.8,
            linestyle=(0, (4, 2)),
            drawstyle="steps-mid",
        )
    axes.set_ylim(-0.06, 1.06)
    axes.set_xlim(left=max(0.0, float(found.bin_m.min()) - 0.2), right=float(found.bin_m.max()) + 0.1)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_yticks(sorted({0.0, 1.0, *levels}) if len(levels) <= 6 else [0, 0.25, 0.5, 0.75, 1])
    axes.set_xlabel(labels["distance"])
    axes.set_ylabel(labels["speed"])
    axes.legend(loc="lower right", handlelength=2.4)
    return figure


def floor_map(width_in: float, plan: FloorPlan, labels: Mapping[str, str]) -> Figure:
    """The floor from above: where the operator walked, squares where time was lost, the robot and the places."""
    span = np.ptp(np.concatenate([plan.walked_m, plan.robot_m, np.zeros((1, 2))]), axis=0) + 0.6
    height_in = min(1.25, max(0.45, float(span[1] / span[0]))) * (width_in - 0.7) + 0.9
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(*plan.walked_m.T, ".", markersize=2, markeredgewidth=0, color="#b4bdc7", zorder=1, rasterized=True)
    most = float(plan.lost_s.max()) if len(plan.lost_s) else 1.0
    for x, y, lost, scaling in zip(plan.x_m, plan.y_m, plan.lost_s, plan.scaling, strict=True):
        side = plan.cell_m * float(np.sqrt(lost / most))
        if side < 0.08 * plan.cell_m:
            continue
        colour = colours.scaling_hex(float(scaling))
        axes.add_patch(Rectangle((x - side / 2, y - side / 2), side, side, color=colour, linewidth=0, zorder=2))
    if len(plan.robot_m):
        axes.plot(*plan.robot_m.T, ".", color=colours.ROBOT, markersize=1.2, alpha=0.5, zorder=3, rasterized=True)
    axes.plot([0], [0], marker="s", markersize=9, color=colours.ROBOT, zorder=5)
    _note(axes, labels["base"], (0.0, 0.0), colours.ROBOT)
    _places(axes, plan.places, "D", colours.ROBOT)
    _places(axes, plan.human_places, "o", colours.OPERATOR)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.set_xlabel(labels["x"])
    axes.set_ylabel(labels["y"])
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    _scale_bar(axes, labels["speed"])
    return figure


def _places(axes: Axes, places: Mapping[str, Place], marker: str, colour: str) -> None:
    for place in places.values():
        x, y, _ = place.xyz_m
        axes.plot([x], [y], marker, markersize=5.5, color=colour, markeredgecolor="white", zorder=6)
    for label in place_labels(places):
        _note(axes, label.text, label.xyz_m[:2], colour)


def _note(axes: Axes, text: str, at: tuple[float, float], colour: str) -> None:
    halo = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    axes.annotate(
        text,
        at,
        xytext=(0, 8),
        textcoords="offset points",
        ha="center",
        color=colour,
        fontsize=8.5,
        bbox=halo,
        zorder=7,
    )


def _scale_bar(axes: Axes, label: str) -> None:
    """The colour scale of scaling, the same on every page and in the replay."""
    inset = axes.inset_axes((0.0, 1.03, 0.42, 0.03))
    inset.imshow(colours.scaling_rgb(np.linspace(0, 1, 120))[None] / 255.0, aspect="auto", extent=(0, 1, 0, 1))
    inset.set_yticks([])
    inset.set_xticks([0, 0.5, 1], ["0", "50", "100 %"])
    inset.tick_params(length=2, labelsize=8, top=True, labeltop=True, bottom=False, labelbottom=False)
    for spine in inset.spines.values():
        spine.set_visible(False)
    inset.text(1.08, 0.5, label, transform=inset.transAxes, va="center", fontsize=8.5, color=MUTED)


def _rows(width_in: float, count: int, *, bottom_in: float) -> tuple[Figure, Axes]:
    """A figure with room for `count` horizontal rows, the first on top."""
    row_in = _ROW_IN if count <= FEW_ROWS else _LOW_ROW_IN
    figure = Figure(figsize=(width_in, bottom_in + row_in * max(count, 1)), layout="constrained")
    axes = figure.add_subplot()
    axes.set_ylim(max(count, 1) - 0.45, -0.55)
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    return figure, axes


def _name_rows(axes: Axes, names: Sequence[str], width_in: float) -> None:
    longest = 34 if width_in == WIDE_IN else 18
    axes.set_yticks(range(len(names)), [_two_lines(name, longest) for name in names], color=INK, linespacing=0.95)
    axes.xaxis.set_major_locator(MaxNLocator(8 if width_in == WIDE_IN else 4, steps=[1, 2, 5, 10]))


def _two_lines(name: str, longest: int) -> str:
    """Break a name into at most two lines of that length."""
    lines = textwrap.wrap(name, longest) or [""]
    return "\n".join(lines[:2]) + ("…" if len(lines) > 2 else "")


def _key(figure: Figure, axes: Axes, entries: Sequence[tuple[str, str, str]], width_in: float) -> None:
    """A legend above the plot, in one line on a desk and two columns on a phone."""
    handles = [
        axes.plot([], [], marker, color=colour, markersize=7, markeredgewidth=1.4 if marker == "|" else 0)[0]
        for marker, colour, _ in entries
    ]
    columns = len(entries) if width_in == WIDE_IN else 2 if len(entries) > 3 else 1
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
    return (f"{100 * levels[0]:g}", f"{100 * levels[-1]:g}") if levels else ("5", "95")
