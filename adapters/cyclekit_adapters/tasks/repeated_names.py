"""One name for several executions: a recipe runs again, so its plan begins again, or others ran in between."""

from __future__ import annotations

import polars as pl

TOUCH_S = 1e-3
"""Tolerance of planned starts, s."""
WHOLE = 0.75
"""Minimum share of executions of one name with the same tasks."""
RESTS = 0.5
"""Minimum rest between executions of one name, in shortest rests between executions of different names."""


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
    return _numbered(cells, several, turns["turn"], "whose plan begins again")


def named_apart_by_others(cells: pl.DataFrame) -> tuple[pl.DataFrame, list[str]]:
    """Return the cells with executions of the same name numbered, without the help of a plan, and a warning.

    A name stands for several executions if tasks of another name start while none of its own is done, or if it then
    rests as long as the list does between executions, and if each execution then has the same tasks. A fault may cut
    one of four short.

    Args:
        cells: Columns `execution`, `agent`, `task`, `start_s` and `end_s`, s in one clock.
    """
    rows = cells.with_row_index("_row").sort("start_s", maintain_order=True, nulls_last=True).with_row_index("_at")
    until, name = pl.max_horizontal("start_s", "end_s"), pl.col("execution")
    rows = rows.with_columns(
        quiet_s=pl.col("start_s") - until.cum_max().forward_fill().shift(1).over(name),
        rest_s=pl.when(name != name.shift(1)).then(pl.col("start_s") - until.cum_max().forward_fill().shift(1)),
        others=pl.col("_at").cast(pl.Int64).diff().over("execution") > 1,
    )
    free = pl.col("quiet_s") >= 0.0
    rests = pl.col("quiet_s") >= RESTS * pl.col("rest_s").filter(pl.col("rest_s") > 0.0).min()
    for back in (free & (pl.col("others") | rests), free & pl.col("others")):
        turn = back.fill_null(value=False).cast(pl.Int64).cum_sum().over("execution")
        turns = rows.with_columns(turn=turn).sort("_row")
        work = turns.group_by("execution", "turn").agg(pl.concat_str("agent", "task", separator="\0").sort())
        alike = work.group_by("execution", "agent").agg(alike=pl.len())
        several = alike.group_by("execution").agg(alike=pl.col("alike").max(), count=pl.col("alike").sum())
        whole = (pl.col("alike") >= WHOLE * pl.col("count")) & (pl.col("count") > 1)
        several = several.filter(whole, pl.col("execution").is_not_null())
        if several.height:
            return _numbered(cells, several, turns["turn"], "between which others ran")
    return cells, []


def _numbered(cells: pl.DataFrame, several: pl.DataFrame, turn: pl.Series, how: str) -> tuple[pl.DataFrame, list[str]]:
    later = pl.col("execution").is_in(several["execution"].to_list()) & (turn > 0)
    numbered = pl.format("{} #{}", "execution", turn + 1)
    first = several.sort("execution").row(0, named=True)
    warning = (
        f"names that stand for several executions, {how}: {several.height}, such as "
        f"{first['execution']!r} ({first['count']} executions): they are numbered"
    )
    return cells.with_columns(pl.when(later).then(numbered).otherwise("execution").alias("execution")), [warning]
