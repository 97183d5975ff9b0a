"""Tells lags after a needed task of another agent from lags after the agent's own task.

Who waits for another needs a moment to see that it is done; who comes when it is done goes on at once. Drawn from one
distribution, each would have half of the other's lag, and the later of two causes would come too late.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.task_times.starts import DECIDED_S, GAIN, MIN_DECIDED, deviation

if TYPE_CHECKING:
    from cyclekit.learning.task_times.starts import Waiting
    from cyclekit.schema import Vector

LONG = 0.95
"""Quantile of the lags after needed tasks by which the own task must end later to decide a start."""


def by_cause(one: Waiting, lags_s: Vector) -> tuple[Vector, Vector]:
    """Return the lags after the agent's own task or planned start, and those after needed tasks, s.

    The second is empty if both are alike, or too few are known; then the first has all.

    Args:
        one: Starts of a task with their conditions.
        lags_s: Lag of each start after all conditions, shape (N,), s; NaN = unknown.
    """
    known = np.isfinite(lags_s)
    every = lags_s[known], np.empty(0)
    needs = [one.ends_s(need) for need in one.found if need is not None]
    if not needs:
        return every
    own_s = np.fmax(one.free_s, one.planned_s) if None in one.found else one.free_s
    needed_s = np.fmax.reduce(needs)
    after = lags_s[known & (needed_s > own_s + DECIDED_S)]
    if len(after) < MIN_DECIDED:
        return every
    long_s = max(float(np.quantile(after, LONG)), DECIDED_S)
    own = lags_s[known & ~(needed_s > own_s - long_s)]  # no need is NaN
    if len(own) < MIN_DECIDED:
        return every
    both = np.concatenate([own, after])
    gain = len(both) * np.log(deviation([both]) / deviation([own, after]))
    return (own, after) if gain > GAIN else every
