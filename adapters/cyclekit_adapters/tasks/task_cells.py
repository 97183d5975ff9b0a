"""Conversion of the cells of a task list to table TASK_LIST, with unusable rows set aside.

A row without start, agent or task, or with an end before its start, is set aside with its reason. A row without an end
is kept with unknown duration. `task_columns` finds the columns. Faults of the list as a whole (overlapping tasks of one
agent) are reported after reading.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import is_person
from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit.schema import MOST_FAILED, TASK_LIST, conform
from cyclekit_adapters.tasks.task_columns import FLOW, NEEDED, TIMES
from cyclekit_adapters.tasks.task_times import cleaned, with_seconds
from cyclekit_adapters.text.text_rows import UNDECODED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.adapter import ClockKind, TimeUnit
    from cyclekit_adapters.tasks.task_columns import Settings

DONE = {"1", "1.0", "true", "yes", "done", "ok", "success", "successful", "succeeded", "complete", "completed",
        "finished"}  # fmt: skip
FAILED = {"0", "0.0", "-1", "-1.0", "false", "no", "failed", "fail", "failure", "error", "aborted", "abort",
          "canceled", "cancelled", "timeout", "ate_abort", "pi_abort"}  # fmt: skip


@dataclass(frozen=True)
class TaskTable:
    """A task list as read.

    Attributes:
        rows: Table TASK_LIST, ordered by start.
        set_aside: Columns `source_row`, `reason`.
        clock: Kind of clock.
        time_units: Units that the times may have, while they are not proven.
        warnings: One sentence each.
        facts: Interpretation of its columns.
    """

    rows: pl.DataFrame
    set_aside: pl.DataFrame
    clock: ClockKind
    time_units: tuple[TimeUnit, ...] = ()
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)


def task_table(
    path: Path, cells: pl.DataFrame, columns: Mapping[str, str], settings: Settings, *, decimal_comma: bool = False
) -> TaskTable:
    """Return the table of a task list.

    Args:
        path: The log, for messages.
        cells: A text column for each field of `columns`, and `source_row`.
        columns: Field -> column name in the log.
        settings: Settings of the cell file.
        decimal_comma: Numbers may be written `0,5`.

    Raises:
        LogError: The time format cannot be determined, or the cell file names an agent that is not in the log.
        DamagedLog: No row is usable.
    """
    cells = cells.with_columns(cleaned(key) for key in columns)
    if "agent" not in columns:
        cells = cells.with_columns(pl.lit(FLOW).alias("agent"))
    timed, clocks = with_seconds(path, cells, columns, settings, decimal_comma=decimal_comma)
    good, aside = _trusted(timed)
    if good.is_empty():
        first = aside.row(0) if aside.height else ("", "it holds no row")
        cause = f"none of its {cells.height} tasks can be used; the first (row {first[0]}): {first[1]}"
        raise DamagedLog(path, cause, cure="Check which columns are start and end, and their unit.")
    kinds = _kinds(path, good["agent"].unique(maintain_order=True).to_list(), settings)
    rows = conform(
        good.select(
            "end_s",
            "task",
            "source_row",
            *(name for name in ("execution", "planned_start_s", "planned_end_s") if name in good.columns),
            pl.col("start_s").alias("t_s"),
            pl.col("agent").replace_strict(kinds, return_dtype=pl.String).alias("agent"),
            pl.col("agent").alias("agent_name"),
            _outcome() if "outcome" in good.columns else pl.lit(None, pl.String).alias("outcome"),
        ),
        TASK_LIST,
    ).sort("t_s", maintain_order=True)
    people = [name for name, kind in kinds.items() if kind == "operator"]
    warnings = [
        *_warnings(rows, people),
        *([] if "agent" in columns else [_of_flow(columns)]),
        *_plan_warnings(good),
        *clocks.warnings,
    ]
    return TaskTable(rows, aside, clocks.clock, clocks.time_units, tuple(warnings), clocks.facts)


def _trusted(cells: pl.DataFrame) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Return the usable rows, and the others with their reasons."""
    who = [name for name in ("agent", "task", "start", "end", "execution") if name in cells.columns]
    odd = [pl.when(pl.col(key).is_null()).then(pl.lit(f"no {key}")) for key in NEEDED if key != "end"]
    odd += [
        pl.when(pl.col(key).str.contains(UNDECODED, literal=True)).then(pl.lit(f"its {key} has unreadable characters"))
        for key in ("agent", "task", "execution")
        if key in cells.columns
    ]
    written = {"start": "start", "end": "duration" if "duration" in cells.columns else "end"}
    odd += [
        pl.when(pl.col(key).is_not_null() & pl.col(f"{key}_s").is_null()).then(
            pl.lit(f"its {written[key]} is not a time in the format of the others")
        )
        for key in ("start", "end")
    ]
    late = pl.col("end_s") < pl.col("start_s")
    odd += [pl.when(late).then(pl.lit("it ends before it starts"))]
    odd += [pl.when(~pl.struct(who).is_first_distinct()).then(pl.lit("it repeats another task"))]
    judged = cells.with_columns(pl.coalesce(odd).alias("reason"))
    bad = judged["reason"].is_not_null()
    return cells.filter(~bad), judged.filter(bad).select("source_row", "reason")


