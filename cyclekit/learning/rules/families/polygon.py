"""A polygon on the floor: slow while the operator is in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.dataset.cards.rule import RegionCard
from cyclekit.learning.rules.families.family import Family
from cyclekit.learning.rules.polygons.polygons import best_polygon

if TYPE_CHECKING:
    from cyclekit.learning.rules.cuts import LimitRows


def polygon(rows: LimitRows, start: RegionCard | None) -> RegionCard:
    """Return the convex polygon of up to six sides that fits best; empty if there is none."""
    found = best_polygon(rows, start.polygons[0] if start and start.polygons else None)
    return RegionCard() if found is None else RegionCard(polygons=(found,))


POLYGON = {"polygon on the floor": Family(polygon)}
