"""The logged executions of task lists: tasks of each agent with start and end."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.learning.censored import as_whole
from cyclekit.schema import MOST_FAILED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset

FAILED = " (failed)"
"""Added to the name of a failed attempt, which is a task of its own."""
AT_ONCE = 0.5
"""Minimum overlap of two tasks of one agent, as a share of the shorter one, that are done at once."""
MIN_IN_A_ROW = 5
"""Minimum number of different orders of an agent in which two of its tasks follow each other."""


@dataclass(frozen=True)
class DoneTask:
    """A task that was done. Times since the start of the execution, s.

    Attributes:
        planned_s: Planned start; NaN if no plan was logged.
        counts: Whether its duration is one of this task: it did not fail, and did not wait for the end of another.
        mate: Agent and task of the other side of a joint task.
        joined_s: When the agent of a joint task was free; NaN if it need not start together with one.
        cut: Whether the log ends within it: it lasted at least to `end_s`.
    """

    task: str
    start_s: float
    end_s: float
    planned_s: float = float("nan")
    counts: bool = True
    mate: tuple[str, str] | None = None
    joined_s: float = float("nan")
    cut: bool = False

    @property
    def took_s(self) -> float:
        """Its duration, s."""
        return self.end_s - self.start_s


@dataclass(frozen=True)
class Run:
    """One execution.

    Attributes:
        name: Name of the execution.
        tasks: Tasks by agent name, ordered by start.
        number: Number among all logged executions, ordered by time.
        failed: Whether one of its tasks failed.
        session: Name of its session.
        begin_s: Its start, session seconds.
    """

    name: str
    tasks: Mapping[str, tuple[DoneTask, ...]]
    number: int = 0
    failed: bool = False
    session: str = ""
    begin_s: float = 0.0

    @property
    def cut(self) -> bool:
        """Whether the log ends within one of its tasks; what would have come later is then unknown."""
        return any(done.cut for some in self.tasks.values() for done in some)

    @property
    def order(self) -> tuple[tuple[str, ...], ...]:
        """The order of tasks of each agent, agents sorted by name."""
        return tuple((agent, *(done.task for done in self.tasks[agent])) for agent in sorted(self.tasks))

    @property
    def duration_s(self) -> float:
        """Time from the first start to the last end, s."""
        ends = [done.end_s for some in self.tasks.values() for done in some]
        return max(ends) - min(done.start_s for some in self.tasks.values() for done in some)


def logged_runs(dataset: Dataset) -> tuple[list[Run], dict[str, str]]:
    """Return the executions in which all tasks end, ordered by time, and `robot` or `operator` by agent name."""
    runs, agents = every_run(dataset)
    return [run for run in runs if not run.cut], agents


def every_run(dataset: Dataset) -> tuple[list[Run], dict[str, str]]:
    """Return all executions, ordered by time, those that a log cuts included, and `robot` or `operator` by agent name.

    Names of an agent's tasks that differ only in case, spaces or underscores are those of one task. A failed attempt
    is a task of its own, as it tells no time of the task.
    """
    rows = dataset.every_task().with_columns(agent_name=pl.coalesce("agent_name", "agent")).sort("start_s")
    named = rows.select("agent_name", "agent").unique().sort("agent_name")
    agents = {str(name): str(agent) for name, agent in named.iter_rows()}
    spelling = _spelling(rows)
    fails = rows["outcome"] == "failed"
    told = bool(fails.sum() <= MOST_FAILED * rows.height)
    rows = rows.with_columns(failed=fails.fill_null(value=False) if told else pl.lit(value=False))
    found: list[Run] = []
    for (name,), mine in rows.group_by(["execution"], maintain_order=True):
        begin = float(mine["start_s"].min())  # type: ignore[arg-type]  # a number
        last_s = max(float(mine[at].max() or begin) for at in ("start_s", "end_s")) - begin  # type: ignore[arg-type]
        times = mine.select(
            "agent_name", "task", "failed", *(pl.col(at) - begin for at in ("start_s", "end_s", "planned_start_s"))
        )
        tasks: dict[str, list[DoneTask]] = {}
        for agent, task, failed, start_s, end_s, planned_s in times.iter_rows():
            planned = np.nan if planned_s is None else planned_s
            task = spelling[agent, _plain(task)] + (FAILED if failed else "")
            one = DoneTask(task, start_s, last_s if end_s is None else end_s, planned, cut=end_s is None)
            tasks.setdefault(agent, []).append(one)
        done = {agent: tuple(some) for agent, some in tasks.items()}
        if any(one.cut for some in done.values() for one in some[:-1]):  # its agent went on: its end was not logged
            continue
        found.append(Run(str(name), done, failed=bool(mine["failed"].any()), begin_s=begin))
    at = {one.execution: number for number, one in enumerate(dataset.card.executions)}
    session = {one.execution: one.session for one in dataset.card.executions}
    found.sort(key=lambda run: at[run.name])
    whole = np.cumsum([not run.cut for run in found]) - 1
    numbers = np.maximum(whole, 0).tolist()
    return [replace(run, number=n, session=session[run.name]) for n, run in zip(numbers, found, strict=True)], agents


def as_if_whole(cut: Sequence[Run], runs: Sequence[Run]) -> list[Run]:
    """Return executions with each task that the log cuts as long as a whole one that lasted longer.

    Those of one task get evenly spread quantiles of them.

    Args:
        cut: Executions within whose tasks the log ends.
        runs: Whole executions; tasks that none of these has make no execution.
    """
    known = _tasks(runs)
    cut = [run for run in cut if _tasks([run]) <= known]
    lasted: dict[tuple[str, str], list[DoneTask]] = {}
    for run in (*runs, *cut):
        for agent, some in run.tasks.items():
            for done in some:
                lasted.setdefault((agent, done.task), []).append(done)
    length_s: dict[int, float] = {}
    for every in lasted.values():
        took_s, unended = np.array([done.took_s for done in every]), [done for done in every if done.cut]
        whole_s = as_whole(took_s, np.array([done.cut for done in every]))
        for number, done in enumerate(unended):
            longer_s = whole_s[whole_s > done.took_s]
            at = int((number + 0.5) / len(unended) * len(longer_s))
            length_s[id(done)] = float(longer_s[at]) if len(longer_s) else done.took_s

    def finished(done: DoneTask) -> DoneTask:
        return replace(done, end_s=done.start_s + length_s[id(done)]) if done.cut else done

    return [replace(run, tasks={agent: tuple(map(finished, some)) for agent, some in run.tasks.items()}) for run in cut]


def _spelling(rows: pl.DataFrame) -> dict[tuple[str, str], str]:
    """Return the most frequent spelling of each task's name, by agent and `_plain` name."""
    found: dict[tuple[str, str], str] = {}
    often = rows.group_by("agent_name", "task").len().sort("len", "task", descending=[True, False])
    for agent, task, _ in often.iter_rows():
        found.setdefault((agent, _plain(task)), task)
    return found


