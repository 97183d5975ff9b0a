"""Outlines of a rule on the floor: rectangles, polygons, regions of the robot, distance thresholds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.rule import MetresCard
from cyclekit.learning.rules.samples.distances import TO_BASE
from cyclekit.learning.rules.samples.regions import corners, polygon_corners

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.rule import RectangleCard, RuleCard

    Outline = tuple[tuple[float, float], ...]

CORNERS = 72
"""Number of corners of a curved outline."""
POINTS = 400
"""Maximum number of points of the TCP's path."""


@dataclass(frozen=True)
class RuleShape:
    """Outline on the floor in which a limit holds.

    Attributes:
        level: Maximum speed inside, 0 to 1.
        leaving: Whether the operator must leave it for the robot to speed up again (dashed in pictures).
        name: `rectangle`, `polygon`, `TCP in the rectangle`, or the distance. The outline of a distance to the TCP
            encloses its whole path: outside the limit never holds, inside it holds while the TCP is near.
        outline_m: Corners x, y of a closed line, base frame, m.
    """

    level: float
    leaving: bool
    name: str
    outline_m: Outline


def shapes_of(rule: RuleCard, path_m: NDArray[np.float64], *, within_m: float) -> list[RuleShape]:
    """Return the outlines of a rule, fastest limit first so that the slowest is drawn last.

    Args:
        rule: The rule.
        path_m: Positions of the TCP, x and y, base frame, shape (R, 2), m; NaN = unknown. Without any, only rectangles,
            polygons and distances to the base have an outline.
        within_m: Distance from the base at which unknown edges are drawn, m.
    """
    known = path_m[np.isfinite(path_m).all(axis=1)]
    known = known[:: max(1, len(known) // POINTS)]
    found = []
    for limit in reversed(rule.limits):
        for region in (limit.within, limit.until):
            if region is None:
                continue
            outlines = [("rectangle", one) for each in region.rectangles for one in _rectangle(each, within_m)]
            closed = (polygon_corners(each) for each in region.polygons)
            outlines += [("polygon", tuple(one)) for one in closed if one is not None]
            if region.robot is not None:
                outlines += [("TCP in the rectangle", one) for one in _rectangle(region.robot, within_m)]
            for near in region.nearer:
                points = np.zeros((1, 2)) if near.distance == TO_BASE else known
                outlines += [(near.distance, around(points, near.metres.value))] if len(points) else []
            found += [RuleShape(limit.scaling, region is limit.until, name, outline) for name, outline in outlines]
    return found


def around(points_m: NDArray[np.float64], by_m: float) -> Outline:
    """Return the outline of the area within `by_m` of any of the points (R, 2), as seen from their middle."""
    middle = (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    angles = np.linspace(0.0, 2 * np.pi, CORNERS, endpoint=False)
    way = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    along = way @ (points_m - middle).T
    beside = np.stack([-way[:, 1], way[:, 0]], axis=1) @ (points_m - middle).T
    reach = along + np.sqrt(np.maximum(by_m**2 - beside**2, 0.0))
    reach = np.where(np.abs(beside) <= by_m, reach, -np.inf).max(axis=1)
    return tuple((float(x), float(y)) for x, y in (middle + np.maximum(reach, 0.0)[:, None] * way))


def _rectangle(rectangle: RectangleCard, within_m: float) -> Iterator[Outline]:
    far = MetresCard(value=-within_m), MetresCard(value=within_m)
    sides = ((edges[0] or far[0], edges[1] or far[1]) for edges in (rectangle.along, rectangle.across))
    along, across = sides
    found = corners(structs.replace(rectangle, along=along, across=across))
    if found is not None:
        yield tuple(found)
