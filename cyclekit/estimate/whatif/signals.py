"""A changed level of a signal of people, or a changed part of the robot's path in which it applies."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from msgspec import structs

from cyclekit.dataset.cards.rule import LimitCard, MetresCard, RectangleCard, RegionCard
from cyclekit.errors import EstimateError
from cyclekit.learning.rules.safety import RuleSafety

if TYPE_CHECKING:
    from cyclekit.dataset.cards.rule import SignalCard
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.estimate.whatif.change import Change, SignalChange

SAME_LEVEL = 0.005
"""Tolerance within which two levels are equal: learned levels have more digits than people write."""


def with_other_signals(change: Change, model: SafetyModel) -> RuleSafety:
    """Return a rule on signals in which some have other levels, or other rectangles of the TCP.

    Raises:
        EstimateError: The model has no rule on signals, or the rule does not use this signal.
    """
    if not isinstance(model, RuleSafety) or not model.card.operator_signals:
        seen = f"change {change.name!r}: signals needs a rule on signals of people, and the model has none"
        raise EstimateError(seen, cure="Train with --model auto on logs with signals of people, or leave signals out.")
    asked = [(limit.scaling, signal) for limit in model.rule.limits for signal in limit.within.signals]
    for wanted in change.signals:
        known = list(dict.fromkeys(signal.signal for _, signal in asked))
        if wanted.signal not in known:
            seen = f"change {change.name!r}: the rule does not use signal {wanted.signal!r}"
            raise EstimateError(seen, cure=f"It uses: {', '.join(known)}.")
        asked = [_changed(wanted, level, card) if card.signal == wanted.signal else (level, card)
                 for level, card in asked]  # fmt: skip
    scalings = sorted({level for level, _ in asked})
    limits = tuple(
        LimitCard(scaling=one, within=RegionCard(signals=tuple(card for level, card in asked if level == one)))
        for one in scalings
    )
    levels = tuple(sorted({*scalings, model.rule.levels[-1]}))
    return replace(model, rule=structs.replace(model.rule, limits=limits, levels=levels))


def _changed(wanted: SignalChange, level: float, card: SignalCard) -> tuple[float, SignalCard]:
    """Return the changed level and card of a signal."""
    if wanted.level is not None and abs(wanted.level - level) > SAME_LEVEL:
        level = wanted.level
    if wanted.x_m is None and wanted.y_m is None:
        return level, card
    robot = RectangleCard(along=_edges(wanted.x_m), across=_edges(wanted.y_m))
    return level, structs.replace(card, robot=robot)


def _edges(metres: tuple[float, float] | None) -> tuple[MetresCard | None, MetresCard | None]:
    return (None, None) if metres is None else (MetresCard(value=metres[0]), MetresCard(value=metres[1]))
