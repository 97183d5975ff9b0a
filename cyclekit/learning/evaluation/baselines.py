"""What a network must beat: rivals that learn from the same rows and are judged by the same rows.

    constant mean        what one knows who looks at no position at all
    distance staircase   the best thresholds on ||x_r - x_h||; right where the safety function is one of the distance
    gradient boosting    scikit-learn's, on the same inputs; no geometry assumed

The noise floor of the true staircase is not among them: it is unknown for a real log.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.networks.beaten import STAIRCASE, distance_of, fit_thresholds, staircase_at

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.windows import Samples
    from cyclekit.schema import Floats

_BOOSTED_ROWS = 100_000


@dataclass(frozen=True)
class Rival:
    """What was done instead of a network, and its squared errors, shape (N,), at the rows that all are judged by."""

    name: str
    squared: Floats
    note: str


def rivals(learn: Samples, judge: Samples, levels: Sequence[float], *, boosting: bool = True) -> list[Rival]:
    """Fit the rivals on `learn` and return their errors on `judge`."""
    mean = float(learn.scaling.mean())
    found = [Rival("constant mean", (mean - judge.scaling) ** 2, f"scaling {mean:.3f} everywhere")]
    if len(levels) > 1:
        thresholds = fit_thresholds(distance_of(learn), learn.scaling, levels)
        shown = ", ".join(f"{threshold:.2f}" if np.isfinite(threshold) else "never" for threshold in thresholds)
        squared = (staircase_at(thresholds, levels, judge) - judge.scaling) ** 2
        found.append(Rival(STAIRCASE, squared, f"thresholds on the distance: {shown} m"))
    if boosting:
        found.append(_boosted(learn, judge))
    return found


def _boosted(learn: Samples, judge: Samples) -> Rival:
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
    return Rival("gradient boosting", (predicted - judge.scaling) ** 2, note)
