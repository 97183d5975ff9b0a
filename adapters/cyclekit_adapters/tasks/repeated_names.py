"""One name for several executions: the plan of a recipe that runs again begins again."""

from __future__ import annotations

import polars as pl

TOUCH_S = 1e-3
"""Tolerance of planned starts, s."""


def named_apart(cells: pl.DataFrame) -> tuple[pl.DataFrame, list[str]]:
    """Return the cells with executions of the same name numbered, `a`, `a #2`, ..., and a warning if there are any.

    A name stands for several executions if the planned starts of every agent go back equally often, and each
    execution then has the same tasks.

    Args:
        cells: Columns `execution`, `agent`, `task`, `start_s`, `planned_start_s` (s since the start of the plan).
    """
    agent = ("execution", "agent")
    planned = pl.col("planned_start_s")
    back = (planned < planned.shift(1).over(agent) - TOUCH_S).fill_null(value=False)
    turns = cells.with_row_index("_row").sort("start_s", maintain_order=True, nulls_last=True)
    turns = turns.with_columns(turn=back.cast(pl.Int64).cum_sum().over(agent)).sort("_row")
    work = turns.group_by("execution", "turn").agg(pl.concat_str("agent", "task", separator="\0").sort())
    several = work.group_by("execution").agg(alike=pl.col("agent").n_unique() == 1, count=pl.len())
    several = several.filter(pl.col("alike") & (pl.col("count") > 1), pl.col("execution").is_not_null())
    if several.is_empty():
        return cells, []
    later = pl.col("execution").is_in(several["execution"].to_list()) & (turns["turn"] > 0)
    numbered = pl.format("{} #{}", "execution", turns["turn"] + 1)
    first = several.sort("execution").row(0, named=True)
    warning = (
        f"names that stand for several executions, whose plan begins again: {several.height}, such as "
        f"{first['execution']!r} ({first['count']} executions): they are numbered"
    )
    return cells.with_columns(pl.when(later).then(numbered).otherwise("execution").alias("execution")), [warning]
