"""Where the level changed: what each change tells of a threshold or edge, for positions that are noisy.

With noise the fit that leaves the fewest samples unexplained is drawn to the side where the operator is less often.
When the level changed is known from the scaling alone, so where the operator was then tells where the threshold lies
(`crossing_fit`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.learning.rules.quantities import quantities
from cyclekit.learning.rules.regions import turned

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.rule import LimitCard, RectangleCard, RegionCard, SideCard
    from cyclekit.learning.rules.quantities import RulePlace
    from cyclekit.learning.rules.rows import RuleRows
    from cyclekit.schema import Bools, Ints, Vector


LEAST = 15
"""Fewer changes in one direction say nothing about hysteresis."""
NEAR_M = 0.35
"""A change farther than this from an edge is of another one."""
CLEAR_M = 0.2
"""So far from the ends of an edge no other edge could have caused the change."""
LAG_M, LAG_SURE = 0.02, 4.0
"""Hysteresis is believed where it is larger than this and than so many standard errors."""
APART = 3
"""After more samples of unknown level it is open when in between it changed: a hold time ends with the change."""
EXACT_M = 0.005
"""Where a change happened is known no better than this, standard deviation: few slow ones would else count for all."""


class LevelChanges(NamedTuple):
    """K changes of the level that one threshold or edge caused.

    Attributes:
        value_m: Where the operator was along it, shape (K,), in the mean of all instants between two samples.
        pace_m: By how much that changes from one sample to the next, shape (K,).
        spread_m: How far `value_m` is off, standard deviation, shape (K,): noise, and the time between two samples.
        execution: Number of the execution, shape (K,).
    """

    value_m: Vector
    pace_m: Vector
    spread_m: Vector
    execution: Ints

    def where(self, keep: Bools) -> LevelChanges:
        """Return some of them."""
        return LevelChanges(self.value_m[keep], self.pace_m[keep], self.spread_m[keep], self.execution[keep])


def crossings_of(
    limits: tuple[LimitCard, ...], rows: RuleRows, steps: Mapping[float, int], *, dated: bool = False
) -> dict[RulePlace, tuple[LevelChanges, LevelChanges]]:
    """Return for each threshold and edge where the level fell, and where it rose.

    Args:
        limits: The rule as it was fitted.
        rows: What it was fitted to.
        steps: Index of each level.
        dated: Only changes of which is known when they were.
    """
    known = rows.sample - rows.sample[rows.before] <= APART if dated else True
    regions = {(limit.scaling, until): limit.until if until else limit.within for limit in limits for until in (0, 1)}
    found: dict[RulePlace, tuple[LevelChanges, LevelChanges]] = {}
    for place in quantities(limits):
        region, step = regions[place.level, int(place.until)], steps[place.level]
        if region is None:
            continue
        along = _along(region, place, rows.apart_m, rows.floor_m, rows.positions.tcp_m)
        every = _measured(along, rows, 0.0 if place.kind == "robot" else rows.noise_m)
        was, now = rows.level[rows.before], rows.level
        on = known & (rows.before >= 0) & _tells(region, place, rows) & np.isfinite(every.value_m + every.pace_m)
        down, up = (on & (was == a) & (now == b) for a, b in ((step + 1, step), (step, step + 1)))
        found[place] = (every.where(down), every.where(up))
    return found


def lags(limits: tuple[LimitCard, ...], rows: RuleRows, steps: Mapping[float, int]) -> bool:
    """Tell whether the level rises farther out than it falls, beyond chance: most thresholds and edges must show it."""
    shown = []
    for place, ways in crossings_of(limits, rows, steps).items():
        down, up = (_mean(each.value_m) for each in ways)
        if min(down.changes, up.changes) >= LEAST:
            margin = (down.value - up.value) if place.lower else (up.value - down.value)
            shown.append(margin > max(LAG_M, LAG_SURE * float(np.hypot(down.error, up.error))))
    return bool(shown) and 2 * sum(shown) > len(shown)


def _measured(along: Vector, rows: RuleRows, noise_m: float) -> LevelChanges:
    """Return what each row (N,) tells if the level changed between it and the row before.

    The mean of both rows is off where the operator passes at an angle, as a distance then falls and rises again; two
    rows more on either side tell by how much. At the ends of a stretch the mean has to do.
    """
    before, after = rows.before, np.full(len(rows), -1)
    has = np.flatnonzero(before >= 0)
    after[before[has]] = has
    earlier = np.where(before >= 0, before[before], -1)
    along = np.where(np.isfinite(along), along, np.nan)
    value, pace = (along + along[before]) / 2, along - along[before]
    bent = (7 * (along + along[before]) - along[earlier] - along[after]) / 12
    long = (along[after] - along[earlier]) / 3
    four = (earlier >= 0) & (after >= 0) & np.isfinite(bent)
    value, pace = np.where(four, bent, value), np.where(four, long, pace)
    spread = np.sqrt(0.7 * noise_m**2 + pace**2 / 12 + EXACT_M**2)
    return LevelChanges(value, pace, spread, rows.execution)


def _along(
    region: RegionCard,
    place: RulePlace,
    apart_m: Mapping[str, Vector],
    floor_m: NDArray[np.float64],
    tcp_m: NDArray[np.float64],
) -> Vector:
    """Return the value that a threshold or edge is a value of, shape (N,)."""
    if place.kind == "nearer":
        return apart_m[region.nearer[place.item].distance]
    if place.kind == "polygon":
        return turned(floor_m, region.polygons[place.item].sides[place.edge].angle_rad)[0]
    if place.kind == "robot" and region.robot is not None:
        return turned(tcp_m, region.robot.angle_rad)[place.edge // 2]
    return turned(floor_m, region.rectangles[place.item].angle_rad)[place.edge // 2]


def _tells(region: RegionCard, place: RulePlace, rows: RuleRows) -> Bools:
    """Return which rows can tell of this threshold or edge, by where everybody is half way from the row before."""
    floor, tcp = ((at + at[rows.before]) / 2 for at in (rows.floor_m, rows.positions.tcp_m))
    apart = {name: (each + each[rows.before]) / 2 for name, each in rows.apart_m.items()}
    value = _along(region, place, apart, floor, tcp)
    if place.kind == "nearer":
        on = np.abs(value - region.nearer[place.item].metres.value) < NEAR_M
        for rectangle in region.rectangles:
            on &= _outside_m(rectangle, floor) > CLEAR_M
        return on
    if place.kind == "polygon":
        return _at_side(region.polygons[place.item].sides, place.edge, floor)
    of_robot = region.robot if place.kind == "robot" else None
    rectangle = of_robot or region.rectangles[place.item]
    other = turned(tcp if of_robot else floor, rectangle.angle_rad)[1 - place.edge // 2]
    edge = (*rectangle.along, *rectangle.across)[place.edge]
    ends = (rectangle.across, rectangle.along)[place.edge // 2]
    if edge is None:
        return np.zeros(len(value), np.bool_)
    on = np.abs(value - edge.value) < NEAR_M
    on &= ends[0] is None or other > ends[0].value + CLEAR_M
    on &= ends[1] is None or other < ends[1].value - CLEAR_M
    for near in region.nearer:
        on &= apart[near.distance] > near.metres.value + CLEAR_M
    if place.kind == "robot":
        for each in region.rectangles:
            on &= _outside_m(each, floor) < -CLEAR_M
    elif region.robot is not None:
        on &= _outside_m(region.robot, tcp) < -CLEAR_M
    return on


def _at_side(sides: Sequence[SideCard], number: int, floor_m: NDArray[np.float64]) -> Bools:
    """Return which points are near a side and clear of the others."""
    along = [turned(floor_m, side.angle_rad)[0] for side in sides]
    on = np.abs(along[number] - sides[number].metres.value) < NEAR_M
    for at, (value, side) in enumerate(zip(along, sides, strict=True)):
        on &= (at == number) | (value < side.metres.value - CLEAR_M)
    return on


def _outside_m(rectangle: RectangleCard, floor_m: NDArray[np.float64]) -> Vector:
    """Return how far outside of a rectangle points (N, 2) lie along its axes, negative inside, shape (N,), m."""
    found = np.full(len(floor_m), -np.inf)
    for edges, at in zip((rectangle.along, rectangle.across), turned(floor_m, rectangle.angle_rad), strict=True):
        for edge, sign in zip(edges, (-1.0, 1.0), strict=True):
            if edge is not None:
                found = np.maximum(found, sign * (at - edge.value))
    return found


class _Mean(NamedTuple):
    value: float
    error: float
    changes: int


def _mean(at: Vector) -> _Mean:
    """Return the mean without what lies off by more than three deviations."""
    if not len(at):
        return _Mean(float("nan"), float("inf"), 0)
    off = np.abs(at - np.median(at))
    near = at[off <= 3 * 1.4826 * np.median(off) + 1e-6]
    return _Mean(float(near.mean()), float(near.std() / max(1.0, np.sqrt(len(near)))), len(near))
