"""Trees on the features of the last second as one array, and their prediction with numpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.learning.last_second import window_features

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Ints, Singles

COLUMNS = 6
_FEATURE, _THRESHOLD, _LEFT, _RIGHT, _UNKNOWN_LEFT, _VALUE = range(COLUMNS)
_BLOCK = 512


@dataclass(frozen=True)
class Trees:
    """A sum of trees.

    Attributes:
        nodes: Shape (trees, nodes, 6): feature tested, threshold, next node if at most the threshold, next node if
            above (both the node itself for a leaf), 1 if an unknown feature goes to the first, and value of a leaf. The
            first node of a tree is its root; following nodes have higher numbers.
        known: Groups of inputs that may be unknown.
    """

    nodes: Singles
    known: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of values stored."""
        return int(self.nodes.size)

    def run(self, X: NDArray[np.floating[Any]]) -> Singles:
        """Return the sum of the leaves reached by each row, shape (N, 1).

        Args:
            X: Raw inputs, shape (N, K, F), oldest first; NaN only in groups of `known`.
        """
        count, width, _ = self.nodes.shape
        flat, root = self.nodes.reshape(-1, COLUMNS), np.arange(count) * width
        following = (self.nodes[:, :, [_RIGHT, _LEFT]] + root[:, None, None]).astype(np.intp)
        walk = _Walk(root, flat[:, _FEATURE].astype(np.intp), flat[:, _THRESHOLD].copy(), following.ravel())
        out = np.empty((len(X), 1), np.float32)
        for at in range(0, len(X), _BLOCK):
            leaf = walk.leaves(window_features(X[at : at + _BLOCK]), flat[:, _UNKNOWN_LEFT] > 0)
            out[at : at + _BLOCK, 0] = flat[:, _VALUE].take(leaf).sum(axis=1, dtype=np.float64)
        return out


@dataclass(frozen=True)
class _Walk:
    """All nodes of all trees in flat arrays: roots, features, thresholds, and the two next nodes of each."""

    root: Ints
    feature: Ints
    threshold: Singles
    following: Ints

    def leaves(self, features: Singles, unknown_left: Bools) -> Ints:
        """Return the leaf of each tree for features (N, D), shape (N, trees)."""
        values, row = features.ravel(), np.arange(len(features))[:, None] * features.shape[1]
        unknown = bool(np.isnan(values).any())
        node = np.broadcast_to(self.root, (len(features), self.root.size))
        while True:
            seen = values.take(self.feature.take(node) + row)
            lower = seen <= self.threshold.take(node)
            if unknown:
                lower |= np.isnan(seen) & unknown_left.take(node)
            below = self.following.take(2 * node + lower)
            if (below == node).all():
                return np.asarray(below)
            node = below


def sound(nodes: Singles, features: int) -> bool:
    """Return whether nodes read from a file are valid trees over `features` features: every path ends at a leaf."""
    number = np.arange(nodes.shape[1])
    whole = nodes[:, :, [_FEATURE, _LEFT, _RIGHT, _UNKNOWN_LEFT]]
    left, right = nodes[:, :, _LEFT], nodes[:, :, _RIGHT]
    leaf = (left == number) & (right == number)
    below = (left > number) & (right > number) & (left < nodes.shape[1]) & (right < nodes.shape[1])
    fits: Bools = (nodes[:, :, _FEATURE] >= 0) & (nodes[:, :, _FEATURE] < features) & (leaf | below)
    return bool((whole == np.round(whole)).all() and fits.all())
