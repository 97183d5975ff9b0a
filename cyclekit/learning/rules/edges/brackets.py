"""Locates thresholds and edges that few operators crossed, from the samples on both sides.

A sample that is slow because of this threshold alone lies inside of it, one that is not slow lies outside. So samples
without a change of the level count too: they bracket the threshold. Each possible position has the probability of all
samples on the side on which they were seen; without noise, it is even over the gap between both sides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import log_ndtr

from cyclekit.dataset.cards.rule import MetresCard
from cyclekit.learning.rules.edges.crossings import EXACT_M, along, tells
from cyclekit.learning.rules.samples.quantities import outwards, put, quantities

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from cyclekit.dataset.cards.rule import LimitCard
    from cyclekit.learning.rules.samples.quantities import RulePlace
    from cyclekit.learning.rules.samples.rows import RuleRows
    from cyclekit.schema import Bools, Floats, Ints, Vector

WINDOW_M, GRID_M, FAR_M = 0.5, 0.001, 100.0
"""Maximum distance of samples from the fitted threshold, resolution of its position, value without an operator, m."""
CLEAR_M, CLEAR_NOISE = 0.05, 2.0
"""Minimum clearance of a sample from other edges, m; standard deviations of noise added to it."""
LATE = 0.1
"""Standard deviation of the error of the reaction time, samples."""
WRONG = 0.001
"""Prior probability that the levels of a whole pass of the operator are wrong."""
BOUNDS = (0.025, 0.5, 0.975)
_BLOCK = 1000


def bracketed(
    limits: tuple[LimitCard, ...], rows: RuleRows, steps: Mapping[float, int], places: Collection[RulePlace]
) -> tuple[tuple[LimitCard, ...], frozenset[RulePlace]]:
    """Return a rule with thresholds and edges placed between the samples on both sides, and which these are.

    Args:
        limits: The fitted rule; a threshold without samples on both sides is kept.
        rows: Rows to which it was fitted.
        steps: Index of each level.
        places: Thresholds and edges to place, with the others as they are.
    """
    found = {place: _placed(limits, rows, steps, place) for place in quantities(limits) if place in places}
    known = {place: metres for place, metres in found.items() if metres is not None}
    return put(limits, known), frozenset(known)


def _placed(
    limits: tuple[LimitCard, ...], rows: RuleRows, steps: Mapping[float, int], place: RulePlace
) -> MetresCard | None:
    """Return the median position of a threshold and its 95 % interval; None without samples on both sides."""
    limit = next(limit for limit in limits if limit.scaling == place.level)
    region, step = (limit.until if place.until else None) or limit.within, steps[place.level]
    noise_m = 0.0 if place.kind == "robot" else rows.noise_m
    on = tells(region, place, rows.positions, WINDOW_M, CLEAR_M + CLEAR_NOISE * noise_m)
    on &= decided_by(limit, rows, step, until=place.until)
    way, slow = outwards(place), rows.level[on] == step
    if slow.all() or not slow.any():
        return None
    value = way * np.nan_to_num(along(region, place, rows.positions), posinf=FAR_M)
    spread = spread_m(rows, float(np.hypot(noise_m, EXACT_M)), value[:, None])[on]
    number = np.cumsum(np.where(on, (rows.before < 0) | ~on[rows.before], 0))[on]
    low, middle, high = _quantiles(value[on], np.where(slow, 1.0, -1.0), spread, number)
    low, high = sorted((way * low, way * high))
    return MetresCard(value=way * middle, low=low, high=high)


def decided_by(limit: LimitCard, rows: RuleRows, step: int, *, until: bool) -> Bools:
    """Return which rows show whether a region of a limit holds, shape (N,): the level is not that of a slower limit.

    With hysteresis, the region to enter is shown by rows after a faster level, the region to leave by the others.
    """
    on = rows.level >= step
    if limit.until is not None:
        earlier = np.where(rows.before >= 0, rows.level[rows.before], -1)
        on &= (earlier >= 0) & (earlier <= step) if until else earlier > step
    return np.asarray(on)


def spread_m(rows: RuleRows, noise_m: float, at_m: Floats) -> Vector:
    """Return the standard deviation, m, of values (N, K), m, at the time of the commanded level, shape (N,)."""
    pace = np.linalg.norm(at_m - at_m[rows.before], axis=1) * (rows.before >= 0)
    return np.asarray(np.hypot(noise_m, LATE * np.nan_to_num(pace)))


def _quantiles(value: Vector, side: Vector, spread: Vector, number: Ints) -> list[float]:
    """Return the quantiles BOUNDS of the position of a threshold.

    Args:
        value: Value of each sample, shape (K,), m.
        side: 1 = it lies below the threshold, -1 = above, shape (K,).
        spread: Standard deviation of `value`, shape (K,), m.
        number: Number of the operator's pass, ascending, shape (K,).
    """
    at_m = np.arange(value.min(), value.max() + GRID_M, GRID_M)
    weight = np.zeros(len(at_m))
    for one in np.split(np.arange(len(value)), np.flatnonzero(np.diff(number)) + 1):
        each = np.zeros(len(at_m))
        for some in np.array_split(one, 1 + len(one) // _BLOCK):
            each += log_ndtr(side[some, None] * (at_m - value[some, None]) / spread[some, None]).sum(axis=0)
        weight += np.logaddexp(each, each.max() + np.log(WRONG))
    share = np.cumsum(np.exp(weight - weight.max()))
    return [float(each) for each in np.interp(np.array(BOUNDS) * share[-1], share, at_m)]
