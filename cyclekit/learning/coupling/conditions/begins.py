"""Work that the operator begins with an event: what he waits for comes before his work, not after it.

He stands at the fixture until the robot has brought the part, then works. The lag from the event to his departure then
contains his whole work, and the same work takes as long if the part is there before him. Lag and own work are one draw.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from cyclekit.learning.coupling.conditions.conditions import MIN_DECIDED
from cyclekit.learning.coupling.conditions.lags import quantiles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards.coupling import ConditionCard
    from cyclekit.learning.coupling.conditions.departures import Departures

ABOUT_S = 0.3
"""An event counts as before or after his arrival if they are further apart, s."""
WHOLE, MIN_WORK_S = 0.8, 1.0
"""Minimum median of the lags relative to that of the work, and minimum median of the work, s."""
SPREAD = 0.5
"""Minimum spread (interquartile range) of the lags relative to that of the work: lags without it vary less."""


def with_work_in_lag(
    found: Departures, own_s: tuple[float, ...], cards: Sequence[ConditionCard]
) -> tuple[tuple[float, ...], list[ConditionCard]]:
    """Return own work, s, and the conditions of a gate; if the work begins with the only event, as one draw.

    Args:
        found: Departures of the operator from a place, at his latest pace.
        own_s: Quantiles of his own work there, s.
        cards: Conditions of the gate.
    """
    gate = found.gate
    if (gate.agent, gate.at, len(cards), len(found.since_s)) != ("operator", "leave", 1, 1):
        return own_s, list(cards)
    ((_, condition), since_s), card = next(iter(found.since_s.items())), cards[0]
    if condition.partly or card.signal is not None or card.alike:
        return own_s, list(cards)
    stays_s = found.left_s - found.own_s + found.more_s
    seen = np.isfinite(since_s) & (since_s > 0.0)
    lags_s, works_s = since_s[seen & (since_s < stays_s - ABOUT_S)], stays_s[seen & (since_s > stays_s + ABOUT_S)]
    if min(len(lags_s), len(works_s)) < MIN_DECIDED:
        return own_s, list(cards)
    usual_s = float(np.median(works_s))
    begins_s = float(np.median(lags_s)) - usual_s
    wide_s = [float(np.diff(np.quantile(some, (0.25, 0.75)))[0]) for some in (lags_s, works_s)]
    if usual_s < MIN_WORK_S or begins_s < -(1.0 - WHOLE) * usual_s or wide_s[0] < SPREAD * wide_s[1]:
        return own_s, list(cards)
    begins_s = max(begins_s, 0.0)
    every_s = np.concatenate([works_s, np.maximum(lags_s - begins_s, 0.0)])
    alike = np.full(len(every_s), 1.0 / len(every_s))
    work_s, lag_s = (quantiles(some, alike) for some in (every_s, every_s + begins_s))
    return work_s, [replace(card, lag_s=lag_s, with_work=True)]


__all__ = ["with_work_in_lag"]
