"""Rules made by hand: regions near something or within a rectangle, and the safety function of a rule."""

from __future__ import annotations

from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.cards.rule import LimitCard, MetresCard, NearerCard, RectangleCard, RegionCard, RuleCard
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.rules.samples.distances import TO_TCP


def near(metres: float, distance: str = TO_TCP) -> RegionCard:
    return RegionCard(nearer=(NearerCard(distance=distance, metres=MetresCard(value=metres)),))


def box(*edges: float | None) -> RegionCard:
    """Return x from, x to, y from, y to; None where the edge was never crossed."""
    left, right, low, high = (None if edge is None else MetresCard(value=edge) for edge in edges)
    return RegionCard(rectangles=(RectangleCard(along=(left, right), across=(low, high)),))


def ruled(*limits: tuple[float, RegionCard, RegionCard | None]) -> RuleSafety:
    made = tuple(LimitCard(scaling=level, within=within, until=until) for level, within, until in limits)
    levels = (*(limit.scaling for limit in made), 1.0)
    return RuleSafety(RuleCard(family=TO_TCP, levels=levels, limits=made, explained=1.0), TrainingCard())
