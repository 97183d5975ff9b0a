"""One kind of rule fitted to rows: a region for each level, with hysteresis two.

Where a rule lies is searched on few rows; all rows near its edges then tell where exactly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import LimitCard, RegionCard
from cyclekit.learning.rules.cuts import LimitRows
from cyclekit.learning.rules.quantities import grown, quantities
from cyclekit.learning.rules.regions import inside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.learning.rules.families.family import Family
    from cyclekit.learning.rules.rows import RuleRows

    Limits = tuple[LimitCard, ...]

FEW = 4000
"""So many rows are searched for where a rule lies."""
NEAR_M = 0.25
"""Rows farther than this from every threshold and edge move none of them."""
_BESIDE = 2
"""Of the few, up to a half are so many rows before and after a change of the level."""


def fit_limits(
    rows: RuleRows,
    levels: Sequence[float],
    family: Family,
    *,
    lag: bool,
    weight: NDArray[np.float64] | None = None,
    start: Limits | None = None,
) -> Limits:
    """Return the limits that explain the commanded levels best.

    The slowest level is fitted first; the next one to the rows that it leaves. With hysteresis the region that slows
    the robot is fitted to samples before which it was faster, the region to leave to those before which it was not.

    Args:
        rows: What is known.
        levels: Of the speed scaling, ascending.
        family: Which kind.
        lag: With hysteresis.
        weight: How often each row counts, shape (N,); None: once.
        start: Limits of the same kind nearby; levels without one stay without.
    """
    counts = np.ones(len(rows)) if weight is None else weight
    earlier = np.where(rows.before >= 0, rows.level[rows.before], -1)
    found = []
    for step, level in enumerate(levels[:-1]):
        open_to = (rows.level >= step) & (counts > 0)
        if not (open_to & (rows.level == step)).any():
            continue
        begin = next((limit for limit in start or () if limit.scaling == level), None)
        if begin is None:
            if start is not None:
                continue
            region = family.fit(_part(rows, open_to, step, counts), None)
            begin = LimitCard(scaling=level, within=region, until=region)
            regions = [region]
        if lag or start is not None:
            parts = (open_to & (earlier > step), open_to & (earlier >= 0) & (earlier <= step)) if lag else (open_to,)
            begins = (begin.within, begin.within if begin.until is None else begin.until)
            regions = [
                family.fit(_part(rows, part, step, counts), first) for part, first in zip(parts, begins, strict=False)
            ]
        if regions[0] != RegionCard():
            found.append(LimitCard(scaling=level, within=regions[0], until=regions[1] if lag else None))
    return tuple(found)


def refined(limits: Limits, rows: RuleRows, levels: Sequence[float], family: Family, *, lag: bool) -> Limits:
    """Return limits that were fitted to few rows, fitted to all of them; arguments as of `fit_limits`."""
    if not quantities(limits):
        return fit_limits(rows, levels, family, lag=lag)
    return fit_limits(rows, levels, family, lag=lag, weight=near_edges(limits, rows), start=limits)


def near_edges(limits: Limits, rows: RuleRows) -> NDArray[np.float64]:
    """Return 1 for rows near a threshold or edge, 0 for others, shape (N,)."""
    near = np.zeros(len(rows), np.bool_)
    for inner, outer in zip(grown(limits, -NEAR_M), grown(limits, NEAR_M), strict=True):
        for small, large in ((inner.within, outer.within), (inner.until, outer.until)):
            if small is not None and large is not None:
                near |= inside(large, rows.positions) & ~inside(small, rows.positions)
    return near.astype(np.float64)


def few_of(rows: RuleRows, seed: int) -> NDArray[np.float64]:
    """Return how often each row counts in a search, shape (N,), 0 for most: FEW rows that stand for all of them.

    Rows beside a change of the level tell where the edges are, so of these more are taken.
    """
    if len(rows) <= FEW:
        return np.ones(len(rows))
    changes = np.flatnonzero((rows.before >= 0) & (rows.level != rows.level[rows.before]))
    beside = (changes[:, None] + np.arange(-_BESIDE, _BESIDE)).ravel().clip(0, len(rows) - 1)
    at_change = np.zeros(len(rows), np.bool_)
    at_change[beside] = True
    weight, rng = np.zeros(len(rows)), np.random.default_rng(seed)
    for part, most in ((at_change, FEW // 2), (~at_change, FEW - min(FEW // 2, int(at_change.sum())))):
        of = np.flatnonzero(part)
        some = rng.permutation(of)[:most]
        weight[some] = len(of) / max(1, len(some))
    return weight


def _part(rows: RuleRows, keep: NDArray[np.bool_], step: int, weight: NDArray[np.float64]) -> LimitRows:
    return LimitRows(rows.positions.where(keep), rows.level[keep] == step, weight[keep])
