"""Logged executions of robot and operator as plans of both: order, cycle time, and mean times of their tasks."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.config.sequences import PLAN
from cyclekit.estimate.result import OWN_TASK, PlannedShare
from cyclekit.estimate.statistics.same_work import plan_goals
from cyclekit.learning.coupling.waits import condition_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Vector

MIN_WAIT_S = 0.05
"""Minimum mean wait short of a place for a row of its own, s."""
LEVELS = (0.05, 0.95)
"""Quantile levels of the ends of tasks."""


class LoggedBoth(NamedTuple):
    """One execution of both agents.

    Attributes:
        tasks: Tasks of the robot, then visits of the operator, as `robot: a->b` and `operator: c`.
        duration_s: From the start of the execution to the last end of either agent, s.
        begins_at: Whether the first visit of the operator is where he is at the start.
    """

    tasks: tuple[str, ...]
    duration_s: float
    begins_at: bool

    @property
    def orders(self) -> list[tuple[str, ...]]:
        """The order as plans may have it: with and without the place where the operator is at the start.

        If he is on his way already, he comes from the place where he ends.
        """
        robot, operator = ([task for task in self.tasks if task.startswith(agent)] for agent in ("robot", "operator"))
        other = operator[1:] if self.begins_at else [operator[-1], *operator]
        return [(PLAN, *plan_goals([*robot, *his])) for his in (operator, other)]


def logged_of_both(dataset: Dataset) -> dict[str, LoggedBoth]:
    """Return the complete executions with tasks of both agents, by name; empty for task lists."""
    complete = dataset.executions.filter("complete")
    found = {}
    for (name,), rows in _timed(dataset, complete["execution"].to_list()).group_by(["execution"], maintain_order=True):
        robot, operator = (rows.filter(agent=agent) for agent in ("robot", "operator"))
        if robot.height and operator.height:
            order = (
                f"{agent}: {task}" for each in (robot, operator) for agent, task in each.select("agent", "task").rows()
            )
            ends_s = float(robot["end_s"][-1]), float(operator["end_s"][-1])
            found[str(name)] = LoggedBoth(tuple(order), max(ends_s), operator["arrival_s"][0] is None)
    return found


def logged_plan(dataset: Dataset, names: Sequence[str]) -> tuple[PlannedShare, ...]:
    """Return mean start, end and wait of each task of executions in one order of both agents.

    A task in which the robot waits on its way has two rows, as in a rollout. Empty if the orders differ.
    """
    executions = logged_of_both(dataset)
    if len({executions[name].tasks if name in executions else () for name in names}) != 1 or names[0] not in executions:
        return ()
    tasks, shares = _timed(dataset, names), list[PlannedShare]()
    for agent in ("robot", "operator"):
        mine = tasks.filter(agent=agent).sort("index", "execution")
        shares += _shares(agent, [rows for _, rows in mine.group_by(["index"], maintain_order=True)])
    named = _Named(dataset.card.coupling, shares)
    shares = [replace(one, decided=named(one)) for one in shares]
    return tuple(sorted(shares, key=lambda share: share.start_s))


class _Named:
    """Names the causes of starts as a rollout does: by the task of the other agent, such as `operator: bench`."""

    def __init__(self, coupling: CouplingCard | None, shares: Sequence[PlannedShare]) -> None:
        gates = coupling.gates if coupling else ()
        self._conditions = {condition_text(one): one for gate in gates for one in gate.conditions}
        self._shares = shares

    def __call__(self, share: PlannedShare) -> dict[str, float]:
        """Return the share of the executions by named cause."""
        found = Counter[str]()
        for text, part in share.decided.items():
            found[self._name(share, text)] += part  # type: ignore[assignment]  # shares of a whole
        return dict(found)

    def _name(self, share: PlannedShare, text: str) -> str:
        condition = self._conditions.get(text)
        if condition is None:
            return text
        if condition.agent == "signal":
            return f"signal: {condition.place}"
        begun = [
            one
            for one in self._shares
            if one.agent == condition.agent
            and one.task.rpartition("->")[2] == condition.place
            and one.start_s < share.start_s
        ]
        last = max(begun, key=lambda one: one.start_s, default=None)
        return f"{last.agent}: {last.task}" if last else text


def _timed(dataset: Dataset, names: Sequence[str]) -> pl.DataFrame:
    """Return the tasks of both agents in these executions, with times in seconds from the start of the execution.

    The last visit of the operator ends with his usual work there: he stays until the next execution. `on_way_s` is the
    robot's wait short of the place, `went_on_s` its end.
    """
    starts = dataset.executions.select("execution", begin_s="start_s")
    tasks = dataset.every_task().filter(pl.col("agent_name").is_null()).join(starts, on="execution")
    robot, last = pl.col("agent") == "robot", pl.col("index") == pl.col("index").max().over("execution", "agent")
    usual_s = pl.col("dwell_s").filter(~last).median().over("agent", "task").fill_null(0.0)
    stood_s = pl.col("end_s") - pl.col("arrival_s")
    on_way_s = (pl.col("dwell_s") + pl.col("wait_s") - stood_s).clip(0.0).fill_null(0.0)
    done_s = pl.col("arrival_s").fill_null(pl.col("start_s")) + usual_s
    return (
        tasks.with_columns(
            end_s=pl.when(robot | ~last).then("end_s").otherwise(done_s),
            wait_s=pl.when(robot | ~last).then(pl.col("wait_s").fill_null(0.0)).otherwise(0.0),
            on_way_s=pl.when(robot).then(on_way_s).otherwise(0.0),
            went_on_s=pl.coalesce("went_on_s", "arrival_s"),
        )
        .filter(pl.col("execution").is_in(list(names)))
        .with_columns(pl.col("start_s", "arrival_s", "end_s", "went_on_s") - pl.col("begin_s"))
        .sort("execution", "start_s")
    )


def _shares(agent: str, tasks: Sequence[pl.DataFrame]) -> Iterator[PlannedShare]:
    """Yield the tasks of one agent; each of `tasks` holds one task of all executions."""
    before_s, causes = np.zeros(tasks[0].height), {OWN_TASK: 1.0}
    for rows in tasks:
        task, ended_by = str(rows["task"][0]), _causes(rows)
        columns = ("start_s", "end_s", "wait_s", "on_way_s", "went_on_s")
        start_s, end_s, wait_s, on_way_s, went_on_s = (rows[name].to_numpy().astype(np.float64) for name in columns)
        halted = on_way_s.mean() > MIN_WAIT_S
        if halted:
            yield _share(agent, task, start_s, went_on_s - on_way_s, start_s - before_s, causes)
            start_s, before_s, causes, ended_by = went_on_s, went_on_s - on_way_s, ended_by, {OWN_TASK: 1.0}
        works_s = end_s - (wait_s - on_way_s)
        yield replace(_share(agent, task, start_s, works_s, start_s - before_s, causes), rest=halted)
        before_s, causes = works_s, ended_by


def _share(
    agent: str, task: str, start_s: Vector, end_s: Vector, wait_s: Vector, causes: dict[str, float]
) -> PlannedShare:
    band = np.quantile(end_s, LEVELS, method="weibull").tolist() if len(end_s) > 1 else [None, None]
    wait = max(float(wait_s.mean()), 0.0)
    return PlannedShare(agent, agent, task, float(start_s.mean()), float(end_s.mean()), wait, causes, *band)


def _causes(rows: pl.DataFrame) -> dict[str, float]:
    """Return the share of the executions in which each event ended the wait of a task."""
    counts = Counter(str(cause or OWN_TASK) for cause in rows["waited_for"])
    return {cause: count / rows.height for cause, count in counts.items()}
