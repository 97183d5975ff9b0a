"""Fits one kind of rule to rows: one region per level, two with hysteresis.

A coarse search uses few rows; then all rows near the edges determine their exact positions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.rule import LimitCard, RegionCard
from cyclekit.learning.rules.cuts import LimitRows
from cyclekit.learning.rules.samples.quantities import grown, quantities
from cyclekit.learning.rules.samples.regions import inside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.learning.rules.families.family import Family
    from cyclekit.learning.rules.samples.rows import RuleRows

    Limits = tuple[LimitCard, ...]

FEW = 4000
"""Number of rows in the coarse search."""
NEAR_M = 0.25
"""Rows farther than this, m, from every threshold and edge do not affect the fit."""
_BESIDE = 2
"""Number of rows before and after each change of the level that the coarse search prefers (up to half of its rows)."""


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

    The slowest level is fitted first, the next one to the remaining rows. With hysteresis, the region that slows the
    robot is fitted to samples after faster ones, and the region to leave to samples after equally slow or slower ones.

    Args:
        rows: Samples with their commanded levels.
        levels: Levels of the speed scaling, ascending.
        family: Kind of the rule.
        lag: Fit with hysteresis.
        weight: Weight of each row, shape (N,); None: 1.
        start: Limits of the same kind to start from; levels without a limit there stay without.
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
    """Return the limits fitted again to all rows, after a fit to few; arguments as of `fit_limits`."""
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
    """Return the weight of each row in the coarse search, shape (N,): FEW rows that represent all, 0 for the others.

    Rows around changes of the level locate the edges, so these are sampled more densely.
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
