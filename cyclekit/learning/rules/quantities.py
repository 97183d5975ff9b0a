"""The numbers of a rule one by one: read, and put back with other values or intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from msgspec import structs

if TYPE_CHECKING:
    from cyclekit.dataset.cards.rule import LimitCard, MetresCard, RectangleCard, RegionCard


MOST_M = 0.05
"""A bound farther off than this is no gap between samples but a lack of them."""

BETWEEN_M = 0.01
"""Nobody comes farther between two samples than a straight line between them, but by this."""


class RulePlace(NamedTuple):
    """Which number of a rule: of which limit (by its level), which of its two regions, and where in that."""

    level: float
    until: bool
    kind: str
    item: int
    edge: int = 0

    @property
    def lower(self) -> bool:
        """Whether the region lies above it."""
        return self.kind in ("rectangle", "robot") and self.edge % 2 == 0


def quantities(limits: tuple[LimitCard, ...]) -> dict[RulePlace, MetresCard]:
    """Return all thresholds and edges of a rule by their place."""
    found: dict[RulePlace, MetresCard] = {}

    def keep(place: RulePlace, metres: MetresCard) -> MetresCard:
        found[place] = metres
        return metres

    changed(limits, keep)
    return found


def changed(
    limits: tuple[LimitCard, ...], change: Callable[[RulePlace, MetresCard], MetresCard]
) -> tuple[LimitCard, ...]:
    """Return a rule with every threshold and edge replaced by what `change` makes of it."""
    return tuple(
        structs.replace(
            limit,
            within=_region(limit.within, limit.scaling, change, until=False),
            until=None if limit.until is None else _region(limit.until, limit.scaling, change, until=True),
        )
        for limit in limits
    )


def put(limits: tuple[LimitCard, ...], values: Mapping[RulePlace, MetresCard]) -> tuple[LimitCard, ...]:
    """Return a rule with some of its thresholds and edges replaced."""
    return changed(limits, lambda place, metres: values.get(place, metres))


def outwards(place: RulePlace) -> int:
    """Return 1 where a region becomes larger as this number grows, -1 where it becomes smaller."""
    return -1 if place.lower else 1


def grown(limits: tuple[LimitCard, ...], by_m: float) -> tuple[LimitCard, ...]:
    """Return a rule with all its regions larger by `by_m` on every side, smaller where that is negative."""

    def moved(place: RulePlace, metres: MetresCard) -> MetresCard:
        return structs.replace(metres, value=metres.value + outwards(place) * by_m)

    return changed(limits, moved)


def shifted(limits: tuple[LimitCard, ...], place: RulePlace, by_m: float) -> tuple[LimitCard, ...]:
    """Return a rule with one threshold or edge moved by `by_m`; that of the region to leave moves with it."""

    def moved(at: RulePlace, metres: MetresCard) -> MetresCard:
        return structs.replace(metres, value=metres.value + by_m) if at._replace(until=False) == place else metres

    return changed(limits, moved)


def released(limits: tuple[LimitCard, ...], by_m: float) -> tuple[LimitCard, ...]:
    """Return a rule with its regions to leave larger by `by_m`; those to enter stay."""

    def moved(place: RulePlace, metres: MetresCard) -> MetresCard:
        return structs.replace(metres, value=metres.value + outwards(place) * by_m) if place.until else metres

    return changed(limits, moved)


def with_bounds(limits: tuple[LimitCard, ...], *, larger: bool, least_m: float = 0.0) -> tuple[LimitCard, ...]:
    """Return a rule with each region as large, or as small, as the bounds of its numbers allow, within MOST_M.

    By `least_m` at least, with hysteresis by BETWEEN_M: who comes so near to a threshold may have crossed it between
    two samples, and the level is then held until long after.
    """
    least = {limit.scaling: max(least_m, 0.0 if limit.until is None else BETWEEN_M) for limit in limits}

    def moved(place: RulePlace, metres: MetresCard) -> MetresCard:
        upper = larger == (outwards(place) > 0)
        bound = metres.high if upper else metres.low
        way = 0.0 if bound is None else min(abs(bound - metres.value), MOST_M)
        way = max(way, least[place.level])
        return structs.replace(metres, value=metres.value + (way if upper else -way))

    return changed(limits, moved)


def without_doubtful(limits: tuple[LimitCard, ...]) -> tuple[LimitCard, ...]:
    """Return a rule without the rectangles that may have no extent, since the intervals of opposite edges meet.

    Only where a distance limits the same level: with slow ramps or noise a strip beside the threshold explains a few
    samples more.
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
    """Tell whether one edge lies below the other whatever their intervals; an edge never crossed lies far away."""
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
