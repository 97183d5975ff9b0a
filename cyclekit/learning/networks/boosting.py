"""Gradient boosting on the features of the last second: trained by scikit-learn, stored as plain arrays.

The number of trees is chosen on held-out executions, because neighbouring rows are nearly equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.dataset.cards import EpochCard
from cyclekit.learning.last_second import window_features
from cyclekit.learning.networks.fitted import Fitted
from cyclekit.learning.networks.trees import COLUMNS, Trees
from cyclekit.text.numbers import scientific

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import AbstractContextManager

    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.learning.windows import Samples
    from cyclekit.schema import Bools, Floats, Progress, Singles

TREES, _EVERY = 300, 10
_LEARNING_RATE, _LEAVES, _LEAF_ROWS, _LOOKED_AT = 0.08, 31, 40, 16
_MAX_ROWS, _LOSS_ROWS = 400_000, 20_000


def fit_trees(
    spec: ModelSpec,
    rows: Samples,
    validation: Samples,
    levels: Sequence[float],
    progress: Progress | None = None,
    *,
    known: Sequence[str] = (),
) -> Fitted:
    """Train trees with the interface of `fitting.fit`; `levels` are not used, because trees predict a value.

    Rows have a history; very many are subsampled at random. The validation rows select the number of trees.
    """
    del levels
    grown = grow(rows, seed=spec.seed)
    some = rows.where(_some(len(rows), _LOSS_ROWS))
    loss, error = (grown.staged_errors(part) for part in (some, validation))
    kept = int(np.argmin(error)) + 1
    if progress:
        progress(1.0, f"{kept} trees, validation MSE {scientific(error[kept - 1])}")
    at = np.arange(_EVERY, len(error) + 1, _EVERY)
    history = [EpochCard(epoch=int(n), loss=float(loss[n - 1]), validation_mse=float(error[n - 1])) for n in at]
    none = np.zeros(0)
    return Fitted(spec, Trees(grown.nodes(kept), tuple(known)), tuple(history), none, none)


@dataclass(frozen=True)
class Grown:
    """A regressor of scikit-learn on the features of windows."""

    trees: Any

    def predict(self, rows: Samples) -> Floats:
        """Return the scaling, shape (N,), in [0, 1]."""
        with _one_thread():
            return np.clip(np.asarray(self.trees.predict(window_features(rows.model_inputs)), np.float64), 0.0, 1.0)

    def staged_errors(self, rows: Samples) -> Floats:
        """Return the weighted mean squared error on `rows` with 1, 2, ... trees, shape (trees,)."""
        stages = self.trees.staged_predict(window_features(rows.model_inputs))
        squared = ((np.clip(stage, 0.0, 1.0) - rows.scaling) ** 2 for stage in stages)
        with _one_thread():
            return np.array([np.average(each, weights=rows.weight) for each in squared])

    def nodes(self, kept: int) -> Singles:
        """Return the first `kept` trees as the nodes of `Trees`."""
        each = [trees[0].nodes for trees in self.trees._predictors[:kept]]
        found = np.zeros((kept, max(map(len, each)), COLUMNS), np.float32)
        found[:, :, 2] = found[:, :, 3] = np.arange(found.shape[1])
        for tree, nodes in zip(found, each, strict=True):
            tree[: len(nodes)] = _columns(nodes)
        found[0, :, -1] += float(np.ravel(self.trees._baseline_prediction)[0])
        return found


def grow(rows: Samples, *, seed: int = 0) -> Grown:
    """Train `TREES` trees on (a subset of) the rows; all comparisons use these settings."""
    from sklearn.ensemble import HistGradientBoostingRegressor  # slow to import

    some = rows.where(_some(len(rows), _MAX_ROWS, seed))
    features = window_features(some.model_inputs)
    trees = HistGradientBoostingRegressor(
        learning_rate=_LEARNING_RATE,
        max_iter=TREES,
        max_leaf_nodes=_LEAVES,
        min_samples_leaf=_LEAF_ROWS,
        max_features=min(1.0, _LOOKED_AT / features.shape[1]),
        early_stopping=False,
        random_state=seed,
    )
    with _one_thread():
        return Grown(trees.fit(features, some.scaling, sample_weight=some.weight))


def _one_thread() -> AbstractContextManager[object]:
    """Limit scikit-learn to one thread: several wait for each other, and sums would depend on their number."""
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(1)
    return limits


def _some(count: int, most: int, seed: int = 0) -> Bools:
    """Return which of `count` rows are used: all, or `most` drawn at random, shape (count,)."""
    taken = np.ones(count, np.bool_)
    if count > most:
        taken[np.random.default_rng(seed).choice(count, count - most, replace=False)] = False
    return taken


def _columns(nodes: Any) -> Singles:  # noqa: ANN401 - a structured array
    """Return scikit-learn's nodes as rows of `Trees.nodes`; thresholds are rounded down to single precision."""
    own, leaf = np.arange(len(nodes)), nodes["is_leaf"].astype(bool)
    threshold = np.where(leaf, 0.0, nodes["num_threshold"])
    single = np.clip(threshold, -3e38, 3e38).astype(np.float32)
    single = np.where(single > threshold, np.nextafter(single, np.float32(-np.inf)), single)
    left, right = (np.where(leaf, own, nodes[side]) for side in ("left", "right"))
    feature = np.where(leaf, 0, nodes["feature_idx"])
    columns = (feature, single, left, right, nodes["missing_go_to_left"], np.where(leaf, nodes["value"], 0.0))
    return np.stack(columns, axis=1).astype(np.float32)
