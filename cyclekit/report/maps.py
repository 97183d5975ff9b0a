"""Figures of scaling against distance, floor plans, heatmap of the levels, calibration.

Each function draws one vector figure for a width in inches, with the numbers as tooltips. The numbers come from
`findings`, `floor` and `calibration`; `pictures` turns a figure into SVG.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import PercentFormatter

from cyclekit.plots import colours
from cyclekit.plots.floor import SHADE, draw_cell, label_axes, outline, square
from cyclekit.plots.style import INK, MUTED, RULE, tip
from cyclekit.report.findings import DISTANCE_BIN_M, SCALING_BIN
from cyclekit.report.pictures import WIDE_IN
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from cyclekit.plots.floor import FloorNote
    from cyclekit.report.calibration import PredictionBins
    from cyclekit.report.findings import LoggedResponse
    from cyclekit.report.floor import FloorPlan
    from cyclekit.report.texts import ReportTexts

_FAINTEST = 0.02
"""Squares with less than this part of the largest value are left out."""


def staircase(width_in: float, found: LoggedResponse, levels: Sequence[float], labels: Mapping[str, str]) -> Figure:
    """Scaling against distance: samples as squares in the scaling's colour, mean of the log, mean of the model."""
    figure = Figure(figsize=(width_in, 2.7 if width_in == WIDE_IN else 3.2), layout="constrained")
    axes = figure.add_subplot()
    for level in levels:
        axes.axhline(level, color=RULE, linewidth=0.8, zorder=0)
    most = float(found.cells[:, 2].max())
    for distance, scaling, count in found.cells.tolist():
        strength = float(np.sqrt(count / most))
        height = SCALING_BIN * (0.8 + 1.4 * strength)  # taller than the lines of the means are thick
        corner = (distance - DISTANCE_BIN_M / 2, scaling - height / 2)
        square = Rectangle(
            corner, DISTANCE_BIN_M, height, color=colours.scaling_hex(scaling), alpha=0.3 + 0.6 * strength, linewidth=0
        )
        axes.add_artist(square)
        low, high = distance - DISTANCE_BIN_M / 2, distance + DISTANCE_BIN_M / 2
        values = {
            "low": fixed(low, 2),
            "high": fixed(high, 2),
            "speed": fixed(100 * scaling, 0),
            "count": fixed(count, 0),
        }
        tip(figure, square, labels["tip"].format(**values))
    means: list[tuple[NDArray[np.float64], str, str, Any]] = [(found.logged, INK, labels["logged"], "-")]
    if found.predicted is not None:
        means.append((found.predicted, colours.PREDICTED, labels["predicted"], (0, (4, 2))))
    for mean, colour, label, dashes in means:
        axes.plot(
            found.bin_m,
            mean,
            drawstyle="steps-mid",
            color=colour,
            label=label,
            linewidth=1.3,
            linestyle=dashes,
            zorder=3,
        )
    axes.set(ylim=(-0.06, 1.06), xlim=(max(0.0, float(found.bin_m.min()) - 0.2), float(found.bin_m.max()) + 0.1))
    axes.set(xlabel=labels["distance"], ylabel=labels["speed"])
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_yticks(sorted({0.0, 1.0, *levels}) if len(levels) <= 6 else [0, 0.25, 0.5, 0.75, 1])
    axes.legend(loc="lower right", handlelength=2.4)
    return figure


def floor_labels(texts: ReportTexts) -> dict[str, str]:
    """Return the words of a floor plan."""
    words = texts.section("why")
    return {key: words[key] for key in ("base", "x", "y", "tip_seen", "tip_lost", "tip_zone", "tip_rule")}


def lost_map(width_in: float, plan: FloorPlan, labels: Mapping[str, str]) -> Figure:
    """Floor plan: time per operator position (grey) and time lost (squares)."""
    figure, axes = _floor(width_in, plan)
    longest = float(plan.seen[:, 2].max())
    for x, y, seconds in plan.seen.tolist():
        grey = 0.10 + 0.35 * float(np.sqrt(seconds / longest))
        drawn = square(axes, x, y, plan.cell_m, "#6b7885", alpha=grey)
        tip(figure, drawn, labels["tip_seen"].format(x=fixed(x, 1), y=fixed(y, 1), seconds=fixed(seconds, 2)))
    most = float(plan.lost[:, 2].max()) if len(plan.lost) else 1.0
    for x, y, seconds, scaling in plan.lost.tolist():
        if seconds < _FAINTEST * most:
            continue
        side = plan.cell_m * float(np.sqrt(seconds / most))
        drawn = square(axes, x, y, side, colours.scaling_hex(scaling), alpha=SHADE)
        values = {"x": fixed(x, 1), "y": fixed(y, 1), "seconds": fixed(seconds, 2), "speed": fixed(100 * scaling, 0)}
        tip(figure, drawn, labels["tip_lost"].format(**values))
    _finish(axes, plan, labels, [])
    return figure


