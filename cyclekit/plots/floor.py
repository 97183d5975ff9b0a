"""Draws a floor plan: squares, outlines of rules, furniture, places, and names without overlap."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Protocol, TypeAlias, cast

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from cyclekit.plots import colours
from cyclekit.plots.labels import place_labels
from cyclekit.plots.style import INK, MUTED, RULE, tip
from cyclekit.text.numbers import compact

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cyclekit.plots.labels import CellOnFloor

_GAP_PX = 9.0
"""Distance from a place to its name, px."""
_MARKER_PX = 5.0
_OFF_PX = 8.0
"""Cost of a name that lies farther from its place, px2 of overlap per px."""
SHADE = 0.85
"""Opacity of squares in the colour of the speed, and of their scale."""
_MAX_COVERED = 0.3
"""Maximum covered share of a name; with more the name is left out, and only the tooltip of its place has it."""
_Box: TypeAlias = tuple[float, float, float, float]
"""Left, bottom, right and top, px."""


class Shape(Protocol):
    """A limit of a rule on the floor (`learning.rules.shapes`)."""

    @property
    def level(self) -> float: ...  # noqa: D102
    @property
    def leaving(self) -> bool: ...  # noqa: D102
    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def outline_m(self) -> tuple[tuple[float, float], ...]: ...  # noqa: D102


@dataclass(frozen=True)
class FloorNote:
    """A name and its possible positions, m; drawn on its line, or next to its point."""

    text: str
    points_m: Sequence[tuple[float, float]]
    colour: str
    on_line: bool = False


def square(axes: Axes, x: float, y: float, side: float, colour: str, alpha: float = 1.0) -> Rectangle:
    """Draw a square around x, y, m."""
    drawn = Rectangle((x - side / 2, y - side / 2), side, side, color=colour, alpha=alpha, linewidth=0, zorder=2)
    axes.add_artist(drawn)
    return drawn


def outline(axes: Axes, shape: Shape, text: str) -> FloorNote | None:
    """Draw a limit of the rule: solid for the region to enter, dashed for the region to leave."""
    wide, dashes = (1.0, (0, (4, 3))) if shape.leaving else (2.0, "-")
    line = Polygon(shape.outline_m, closed=True, fill=False, edgecolor=colours.scaling_hex(shape.level), zorder=4)
    line.set(linewidth=wide, linestyle=dashes)
    if not shape.leaving:  # on squares of its own colour the line would be lost
        line.set_path_effects([withStroke(linewidth=4.0, foreground="white")])
    axes.add_artist(line)
    speed = compact(100 * shape.level, 4)
    tip(_figure(axes), line, text.format(speed=speed))
    return None if shape.leaving else FloorNote(f"{speed} %", shape.outline_m, INK, on_line=True)


def draw_cell(axes: Axes, cell: CellOnFloor, base: str | None) -> list[FloorNote]:
    """Draw tables, the robot's base labelled `base`, and the places; return their labels."""
    for name, thing in cell.furniture.items():
        (x, y, _), (length, width, _) = thing.xyz_m, thing.size_m
        corner = (x - length / 2, y - width / 2)
        box = Rectangle(corner, length, width, angle=thing.yaw_deg, rotation_point="center")
        box.set(facecolor=RULE, edgecolor=MUTED, linewidth=1.2, zorder=1)
        axes.add_patch(box)
        tip(_figure(axes), box, name)
    notes = []
    if base is not None:
        axes.plot([0], [0], marker="s", markersize=9, color=colours.ROBOT, zorder=5)
        notes.append(FloorNote(base, [(0.0, 0.0)], colours.ROBOT))
    for places, marker, colour in ((cell.places, "D", colours.ROBOT), (cell.human_places, "o", colours.OPERATOR)):
        for place in places.values():
            (dot,) = axes.plot(
                *place.xyz_m[:2], marker, markersize=5.5, color=colour, markeredgecolor="white", zorder=6
            )
            tip(_figure(axes), dot, place.shown)
        notes += [
            FloorNote(label.text, [place[:2] for place in label.places_m], colour) for label in place_labels(places)
        ]
    return notes


