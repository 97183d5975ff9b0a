"""A rectangle on the floor: slow while the operator is in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.dataset.cards.rule import RegionCard
from cyclekit.learning.rules.cuts import best_rectangle, best_turned
from cyclekit.learning.rules.families.family import Family

if TYPE_CHECKING:
    from cyclekit.learning.rules.cuts import LimitRows


def straight(rows: LimitRows, start: RegionCard | None) -> RegionCard:
    """Return the rectangle along the axes of the base frame that fits best; empty if there is none."""
    begin = start.rectangles[0] if start and start.rectangles else None
    found = best_rectangle(0.0, rows, begin)
    return RegionCard() if found is None else RegionCard(rectangles=(found,))


def at_any_angle(rows: LimitRows, start: RegionCard | None) -> RegionCard:
    """Return the rectangle at any angle that fits best; empty if there is none."""
    found = best_turned(rows, start.rectangles[0] if start and start.rectangles else None)
    return RegionCard() if found is None else RegionCard(rectangles=(found,))


RECTANGLE = {"rectangle on the floor": Family(straight)}
TURNED = {"turned rectangle on the floor": Family(at_any_angle)}