def zone_map(width_in: float, plan: FloorPlan, labels: Mapping[str, str]) -> Figure:
    """Floor plan: mean robot speed for an operator in each square."""
    figure, axes = _floor(width_in, plan)
    for x, y, scaling in plan.zones.tolist():
        drawn = square(axes, x, y, plan.cell_m, colours.scaling_hex(scaling), alpha=SHADE)
        tip(figure, drawn, labels["tip_zone"].format(x=fixed(x, 1), y=fixed(y, 1), speed=fixed(100 * scaling, 0)))
    _finish(axes, plan, labels, [outline(axes, shape, labels["tip_rule"]) for shape in plan.shapes])
    return figure


def heatmap(width_in: float, counts: NDArray[np.float64], names: Sequence[str], labels: Mapping[str, str]) -> Figure:
    """Logged against predicted level, per cent of each logged level; counts (P, P), first index logged."""
    side = min(width_in, 4.6)
    figure = Figure(figsize=(width_in, 0.8 * side), layout="constrained")
    axes = figure.add_subplot()
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    for logged in range(len(names)):
        for predicted in range(len(names)):
            part = float(share[logged, predicted])
            square = Rectangle(
                (predicted - 0.5, logged - 0.5), 1, 1, color=colours.NOMINAL, alpha=part**0.6, linewidth=0
            )
            axes.add_artist(square)
            values = {"logged": names[logged], "predicted": names[predicted], "part": fixed(100 * part, 1)}
            tip(figure, square, labels["tip"].format(**values, count=fixed(counts[logged, predicted], 0)))
            if part >= 0.0005:
                ink = "white" if part > 0.45 else INK
                axes.text(predicted, logged, fixed(100 * part, 1), ha="center", va="center", color=ink, fontsize=8.5)
    axes.set(xlim=(-0.5, len(names) - 0.5), ylim=(len(names) - 0.5, -0.5), aspect="equal")
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel=labels["predicted"], ylabel=labels["logged"])
    axes.tick_params(length=0)
    return figure


def calibration(width_in: float, found: PredictionBins, labels: Mapping[str, str]) -> Figure:
    """Mean logged scaling per bin of predicted scaling, with the line on which both are equal."""
    side = min(width_in, 4.6)
    figure = Figure(figsize=(width_in, 0.75 * side), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color=MUTED, linewidth=1.0, linestyle=(0, (4, 3)), zorder=1)
    biggest = float(found.count.max())
    for predicted, logged, count in zip(found.predicted, found.logged, found.count, strict=True):
        size = 4 + 8 * float(np.sqrt(count / biggest))
        (dot,) = axes.plot([predicted], [logged], "o", color=colours.PREDICTED, markersize=size, alpha=0.85, zorder=2)
        values = {"predicted": fixed(100 * predicted, 0), "logged": fixed(100 * logged, 1), "count": fixed(count, 0)}
        tip(figure, dot, labels["tip"].format(**values))
    axes.set(xlim=(-0.04, 1.04), ylim=(-0.04, 1.04), aspect="equal")
    axes.set(xlabel=labels["predicted"], ylabel=labels["logged"])
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(visible=True)
    axes.set_axisbelow(True)
    return figure


def _floor(width_in: float, plan: FloorPlan) -> tuple[Figure, Axes]:
    robot = plan.robot_m[np.isfinite(plan.robot_m).all(axis=1)]
    span = np.ptp(np.concatenate([plan.seen[:, :2], robot, np.zeros((int(plan.robot_known), 2))]), axis=0) + 0.6
    height_in = min(0.78, max(0.45, float(span[1] / span[0]))) * (width_in - 0.7) + 0.9
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = figure.add_subplot()
    half = plan.cell_m / 2  # set once: limits updated by every patch cost more than the drawing
    axes.update_datalim([plan.seen[:, :2].min(axis=0) - half, plan.seen[:, :2].max(axis=0) + half])
    return figure, axes


def _finish(axes: Axes, plan: FloorPlan, labels: Mapping[str, str], notes: list[FloorNote | None]) -> None:
    """Tables, robot base and path, places, axes and colour scale."""
    axes.plot(*plan.robot_m.T, color=colours.ROBOT, linewidth=0.7, alpha=0.7, zorder=3)
    notes += draw_cell(axes, plan.cell, labels["base"] if plan.robot_known else None)
    label_axes(axes, labels["x"], labels["y"], labels.get("speed"), notes)