def _kinds(path: Path, agents: Sequence[str], settings: Settings) -> dict[str, str]:
    """Return for each agent whether it is a robot or an operator.

    Raises:
        LogError: The cell file names an agent that is not in the log.
    """
    for name in (*settings.robot, *settings.operator):
        if name not in agents:
            cause = f"no agent {name!r}, which [sources.map] names"
            raise LogError(path, cause, nearest=nearest(name, agents), cure=f"It has: {', '.join(agents[:40])}.")
    given = dict.fromkeys(settings.robot, "robot") | dict.fromkeys(settings.operator, "operator")
    return {name: given.get(name, "operator" if is_person(name) else "robot") for name in agents}


def _outcome() -> pl.Expr:
    word = pl.col("outcome").str.to_lowercase()
    known = pl.when(word.is_in(DONE)).then(pl.lit("done")).when(word.is_in(FAILED)).then(pl.lit("failed"))
    return known.otherwise(pl.col("outcome")).alias("outcome")


def _of_flow(columns: Mapping[str, str]) -> str:
    return (
        f"no column says who does a task: {columns['task']!r} is where the part of each {columns['execution']!r} is, "
        "one flow. If these are machines that each do tasks, say so in the cell file: "
        f'map = {{ agent = "{columns["task"]}", task = "COLUMN" }}'
    )


def _warnings(rows: pl.DataFrame, people: Sequence[str]) -> list[str]:
    messages = []
    if not people and rows["agent_name"].n_unique() > 1:
        names = ", ".join(map(repr, rows["agent_name"].unique(maintain_order=True).to_list()[:6]))
        messages.append(
            f"no agent is recognised as a person ({names}): all are taken for robots. "
            'Say in the cell file who is one: map = { operator = ["NAME"] }'
        )
    unnamed = rows["execution"].null_count()
    if unnamed == rows.height:
        messages.append(
            "no column gives the execution of a task: a file is taken for one. If it has several, say in the cell file "
            'which column does, map = { execution = "COLUMN" }, or that a new one begins after a rest: [executions] '
            'begin = "gap"'
        )
    elif unnamed:
        messages.append(f"{unnamed} of {rows.height} tasks name no execution: they are in no execution")
    if (failed := int((rows["outcome"] == "failed").sum())) > MOST_FAILED * rows.height:
        messages.append(f"{failed} of {rows.height} tasks failed: too many for failures, so the outcome is not used")
    words = rows["outcome"].drop_nulls().unique(maintain_order=True)
    if unknown := [word for word in words if word not in ("done", "failed")]:
        messages.append(
            f"unknown outcomes, neither done nor failed, are kept as written: {', '.join(map(repr, unknown[:6]))}"
        )
    return messages


def _plan_warnings(cells: pl.DataFrame) -> list[str]:
    """Return a warning for each planned time that cannot be read, with the number of tasks; the tasks are kept."""
    found = []
    for key in (key for key in TIMES if key.startswith("planned") and key in cells.columns):
        odd = cells.filter(pl.col(key).is_not_null() & pl.col(f"{key}_s").is_null()).height
        found += (
            [f"{odd} tasks: the {key.replace('_', ' ')} is not a time in the format of the others; unknown there"]
            if odd
            else []
        )
    return found
