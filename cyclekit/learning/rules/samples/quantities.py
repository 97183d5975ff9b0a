"""Access to the thresholds and edges of a rule one by one: read, and replace values or intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from msgspec import structs

if TYPE_CHECKING:
    from cyclekit.dataset.cards.rule import LimitCard, MetresCard, RectangleCard, RegionCard


MAX_M = 0.05
"""Maximum distance, m, of a bound that counts as a gap between samples; beyond, samples are missing."""

BETWEEN_M = 0.01
"""Tolerance, m, for the deviation of an operator's path from the straight line between two samples."""


class RulePlace(NamedTuple):
    """Key of one value of a rule: its limit (by level), which of the two regions, and the place in that region."""

    level: float
    until: bool
    kind: str
    item: int
    edge: int = 0

    @property
    def lower(self) -> bool:
        """Whether the region lies above the value."""
        return self.kind in ("rectangle", "robot") and self.edge % 2 == 0


def quantities(limits: tuple[LimitCard, ...]) -> dict[RulePlace, MetresCard]:
    """Return all thresholds and edges of a rule by key."""
    found: dict[RulePlace, MetresCard] = {}

    def keep(place: RulePlace, metres: MetresCard) -> MetresCard:
        found[place] = metres
        return metres

    changed(limits, keep)
    return found


def changed(
    limits: tuple[LimitCard, ...], change: Callable[[RulePlace, MetresCard], MetresCard]
) -> tuple[LimitCard, ...]:
    """Return a rule with every threshold and edge replaced by the result of `change`."""
    return tuple(
        structs.replace(
            limit,
            within=_region(limit.within, limit.scaling, change, until=False),
            until=None if limit.until is None else _region(limit.until, limit.scaling, change, until=True),
        )
        for limit in limits
    )


def put(limits: tuple[LimitCard, ...], values: Mapping[RulePlace, MetresCard]) -> tuple[LimitCard, ...]:
    """Return a rule with some thresholds and edges replaced."""
    return changed(limits, lambda place, metres: values.get(place, metres))


def outwards(place: RulePlace) -> int:
    """Return 1 if a region grows with this value, -1 if it shrinks."""
    return -1 if place.lower else 1


def grown(limits: tuple[LimitCard, ...], by_m: float) -> tuple[LimitCard, ...]:
    """Return a rule with all regions larger by `by_m` on every side; smaller if negative."""

    def moved(place: RulePlace, metres: MetresCard) -> MetresCard:
        return structs.replace(metres, value=metres.value + outwards(place) * by_m)

    return changed(limits, moved)


def shifted(limits: tuple[LimitCard, ...], place: RulePlace, by_m: float) -> tuple[LimitCard, ...]:
    """Return a rule with one threshold or edge moved by `by_m`, together with that of the region to leave."""

    def moved(at: RulePlace, metres: MetresCard) -> MetresCard:
        return structs.replace(metres, value=metres.value + by_m) if at._replace(until=False) == place else metres

    return changed(limits, moved)


def released(limits: tuple[LimitCard, ...], by_m: float) -> tuple[LimitCard, ...]:
    """Return a rule with its regions to leave larger by `by_m`; those to enter are unchanged."""

    def moved(place: RulePlace, metres: MetresCard) -> MetresCard:
        return structs.replace(metres, value=metres.value + outwards(place) * by_m) if place.until else metres

    return changed(limits, moved)


def with_bounds(limits: tuple[LimitCard, ...], *, larger: bool, least_m: float = 0.0) -> tuple[LimitCard, ...]:
    """Return a rule with each region as large, or as small, as the bounds of its values allow, within MAX_M.

    Each value moves by at least `least_m`, with hysteresis by at least BETWEEN_M: an operator so close to a threshold
    may have crossed it between two samples, and the level is then held for long.
    """
    least = {limit.scaling: max(least_m, 0.0 if limit.until is None else BETWEEN_M) for limit in limits}

    def moved(place: RulePlace, metres: MetresCard) -> MetresCard:
        upper = larger == (outwards(place) > 0)
        bound = metres.high if upper else metres.low
        way = 0.0 if bound is None else min(abs(bound - metres.value), MAX_M)
        way = max(way, least[place.level])
        return structs.replace(metres, value=metres.value + (way if upper else -way))

    return changed(limits, moved)


def without_doubtful(limits: tuple[LimitCard, ...]) -> tuple[LimitCard, ...]:
    """Return a rule without rectangles whose extent is uncertain because the intervals of opposite edges overlap.

    Applies only to levels that also have a distance: with slow ramps or noise, a strip next to the threshold explains a
    few more samples.
    """
    return tuple(
        structs.replace(limit, within=_sure(limit.within), until=None if limit.until is None else _sure(limit.until))
        for limit in limits
    )


def _sure(region: RegionCard) -> RegionCard:
    if not region.nearer:
        return region
    kept = tuple(one for one in region.rectangles if _apart(*one.along) and _apart(*one.across))
    return structs.replace(region, rectangles=kept)


def _apart(lower: MetresCard | None, upper: MetresCard | None) -> bool:
    """Return whether one edge is below the other given their intervals; True if one of them is unknown."""
    if lower is None or upper is None or lower.high is None or upper.low is None:
        return True
    return lower.high < upper.low


def _region(
    region: RegionCard, level: float, change: Callable[[RulePlace, MetresCard], MetresCard], *, until: bool
) -> RegionCard:
    nearer = [
        structs.replace(near, metres=change(RulePlace(level, until, "nearer", item), near.metres))
        for item, near in enumerate(region.nearer)
    ]
    rectangles = [
        _rectangle(rectangle, "rectangle", item, level, change, until=until)
        for item, rectangle in enumerate(region.rectangles)
    ]
    polygons = [
        structs.replace(
            polygon,
            sides=tuple(
                structs.replace(side, metres=change(RulePlace(level, until, "polygon", item, number), side.metres))
                for number, side in enumerate(polygon.sides)
            ),
        )
        for item, polygon in enumerate(region.polygons)
    ]
    robot = None if region.robot is None else _rectangle(region.robot, "robot", 0, level, change, until=until)
    return structs.replace(
        region, nearer=tuple(nearer), rectangles=tuple(rectangles), polygons=tuple(polygons), robot=robot
    )


def _rectangle(
    rectangle: RectangleCard,
    kind: str,
    item: int,
    level: float,
    change: Callable[[RulePlace, MetresCard], MetresCard],
    *,
    until: bool,
) -> RectangleCard:
    edges = [
        None if edge is None else change(RulePlace(level, until, kind, item, number), edge)
        for number, edge in enumerate((*rectangle.along, *rectangle.across))
    ]
    return structs.replace(rectangle, along=(edges[0], edges[1]), across=(edges[2], edges[3]))
