"""Finds conditions by which both agents would wait for each other's next step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.coupling.conditions.candidates import EARLY_LEAVING_S
from cyclekit.learning.coupling.conditions.departures import condition_gain

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.learning.coupling.conditions.departures import Condition, Departures
    from cyclekit.learning.coupling.events.visits import Event


def in_circles(robot: Sequence[Departures], operator: Sequence[Departures]) -> Iterator[tuple[Agent, Event]]:
    """Yield conditions by which both agents wait for each other's next step; of each pair the one with less gain.

    A robot that waits for a button keeps that: the operator presses it before he leaves, often just before, and so he
    seems to leave as the robot goes on.
    """
    for mine in robot:
        for his in operator:
            for a in mine.found:
                for b in his.found:
                    if _meets(mine, a, his, b):
                        drop_mine = a.event.signal is None and condition_gain(mine, a) < condition_gain(his, b)
                        yield ("robot", a.event) if drop_mine else ("operator", b.event)


def _meets(mine: Departures, a: Condition, his: Departures, b: Condition) -> bool:
    """Return whether most of `his` departures wait for one of `mine` that waits for an event of the same departure."""
    needed = his.left_s - his.since_s[his.gate, b]
    at = {key: row for row, key in enumerate(zip(mine.course.tolist(), mine.left_s.round(6).tolist(), strict=True))}
    rows = [at.get(key, -1) for key in zip(his.course.tolist(), needed.round(6).tolist(), strict=True)]
    met = np.array(rows) >= 0
    began = (mine.left_s - mine.since_s[mine.gate, a])[rows]
    within = met & (began <= his.left_s + EARLY_LEAVING_S) & (began >= his.own_s)
    return bool(within.sum() > 0.5 * np.isfinite(needed).sum() > 0)