def _plain(task: str) -> str:
    return " ".join(task.casefold().replace("_", " ").split())


def without_failures(runs: Sequence[Run], least: int) -> list[Run]:
    """Return the executions without a failed task; all, if these are too few, or lack a task.

    The repetition of a failed attempt comes later than the plan says, and what waits for it too.

    Args:
        runs: Executions.
        least: Minimum number to keep.
    """
    return _if_enough([run for run in runs if not run.failed], runs, least)


def one_at_a_time(runs: Sequence[Run], least: int) -> list[Run]:
    """Return the executions in which no agent does two tasks at once; all, if these are too few, or lack a task.

    Two executions under one name look so. If most executions are so, the agents can do it, such as with two arms.

    Args:
        runs: Executions.
        least: Minimum number to keep.
    """
    return _if_enough([run for run in runs if not _at_once(run)], runs, least)


def _at_once(run: Run) -> bool:
    return any(
        one.end_s - other.start_s > AT_ONCE * min(one.took_s, other.took_s) > 0.0
        for some in run.tasks.values()
        for one, other in pairwise(some)
    )


def _if_enough(some: list[Run], runs: Sequence[Run], least: int) -> list[Run]:
    enough = len(some) >= max(least, len(runs) / 2) and _tasks(some) == _tasks(runs)
    return some if enough else list(runs)


def _tasks(runs: Sequence[Run]) -> set[tuple[str, str]]:
    every = {(agent, done.task) for run in runs for agent, some in run.tasks.items() for done in some}
    return {(agent, task) for agent, task in every if not task.endswith(FAILED)}


def always_in_a_row(runs: Sequence[Run]) -> dict[tuple[str, str], str]:
    """Return by agent and task the other task of the same agent that always came directly before it, if there is one.

    That other task was never followed by anything else: they are parts of one job, such as picking and placing. "" as
    the other task = it always came first; as the task = what the agent always did last.
    """
    found = {}
    for agent in sorted({name for run in runs for name in run.tasks}):
        orders = {tuple(done.task for done in run.tasks.get(agent, ())) for run in runs}
        pairs = Counter(pair for order in orders for pair in set(pairwise(("", *order, ""))))
        before, after = (Counter(pair[side] for pair in pairs) for side in (1, 0))
        for (one, other), count in pairs.items():
            if before[other] == after[one] == 1 and count >= MIN_IN_A_ROW:
                found[agent, other] = one
    return found
