"""Tests where a region holds and which level a rule allows."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.rule import LimitCard, PolygonCard, RectangleCard, RegionCard, SideCard
    from cyclekit.learning.rules.samples.positions import Positions
    from cyclekit.learning.rules.samples.rows import RuleRows
    from cyclekit.schema import Bools, Vector


NOWHERE = (-np.inf, np.inf)


def turned(floor_m: NDArray[np.float64], angle_rad: float) -> tuple[Vector, Vector]:
    """Return the coordinates (N,), (N,) of points (N, 2), m, in a frame turned by `angle_rad`."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return floor_m[:, 0] * cos + floor_m[:, 1] * sin, floor_m[:, 1] * cos - floor_m[:, 0] * sin


def corners(rectangle: RectangleCard) -> list[tuple[float, float]] | None:
    """Return the corners of a rectangle, base frame, m, counterclockwise; None if an edge is unknown."""
    (left, right), (near, far) = rectangle.along, rectangle.across
    if left is None or right is None or near is None or far is None:
        return None
    cos, sin = np.cos(rectangle.angle_rad), np.sin(rectangle.angle_rad)
    frame = [(u.value, v.value) for u, v in ((left, near), (right, near), (right, far), (left, far))]
    return [(float(u * cos - v * sin), float(u * sin + v * cos)) for u, v in frame]


def polygon_corners(polygon: PolygonCard) -> list[tuple[float, float]] | None:
    """Return the corners of a polygon, base frame, m, counterclockwise; None if it is open on one side."""
    sides = [*polygon.sides, polygon.sides[0]]
    found = []
    for one, other in pairwise(sides):
        turn = (other.angle_rad - one.angle_rad) % (2 * np.pi)
        if not 0.0 < turn < np.pi:
            return None
        normals = np.array([[np.cos(side.angle_rad), np.sin(side.angle_rad)] for side in (one, other)])
        x, y = np.linalg.solve(normals, [one.metres.value, other.metres.value])
        found.append((float(x), float(y)))
    return found


def inside(region: RegionCard, rows: Positions) -> Bools:
    """Return where a region holds, shape (N,)."""
    found = np.isfinite(rows.floor_m[:, 0]) if region.anywhere else np.zeros(len(rows.floor_m), np.bool_)
    for near in region.nearer:
        found |= rows.apart_m[near.distance] < near.metres.value
    for rectangle in region.rectangles:
        found |= within_rectangle(rectangle, rows.floor_m)
    for polygon in region.polygons:
        found |= within_sides(polygon.sides, rows.floor_m)
    for signal in region.signals:
        on = rows.signals[signal.signal, signal.delay_s] == signal.value
        found |= on if signal.robot is None else on & within_rectangle(signal.robot, rows.tcp_m)
    if region.robot is None:
        return found
    there = within_rectangle(region.robot, rows.tcp_m)
    return there & found if asks_operator(region) else there


def asks_operator(region: RegionCard) -> bool:
    """Return whether a region depends on more than the TCP."""
    return region.anywhere or bool(region.nearer or region.rectangles or region.polygons or region.signals)


def within_sides(sides: Sequence[SideCard], floor_m: NDArray[np.float64]) -> Bools:
    """Return which points (N, 2), m, lie within all sides of a polygon."""
    found = np.isfinite(floor_m[:, 0])
    for side in sides:
        found &= turned(floor_m, side.angle_rad)[0] < side.metres.value
    return found


def within_rectangle(rectangle: RectangleCard, floor_m: NDArray[np.float64]) -> Bools:
    """Return which points (N, 2), m, lie in a rectangle; it is unbounded where an edge is unknown."""
    found = np.isfinite(floor_m[:, 0])
    for edges, at in zip((rectangle.along, rectangle.across), turned(floor_m, rectangle.angle_rad), strict=True):
        low, high = (bound if edge is None else edge.value for edge, bound in zip(edges, NOWHERE, strict=True))
        found &= (at > low) & (at < high)
    return found


def allowed(limits: Sequence[LimitCard], levels: Sequence[float], rows: Positions, *, until: bool) -> Vector:
    """Return the level that a rule allows in each row, shape (N,).

    Args:
        limits: Limits of the rule.
        levels: Levels of the speed scaling, ascending.
        rows: Positions of robot and operator.
        until: Use the regions that the operator must leave instead of those that he enters.
    """
    found = np.full(len(rows.floor_m), levels[-1])
    for limit in reversed(limits):
        region = limit.until if until and limit.until is not None else limit.within
        found[inside(region, rows)] = limit.scaling
    return found


def followed(limits: Sequence[LimitCard], levels: Sequence[float], rows: RuleRows) -> NDArray[np.int64]:
    """Return the index of the level that a rule allows in each row, shape (N,), with hysteresis applied over time.

    The state at the start of a stretch is that of its commanded level.
    """
    found = np.full(len(rows), len(levels) - 1)
    at, begins = np.arange(len(rows)), rows.before < 0
    for limit in reversed(limits):
        step = int(np.abs(np.asarray(levels) - limit.scaling).argmin())
        slow = inside(limit.within, rows.positions)
        if limit.until is not None:
            decided = slow | ~inside(limit.until, rows.positions)
            slow = np.where(decided, slow, rows.level <= step)
            slow = slow[np.maximum.accumulate(np.where(decided | begins, at, 0))] if len(at) else slow
        found[slow] = step
    return found
