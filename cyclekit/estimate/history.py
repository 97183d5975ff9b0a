"""Logged durations beside the rollout: two estimates of the same mean, combined by their variances.

The sum of what each task took in the logs knows nothing of the order, and the rollout may be off as a whole; finite
logs move both, and mostly together. Both are drawn from the same resampled executions, so their variances and their
covariance are known; to that of history comes what the order does (how far it lies from rollouts of logged orders, and
from the rollout of this one), to that of the rollout the network's error. The weights are those of least variance
(Bates and Granger, Operational Research Quarterly 20, 1969).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.estimate.logged import SLIDER_LOSS
from cyclekit.estimate.nominal import slider_losses
from cyclekit.estimate.resample import resampled, resampled_alike

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats, Vector


LEAST_ORDERS = 10
"""From fewer logged orders it is not known how far history is off by the order, and the rollout stands alone."""


@dataclass(frozen=True)
class Combined:
    """How a number is made of two.

    Attributes:
        rollout_s: Expected cycle time by the rollout alone, corrected by what the logged executions show, s.
        history_s: By the logged durations of the tasks alone, s.
        history_share: Weight of the latter, in [0, 1].
    """

    rollout_s: float
    history_s: float
    history_share: float

    @property
    def expected_s(self) -> float:
        """The weighted mean of both, s."""
        return self.rollout_s + self.history_share * (self.history_s - self.rollout_s)


class TaskTimes:
    """What each task took in each execution beside an operator, the speed slider turned up."""

    def __init__(self, dataset: Dataset) -> None:
        """Read the logged tasks whose motion and scaling are known."""
        other = {entry.execution for entry in dataset.card.executions if entry.reference}
        other |= {name for name, part in slider_losses(dataset).items() if part > SLIDER_LOSS}
        tasks = dataset.tasks().filter(pl.col("safety_loss_s").is_not_null() & ~pl.col("execution").is_in(list(other)))
        took = tasks.select("execution", "task", s=pl.col("end_s") - pl.col("start_s"))
        self.executions = took["execution"].unique(maintain_order=True).to_list()
        self._row = {name: row for row, name in enumerate(self.executions)}
        self._column = {name: column for column, name in enumerate(took["task"].unique(maintain_order=True))}
        row = np.array([self._row[name] for name in took["execution"]], dtype=np.int64)
        column = np.array([self._column[name] for name in took["task"]], dtype=np.int64)
        shape = len(self._row), len(self._column)
        self._total_s, self._count = np.zeros(shape), np.zeros(shape)
        np.add.at(self._total_s, (row, column), took["s"].to_numpy())
        np.add.at(self._count, (row, column), 1.0)

    def knows(self, tasks: Sequence[str]) -> bool:
        """Tell whether all of them were logged."""
        return all(task in self._column for task in tasks)

    def sum_s(self, tasks: Sequence[str]) -> float:
        """Return the sum of the mean durations of tasks, s."""
        columns = self._columns(tasks)
        return float((self._total_s[:, columns].sum(axis=0) / self._count[:, columns].sum(axis=0)).sum())

    def resampled_s(self, tasks: Sequence[str], weights: Floats) -> Vector:
        """Return that sum in each resample, s; a task that no drawn execution holds counts with its mean.

        Args:
            tasks: Which, in any order, each as often as it occurs.
            weights: Of `executions` in each resample, shape (resamples, executions).
        """
        names, times = np.unique(self._columns(tasks), return_counts=True)
        usual = self._total_s[:, names].sum(axis=0) / self._count[:, names].sum(axis=0)
        count = weights @ self._count[:, names]
        mean = np.where(count > 0.0, weights @ self._total_s[:, names] / np.maximum(count, 1e-12), usual)
        return np.asarray(mean @ times)

    def elsewhere_s(self, sequence: TaskSequence) -> float:
        """Return the sum for a logged execution from the others alone, s; NaN where they lack a task of it."""
        columns, row = self._columns(sequence.tasks), self._row[sequence.name]
        count = self._count[:, columns].sum(axis=0) - self._count[row, columns]
        total = self._total_s[:, columns].sum(axis=0) - self._total_s[row, columns]
        return float((total / count).sum()) if (count > 0.0).all() else float("nan")

    def _columns(self, tasks: Sequence[str]) -> list[int]:
        return [self._column[task] for task in tasks]


def order_error(
    times: TaskTimes, sequences: Sequence[TaskSequence], crossed_s: Vector, chance: Vector | float = 0.0
) -> float | None:
    """Return how far history is off by the order, as part of the duration, for an order of one task.

    Tasks add up as if each were off by itself: for an order of N tasks it is this over the root of N.

    Args:
        times: What tasks took.
        sequences: The logged executions.
        crossed_s: Their mean durations rolled out beside the operators of others, shape (E,), s.
        chance: Variance of history over rollout by which executions were logged and walked, shape (E,): no order.

    Returns:
        None where fewer than LEAST_ORDERS of them can be compared.
    """
    known = [s.name in times.executions and times.knows(s.tasks) for s in sequences]
    elsewhere = [times.elsewhere_s(s) if ok else np.nan for s, ok in zip(sequences, known, strict=True)]
    squares = ((np.array(elsewhere) / crossed_s - 1.0) ** 2 - chance) * np.array([len(s.tasks) for s in sequences])
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(max(squares.mean(), 0.0))) if len(squares) >= LEAST_ORDERS else None


def chance_of_logs(
    times: TaskTimes, sequences: Sequence[TaskSequence], crossed_s: Floats, executions: Sequence[str], together: int
) -> Vector:
    """Return the variance of history over rollout when executions are drawn again, shape (E,); NaN where unknown.

    Args:
        times: What tasks took.
        sequences: The logged executions.
        crossed_s: Their durations beside the operators of others, shape (E, K), s; NaN where that was not walked.
        executions: Behind each of the K operators.
        together: Neighbouring executions drawn together.
    """
    operators = resampled(executions, 0, together=together)
    drawn = resampled_alike(executions, times.executions, 0, together=together)
    found = np.full(len(sequences), np.nan)
    for row, (sequence, mine_s) in enumerate(zip(sequences, crossed_s, strict=True)):
        walked = np.isfinite(mine_s)
        if walked.any() and times.knows(sequence.tasks):
            weight = operators[:, walked]
            total, some = weight @ mine_s[walked], weight.sum(axis=1)
            history_s = times.resampled_s(sequence.tasks, drawn)
            found[row] = (history_s * some / np.maximum(total, 1e-12))[some > 0.0].var()
    return found


def history_share(rollout: Vector, history: Vector, *, model_error: float, order_error: float) -> float:
    """Return the weight of history with which the variance of the combination is least, in [0, 1].

    Args:
        rollout: Means by the rollout in each resample, as parts of its mean, shape (resamples,).
        history: Those by history in the same resamples, as parts of its mean.
        model_error: Standard deviation that the network's error leaves, as part of the mean.
        order_error: What the order moves history by, as part of the mean.
    """
    together = float(np.cov(rollout, history)[0, 1])
    mine = float(rollout.var(ddof=1)) + model_error**2 - together
    other = float(history.var(ddof=1)) + order_error**2 - together
    return float(np.clip(mine / (mine + other), 0.0, 1.0)) if mine + other > 0.0 else 0.0
