"""Which scalings are usual where the operator is: a small decision tree over positions, quickly learned and applied.

It names no rule and predicts nothing; it only tells a slow-down that people usually cause there from one that they do
not. Rules are found by `learning.rules`, on commanded levels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Floats, Ints, Vector

BINS = 256
"""Each feature is cut at up to so many of its quantiles."""
MOST_LEAVES, LEAST_ROWS = 96, 12
GAIN = 1e-4
"""A cut lowers the impurity of all rows by at least this, or is not made."""
LIKELIER = 10.0
"""By how much a cut must raise the log-likelihood of rows that it was not found in."""

STRAY = 0.1
"""So many rows near a cut may lie on its wrong side: positions are noisy, and the robot answers late."""


class _Cut(NamedTuple):
    """Rows with `feature` up to `at` go to leaf or cut `low`, others to `high`; below zero: leaf -1 - number."""

    feature: int
    at: float
    low: int
    high: int


class _Node(NamedTuple):
    """A group of rows (numbers), and the best cut of it: gain, feature, bin."""

    rows: Ints
    gain: float
    feature: int
    bin: int


@dataclass(frozen=True)
class UsualLevels:
    """A tree over F features, and the shares of P classes at each leaf, shape (L, P)."""

    cuts: tuple[_Cut, ...]
    shares: Floats

    def leaf(self, features: Floats) -> Ints:
        """Return the leaf of each row of `features`, shape (N, F)."""
        at = np.zeros(len(features), np.int64) if self.cuts else np.full(len(features), -1)
        for number, cut in enumerate(self.cuts):  # a cut comes before those below it
            here = np.flatnonzero(at == number)
            at[here] = np.where(features[here, cut.feature] <= cut.at, cut.low, cut.high)
        return np.asarray(-1 - at)

    def lowest(self, features: Floats, share: float) -> Ints:
        """Return the lowest class at each row, shape (N,), that with those below it has at least this share there."""
        lowest = (np.cumsum(self.shares, axis=1) >= share).argmax(axis=1)
        return np.asarray(lowest[self.leaf(features)])


def usual_levels(features: Floats, label: Ints, classes: int, group: Ints) -> UsualLevels:
    """Return the tree of some rows: cuts are found in groups of even number, and kept where they help in the others.

    Args:
        features: Shape (N, F), N > 0, finite.
        label: Class of each row, shape (N,), from 0 to below `classes`.
        classes: How many there are.
        group: What happens once happens in one group, such as an execution; numbers, shape (N,).
    """
    edges = [np.unique(np.quantile(column, np.linspace(0, 1, BINS + 1)[1:-1])) for column in features.T]
    binned = np.stack([np.searchsorted(e, column) for e, column in zip(edges, features.T, strict=True)])
    learn = group % 2 == 0
    learn = learn if learn.any() and not learn.all() else np.ones_like(learn)
    nodes = [_looked_at(binned, label, classes, np.arange(len(label)), learn)]
    cuts: list[_Cut | None] = [None]
    while len(nodes) - sum(cut is not None for cut in cuts) < MOST_LEAVES:
        best = max((n for n, cut in enumerate(cuts) if cut is None), key=lambda n: nodes[n].gain)
        node = nodes[best]
        if node.gain < GAIN * len(label):
            break
        below: Bools = binned[node.feature, node.rows] <= node.bin
        cuts[best] = _Cut(node.feature, float(edges[node.feature][node.bin]), len(nodes), len(nodes) + 1)
        nodes += [_looked_at(binned, label, classes, node.rows[side], learn) for side in (below, ~below)]
        cuts += [None, None]
    return _tree(nodes, cuts, label, classes)


def _tree(nodes: list[_Node], cuts: list[_Cut | None], label: Ints, classes: int) -> UsualLevels:
    """Number cuts and leaves apart from each other."""
    inner = [n for n, cut in enumerate(cuts) if cut is not None]
    leaves = [n for n, cut in enumerate(cuts) if cut is None]
    number = {n: i for i, n in enumerate(inner)} | {n: -1 - i for i, n in enumerate(leaves)}
    made = [cut._replace(low=number[cut.low], high=number[cut.high]) for cut in cuts if cut is not None]
    counts = np.array([np.bincount(label[nodes[n].rows], minlength=classes) for n in leaves], np.float64)
    return UsualLevels(tuple(made), counts / counts.sum(axis=1, keepdims=True))


def _looked_at(binned: Ints, label: Ints, classes: int, every: Ints, learn: Bools) -> _Node:
    """Return a group of rows with its best cut that helps: the largest fall of the Gini impurity times rows."""
    rows, found = every[learn[every]], list[tuple[float, int, int]]()
    for feature, column in enumerate(binned if len(rows) >= 2 * LEAST_ROWS else ()):
        counts = np.bincount(column[rows] * classes + label[rows], minlength=BINS * classes)
        low = np.cumsum(counts.reshape(-1, classes), axis=0)[:-1].astype(np.float64)
        high = np.bincount(label[rows], minlength=classes) - low
        gain = _purity(low) + _purity(high) - float(_purity(low[-1:] + high[-1:])[0])
        gain[np.minimum(low.sum(axis=1), high.sum(axis=1)) < LEAST_ROWS] = 0.0
        found.append((float(gain.max()), feature, int(gain.argmax())))
    found = sorted((one for one in found if one[0] > 0.0), key=lambda one: -one[0])  # distances before places
    helping = (one for one in found if _helps(binned[one[1]] <= one[2], label, every, learn, classes))
    return _Node(every, *next(helping, (0.0, 0, 0)))


def _helps(low: Bools, label: Ints, every: Ints, learn: Bools, classes: int) -> bool:
    """Tell whether the shares on each side of a cut make the other rows likelier, which it was not found in."""
    found, others = every[learn[every]], every[~learn[every]]
    if not len(others):
        return bool(learn.all())
    before = _shares(label[found], classes)
    gain = 0.0
    for side in (low, ~low):
        after = (1.0 - STRAY) * _shares(label[found[side[found]]], classes) + STRAY * before
        gain += float(np.log(after / before)[label[others[side[others]]]].sum())
    return gain > LIKELIER


def _shares(label: Ints, classes: int) -> Vector:
    counts = np.bincount(label, minlength=classes) + 0.5
    return np.asarray(counts / counts.sum())


def _purity(counts: Floats) -> Vector:
    """Return the sum of squared counts over their sum, for each row of (K, P)."""
    total = np.maximum(counts.sum(axis=1), 1e-9)
    return np.asarray((counts.astype(np.float64) ** 2).sum(axis=1) / total)
