"""Evaluates a model of task times on logged executions, and tests whether the pace has changed since training."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import DatasetError, EstimateError, UnknownName
from cyclekit.learning.task_times.clocks import in_one_clock
from cyclekit.learning.task_times.joint import marked
from cyclekit.learning.task_times.learn import rolled_run
from cyclekit.learning.task_times.runs import logged_runs
from cyclekit.text.numbers import percent, signed, signed_percent
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards.task_model import TaskModelCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.task_times.runs import Run
    from cyclekit.schema import Progress, Vector

BLOCKS = 5
"""Number of blocks of executions for a standard error."""
CHANGED = 3.0
"""Minimum change of the pace, in standard errors."""
MIN_CHANGE = 0.02
"""Minimum change of the pace, as a share."""
MAX_EXECUTIONS = 500
"""Maximum number of executions evaluated; above it, evenly spaced ones."""


@dataclass(frozen=True)
class PaceShift:
    """Change of the durations of an agent's tasks since training: `change` as a share, `z` in standard errors."""

    agent: str
    change: float
    z: float

    @property
    def changed(self) -> bool:
        """Whether the change is significant and large enough to matter."""
        return abs(self.z) > CHANGED and abs(self.change) > MIN_CHANGE


@dataclass(frozen=True, repr=False)
class TaskTimesEvaluation(Result):
    """Prediction errors of a model of task times on logged executions.

    Attributes:
        executions: Number of executions evaluated; `unknown` contain a task that the model does not know.
        bias, error: Mean and mean absolute value of estimate / logged cycle time - 1.
        coverage: Share of the executions within the middle 90 % of the simulated cycles.
        drift: Change of each agent's pace since training; None if not requested.
        trends: Trends of the pace within the training and clocks that are off, one sentence each.
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

    def _lines(self) -> list[str]:
        lines = [
            f"{self.executions} executions: cycle time {signed_percent(self.bias, 1)} off on average, mean "
            f"error {percent(self.error, 1)}, {percent(self.coverage)} within the middle 90 % of the rolled-out cycles",
            *([f"left out: {self.unknown} executions with a task that was never logged"] if self.unknown else []),
            *self.trends,
        ]
        for shift in self.drift or ():
            how = (
                f"CHANGED by {signed_percent(shift.change)} (train again on the newer logs)"
                if shift.changed
                else "no change seen"
            )
            lines.append(f"durations of {shift.agent} since the training: {how}, {signed(shift.z, 1)} standard errors")
        return lines

    def said(self) -> str:
        """Return the evaluation as lines of text."""
        return "\n".join(self._lines())


def judge_task_times(
    model: TaskModelCard, dataset: Dataset, *, trained_on: Dataset | None = None, progress: Progress | None = None
) -> TaskTimesEvaluation:
    """Compare a model with logged executions.

    Args:
        model: Learned task times.
        dataset: Dataset of task lists.
        trained_on: Dataset of the training, if `dataset` is newer.
        progress: Called with the share done.

    Raises:
        DatasetError: No execution can be evaluated.
    """
    every, agents = logged_runs(dataset)
    if model.clocks:
        every, _ = in_one_clock(every, agents)
    runs = every[:: -(-len(every) // MAX_EXECUTIONS) or 1]
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
    errors = np.array(ratios)
    return TaskTimesEvaluation(
        len(ratios),
        unknown,
        float(errors.mean()),
        float(np.abs(errors).mean()),
        float(np.mean(inside)),
        drift,
        model.notices,
    )


def _shifts(model: TaskModelCard, before: Sequence[Run], after: Sequence[Run]) -> tuple[PaceShift, ...]:
    """Return the change of each agent's log durations, as a mean over its tasks."""
    found = []
    joint = {(task.agent, task.task): task.joint for task in model.tasks if task.joint}
    before, after = marked(before, joint), marked(after, joint)
    for agent in model.agents:
        old, new = _paces(model, before, agent), _paces(model, after, agent)
        latest = 0.0
        if pace := model.pace.get(agent):
            old, latest = old - np.log(pace.factor(np.arange(len(old)))), pace.error
        if min(len(old), len(new)) < BLOCKS:
            continue
        change = float(new.mean() - old.mean())
        error = float(np.sqrt(_error(old) ** 2 + _error(new) ** 2 + latest**2))
        found.append(PaceShift(agent, float(np.expm1(change)), change / max(error, 1e-9)))
    return tuple(found)


def _paces(model: TaskModelCard, runs: Sequence[Run], agent: str) -> Vector:
    """Return the mean log of duration / usual duration per execution, shape (executions,)."""
    usual = {task.task: task.usual_s for task in model.tasks if task.agent == agent}
    found = []
    for run in runs:
        logs = [
            np.log(done.took_s / usual[done.task])
            for done in run.tasks.get(agent, ())
            if done.task in usual and done.counts and done.took_s > 0.0
        ]
        if logs:
            found.append(float(np.mean(logs)))
    return np.array(found)


def _error(paces: Vector) -> float:
    """Return the standard error of the mean from means of blocks, because neighbouring executions are correlated."""
    means = np.array([block.mean() for block in np.array_split(paces, BLOCKS)])
    return float(means.std(ddof=1) / np.sqrt(BLOCKS))
