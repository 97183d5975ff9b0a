"""Baselines that learn from the same rows as a network and are evaluated on the same rows.

    constant mean                 without any position
    distance staircase            the best thresholds on ||x_r - x_h||
    gradient boosting             scikit-learn's, on the inputs of the model and the distances between them
    gradient boosting, last second    with the last second and past scaling, for `ahead` and `average`

The noise floor of the true staircase is not included, because it is unknown for a real log.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.networks.boosting import TREES, grow
from cyclekit.learning.networks.comparison import STAIRCASE, distance_of, fit_thresholds, staircase_at
from cyclekit.learning.windows import GROUPS
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.windows import Samples
    from cyclekit.schema import Floats


@dataclass(frozen=True)
class Rival:
    """A baseline and its squared errors, shape (N,), on the common rows."""

    name: str
    squared: Floats
    note: str


def rivals(learn: Samples, judge: Samples, levels: Sequence[float], *, signals: bool = False) -> list[Rival]:
    """Fit the fast baselines to `learn` and return their errors on `judge`.

    Args:
        learn: Rows to learn from.
        judge: Rows to evaluate on.
        levels: Levels of the scaling, ascending.
        signals: The inputs are signals instead of the operator's position: use their states, and no distance.
    """
    mean = float(learn.scaling.mean())
    found = [Rival("constant mean", (mean - judge.scaling) ** 2, f"scaling {fixed(mean, 3)} everywhere")]
    if signals:
        squared = (_by_state(learn, judge) - judge.scaling) ** 2
        found.append(Rival("signals alone", squared, "mean scaling while these signals are on"))
    elif len(levels) > 1:
        thresholds = fit_thresholds(distance_of(learn), learn.scaling, levels)
        shown = ", ".join(fixed(threshold, 2) if np.isfinite(threshold) else "never" for threshold in thresholds)
        squared = (staircase_at(thresholds, levels, judge) - judge.scaling) ** 2
        found.append(Rival(STAIRCASE, squared, f"thresholds on the distance: {shown} m"))
    return found


def _by_state(learn: Samples, judge: Samples) -> Floats:
    """Return the mean training scaling for the signal state of each evaluated row, shape (N,)."""
    human = GROUPS["human"]
    both = np.concatenate([learn.X[:, human], judge.X[:, human]])
    state = np.unique(both, axis=0, return_inverse=True)[1].ravel()
    mine = state[: len(learn)]
    rows, total = np.bincount(mine, minlength=state.max() + 1), np.bincount(mine, learn.scaling, state.max() + 1)
    means = np.where(rows > 0, total / np.maximum(rows, 1), learn.scaling.mean())
    return np.asarray(means[state[len(learn) :]])


def boosted(name: str, sees: str, learn: Samples, judge: Samples) -> Rival:
    """Train all trees of a model `boosting` on `learn`, and return their errors on `judge`."""
    predicted = grow(learn).predict(judge)
    note = f"scikit-learn, {TREES} trees on {sees}; {len(learn)} rows"
    return Rival(name, (predicted - judge.scaling) ** 2, note)
