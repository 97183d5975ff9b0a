"""What a network must beat: rivals that learn from the same rows and are judged by the same rows.

    constant mean        what one knows who looks at no position at all
    distance staircase   the best thresholds on ||x_r - x_h||; right where the safety function is one of the distance
    gradient boosting    scikit-learn's, on the same inputs; no geometry assumed

The noise floor of the true staircase is not among them: in a real log nobody knows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.samples import Samples

_BINS = 4096
_BOOSTED_ROWS = 100_000


@dataclass(frozen=True)
class Row:
    """One line of the comparison: mean squared error of the scaling, and what was done."""

    name: str
    mse: float
    note: str


def rivals(learn: Samples, judge: Samples, levels: Sequence[float], *, boosting: bool = True) -> list[Row]:
    """Fit the rivals on `learn` and return their errors on `judge`."""
    mean = float(learn.scaling.mean())
    rows = [Row("constant mean", _mse(np.full(len(judge), mean), judge), f"scaling {mean:.3f} everywhere")]
    if len(levels) > 1:
        thresholds = fit_thresholds(distance_of(learn), learn.scaling, levels)
        values = np.array(levels)[np.searchsorted(thresholds, distance_of(judge), side="right")]
        shown = ", ".join(f"{threshold:.2f}" if np.isfinite(threshold) else "never" for threshold in thresholds)
        rows.append(Row("distance staircase", _mse(values, judge), f"thresholds on the distance: {shown} m"))
    if boosting:
        rows.append(_boosted(learn, judge))
    return rows


def fit_thresholds(
    distance_m: NDArray[np.float64], scaling: NDArray[np.float64], levels: Sequence[float]
) -> NDArray[np.float64]:
    """Return the distances at which a rising staircase of given levels fits best.

    Exact to one of 4096 equally filled bins of distance: a dynamic programme over bins and levels.

    Args:
        distance_m: Shape (N,), N > 0.
        scaling: Shape (N,).
        levels: Ascending, shape (P,).

    Returns:
        Shape (P - 1,), ascending, m: from threshold i on, level i + 1 holds. Minus or plus infinity at an end where
        a level is never used.
    """
    order = np.argsort(distance_m, kind="stable")
    ends = np.unique(np.linspace(0, order.size, min(_BINS, order.size) + 1).astype(np.int64))
    edges = distance_m[order][ends[:-1]]
    error = (scaling[order][:, None] - np.asarray(levels)[None, :]) ** 2
    total = np.concatenate([np.zeros((1, len(levels))), np.cumsum(error, axis=0)])[ends]  # (bins + 1, P)
    best, cut = total[:, 0], np.zeros((len(levels), len(ends)), np.int64)
    for level in range(1, len(levels)):  # best[b]: least error of the first b bins with levels 0..level
        ahead = best - total[:, level]
        lowest = np.minimum.accumulate(ahead)
        first = np.flatnonzero(np.diff(lowest, prepend=np.inf) < 0)
        cut[level] = first[np.searchsorted(first, np.arange(len(ends)), side="right") - 1]
        best = lowest + total[:, level]
    thresholds, stop = np.empty(len(levels) - 1), len(ends) - 1
    for level in range(len(levels) - 1, 0, -1):
        stop = int(cut[level][stop])
        thresholds[level - 1] = -np.inf if stop == 0 else np.inf if stop == len(edges) else edges[stop]
    return thresholds


def _boosted(learn: Samples, judge: Samples) -> Row:
    from sklearn.ensemble import HistGradientBoostingRegressor  # slow to import
    from threadpoolctl import threadpool_limits

    rows = np.arange(len(learn))
    if rows.size > _BOOSTED_ROWS:
        rows = np.sort(np.random.default_rng(0).choice(rows, _BOOSTED_ROWS, replace=False))
    trees = HistGradientBoostingRegressor(max_iter=200, max_leaf_nodes=63, early_stopping=False, random_state=0)
    with threadpool_limits(1):  # its threads wait for each other, and share sums out by their number
        trees.fit(learn.X[rows], learn.scaling[rows])
        predicted = np.clip(trees.predict(judge.X), 0.0, 1.0)
    note = f"scikit-learn, 200 trees of 63 leaves, {rows.size} rows"
    return Row("gradient boosting", _mse(predicted, judge), note)


def distance_of(rows: Samples) -> NDArray[np.float64]:
    """Return ||x_r - x_h|| of every row, shape (N,), m; infinite where nobody is there."""
    apart = np.linalg.norm((rows.X[:, 0:3] - rows.X[:, 3:6]).astype(np.float64), axis=1)
    return np.asarray(np.where(np.isnan(apart), np.inf, apart))


def _mse(predicted: NDArray[np.float64], rows: Samples) -> float:
    return float(np.mean((predicted - rows.scaling) ** 2))
