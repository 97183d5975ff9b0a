"""Logged cycles at the operator's latest pace: estimates are for it, so what was logged is compared at it too.

Only a part of a cycle follows the operator's pace, as the robot works and waits too. How much is a slope: that of the
logarithm of logged cycles over that of his pace in them, beside the means of their orders. It is from 0 to 1 (all
alike before any log is seen), which keeps few executions from telling more than they know.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards import OperatorPaceCard
from cyclekit.estimate.statistics.resample import TOGETHER, resampled
from cyclekit.learning.task_times.runs import logged_runs

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards.task_model import PaceCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats, Vector

SHARES = np.linspace(0.0, 1.0, 201)
"""Shares of the cycle that may follow the operator's pace."""
MIN_SLOPE = 6
"""Minimum number of executions, more than orders among them, for the slope; with fewer, all shares are alike."""


class LoggedPace(NamedTuple):
    """The operator's pace in logged executions.

    Attributes:
        log: Logarithm of his durations relative to the latest, by name of the execution.
        error: Standard error of the logarithm of the latest durations.
    """

    log: Mapping[str, float]
    error: float


class PaceShare(NamedTuple):
    """Share of the cycle that follows the operator's pace: mean and standard deviation."""

    mean: float
    sd: float


def logged_pace(dataset: Dataset, cards: Sequence[OperatorPaceCard | PaceCard]) -> LoggedPace | None:
    """Return the operator's pace in the logged executions; None if no accepted change of it concerns them.

    Several operators of task lists count alike.

    Args:
        dataset: The logs.
        cards: Accepted changes of the pace.
    """
    found = [
        _of_positions(dataset, card) if isinstance(card, OperatorPaceCard) else _of_list(dataset, card)
        for card in cards
    ]
    found = [one for one in found if one.log]
    if not found:
        return None
    names = set.intersection(*(set(one.log) for one in found))
    log = {name: float(np.mean([one.log[name] for one in found])) for name in names}
    return LoggedPace(log, float(np.mean([one.error for one in found])))


def _of_positions(dataset: Dataset, card: OperatorPaceCard) -> LoggedPace:
    """Return the pace in all executions; those that tell nothing of it have that of their neighbours."""
    part = np.array([card.work_share, 1.0 - card.work_share])
    errors = np.array([0.0 if one is None else one.error for one in (card.work, card.walk)])
    number = {one.execution: n for n, one in enumerate(dataset.card.executions)}
    known = sorted(
        (number[name], float(part @ np.log(both))) for name, both in card.factors().items() if name in number
    )
    if not known:
        return LoggedPace({}, 0.0)
    at, log = zip(*known, strict=True)
    return LoggedPace({name: float(np.interp(n, at, log)) for name, n in number.items()}, float(part @ errors))


def _of_list(dataset: Dataset, card: PaceCard) -> LoggedPace:
    runs, _ = logged_runs(dataset)
    log = {run.name: float(np.log(card.factor(min(run.number, card.last)))) for run in runs}
    return LoggedPace(log, card.error)


def at_latest_pace(pace: LoggedPace, share: PaceShare, names: Sequence[str], cycles_s: Vector) -> tuple[Vector, float]:
    """Return logged cycles at the operator's latest pace, shape (N,), s, and what that adds to the error of their mean.

    Args:
        pace: His pace in the logged executions.
        share: Share of a cycle that follows it.
        names: Names of the executions.
        cycles_s: Their durations as logged, shape (N,), s.
    """
    log = np.array([pace.log.get(name, 0.0) for name in names])
    found = cycles_s * np.exp(-share.mean * log)
    return found, float(np.hypot(share.sd * (found * log).mean(), share.mean * pace.error * found.mean()))


def share_of_pace(
    pace: LoggedPace, duration_s: Mapping[str, float], orders: Mapping[str, tuple[str, ...]]
) -> PaceShare:
    """Return the share of a cycle that follows the operator's pace.

    Args:
        pace: His pace in the logged executions.
        duration_s: Durations of executions by name, s.
        orders: Orders of the executions that count, by name; orders that ran once count as one.
    """
    names = [name for name in orders if name in pace.log]
    cycles_s, log_pace = (np.array([of[name] for name in names]) for of in (duration_s, pace.log))
    times = Counter(orders.values())
    group = [orders[name] if times[orders[name]] > 1 else None for name in names]
    free = len(names) - len(set(group)) - 1
    weight = np.ones(len(SHARES))
    if free >= MIN_SLOPE:
        x, y = (_beside_order(values, group) for values in (log_pace, np.log(cycles_s)))
        slopes = _slopes(resampled(names, 0, together=TOGETHER), x, y)
        error = float(slopes.std()) * (len(names) / free) ** 0.5
        if error > 0.0:
            slope = float(_slopes(np.full((1, len(names)), 1.0 / len(names)), x, y)[0])
            off = (SHARES - slope) ** 2
            weight = np.exp(-0.5 * (off - off.min()) / error**2)
    weight /= weight.sum()
    mean = float(weight @ SHARES)
    return PaceShare(mean, float(weight @ (SHARES - mean) ** 2) ** 0.5)


def _beside_order(values: Vector, group: Sequence[object]) -> Vector:
    """Return values (N,) less the mean of their order."""
    number = {each: n for n, each in enumerate(dict.fromkeys(group))}
    which = np.array([number[each] for each in group])
    return np.asarray(values - (np.bincount(which, values) / np.bincount(which))[which])


def _slopes(weights: Floats, x: Vector, y: Vector) -> Vector:
    """Return the slope of y (N,) over x (N,) under each row of weights (R, N), shape (R,)."""
    mean_x, mean_y = weights @ x, weights @ y
    spread = weights @ x**2 - mean_x**2
    return np.asarray((weights @ (x * y) - mean_x * mean_y) / np.maximum(spread, 1e-12))
