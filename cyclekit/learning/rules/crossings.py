"""Thresholds and edges from the instants at which the level changed, for positions that are noisy.

With noise the fit that leaves the fewest samples unexplained is drawn to the side where the operator is less often.
When the level changed is known from the scaling alone, so the mean of the noisy positions at those instants is where
the threshold lies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards.rule import MetresCard
from cyclekit.learning.rules.quantities import RulePlace, put, quantities
from cyclekit.learning.rules.regions import turned

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.rule import LimitCard, RectangleCard, RegionCard, SideCard
    from cyclekit.learning.rules.rows import RuleRows
    from cyclekit.schema import Bools, Vector


LEAST = 15
"""Fewer changes in one direction say nothing about where a threshold lies."""
NEAR_M = 0.35
"""A change farther than this from an edge is of another one."""
CLEAR_M = 0.2
"""So far from the ends of an edge no other edge could have caused the change."""
LAG_M, LAG_SURE = 0.02, 4.0
"""Hysteresis is believed where it is larger than this and than so many standard errors."""


class _Mean(NamedTuple):
    value: float
    error: float
    changes: int


def by_crossings(
    limits: tuple[LimitCard, ...], rows: RuleRows, steps: dict[float, int], weight: Vector | None = None
) -> tuple[LimitCard, ...]:
    """Return a rule with its thresholds and edges at the mean of the positions where the level changed.

    Args:
        limits: The rule as it was fitted; where changes are too few it stays.
        rows: What it was fitted to.
        steps: Index of each level.
        weight: How often each row counts, shape (N,); None: once.
    """
    found: dict[RulePlace, MetresCard] = {}
    for place, (down, up) in _crossed(limits, rows, steps, weight):
        if min(down.changes, up.changes) < LEAST:
            continue
        lag = next(limit.until is not None for limit in limits if limit.scaling == place.level)
        value = (up.value if place.until else down.value) if lag else (down.value + up.value) / 2
        found[place] = MetresCard(value=value, low=value, high=value)
    return put(limits, found)


def lags(limits: tuple[LimitCard, ...], rows: RuleRows, steps: dict[float, int]) -> bool:
    """Tell whether the level rises farther out than it falls, beyond chance: most thresholds and edges must show it."""
    shown = []
    for place, (down, up) in _crossed(limits, rows, steps, None):
        if min(down.changes, up.changes) >= LEAST:
            margin = (down.value - up.value) if place.lower else (up.value - down.value)
            shown.append(margin > max(LAG_M, LAG_SURE * float(np.hypot(down.error, up.error))))
    return bool(shown) and 2 * sum(shown) > len(shown)


def _crossed(
    limits: tuple[LimitCard, ...], rows: RuleRows, steps: dict[float, int], weight: Vector | None
) -> Iterator[tuple[RulePlace, tuple[_Mean, _Mean]]]:
    """Yield for each threshold and edge where the level fell and where it rose."""
    regions = {(limit.scaling, until): limit.until if until else limit.within for limit in limits for until in (0, 1)}
    for place in quantities(limits):
        region, step = regions[place.level, int(place.until)], steps[place.level]
        was, now = rows.level[rows.before], rows.level
        known = (rows.before >= 0) & ((weight is None) | (weight is not None and weight > 0))
        down, up = (known & (was == a) & (now == b) for a, b in ((step + 1, step), (step, step + 1)))
        if region is None:
            continue
        value, on = _at(region, place, rows)
        yield place, (_mean(value, down & on, weight), _mean(value, up & on, weight))


def _at(region: RegionCard, place: RulePlace, rows: RuleRows) -> tuple[Vector, Bools]:
    """Return the value (N,) half way from the row before, and which rows can tell of this threshold or edge."""
    floor, tcp = ((at + at[rows.before]) / 2 for at in (rows.floor_m, rows.positions.tcp_m))
    if place.kind == "nearer":
        near = region.nearer[place.item]
        apart = rows.apart_m[near.distance]
        value = (apart + apart[rows.before]) / 2
        on = np.abs(value - near.metres.value) < NEAR_M
        for rectangle in region.rectangles:
            on &= _outside_m(rectangle, floor) > CLEAR_M
        return value, on
    if place.kind == "polygon":
        return _at_side(region.polygons[place.item].sides, place.edge, floor)
    of_robot = region.robot if place.kind == "robot" else None
    rectangle = of_robot or region.rectangles[place.item]
    frame = turned(tcp if of_robot else floor, rectangle.angle_rad)
    value, other = frame[place.edge // 2], frame[1 - place.edge // 2]
    edge = (*rectangle.along, *rectangle.across)[place.edge]
    ends = (rectangle.across, rectangle.along)[place.edge // 2]
    if edge is None:
        return value, np.zeros(len(value), np.bool_)
    on = np.abs(value - edge.value) < NEAR_M
    on &= ends[0] is None or other > ends[0].value + CLEAR_M
    on &= ends[1] is None or other < ends[1].value - CLEAR_M
    for near in region.nearer:
        on &= rows.apart_m[near.distance] > near.metres.value + CLEAR_M
    if place.kind == "robot":
        for each in region.rectangles:
            on &= _outside_m(each, floor) < -CLEAR_M
    elif region.robot is not None:
        on &= _outside_m(region.robot, tcp) < -CLEAR_M
    return value, on


def _at_side(sides: Sequence[SideCard], number: int, floor_m: NDArray[np.float64]) -> tuple[Vector, Bools]:
    """Return how far points lie along the normal of a side, and which are near it and clear of the others."""
    along = [turned(floor_m, side.angle_rad)[0] for side in sides]
    on = np.abs(along[number] - sides[number].metres.value) < NEAR_M
    for at, (value, side) in enumerate(zip(along, sides, strict=True)):
        on &= (at == number) | (value < side.metres.value - CLEAR_M)
    return along[number], on


def _outside_m(rectangle: RectangleCard, floor_m: NDArray[np.float64]) -> Vector:
    """Return how far outside of a rectangle points (N, 2) lie along its axes, negative inside, shape (N,), m."""
    found = np.full(len(floor_m), -np.inf)
    for edges, at in zip((rectangle.along, rectangle.across), turned(floor_m, rectangle.angle_rad), strict=True):
        for edge, sign in zip(edges, (-1.0, 1.0), strict=True):
            if edge is not None:
                found = np.maximum(found, sign * (at - edge.value))
    return found


def _mean(value: Vector, on: Bools, weight: Vector | None) -> _Mean:
    """Return the mean without what lies off by more than three deviations."""
    on = on & np.isfinite(value)
    at = value[on]
    if not len(at):
        return _Mean(float("nan"), float("inf"), 0)
    off = np.abs(at - np.median(at))
    near = off <= 3 * 1.4826 * np.median(off) + 1e-6
    counts = np.ones(int(near.sum())) if weight is None else weight[on][near]
    error = float(at[near].std() / max(1.0, np.sqrt(near.sum())))
    return _Mean(float(np.average(at[near], weights=counts)), error, int(near.sum()))
