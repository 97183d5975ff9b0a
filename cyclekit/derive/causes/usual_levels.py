"""Usual scalings by operator position: a small decision tree, fast to learn and to apply.

It only separates slow-downs that people usually cause at a position from others. Rules are found by `learning.rules`,
on commanded levels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Floats, Ints, Vector

BINS = 256
"""Maximum number of bins per feature, bounded by quantiles."""
MAX_LEAVES, MIN_ROWS = 96, 12
MIN_GINI_GAIN = 1e-4
"""Minimum reduction of the Gini impurity by a cut, per row of the whole data."""
MIN_LOGLIK_GAIN = 10.0
"""Minimum gain of a cut in log-likelihood on held-out rows."""

MISPLACED_SHARE = 0.1
"""Share of rows that may be on the wrong side of a cut: positions are noisy, and the robot reacts late."""


class _Cut(NamedTuple):
    """Rows with `feature` <= `at` go to cut `low`, others to cut `high`; a negative value means leaf -1 - value."""

    feature: int
    at: float
    low: int
    high: int


class _Node(NamedTuple):
    """Indices of a group of rows, and its best cut: gain, feature, bin."""

    rows: Ints
    gain: float
    feature: int
    bin: int


@dataclass(frozen=True)
class UsualLevels:
    """Decision tree over F features, with the shares of P classes at each leaf, shape (L, P)."""

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
        """Return for each row the lowest class whose cumulative share at its leaf is at least `share`, shape (N,)."""
        lowest = (np.cumsum(self.shares, axis=1) >= share).argmax(axis=1)
        return np.asarray(lowest[self.leaf(features)])


def usual_levels(features: Floats, label: Ints, classes: int, group: Ints) -> UsualLevels:
    """Return a tree fitted to rows: cuts are found in even groups and kept if they help in odd groups.

    Args:
        features: Shape (N, F), N > 0, finite.
        label: Class of each row, shape (N,), from 0 to `classes` - 1.
        classes: Number of classes.
        group: Group of each row, such as the index of its execution, shape (N,); rows of a group are not independent.
    """
    edges = [np.unique(np.quantile(column, np.linspace(0, 1, BINS + 1)[1:-1])) for column in features.T]
    binned = np.stack([np.searchsorted(e, column) for e, column in zip(edges, features.T, strict=True)])
    learn = group % 2 == 0
    learn = learn if learn.any() and not learn.all() else np.ones_like(learn)
    nodes = [_node(binned, label, classes, np.arange(len(label)), learn)]
    cuts: list[_Cut | None] = [None]
    while len(nodes) - sum(cut is not None for cut in cuts) < MAX_LEAVES:
        best = max((n for n, cut in enumerate(cuts) if cut is None), key=lambda n: nodes[n].gain)
        node = nodes[best]
        if node.gain < MIN_GINI_GAIN * len(label):
            break
        below: Bools = binned[node.feature, node.rows] <= node.bin
        cuts[best] = _Cut(node.feature, float(edges[node.feature][node.bin]), len(nodes), len(nodes) + 1)
        nodes += [_node(binned, label, classes, node.rows[side], learn) for side in (below, ~below)]
        cuts += [None, None]
    return _tree(nodes, cuts, label, classes)


def _tree(nodes: list[_Node], cuts: list[_Cut | None], label: Ints, classes: int) -> UsualLevels:
    """Return the tree with cuts and leaves numbered separately."""
    inner = [n for n, cut in enumerate(cuts) if cut is not None]
    leaves = [n for n, cut in enumerate(cuts) if cut is None]
    number = {n: i for i, n in enumerate(inner)} | {n: -1 - i for i, n in enumerate(leaves)}
    made = [cut._replace(low=number[cut.low], high=number[cut.high]) for cut in cuts if cut is not None]
    counts = np.array([np.bincount(label[nodes[n].rows], minlength=classes) for n in leaves], np.float64)
    return UsualLevels(tuple(made), counts / counts.sum(axis=1, keepdims=True))


def _node(binned: Ints, label: Ints, classes: int, every: Ints, learn: Bools) -> _Node:
    """Return a group of rows with its best helpful cut: the largest reduction of Gini impurity times rows."""
    rows = every[learn[every]]
    if len(rows) < 2 * MIN_ROWS:
        return _Node(every, 0.0, 0, 0)
    own = label[rows]
    whole = np.bincount(own, minlength=classes).astype(np.float64)[None, :, None]
    counts = [np.bincount(own * BINS + column[rows], minlength=classes * BINS) for column in binned]
    low = np.cumsum(np.reshape(counts, (-1, classes, BINS)), axis=2)[:, :, :-1].astype(np.float64)
    below = low.sum(axis=1)
    above = len(rows) - below
    gain = _purity(low, below) + _purity(whole - low, above) - _purity(whole, np.float64(len(rows)))
    gain[np.minimum(below, above) < MIN_ROWS] = 0.0
    best, at = gain.max(axis=1), gain.argmax(axis=1)
    found = sorted(np.flatnonzero(best > 0.0).tolist(), key=lambda feature: -best[feature])  # distances before places
    for feature in found:
        if _helps(binned[feature] <= at[feature], label, every, learn, classes):
            return _Node(every, float(best[feature]), feature, int(at[feature]))
    return _Node(every, 0.0, 0, 0)


def _helps(low: Bools, label: Ints, every: Ints, learn: Bools, classes: int) -> bool:
    """Return whether a cut raises the log-likelihood of the held-out rows by more than MIN_LOGLIK_GAIN."""
    found, others = every[learn[every]], every[~learn[every]]
    if not len(others):
        return bool(learn.all())
    before = _shares(label[found], classes)
    gain = 0.0
    for side in (low, ~low):
        after = (1.0 - MISPLACED_SHARE) * _shares(label[found[side[found]]], classes) + MISPLACED_SHARE * before
        gain += float(np.log(after / before)[label[others[side[others]]]].sum())
    return gain > MIN_LOGLIK_GAIN


def _shares(label: Ints, classes: int) -> Vector:
    counts = np.bincount(label, minlength=classes) + 0.5
    return np.asarray(counts / counts.sum())


def _purity(counts: Floats, total: Floats | np.float64) -> Floats:
    """Return the sum over P classes of squared counts, shape (F, P, K), divided by their totals, (F, K): (F, K)."""
    return np.asarray((counts**2).sum(axis=1) / np.maximum(total, 1e-9))
