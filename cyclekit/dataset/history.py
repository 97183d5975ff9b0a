"""The history of a dataset: what each agent did in each execution, whatever it was logged by, in one table.

Tasks of robot and operator, tasks of a task list and states of signals are the same kind of row: an agent was at an
activity from a time to a time. What the log cut has no end, or no begin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.dataset.signals import switches

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Vector

SIGNAL = "signal"
"""Agent of the rows of signals, whose `activity` is the signal."""


def history_of(dataset: Dataset, executions: Sequence[str] | None = None) -> pl.DataFrame:
    """Return what each agent did, in table HISTORY, ordered by execution, then by begin.

    Args:
        dataset: The dataset.
        executions: Names of executions; None = all.
    """
    cards = dataset.executions
    if executions is not None:
        cards = cards.filter(pl.col("execution").is_in([dataset.find_execution(name) for name in executions]))
    rows = pl.concat([_of_tasks(dataset, cards), _of_signals(dataset, cards)])
    ordered = rows.sort("from_s", "begin_s", "agent", nulls_last=False, maintain_order=True)
    return ordered.select(pl.col(name).cast(column.dtype) for name, column in schema.HISTORY.items())


def kinds_of(dataset: Dataset) -> dict[str, str]:
    """Return `robot` or `operator` of each agent in table HISTORY, and `signal` of signals."""
    named = dataset.every_task().select(pl.coalesce("agent_name", "agent").alias("name"), "agent").unique()
    return {**dict(named.sort("name").iter_rows()), SIGNAL: SIGNAL}


def _of_tasks(dataset: Dataset, cards: pl.DataFrame) -> pl.DataFrame:
    """Return the tasks of table TASKS as rows of HISTORY with the start of their execution, `from_s`."""
    starts = cards.select("execution", from_s="start_s")
    ended = pl.col("end_s").is_not_null()
    lasts_s = pl.col("end_s") - pl.col("wait_s").fill_null(0.0)
    return dataset.every_task().join(starts, on="execution").select(
        "execution",
        "from_s",
        agent=pl.coalesce("agent_name", "agent"),
        activity="task",
        place="goal_place",
        begin_s=pl.col("start_s") - pl.col("from_s"),
        there_s=pl.col("arrival_s") - pl.col("from_s"),
        ready_s=pl.when(ended).then(lasts_s) - pl.col("from_s"),
        end_s=pl.col("end_s") - pl.col("from_s"),
        waited_for="waited_for",
        cut=pl.col("cut").fill_null(value=False) | ~ended,
    )  # fmt: skip


def _of_signals(dataset: Dataset, cards: pl.DataFrame) -> pl.DataFrame:
    """Return when each two-valued signal was on in each execution, as rows of HISTORY with `from_s`."""
    every: dict[str, dict[str, tuple[Vector, Bools]]] = {}
    for record in dataset.recordings:
        found = {name: (bit.t_s, bit.value == "1") for name, bit in dataset.bits(record).items()}
        found |= switches(record, dataset.recorded)
        clock = record.clock
        of_session = every.setdefault(record.session, {})
        of_session |= {name: (at * clock.rate + clock.offset_s, on) for name, (at, on) in found.items()}
    columns = {"execution": schema.TEXT, "from_s": schema.F64}
    types = columns | {name: column.dtype for name, column in schema.HISTORY.items() if name not in columns}
    rows: list[tuple[object, ...]] = []
    for execution, session, from_s, end_s in cards.select("execution", "session", "start_s", "end_s").iter_rows():
        for name, (at, on) in every.get(session, {}).items():
            rows += [
                (execution, from_s, SIGNAL, name, None, first, None, None, last, None, first is None or last is None)
                for first, last in _on_between(at - from_s, on, end_s - from_s)
            ]
    return pl.DataFrame(rows, types, orient="row")


def _on_between(at: Vector, on: Bools, end_s: float) -> list[tuple[float | None, float | None]]:
    """Return when a signal came on and went off from 0 to `end_s`, s; None: before it, or after it."""
    before = np.concatenate([[False], on[:-1]])
    rises, falls = at[on & ~before], at[~on & before]
    falls = np.append(falls, np.inf)[: len(rises)]
    seen = (falls > 0.0) & (rises <= end_s)
    within = zip(rises[seen].tolist(), falls[seen].tolist(), strict=True)
    return [(first if first >= 0.0 else None, last if last <= end_s else None) for first, last in within]
