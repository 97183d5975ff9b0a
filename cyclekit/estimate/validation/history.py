"""Combination of the rollout with logged task durations: two estimates of one mean, weighted by their variances.

The sum of logged task durations ignores the effect of the order, and the rollout may have a bias; finite logs shift
both, mostly in the same direction. Both are computed from the same resampled executions, so their variances and their
covariance are known. To the variance of history is added the effect of the order (its difference from rollouts of
logged orders, and from the rollout of this one), to that of the rollout the network's error. The weights minimise the
variance (Bates and Granger, Operational Research Quarterly 20, 1969).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.estimate.robot.nominal import turned_otherwise
from cyclekit.estimate.statistics.resample import resampled, resampled_alike

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Floats, Vector


MIN_ORDERS = 10
"""Minimum number of logged orders to estimate the effect of the order; with fewer the rollout is used alone."""


@dataclass(frozen=True)
class Combined:
    """Weighted mean of rollout and logged task durations.

    Attributes:
        rollout_s: Expected cycle time by the rollout alone, corrected by the validation on logged executions, s.
        history_s: Expected cycle time by the logged durations of the tasks alone, s.
        history_share: Weight of `history_s`, in [0, 1].
        by_order: Whether `history_s` is that of tasks after those before them (`order_effect`).
        visits_after: Place that visits of people follow, if `history_s` is the rollout with such visits
            (`visit_effect`).
    """

    rollout_s: float
    history_s: float
    history_share: float
    by_order: bool = False
    visits_after: str | None = None

    @property
    def expected_s(self) -> float:
        """The weighted mean, s."""
        return self.rollout_s + self.history_share * (self.history_s - self.rollout_s)


class TaskTimes:
    """Logged duration of each task in each execution with an operator, at the usual speed slider."""

    def __init__(self, dataset: Dataset) -> None:
        """Read the logged tasks whose motion and scaling are known."""
        other = {entry.execution for entry in dataset.card.executions if entry.reference}
        other |= turned_otherwise(dataset)
        tasks = dataset.whole_tasks()
        tasks = tasks.filter(pl.col("safety_loss_s").is_not_null() & ~pl.col("execution").is_in(list(other)))
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
        """Return whether all tasks were logged."""
        return all(task in self._column for task in tasks)

    def sum_s(self, tasks: Sequence[str]) -> float:
        """Return the sum of the mean durations of tasks, s."""
        columns = self._columns(tasks)
        return float((self._total_s[:, columns].sum(axis=0) / self._count[:, columns].sum(axis=0)).sum())

    def resampled_s(self, tasks: Sequence[str], weights: Floats) -> Vector:
        """Return that sum in each resample, s; a task missing from all drawn executions counts with its overall mean.

        Args:
            tasks: The tasks, in any order, repeated as often as they occur.
            weights: Weights of `executions` in each resample, shape (resamples, executions).
        """
        names, times = np.unique(self._columns(tasks), return_counts=True)
        usual = self._total_s[:, names].sum(axis=0) / self._count[:, names].sum(axis=0)
        count = weights @ self._count[:, names]
        mean = np.where(count > 0.0, weights @ self._total_s[:, names] / np.maximum(count, 1e-12), usual)
        return np.asarray(mean @ times)

    def elsewhere_s(self, sequence: TaskSequence) -> float:
        """Return the sum for a logged execution from all others, s; NaN if they lack one of its tasks."""
        columns, row = self._columns(sequence.tasks), self._row[sequence.name]
        count = self._count[:, columns].sum(axis=0) - self._count[row, columns]
        total = self._total_s[:, columns].sum(axis=0) - self._total_s[row, columns]
        return float((total / count).sum()) if (count > 0.0).all() else float("nan")

    def _columns(self, tasks: Sequence[str]) -> list[int]:
        return [self._column[task] for task in tasks]


def order_error(
    times: TaskTimes, sequences: Sequence[TaskSequence], others_s: Vector, chance: Vector | float = 0.0
) -> float | None:
    """Return the error of history due to the order, as a share of the duration, for an order of one task.

    Errors of single tasks are treated as independent: an order of N tasks has this error over the root of N.

    Args:
        times: Logged task durations.
        sequences: The logged executions.
        others_s: Their mean durations rolled out with the operator tracks of others, shape (E,), s.
        chance: Variance of history over rollout due to the choice of executions logged and simulated, shape (E,); it
            is subtracted.

    Returns:
        The error; None if fewer than MIN_ORDERS executions can be compared.
    """
    known = [s.name in times.executions and times.knows(s.tasks) for s in sequences]
    elsewhere = [times.elsewhere_s(s) if ok else np.nan for s, ok in zip(sequences, known, strict=True)]
    squares = ((np.array(elsewhere) / others_s - 1.0) ** 2 - chance) * np.array([len(s.tasks) for s in sequences])
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(max(squares.mean(), 0.0))) if len(squares) >= MIN_ORDERS else None


def chance_of_logs(
    times: TaskTimes,
    sequences: Sequence[TaskSequence],
    others_s: Floats,
    executions: Sequence[str],
    together: int,
) -> Vector:
    """Return the variance of history over rollout over resampled executions, shape (E,); NaN if unknown.

    Args:
        times: Logged task durations.
        sequences: The logged executions.
        others_s: Their durations with the operator tracks of others, shape (E, K), s; NaN if not simulated.
        executions: Execution of each of the K operator tracks.
        together: Number of neighbouring executions drawn as one block.
    """
    operators = resampled(executions, 0, together=together)
    drawn = resampled_alike(executions, times.executions, 0, together=together)
    found = np.full(len(sequences), np.nan)
    for row, (sequence, mine_s) in enumerate(zip(sequences, others_s, strict=True)):
        walked = np.isfinite(mine_s)
        if walked.any() and times.knows(sequence.tasks):
            weight = operators[:, walked]
            total, some = weight @ mine_s[walked], weight.sum(axis=1)
            history_s = times.resampled_s(sequence.tasks, drawn)
            found[row] = (history_s * some / np.maximum(total, 1e-12))[some > 0.0].var()
    return found


def history_share(rollout: Vector, history: Vector, *, model_error: float, order_error: float) -> float:
    """Return the weight of history, in [0, 1], that minimises the variance of the combination.

    Args:
        rollout: Rollout mean in each resample, relative to its mean, shape (resamples,).
        history: History mean in the same resamples, relative to its mean.
        model_error: Standard deviation due to the network's error, as a share of the mean.
        order_error: Standard deviation of history due to the order, as a share of the mean.
    """
    together = float(np.cov(rollout, history)[0, 1])
    mine = float(rollout.var(ddof=1)) + model_error**2 - together
    other = float(history.var(ddof=1)) + order_error**2 - together
    return float(np.clip(mine / (mine + other), 0.0, 1.0)) if mine + other > 0.0 else 0.0
