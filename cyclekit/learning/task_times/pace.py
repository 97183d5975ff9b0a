"""Tests whether an operator's tasks become faster or slower from execution to execution."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.task_model import PaceCard
from cyclekit.learning.pace_trend import ChangeShape, find_trend

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector

SURE = 0.9
"""Minimum probability of a trend."""
MIN_CHANGE = 0.03
"""Minimum change of the log duration from the first to the last execution that is corrected."""


def pace_drift(number: Ints, log_work: Vector, session: Ints | None = None) -> PaceCard | None:
    """Return the trend of an agent's pace over the executions; None if no change is probable.

    Args:
        number: Number of the execution of each repetition, shape (N,).
        log_work: Log work of each repetition, less the mean of its task, shape (N,).
        session: Number of the session of each repetition, shape (N,); None: all are of one.
    """
    of, first, where = np.unique(number, return_index=True, return_inverse=True)
    sessions = np.zeros(len(of), np.int64) if session is None else session[first]
    mean = np.bincount(where, log_work) / np.bincount(where)
    laws: tuple[Literal["linear", "learning"], ...] = ("linear", "learning")
    cards = [PaceCard(law=law, change=0.0, first=int(of[0]), last=int(of[-1])) for law in laws]
    shapes = [ChangeShape(card.passed(of), float(card.passed(of).mean())) for card in cards]
    found = find_trend(mean, sessions, shapes)
    if found is None or found.probability < SURE or abs(found.change) < MIN_CHANGE:
        return None
    chance = 1.0 - found.probability
    return structs.replace(cards[found.shape], change=found.change, error=found.error, chance=chance)
