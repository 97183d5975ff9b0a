"""Draws the safety function: speed over distance, and the floor with furniture and places of the cell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import PercentFormatter

from cyclekit.plots import colours
from cyclekit.plots.floor import SHADE, draw_cell, label_axes, outline, square
from cyclekit.plots.style import INK, MUTED, RULE
from cyclekit.text.numbers import compact, fixed, span

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from cyclekit.plots.floor import Shape
    from cyclekit.plots.labels import CellOnFloor

    Curve = tuple[NDArray[np.float64], NDArray[np.float64]]


NAMED = 4
"""Maximum number of speeds that a title names."""


def draw_curves(axes: Axes, curves: Mapping[str, Curve], spans_m: Sequence[tuple[float, float]], distance: str) -> None:
    """Draw the speed over a distance.

    Args:
        axes: Axes to draw on.
        curves: Distance, m, and speed, 0 to 1, by name; the first in colours of the speed, others dashed.
        spans_m: 95 % intervals of the thresholds.
        distance: Name of the distance, for the axis.
    """
    for low, high in spans_m:
        axes.axvspan(low, high, color=RULE, linewidth=0, zorder=0)
    for number, (name, (metres, speed)) in enumerate(curves.items()):
        if number:
            axes.plot(metres, speed, color=MUTED, linewidth=1.2, linestyle=(0, (4, 3)), label=name, zorder=2)
            continue
        axes.plot(metres, speed, color=colours.ROBOT, linewidth=1.2, label=name, zorder=2)
        flat = np.flatnonzero(np.diff(speed) == 0)
        for at in flat.tolist() if len(flat) < 60 else ():
            ends = slice(at, at + 2)
            axes.plot(metres[ends], speed[ends], color=colours.scaling_hex(float(speed[at])), linewidth=3.5, zorder=3)
    axes.set(xlabel=f"{distance}, m", ylabel="robot speed (scaling)", ylim=(-0.05, 1.05), xlim=(0, None))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(visible=True)
    if len(curves) > 1:
        axes.legend(loc="lower right")


def draw_floor(
    axes: Axes,
    squares: NDArray[np.float64],
    side_m: float,
    shapes: Sequence[Shape],
    cell: CellOnFloor,
) -> None:
    """Draw the floor from above.

    Args:
        axes: Axes to draw on.
        squares: Centre x, y, m, and median speed while the operator is there, 0 to 1, shape (C, 3).
        side_m: Side of a square, m.
        shapes: Limits of the rule; all but distances to the TCP are shown completely.
        cell: Places and furniture.
    """
    for x, y, speed in squares.tolist():
        square(axes, x, y, side_m, colours.scaling_hex(speed), alpha=SHADE)
    whole = [squares[:, :2] - side_m / 2, squares[:, :2] + side_m / 2]
    whole += [np.array(shape.outline_m) for shape in shapes if "TCP to" not in shape.name]
    axes.update_datalim(np.concatenate(whole))
    notes = [outline(axes, shape, f"{{speed}} %: {shape.name}") for shape in shapes]
    notes += draw_cell(axes, cell, "base")
    label_axes(axes, "x, m (base frame)", "y, m (base frame)", "speed, median while the operator is there", notes)


def draw_path(
    axes: Axes, squares: NDArray[np.float64], side_m: float, fastest: float, signal: str, cell: CellOnFloor
) -> None:
    """Draw the robot's path from above, in the colour of the speed where a signal applies, else grey.

    Args:
        axes: Axes to draw on.
        squares: Centre x, y, m, and speed while only the signal is on, 0 to 1, shape (C, 3).
        side_m: Side of a square, m.
        fastest: Speed where the signal does not apply.
        signal: Name of the signal.
        cell: Places and furniture.
    """
    counts = squares[:, 2] < fastest
    for (x, y, speed), slower in zip(squares.tolist(), counts.tolist(), strict=True):
        square(axes, x, y, side_m, colours.scaling_hex(speed) if slower else MUTED)
    axes.update_datalim(np.concatenate([squares[:, :2] - side_m / 2, squares[:, :2] + side_m / 2]))
    speeds = np.unique(squares[counts, 2].round(3)).tolist()
    named = ", ".join(f"{compact(100 * speed, 4)} %" for speed in speeds)
    if len(speeds) > NAMED:  # of a network
        named = f"{span(100 * speeds[0], 100 * speeds[-1], 0)} %"
    where = f"{named} on {fixed(100 * counts.mean(), 0)} % of the path" if counts.any() else "does not count"
    axes.set_title(f"{signal}: {where}", loc="left")
    label_axes(axes, "x, m (base frame)", "y, m (base frame)", None, draw_cell(axes, cell, "base"))


def draw_table(axes: Axes, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Draw a table instead of axes; a row with a single text spans all columns, and needs no heads if it is alone."""
    axes.set_axis_off()
    lines = [*([columns] if any(len(row) > 1 for row in rows) else []), *rows]
    for line, row in enumerate(lines):
        for number, text in enumerate(row):
            at = number / len(columns), 1.0 - (line + 0.5) / len(lines)
            axes.text(*at, text, transform=axes.transAxes, va="center", color=MUTED if row is columns else INK)
