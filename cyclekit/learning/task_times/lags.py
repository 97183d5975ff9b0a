"""Tells lags after a needed task of another agent from lags after the agent's own task.

Who waits for another needs a moment to see that it is done; who comes when it is done goes on at once. Drawn from one
distribution, each would have half of the other's lag, and the later of two causes would come too late. The lag after
the own task also has the way from there, which differs by the task before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.task_times.starts import DECIDED_S, GAIN, MIN_DECIDED, deviation

if TYPE_CHECKING:
    from cyclekit.learning.task_times.starts import Waiting
    from cyclekit.schema import Bools, Vector

SAME_S = 1e-9
"""Rounding of two times that are one, s."""
LONG = 0.95
"""Quantile of the lags after needed tasks by which the own task must end later to decide a start."""


def by_cause(one: Waiting, lags_s: Vector) -> tuple[Bools, Bools]:
    """Return which lags are after the agent's own task or planned start, and which after needed tasks, shape (N,) each.

    The second are none if both are alike, or too few are known; then the first are all known ones.

    Args:
        one: Starts of a task with their conditions.
        lags_s: Lag of each start after all conditions, shape (N,), s; NaN = unknown.
    """
    known = np.isfinite(lags_s)
    every = known, np.zeros(len(known), dtype=bool)
    needs = [one.ends_s(need) for need in one.found if need is not None]
    if not needs:
        return every
    own_s = np.fmax(one.free_s, one.planned_s) if None in one.found else one.free_s
    needed_s = np.fmax.reduce(needs)
    after = known & (needed_s > own_s + DECIDED_S)
    if after.sum() < MIN_DECIDED:
        return every
    long_s = max(float(np.quantile(lags_s[after], LONG)), DECIDED_S)
    own = known & ~(needed_s > own_s - long_s)  # no need is NaN
    if own.sum() < MIN_DECIDED:
        return every
    both = lags_s[own | after]
    gain = len(both) * np.log(deviation([both]) / deviation([lags_s[own], lags_s[after]]))
    return (own, after) if gain > GAIN else every


def by_task_before(one: Waiting, lags_s: Vector) -> dict[str, float]:
    """Return by how much the lags differ from their mean after each task of the agent, s; "" = it is the first.

    These are the means after each task, shrunk by the spread that they have beyond chance (random effects, moment
    estimate): where the task before changes nothing, nothing is returned.

    Args:
        one: Starts of a task with their conditions.
        lags_s: Lag of each start after all conditions, shape (N,), s; NaN = it does not count.
    """
    own = np.isfinite(lags_s) & (one.free_s >= one.ready_s() - SAME_S)
    after = np.array([each.before for each in one.seen])[own]
    groups = {str(name): lags_s[own][after == name] for name in np.unique(after)}
    counts, left = np.array([len(some) for some in groups.values()]), len(after) - len(groups)
    if len(groups) < 2 or left < 1:
        return {}
    off_s = np.array([some.mean() for some in groups.values()]) - lags_s[own].mean()
    within = sum(float(((some - some.mean()) ** 2).sum()) for some in groups.values()) / left
    between = float((counts * off_s**2).sum()) - (len(groups) - 1) * within
    between /= len(after) - float((counts**2).sum()) / len(after)
    if between <= 0.0:
        return {}
    return dict(zip(groups, (between / (between + within / counts) * off_s).tolist(), strict=True))
