"""Estimates all thresholds and edges of a rule, with intervals, from changes of the level.

The reaction time by which positions were shifted has an error of some milliseconds, so a fast operator seems to cross a
threshold at another distance than a slow one. This error is estimated too, one number for the whole rule. Errors within
an execution are correlated, so the standard errors are clustered by execution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import stdtrit

from cyclekit.dataset.cards.rule import MetresCard
from cyclekit.learning.rules.edges.crossings import CLEAR_M, LevelChanges, crossings_of
from cyclekit.learning.rules.edges.hysteresis import SUREST_M, Z95
from cyclekit.learning.rules.samples.quantities import outwards, put

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.rule import LimitCard
    from cyclekit.learning.rules.samples.quantities import RulePlace
    from cyclekit.learning.rules.samples.rows import RuleRows
    from cyclekit.schema import Bools, Ints, Vector

MIN_CHANGES = 5
"""Minimum number of changes to locate a threshold."""
LATE = 0.3
"""Prior standard deviation of the error of the reaction time, samples."""
FAR_OFF = 4.0
"""Number of standard deviations beyond which a change is an outlier."""
_ROUNDS = 4


class Located(NamedTuple):
    """Estimated positions of P thresholds and edges.

    Attributes:
        places: The thresholds and edges.
        at_m: Positions, shape (P,), m.
        expected, seen: Covariance of `at_m`, from the spread of each change and from the differences between
            executions, shape (P, P), m2.
        executions: Number of executions with changes of each, shape (P,).
    """

    places: Sequence[RulePlace]
    at_m: Vector
    expected: NDArray[np.float64]
    seen: NDArray[np.float64]
    executions: Ints

    def error_m(self, of: NDArray[np.float64]) -> Vector:
        """Return the standard errors (K,) of sums `of` (K, P) @ `at_m`, from the larger of both covariances."""
        squares = [np.einsum("kp,pq,kq->k", of, each, of) for each in (self.expected, self.seen)]
        return np.asarray(np.sqrt(np.maximum(*squares)))

    def cards(self) -> dict[RulePlace, MetresCard]:
        """Return the positions with their 95 % confidence intervals."""
        error_m = np.hypot(self.error_m(np.eye(len(self.at_m))), SUREST_M)
        half = stdtrit(np.maximum(1, self.executions - 1), 0.975) * error_m
        ends = zip(self.places, self.at_m.tolist(), half.tolist(), strict=True)
        return {place: MetresCard(value=at, low=at - way, high=at + way) for place, at, way in ends}


def by_crossings(
    limits: tuple[LimitCard, ...], rows: RuleRows, steps: Mapping[float, int]
) -> tuple[tuple[LimitCard, ...], frozenset[RulePlace]]:
    """Return a rule with thresholds, edges and intervals estimated from changes of the level, and which these are.

    With hysteresis, falls of the level locate the regions to enter and rises those to leave, with one common margin
    (`hysteresis`); without hysteresis both locate the same threshold.

    Args:
        limits: The fitted rule; kept where there are too few changes.
        rows: Rows to which it was fitted.
        steps: Index of each level.
    """
    changes = enough_changes(limits, rows, steps)
    if not changes:
        return limits, frozenset()
    found = with_one_margin(located(changes))
    return put(limits, found.cards()), frozenset(changes)


def enough_changes(
    limits: tuple[LimitCard, ...], rows: RuleRows, steps: Mapping[float, int], clear_m: float = CLEAR_M
) -> dict[RulePlace, LevelChanges]:
    """Return the changes of the level at each threshold and edge that has at least MIN_CHANGES; as `crossings_of`."""
    lag = {limit.scaling: limit.until is not None for limit in limits}
    changes: dict[RulePlace, LevelChanges] = {}
    for place, (down, up) in crossings_of(limits, rows, steps, dated=True, clear_m=clear_m).items():
        both = LevelChanges(*(np.concatenate(pair) for pair in zip(down, up, strict=True)))
        mine = _likely((up if place.until else down) if lag[place.level] else both)
        if len(mine.value_m) >= MIN_CHANGES:
            changes[place] = mine
    return changes


def _likely(each: LevelChanges) -> LevelChanges:
    """Return the changes without outliers."""
    if not len(each.value_m):
        return each
    off = np.abs(each.value_m - np.median(each.value_m))
    return each.where(off <= FAR_OFF * np.maximum(each.spread_m, 1.4826 * np.median(off)))


def located(changes: Mapping[RulePlace, LevelChanges]) -> Located:
    """Return positions of thresholds and edges from one robust regression on all changes of the level.

    Args:
        changes: Changes caused by each of them; at least one.
    """
    value, pace, spread, execution = (np.concatenate(parts) for parts in zip(*changes.values(), strict=True))
    counts = [len(each.value_m) for each in changes.values()]
    of = np.repeat(np.arange(len(changes)), counts)
    inputs = np.column_stack([of[:, None] == np.arange(len(changes)), pace]).astype(np.float64)
    keep: Bools = np.ones(len(value), np.bool_)
    for _ in range(_ROUNDS):
        weight = np.where(keep, spread**-2.0, 0.0)
        squares = (inputs * weight[:, None]).T @ inputs
        squares[-1, -1] += LATE**-2.0
        expected = np.asarray(np.linalg.pinv(squares), np.float64)
        off = value - inputs @ (at_m := expected @ (inputs * weight[:, None]).T @ value)
        usual = max(1.0, 1.4826 * float(np.median(np.abs(off) / spread)))
        keep = np.abs(off) <= FAR_OFF * usual * spread
    units, number = np.unique(execution, return_inverse=True)
    pull = np.zeros((len(units), inputs.shape[1]))
    np.add.at(pull, number, inputs * (weight * off)[:, None])
    seen = expected @ pull.T @ pull @ expected * len(units) / max(1, len(units) - 1)
    executions = np.array([len(np.unique(each.execution)) for each in changes.values()])
    return Located(list(changes), at_m[:-1], expected[:-1, :-1], seen[:-1, :-1], executions)


def with_one_margin(found: Located) -> Located:
    """Return the positions with one common margin between entering and leaving.

    A threshold whose own margin differs by more than its interval keeps it.
    """
    number = {place: at for at, place in enumerate(found.places)}
    pairs = [
        (number[place], other, outwards(place))
        for place in found.places
        if not place.until and (other := number.get(place._replace(until=True))) is not None
    ]
    if len(pairs) < 2:
        return found
    margins = np.zeros((len(pairs), len(found.places)))
    for row, (inner, outer, way) in enumerate(pairs):
        margins[row, [inner, outer]] = (-way, way)
    own, error = margins @ found.at_m, found.error_m(margins)
    same = margins[np.abs(own - np.average(own, weights=error**-2.0)) <= Z95 * error]
    if len(same) < 2:
        return found
    apart = same[1:] - same[:1]
    to_even = found.expected @ apart.T @ np.linalg.pinv(apart @ found.expected @ apart.T)
    change = np.eye(len(found.places)) - to_even @ apart
    expected, seen = (change @ each @ change.T for each in (found.expected, found.seen))
    return found._replace(at_m=change @ found.at_m, expected=expected, seen=seen)
