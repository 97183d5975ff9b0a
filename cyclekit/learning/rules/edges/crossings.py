"""Locates thresholds and edges at changes of the level, for noisy positions.

With noise, the fit with the fewest unexplained samples is biased to the side where the operator is less often. The time
of a change is known from the scaling alone, so the operator's position at that time locates the threshold
(`crossing_fit`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.learning.rules.samples.positions import Positions
from cyclekit.learning.rules.samples.quantities import quantities
from cyclekit.learning.rules.samples.regions import turned

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.rule import LimitCard, RectangleCard, RegionCard, SideCard
    from cyclekit.learning.rules.samples.quantities import RulePlace
    from cyclekit.learning.rules.samples.rows import RuleRows
    from cyclekit.schema import Bools, Ints, Vector


MIN_CHANGES = 15
"""Minimum number of changes in each direction for a statement on hysteresis."""
NEAR_M = 0.35
"""Maximum distance, m, of a change from the edge that caused it."""
CLEAR_M = 0.2
"""Minimum clearance, m, of a change from the ends of an edge and from other regions that could have caused it."""
LAG_M, LAG_SURE = 0.02, 4.0
"""Minimum hysteresis: in m, and in standard errors."""
APART = 3
"""Maximum number of samples between the known levels around a dated change (a hold time ends with the change)."""
EXACT_M = 0.005
"""Minimum standard deviation, m, of the position of a change, so that slow changes do not dominate."""


class LevelChanges(NamedTuple):
    """K changes of the level caused by one threshold or edge.

    Attributes:
        value_m: The operator's coordinate or distance at the change, shape (K,), averaged over the time in which it
            may have been.
        pace_m: Change of that value from one sample to the next, shape (K,).
        spread_m: Standard deviation of `value_m`, shape (K,), from noise and the time between two samples.
        execution: Number of the execution, shape (K,).
    """

    value_m: Vector
    pace_m: Vector
    spread_m: Vector
    execution: Ints

    def where(self, keep: Bools) -> LevelChanges:
        """Return a subset."""
        return LevelChanges(self.value_m[keep], self.pace_m[keep], self.spread_m[keep], self.execution[keep])


def crossings_of(
    limits: tuple[LimitCard, ...],
    rows: RuleRows,
    steps: Mapping[float, int],
    *,
    dated: bool = False,
    clear_m: float = CLEAR_M,
) -> dict[RulePlace, tuple[LevelChanges, LevelChanges]]:
    """Return for each threshold and edge the changes by which the level fell, and by which it rose.

    Args:
        limits: The fitted rule.
        rows: Rows to which it was fitted.
        steps: Index of each level.
        dated: Only changes whose time is known.
        clear_m: As in `tells`.
    """
    known = rows.sample - rows.sample[rows.before] <= APART if dated else True
    halfway = _halfway(rows)
    regions = {(limit.scaling, until): limit.until if until else limit.within for limit in limits for until in (0, 1)}
    found: dict[RulePlace, tuple[LevelChanges, LevelChanges]] = {}
    for place in quantities(limits):
        region, step = regions[place.level, int(place.until)], steps[place.level]
        if region is None:
            continue
        every = _measured(along(region, place, rows.positions), rows, 0.0 if place.kind == "robot" else rows.noise_m)
        was, now = rows.level[rows.before], rows.level
        on = known & (rows.before >= 0) & tells(region, place, halfway, NEAR_M, clear_m)
        on &= np.isfinite(every.value_m + every.pace_m)
        faster_was, faster_now = (
            level == step + 1 if place.kind == "nearer" else level > step for level in (was, now)
        )  # a step over several levels crosses several thresholds, but one edge
        down, up = on & faster_was & (now == step), on & (was == step) & faster_now
        found[place] = (every.where(down), every.where(up))
    return found


def lags(limits: tuple[LimitCard, ...], rows: RuleRows, steps: Mapping[float, int]) -> bool:
    """Return whether most thresholds and edges show that the level rises farther out than it falls, beyond chance."""
    shown = []
    for place, ways in crossings_of(limits, rows, steps).items():
        down, up = (_mean(each.value_m) for each in ways)
        if min(down.changes, up.changes) >= MIN_CHANGES:
            margin = (down.value - up.value) if place.lower else (up.value - down.value)
            shown.append(margin > max(LAG_M, LAG_SURE * float(np.hypot(down.error, up.error))))
    return bool(shown) and 2 * sum(shown) > len(shown)


def _measured(value_m: Vector, rows: RuleRows, noise_m: float) -> LevelChanges:
    """Return the operator's value at a change of the level, if there is one between each row (N,) and the row before.

    The mean of both rows is biased if the operator passes at an angle, because a distance then falls and rises again.
    One more row on each side corrects it; at the ends of a stretch the plain mean is used. If the log shows the time of
    the change, the value at that time is used.
    """
    before, after = rows.before, np.full(len(rows), -1)
    has = np.flatnonzero(before >= 0)
    after[before[has]] = has
    earlier = np.where(before >= 0, before[before], -1)
    at = np.where(np.isfinite(value_m), value_m, np.nan)
    value, pace = (at + at[before]) / 2, at - at[before]
    bent = (7 * (at + at[before]) - at[earlier] - at[after]) / 12
    long = (at[after] - at[earlier]) / 3
    four = (earlier >= 0) & (after >= 0) & np.isfinite(bent)
    value, pace = np.where(four, bent, value), np.where(four, long, pace)
    part, hidden = rows.dated.mean(axis=1), np.diff(rows.dated, axis=1)[:, 0]
    chord = at[before] + part * (at - at[before])
    curved = chord - part * (1.0 - part) * (at[earlier] - at[before] - at + at[after]) / 4
    known = np.isfinite(hidden) & (rows.sample - rows.sample[before] == 1)
    value = np.where(known, np.where(four, curved, chord), value)
    spread = np.sqrt(0.7 * noise_m**2 + (np.where(known, hidden, 1.0) * pace) ** 2 / 12 + EXACT_M**2)
    return LevelChanges(value, pace, spread, rows.execution)


def along(region: RegionCard, place: RulePlace, positions: Positions) -> Vector:
    """Return the coordinate or distance that a threshold or edge bounds, shape (N,), m."""
    if place.kind == "nearer":
        return positions.apart_m[region.nearer[place.item].distance]
    if place.kind == "polygon":
        return turned(positions.floor_m, region.polygons[place.item].sides[place.edge].angle_rad)[0]
    if place.kind == "robot" and region.robot is not None:
        return turned(positions.tcp_m, region.robot.angle_rad)[place.edge // 2]
    return turned(positions.floor_m, region.rectangles[place.item].angle_rad)[place.edge // 2]


def _halfway(rows: RuleRows) -> Positions:
    """Return the positions half-way from the row before, shape (N,)."""
    floor, tcp = ((at + at[rows.before]) / 2 for at in (rows.floor_m, rows.positions.tcp_m))
    return Positions({name: (each + each[rows.before]) / 2 for name, each in rows.apart_m.items()}, floor, tcp)


def tells(region: RegionCard, place: RulePlace, positions: Positions, near_m: float, clear_m: float) -> Bools:
    """Return at which positions the level depends on this threshold or edge alone, shape (N,).

    Args:
        region: The region of the threshold or edge.
        place: The threshold or edge.
        positions: N positions.
        near_m: Maximum distance from the threshold or edge.
        clear_m: Minimum clearance from its ends and from other regions.
    """
    floor, tcp, value = positions.floor_m, positions.tcp_m, along(region, place, positions)
    if place.kind == "nearer":
        on = np.abs(value - region.nearer[place.item].metres.value) < near_m
        for rectangle in region.rectangles:
            on &= _outside_m(rectangle, floor) > clear_m
        return on
    if place.kind == "polygon":
        return _at_side(region.polygons[place.item].sides, place.edge, floor, near_m, clear_m)
    of_robot = region.robot if place.kind == "robot" else None
    rectangle = of_robot or region.rectangles[place.item]
    other = turned(tcp if of_robot else floor, rectangle.angle_rad)[1 - place.edge // 2]
    edge = (*rectangle.along, *rectangle.across)[place.edge]
    ends = (rectangle.across, rectangle.along)[place.edge // 2]
    if edge is None:
        return np.zeros(len(value), np.bool_)
    on = np.abs(value - edge.value) < near_m
    on &= ends[0] is None or other > ends[0].value + clear_m
    on &= ends[1] is None or other < ends[1].value - clear_m
    for near in region.nearer:
        on &= positions.apart_m[near.distance] > near.metres.value + clear_m
    if place.kind == "robot":
        for each in region.rectangles:
            on &= _outside_m(each, floor) < -clear_m
    elif region.robot is not None:
        on &= _outside_m(region.robot, tcp) < -clear_m
    return on


def _at_side(
    sides: Sequence[SideCard], number: int, floor_m: NDArray[np.float64], near_m: float, clear_m: float
) -> Bools:
    """Return which points are near a side and clear of the others, shape (N,)."""
    along = [turned(floor_m, side.angle_rad)[0] for side in sides]
    on = np.abs(along[number] - sides[number].metres.value) < near_m
    for at, (value, side) in enumerate(zip(along, sides, strict=True)):
        on &= (at == number) | (value < side.metres.value - clear_m)
    return on


def _outside_m(rectangle: RectangleCard, floor_m: NDArray[np.float64]) -> Vector:
    """Return the distance of points (N, 2) outside of a rectangle along its axes, negative inside, shape (N,), m."""
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
    """Return the mean without values that deviate by more than three robust standard deviations."""
    if not len(at):
        return _Mean(float("nan"), float("inf"), 0)
    off = np.abs(at - np.median(at))
    near = at[off <= 3 * 1.4826 * np.median(off) + 1e-6]
    return _Mean(float(near.mean()), float(near.std() / max(1.0, np.sqrt(len(near)))), len(near))
