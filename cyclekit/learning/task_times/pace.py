"""Tests whether an operator's tasks become faster or slower from execution to execution.

Neighbouring executions are correlated (same plan, same parts), so the trend is tested on means of blocks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import structs
from scipy.special import stdtr

from cyclekit.dataset.cards.task_model import PaceCard

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector

MIN_EXECUTIONS = 30
"""Minimum number of executions."""
BLOCKS = 10
"""Number of blocks."""
LEVEL = 0.01
"""Significance level."""
MIN_CHANGE = 0.03
"""Minimum change of the log duration from the first to the last execution that is corrected."""


def pace_drift(number: Ints, log_work: Vector) -> PaceCard | None:
    """Return the trend of an agent's pace over the executions; None if no change is significant.

    Args:
        number: Number of the execution of each repetition, shape (N,).
        log_work: Log work of each repetition, less the mean of its task, shape (N,).
    """
    of, where = np.unique(number, return_inverse=True)
    if len(of) < MIN_EXECUTIONS:
        return None
    mean = np.bincount(where, log_work) / np.bincount(where)
    best: tuple[float, PaceCard] | None = None
    laws: tuple[Literal["linear", "learning"], ...] = ("linear", "learning")
    for law in laws:
        card = PaceCard(law=law, change=0.0, first=int(of[0]), last=int(of[-1]))
        x = card.passed(of)
        blocks = np.array_split(np.arange(len(of)), BLOCKS)
        change, chance, left = _trend(*(np.array([values[block].mean() for block in blocks]) for values in (x, mean)))
        if chance < LEVEL / 2 and abs(change) >= MIN_CHANGE and (best is None or left < best[0]):
            best = left, structs.replace(card, change=change, chance=chance)
    return best[1] if best else None


def _trend(x: Vector, y: Vector) -> tuple[float, float, float]:
    """Return the slope of a regression line, its two-sided p-value, and the residual mean square."""
    off = x - x.mean()
    slope = float(off @ y / (off @ off))
    left = float(((y - y.mean() - slope * off) ** 2).sum()) / (len(x) - 2)
    t = abs(slope) / np.sqrt(left / float(off @ off) + 1e-18)
    return slope, float(2.0 * stdtr(len(x) - 2, -t)), left
