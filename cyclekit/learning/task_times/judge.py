"""How well a model of task times predicts logged executions, and whether the pace has changed since its training."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import DatasetError, EstimateError, UnknownName
from cyclekit.learning.task_times.learn import rolled_run
from cyclekit.learning.task_times.runs import logged_runs
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards.task_model import TaskModelCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.task_times.runs import Run
    from cyclekit.schema import Progress, Vector

BLOCKS = 5
CHANGED = 3.0
"""Standard errors of a change of the pace."""
LEAST_CHANGE = 0.02
MOST = 500
"""Executions judged; of more, so many spread over all."""


@dataclass(frozen=True)
class PaceShift:
    """Change of the durations of an agent's tasks since the training: `change` as part, and in standard errors `z`."""

    agent: str
    change: float
    z: float

    @property
    def changed(self) -> bool:
        """Whether it is beyond chance and large enough to matter."""
        return abs(self.z) > CHANGED and abs(self.change) > LEAST_CHANGE


@dataclass(frozen=True, repr=False)
class TaskTimesEvaluation(Result):
    """How well a model of task times predicts logged executions.

    Attributes:
        executions: Judged; `unknown` have a task that the model does not know.
        bias, error: Mean of estimate / logged cycle time - 1, and mean of its absolute value.
        coverage: Part of the executions within the middle 90 % of the rolled-out cycles.
        drift: Of each agent since the training; None where it was not asked for.
        trends: Drift of the pace within the training, one sentence each.
    """

    executions: int
    unknown: int
    bias: float
    error: float
    coverage: float
    drift: tuple[PaceShift, ...] | None
    trends: tuple[str, ...]

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        drift = None if self.drift is None else [vars(shift) | {"changed": shift.changed} for shift in self.drift]
        return {**vars(self), "drift": drift, "trends": list(self.trends)}

    def _frame_rows(self) -> list[dict[str, object]]:
        return [{"executions": self.executions, "bias": self.bias, "error": self.error, "coverage": self.coverage}]

    def _said(self) -> list[str]:
        lines = [
            f"{self.executions} executions: cycle time {self.bias:+.1%} off on average, mean error {self.error:.1%}, "
            f"{self.coverage:.0%} within the middle 90 % of the rolled-out cycles",
            *([f"left out: {self.unknown} executions with a task that was never logged"] if self.unknown else []),
            *self.trends,
        ]
        for shift in self.drift or ():
            how = (
                f"CHANGED by {shift.change:+.0%} (train again on the newer logs)" if shift.changed else "no change seen"
            )
            lines.append(f"durations of {shift.agent} since the training: {how}, {shift.z:+.1f} standard errors")
        return lines

    def said(self) -> str:
        """Return it as lines of text."""
        return "\n".join(self._said())


def judge_task_times(
    model: TaskModelCard, dataset: Dataset, *, trained_on: Dataset | None = None, progress: Progress | None = None
) -> TaskTimesEvaluation:
    """Compare a model with logged executions.

    Args:
        model: What was learned.
        dataset: Of task lists.
        trained_on: Dataset of the training, where `dataset` is newer.
        progress: Told the fraction done.

    Raises:
        DatasetError: No execution can be judged.
    """
    every, _ = logged_runs(dataset)
    runs = every[:: -(-len(every) // MOST) or 1]
    now = max((pace.last for pace in model.pace.values()), default=0)
    ratios, inside, unknown = [], [], 0
    for number, run in enumerate(runs):
        at = run if trained_on is None else replace(run, number=now)
        try:
            took_s = rolled_run(model, at)
        except (UnknownName, EstimateError):
            unknown += 1
            continue
        ratios.append(float(took_s.mean()) / run.duration_s - 1.0)
        low, high = np.quantile(took_s, (0.05, 0.95))
        inside.append(low <= run.duration_s <= high)
        if progress:
            progress((number + 1) / len(runs), run.name)
    if not ratios:
        seen = f"{dataset.place}: none of {len(runs)} executions can be judged: each has a task the model does not know"
        raise DatasetError(seen, cure="Evaluate on logs of the same cell, or train again on these.")
    drift = None if trained_on is None else _shifts(model, logged_runs(trained_on)[0], every)
    trends = tuple(pace.said(agent) for agent, pace in model.pace.items())
    errors = np.array(ratios)
    return TaskTimesEvaluation(
        len(ratios), unknown, float(errors.mean()), float(np.abs(errors).mean()), float(np.mean(inside)), drift, trends
    )


def _shifts(model: TaskModelCard, before: Sequence[Run], after: Sequence[Run]) -> tuple[PaceShift, ...]:
    """Return for each agent how its durations have changed, the mean over its tasks."""
    found = []
    for agent in model.agents:
        old, new = _paces(model, before, agent), _paces(model, after, agent)
        if pace := model.pace.get(agent):
            old = old - np.log(pace.factor(np.arange(len(old))))
        if min(len(old), len(new)) < BLOCKS:
            continue
        change = float(new.mean() - old.mean())
        error = float(np.hypot(_error(old), _error(new)))
        found.append(PaceShift(agent, float(np.expm1(change)), change / max(error, 1e-9)))
    return tuple(found)


def _paces(model: TaskModelCard, runs: Sequence[Run], agent: str) -> Vector:
    """Return the mean logarithm of duration / usual duration of each execution, shape (executions,)."""
    usual = {task.task: task.usual_s for task in model.tasks if task.agent == agent}
    found = []
    for run in runs:
        logs = [
            np.log((done.end_s - done.start_s) / usual[done.task])
            for done in run.tasks.get(agent, ())
            if done.task in usual and done.end_s > done.start_s
        ]
        if logs:
            found.append(float(np.mean(logs)))
    return np.array(found)


def _error(paces: Vector) -> float:
    """Return the standard error of the mean: from means of blocks, as executions near each other are alike."""
    means = np.array([block.mean() for block in np.array_split(paces, BLOCKS)])
    return float(means.std(ddof=1) / np.sqrt(BLOCKS))
