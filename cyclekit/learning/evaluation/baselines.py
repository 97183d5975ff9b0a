"""What a network must beat: rivals that learn from the same rows and are judged by the same rows.

    constant mean        what one knows who looks at no position at all
    distance staircase   the best thresholds on ||x_r - x_h||; right where the safety function is one of the distance
    gradient boosting    scikit-learn's, on the inputs of the model and the distances between them
    the same, last second    on what is known of the last second, with the scaling so far, for what lies ahead

The noise floor of the true staircase is not among them: it is unknown for a real log.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.networks.beaten import STAIRCASE, distance_of, fit_thresholds, staircase_at
from cyclekit.learning.networks.boosting import TREES, grow
from cyclekit.learning.windows import GROUPS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.windows import Samples
    from cyclekit.schema import Floats


@dataclass(frozen=True)
class Rival:
    """What was done instead of a network, and its squared errors, shape (N,), at the rows that all are judged by."""

    name: str
    squared: Floats
    note: str


def rivals(learn: Samples, judge: Samples, levels: Sequence[float], *, signals: bool = False) -> list[Rival]:
    """Fit the rivals that take no time on `learn` and return their errors on `judge`.

    Args:
        learn: Rows to learn from.
        judge: Rows to be judged by.
        levels: Of the scaling, ascending.
        signals: Signals stand in place of the operator's position: a table of them, and no distance.
    """
    mean = float(learn.scaling.mean())
    found = [Rival("constant mean", (mean - judge.scaling) ** 2, f"scaling {mean:.3f} everywhere")]
    if signals:
        squared = (_by_state(learn, judge) - judge.scaling) ** 2
        found.append(Rival("signals alone", squared, "mean scaling while these signals are on"))
    elif len(levels) > 1:
        thresholds = fit_thresholds(distance_of(learn), learn.scaling, levels)
        shown = ", ".join(f"{threshold:.2f}" if np.isfinite(threshold) else "never" for threshold in thresholds)
        squared = (staircase_at(thresholds, levels, judge) - judge.scaling) ** 2
        found.append(Rival(STAIRCASE, squared, f"thresholds on the distance: {shown} m"))
    return found


def _by_state(learn: Samples, judge: Samples) -> Floats:
    """Return the mean scaling, in the rows to learn from, of the state of the signals in each row to be judged."""
    human = GROUPS["human"]
    both = np.concatenate([learn.X[:, human], judge.X[:, human]])
    state = np.unique(both, axis=0, return_inverse=True)[1].ravel()
    mine = state[: len(learn)]
    rows, total = np.bincount(mine, minlength=state.max() + 1), np.bincount(mine, learn.scaling, state.max() + 1)
    means = np.where(rows > 0, total / np.maximum(rows, 1), learn.scaling.mean())
    return np.asarray(means[state[len(learn) :]])


def boosted(name: str, sees: str, learn: Samples, judge: Samples) -> Rival:
    """Grow trees on `learn`, as a model `boosting` does but all of them, and return their errors on `judge`."""
    predicted = grow(learn).predict(judge)
    note = f"scikit-learn, {TREES} trees on {sees}; {len(learn)} rows"
    return Rival(name, (predicted - judge.scaling) ** 2, note)
