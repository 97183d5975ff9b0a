"""Figures of `.plot()`: logged executions, a training, estimates as a time chart, and a planned order."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator, PercentFormatter

from cyclekit.plots import colours
from cyclekit.plots.drawing import Drawing
from cyclekit.plots.gantt import draw_blocks, height_in
from cyclekit.plots.style import INK, MUTED, plain_style
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from cyclekit.plots.gantt import Block

CHART_IN = 11.0
"""Width of a time chart, inches."""
PARTS = (
    ("nominal_s", "motion at full speed", colours.NOMINAL),
    ("safety_loss_s", "safety slow-down", colours.SAFETY),
    ("dwell_s", "dwell", colours.DWELL),
    ("wait_s", "wait", colours.WAIT),
)


def executions_figure(duration_s: Sequence[float], parts: Mapping[str, Sequence[float]]) -> Drawing:
    """Return a figure with one bar per logged execution, its time split into four parts.

    Args:
        duration_s: Duration of each execution, s, in the order of the logs.
        parts: Seconds by the names of `PARTS`; an unknown one is 0.
    """
    with plain_style():
        figure = Drawing(9.0, 3.4)
        axes = figure.subplots()
        at, bottom = np.arange(1, len(duration_s) + 1), np.zeros(len(duration_s))
        for name, words, colour in PARTS:
            values = np.asarray(parts[name], dtype=np.float64)
            if values.any():
                axes.bar(at, values, bottom=bottom, color=colour, label=words, width=0.8)
                bottom += values
        axes.plot(at, duration_s, "_", color=INK, markersize=6, label="cycle time")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(xlabel="execution, in the order of the logs", ylabel="time, s")
        figure.legend(loc="outside upper left", ncols=5)
    return figure


def training_figure(
    epochs: Sequence[tuple[int, float]],
    levels: Sequence[tuple[float, float]],
    *,
    held_out: float | None,
    constant: float | None,
) -> Drawing:
    """Return a figure of the error over the epochs of a training, and of the share of samples on each level.

    Args:
        epochs: Number of each epoch, and mean squared error on the validation set after it.
        levels: Each level and its share of the training samples.
        held_out: Mean squared error on held-out executions; None = unknown.
        constant: Mean squared error of predicting the mean of all samples.
    """
    with plain_style():
        figure = Drawing(9.0, 3.4)
        error, shares = figure.subplots(1, 2, width_ratios=(3, 2))
        _error(error, epochs, held_out, constant)
        speed = [level for level, _ in levels]
        gap = float(np.diff(speed).min()) if len(speed) > 1 else 0.2
        shares.barh(speed, [share for _, share in levels], height=0.7 * gap, color=[*map(colours.scaling_hex, speed)])
        shares.xaxis.set_major_formatter(PercentFormatter(1.0))
        shares.yaxis.set_major_formatter(PercentFormatter(1.0))
        shares.set(ylim=(-0.15, 1.15), xlabel="share of the training samples", ylabel="robot speed (scaling)")
        shares.set_yticks(speed or [0, 0.5, 1])
    return figure


def _error(axes: Axes, epochs: Sequence[tuple[int, float]], held_out: float | None, constant: float | None) -> None:
    numbers, errors = [number for number, _ in epochs], [error for _, error in epochs]
    axes.plot(numbers, errors, "o-", color=colours.NOMINAL, label="validation executions")
    if held_out is not None:
        axes.axhline(held_out, color=colours.PREDICTED, linewidth=1.2, label="held-out executions")
    if constant is not None:
        axes.axhline(constant, color=MUTED, linestyle="--", label="mean of all samples")
    axes.set(xlabel="epoch", ylabel="mean squared error", ylim=(0, None))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(axis="y")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)


def chart_figure(blocks: Sequence[Block], legend: Mapping[str, str], takt_s: float | None = None) -> Drawing:
    """Return a time chart; arguments as of `gantt.draw_gantt`."""
    with plain_style():
        figure = Drawing(CHART_IN, height_in(blocks, legend, CHART_IN))
        draw_blocks(figure.subplots(), blocks, legend, takt_s)
    return figure


def order_figure(order: str, against: str, means_s: tuple[float, float], interval_s: tuple[float, float]) -> Drawing:
    """Return a figure of the mean cycle time of an order and of the orders compared.

    Args:
        order: The visits as text.
        against: Name of the comparison.
        means_s: Mean cycle times of the order and of the comparison, s.
        interval_s: 95 % interval of the order's mean, s; NaN = unknown.
    """
    with plain_style():
        figure = Drawing(9.0, 2.2)
        axes = figure.subplots()
        axes.barh([0, 1], means_s, height=0.55, color=[colours.NOMINAL, colours.DWELL])
        axes.plot(interval_s, [0, 0], color=INK, linewidth=2.0, solid_capstyle="butt")
        for row, mean_s in enumerate(means_s):
            axes.annotate(
                f"{fixed(mean_s, 1)} s", (0, row), xytext=(6, 0), textcoords="offset points", va="center", color=INK
            )
        axes.texts[0].set_color("white")
        axes.set_yticks([0, 1], ["order found", against])
        axes.set(ylim=(1.5, -0.5), xlabel="mean cycle time, s (line: 95 % confidence interval)")
        figure.suptitle(order, fontsize=8.5, x=0.01, ha="left", wrap=True)
    return figure
