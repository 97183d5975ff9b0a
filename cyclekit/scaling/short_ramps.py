"""Changes of level, and rates of ramps that have one row of the log, or none, between their levels.

Two things tell such a rate. A controller changes the scaling once per cycle: if the rows are whole cycles apart, the
increment and the cycle give the rate exactly. Otherwise the phases of the rows are a matter of chance, and the number
of rows between the levels of all changes gives the rate.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence


MIN_SEEN = 20
"""Minimum number of values to determine their increment."""
MAX_CYCLES = 3
"""Maximum number of controller cycles from one increment to the next."""
_ALIKE = 2e-4
"""Tolerance for equal scalings and equal times, s, as logged."""
_OFTEN = 0.9
"""Minimum share of values that occur more than once."""
_SIGMAS = 3.0
"""Maximum difference from the rate by the number of rows, in standard errors of that number."""
_NEAR, _RATES = 3.0, 600
"""Factor about the mean rate within which the likeliest is searched, and number of rates tried."""
_WRONG = 0.01
"""Probability of a number of rows that a rate does not allow: times and levels have errors."""


class LevelChange(NamedTuple):
    """One transition from a level: its start, the threshold that was crossed, and its rate.

    Attributes:
        t_s: Session time at which the scaling started to leave the level.
        step: Index of the slower of the two levels that the threshold separates; -1: it left no level.
        rises: Whether the scaling rose.
        rate_per_s: Rate of change, 1/s; None = too few rows.
        change: Observed change of the scaling; between two levels, that outside of their tolerances.
        way_s: Time between two levels, by the number of rows, s; None if it did not lead from level to level.
        most_per_s: Maximum change from row to row, 1/s; None without rows.
        near: Tolerance within which the scaling is on a level.
        gone: Distance of each row from the level that it left, if there are too few rows for a rate.
        row_s: Times between these rows and from the levels to them, s.
    """

    t_s: float
    step: int
    rises: bool
    rate_per_s: float | None
    change: float = 0.0
    way_s: float | None = None
    most_per_s: float | None = None
    near: float = 0.0
    gone: tuple[float, ...] = ()
    row_s: tuple[float, ...] = ()


def stride_of(values: Sequence[float]) -> float | None:
    """Return the increment of which values are multiples; None if the data do not show it.

    Values that occur once do not count: a ramp may have turned midway.

    Args:
        values: Distances of rows from the level that they left, or times between rows, s.
    """
    seen = np.sort(values)
    apart = np.diff(seen, prepend=0.0)
    alike = apart <= _ALIKE
    often = seen[alike | np.append(alike[1:], False)]
    if len(seen) < MIN_SEEN or len(often) < _OFTEN * len(seen):
        return None
    apart = np.diff(often, prepend=0.0)
    stride = float(apart[apart > _ALIKE].min(initial=np.inf))
    return stride if np.abs(often - stride * np.rint(often / stride)).max() <= _ALIKE else None


def by_cycles(changes: Sequence[LevelChange], stride: float | None, counted: float) -> float | None:
    """Return the rate from increment and cycle of the controller, 1/s; None if the rows do not show both.

    The safety function may change the scaling in every cycle, or in every second or third one: as many as the number of
    rows says.

    Args:
        changes: Changes without a slope.
        stride: Increment of the scaling, from `stride_of`.
        counted: Rate by the number of rows, 1/s.
    """
    cycle_s = stride_of([row_s for change in changes for row_s in change.row_s])
    if stride is None or cycle_s is None:
        return None
    cycles = max(1, round(stride / (counted * cycle_s)))
    rate = stride / (cycles * cycle_s)
    rows = sum(len(change.gone) for change in changes)
    return rate if cycles <= MAX_CYCLES and abs(rate / counted - 1.0) <= _SIGMAS / np.sqrt(rows) else None


def by_counts(changes: Sequence[LevelChange], stride: float | None) -> float:
    """Return the rate that makes the number of rows between the levels of each change likeliest, 1/s.

    A ramp that takes 0.7 rows has one row with probability 0.7, else none; one of 1.7 rows has two or one.

    Args:
        changes: Changes from level to level, at least one of them with rows.
        stride: Increment of the scaling, from `stride_of`; None: it rises evenly.
    """
    off = np.array([_off_levels(change, stride) for change in changes])
    spent_s = np.array([change.way_s or 0.0 for change in changes])
    row_s = float(np.median([each for change in changes for each in change.row_s]))
    mean = float(off.sum() / spent_s.sum())
    rates = mean * np.geomspace(1.0 / _NEAR, _NEAR, _RATES)
    wanted = off / (rates[:, None] * row_s)
    right = np.maximum(0.0, 1.0 - np.abs(wanted - np.rint(spent_s / row_s)))
    fit = np.log(_WRONG + (1.0 - _WRONG) * right).sum(axis=1)
    return float(rates[int(np.argmax(fit))])


def _off_levels(change: LevelChange, stride: float | None) -> float:
    """Return the part of a change between two levels that is off both; with `stride`, counted in increments."""
    if stride is None:
        return change.change
    whole = change.change + 2 * change.near
    gone = stride * np.arange(1, np.ceil(whole / stride - 1e-6))
    return stride * int(np.count_nonzero((gone > change.near) & (gone < whole - change.near)))