def label_axes(axes: Axes, x: str, y: str, speed: str | None, notes: Sequence[FloorNote | None]) -> None:
    """Set axes and their labels, draw the colour scale labelled `speed`, and write the notes."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.autoscale_view()
    axes.set(xlabel=x, ylabel=y)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    if speed:
        _scale_bar(axes, speed)
    _write(axes, [note for note in notes if note is not None])


def _scale_bar(axes: Axes, label: str) -> None:
    """Draw the colour scale of the scaling."""
    inset = axes.inset_axes((0.0, 1.03, 0.42, 0.03))
    edges = np.linspace(0.0, 1.0, 41)
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        colour = [1.0 - SHADE * (1.0 - part) for part in to_rgb(colours.scaling_hex((low + high) / 2))]  # on white
        inset.add_artist(Rectangle((low, 0), high - low + 0.004, 1, color=colour, linewidth=0))
    inset.set(xlim=(0, 1), ylim=(0, 1), yticks=[])
    inset.set_xticks([0, 0.5, 1], ["0", "50", "100 %"])
    inset.tick_params(length=2, labelsize=8, top=True, labeltop=True, bottom=False, labelbottom=False)
    for spine in inset.spines.values():
        spine.set_visible(False)
    inset.text(1.08, 0.5, label, transform=inset.transAxes, va="center", fontsize=8.5, color=MUTED)


def _write(axes: Axes, notes: Sequence[FloorNote]) -> None:
    """Write each note at the position with the least overlap with other notes, places and the frame."""
    figure = _figure(axes)
    figure.draw_without_rendering()  # sets the limits of the axes
    frame = axes.get_window_extent().extents
    marked = [point for note in notes if not note.on_line for point in note.points_m]
    points = axes.transData.transform(marked or np.empty((0, 2)))
    markers = [_around(x, y, 2 * _MARKER_PX, 2 * _MARKER_PX) for x, y in points.tolist()]
    taken: list[_Box] = []
    halo = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    for note in sorted(notes, key=lambda each: each.on_line):
        text = axes.annotate(note.text, note.points_m[0], xytext=(0, 0), textcoords="offset points", zorder=7)
        text.set(color=note.colour, fontsize=8.5, ha="center", va="center", bbox=halo)
        size = text.get_window_extent()
        wide, high = size.width + 5, size.height + 3
        best, cost = None, np.inf
        for at, middle, off in _spots(axes, note, wide, high):
            box = _around(*middle, wide, high)
            names = sum(_common(box, other) for other in taken)
            outside = wide * high - _common(box, frame)
            this = 3 * names + 6 * outside + 2 * sum(_common(box, marker) for marker in markers)
            this += _OFF_PX * off + 1e6 * (names > _MAX_COVERED * wide * high or outside > _MAX_COVERED * wide * high)
            if this < cost - 4.0:
                best, cost = (at, middle, box), this
        if best is None or cost >= 1e6:
            text.remove()
            continue
        anchor, middle, box = best
        shift = (middle - axes.transData.transform(anchor)) * 72 / figure.dpi
        text.xy = anchor
        text.set_position(tuple(shift.tolist()))
        taken.append(box)


def _spots(
    axes: Axes, note: FloorNote, wide: float, high: float
) -> Iterator[tuple[tuple[float, float], tuple[float, float], float]]:
    """Return the points of a note, the centres of its text and how far it lies off, px, by preference."""
    for point in note.points_m:
        x, y = axes.transData.transform(point).tolist()
        if note.on_line:
            yield point, (x, y), 0.0
            continue
        for gap in (_GAP_PX, 2.2 * _GAP_PX, 4.0 * _GAP_PX):
            right, up = wide / 2 + gap, high / 2 + gap
            sides = [(0, up), (0, -up), (right, 0), (-right, 0)]
            corners = [(a * wide / 2, b * up) for a in (1, -1) for b in (1, -1)]
            yield from ((point, (x + a, y + b), gap - _GAP_PX) for a, b in chain(sides, corners))


def _common(one: _Box, other: _Box) -> float:
    """Return the overlap of two boxes, px2."""
    wide, high = min(one[2], other[2]) - max(one[0], other[0]), min(one[3], other[3]) - max(one[1], other[1])
    return wide * high if wide > 0.0 and high > 0.0 else 0.0


def _around(x: float, y: float, wide: float, high: float) -> _Box:
    return x - wide / 2, y - high / 2, x + wide / 2, y + high / 2


def _figure(axes: Axes) -> Figure:
    return cast("Figure", axes.figure)
