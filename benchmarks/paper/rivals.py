"""Rivals with the same training and test rows as the networks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from cyclekit.learning.networks.boosting import grow
from cyclekit.learning.networks.comparison import distance_of, fit_thresholds

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.learning.windows import Samples

    Vector = NDArray[np.float64]


def predict_by(name: str, learn: Samples, judge: Samples, levels: Sequence[float], now: Vector) -> Vector:
    """Return the predictions of a rival for `judge`, shape (N,).

    Args:
        name: One of `plan.RIVALS_AHEAD`.
        learn: Training rows.
        judge: Test rows.
        levels: Levels of the staircase, ascending.
        now: Last known scaling before each row of `judge`, shape (N,).
    """
    if name == "persistence":
        return now
    if name == "distance staircase":
        thresholds = fit_thresholds(distance_of(learn), learn.scaling, levels)
        return np.asarray(np.array(levels)[np.searchsorted(thresholds, distance_of(judge), side="right")])
    if name == "gradient boosting":
        learn, judge = (replace(rows, table=None, before=None) for rows in (learn, judge))
    return _perceptron(learn, judge) if name == "MLP" else grow(learn).predict(judge)


def _perceptron(learn: Samples, judge: Samples) -> Vector:
    from sklearn.neural_network import MLPRegressor

    mean, scale = learn.X.mean(axis=0), np.maximum(learn.X.std(axis=0), 1e-6)
    epochs = int(np.clip(5_000_000 / len(learn), 5, 100))
    batch = min(512, len(learn))
    net = MLPRegressor(hidden_layer_sizes=(64,) * 5, batch_size=batch, max_iter=epochs, random_state=0, tol=0.0)
    import warnings

    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore")  # a warning that it has not converged
        net.fit((learn.X - mean) / scale, learn.scaling)
        return np.clip(np.asarray(net.predict((judge.X - mean) / scale), np.float64), 0.0, 1.0)
