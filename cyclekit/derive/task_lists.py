"""Tasks from task lists: executions of sessions without a robot log, and the operator's tasks of those with one.

A task list assigns its tasks to executions. If there is a robot log, its executions and its robot tasks are used
instead, as they come from the motion; only the operator's tasks are taken from the list. Such a task belongs to the
execution in which it starts, or to the next one if it starts between two executions and ends after that start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from cyclekit import schema
from cyclekit.dataset.cards import ExecutionCard, Note, note

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.config import Cell
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read

_TIMES = ("t_s", "end_s", "planned_start_s", "planned_end_s")


@dataclass(frozen=True)
class Listed:
    """One execution of a task list.

    Attributes:
        name: Name in the dataset.
        logged_as: Name in the list; None if unnamed.
        tasks: Its tasks, table TASK_LIST in session time, in order of start.
    """

    name: str
    logged_as: str | None
    tasks: pl.DataFrame

    @property
    def start_s(self) -> float:
        """Start of the first task, session time."""
        return float(self.tasks["t_s"].min())  # type: ignore[arg-type]  # a number

    @property
    def end_s(self) -> float:
        """Last known time, session time."""
        return max(float(self.tasks[name].max() or self.start_s) for name in ("t_s", "end_s"))  # type: ignore[arg-type]

    @property
    def complete(self) -> bool:
        """Whether every task has an end."""
        return self.tasks["end_s"].null_count() == 0

    def rows(self) -> list[tuple[object, ...]]:
        """Return its rows of table TASKS."""
        return task_rows(self.name, self.tasks)

    def card(self, session: Session) -> ExecutionCard:
        """Return its card."""
        return ExecutionCard(
            execution=self.name,
            session=session.name,
            start_s=self.start_s,
            end_s=self.end_s,
            complete=self.complete,
            reference=session.reference,
            logged_as=self.logged_as,
        )


def task_rows(name: str, tasks: pl.DataFrame) -> list[tuple[object, ...]]:
    """Return listed tasks of one execution as rows of table TASKS."""
    numbered = tasks.select(
        pl.lit(name).alias("execution"),
        pl.int_range(pl.len()).over("agent_name").alias("index"),
        "task",
        "agent",
        "agent_name",
        "planned_start_s",
        "planned_end_s",
        "outcome",
        pl.col("t_s").alias("start_s"),
        "end_s",
    )
    return schema.conform(numbered, schema.TASKS).rows()


def listed_in(session: Session, read: Read, cell: Cell) -> list[Listed]:
    """Return the executions of the task lists of a session, in order of start.

    A list without execution names is one execution; if executions begin by gaps, a new one starts after each time
    without any task that is longer than the gap.
    """
    tasks = _tasks_of(session, read)
    if tasks is None:
        return []
    if tasks["execution"].null_count() == tasks.height:
        quiet = pl.col("t_s") - pl.max_horizontal("end_s", "t_s").cum_max().shift(1)
        begins = (quiet > cell.executions.gap_s).fill_null(value=False) & (cell.executions.begin == "gap")
        groups = tasks.group_by(begins.cum_sum().alias("number"), maintain_order=True)
        every: list[tuple[str | None, pl.DataFrame]] = [(None, rows) for _, rows in groups]
    else:
        named = tasks.drop_nulls("execution").group_by(["execution"], maintain_order=True)
        every = [(str(name), rows) for (name,), rows in named]
    return [Listed(f"{session.name}.{number:03d}", name, rows) for number, (name, rows) in enumerate(every, 1)]


def operator_rows(
    session: Session, cards: Sequence[ExecutionCard], read: Read
) -> tuple[list[tuple[object, ...]], tuple[Note, ...]]:
    """Return the operator's listed tasks as rows of table TASKS, each in its execution, and notes on omitted tasks.

    Args:
        session: Session with a robot log.
        cards: Its executions.
        read: Returns a native table of a recording (id, table), None if it has none.
    """
    tasks = _tasks_of(session, read)
    if tasks is None:
        return [], ()
    operator = tasks.filter(pl.col("agent") == "operator")
    found: list[tuple[object, ...]] = []
    before_s = float("-inf")
    for card in cards:
        begins = pl.col("t_s").is_between(card.start_s, card.end_s, closed="left")
        reaches = (pl.col("t_s") < card.start_s) & (pl.col("t_s") >= before_s) & (pl.col("end_s") > card.start_s)
        found += task_rows(card.execution, operator.filter(begins | reaches.fill_null(value=False)))
        before_s = card.end_s
    said = []
    if robots := tasks.height - operator.height:
        said.append(note("listed-of-robot", tasks=robots))
    if outside := operator.height - len(found):
        said.append(note("listed-outside", outside=outside, tasks=operator.height))
    return found, tuple(said)


def _tasks_of(session: Session, read: Read) -> pl.DataFrame | None:
    """Return the listed tasks of a session in its time, in order of start; None without a task list."""
    found = []
    for entry in session.recordings:
        table = read(entry.id, "task_list") if "task_list" in entry.tables else None
        if table is not None and table.height:
            clock = entry.clock
            found.append(table.with_columns(pl.col(name) * clock.rate + clock.offset_s for name in _TIMES))
    return pl.concat(found).sort("t_s", maintain_order=True) if found else None
