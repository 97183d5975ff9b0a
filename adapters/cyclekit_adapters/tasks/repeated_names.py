"""One name for several executions: a recipe runs again, so its plan begins again, or others ran in between."""

from __future__ import annotations

import polars as pl

TOUCH_S = 1e-3
"""Tolerance of planned starts, s."""
BEGIN_S = 1.0
"""Tolerance of the first planned start, s: plans of one name may begin with another task."""
WHOLE = 0.75
"""Minimum share of executions of one name with the same tasks."""
RESTS = 0.5
"""Minimum rest between executions of one name, in shortest rests between executions of different names."""


def named_apart(cells: pl.DataFrame) -> tuple[pl.DataFrame, list[str]]:
    """Return the cells with executions of the same name numbered, `a`, `a #2`, ..., and a warning if there are any.

    A name stands for several executions if the planned starts of every agent go back equally often, and each
    execution then has the same tasks, or as many, and ends before the next begins.

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
    one_after_other = _one_after_other(turns)
    whole = pl.col("alike") | pl.col("execution").is_in(one_after_other)
    several = several.filter(whole & (pl.col("count") > 1), pl.col("execution").is_not_null())
    if several.is_empty():
        return _apart_by_plan_and_others(cells)
    found, warnings = _numbered(cells, several, turns["turn"], "whose plan begins again")
    more, others = _apart_by_plan_and_others(found)
    return more, [*warnings, *others]


def _one_after_other(turns: pl.DataFrame) -> list[str]:
    """Return the names whose plan begins again at its start each time, for as many tasks, when all before have ended.

    Which agent does a task may change from one execution to the next. A repeated task may make some of them longer.

    Args:
        turns: Columns of `named_apart`, and `turn`, which grows where the planned starts of an agent go back.
    """
    parts = turns.group_by("execution", "turn").agg(
        pl.len(),
        pl.col("planned_start_s").min(),
        first=pl.col("start_s").min(),
        last=pl.max_horizontal("start_s", "end_s").max(),
    )
    before = pl.col("last").shift(1).over("execution", order_by="turn")
    starts = pl.col("planned_start_s")
    alone = (pl.col("first") >= before - TOUCH_S).fill_null(value=True)
    found = (
        parts.with_columns(alone=alone)
        .group_by("execution")
        .agg(
            alone=pl.col("alone").all() & (starts <= starts.min() + BEGIN_S).all(),
            alike=(pl.col("len") == pl.col("len").mode().first()).mean(),
        )
    )
    return found.filter(pl.col("alone"), pl.col("alike") >= WHOLE)["execution"].drop_nulls().to_list()


def _apart_by_plan_and_others(cells: pl.DataFrame) -> tuple[pl.DataFrame, list[str]]:
    """Return the cells with executions of the same name and different tasks numbered, and a warning.

    Between two of them, executions of other names begin while none of this name runs, and its plan then begins again
    at its first planned start. A name whose plan goes on after such a rest stays one execution.
    """
    rows = _in_turns(cells)
    parts = rows.group_by("execution", "turn").agg(pl.col("planned_start_s").min())
    again = (pl.col("planned_start_s") <= pl.col("planned_start_s").min() + BEGIN_S).fill_null(value=False)
    several = parts.group_by("execution").agg(again=again.all(), count=pl.len())
    several = several.filter(pl.col("again") & (pl.col("count") > 1), pl.col("execution").is_not_null())
    if several.is_empty():
        return cells, []
    turn = rows.sort("_row")["turn"]
    return _numbered(cells, several, turn, "whose plan begins again, with other tasks, after others ran")


def _in_turns(cells: pl.DataFrame) -> pl.DataFrame:
    """Return the cells in order of start with `_row`, their place before, and `turn`, which grows after a rest.

    In such a rest of a name none of its tasks is done, others are, and it is no shorter than the median task. Names
    during whose tasks others run, such as those of lists that each count from zero, stay in turn 0.
    """
    rows = cells.with_row_index("_row").sort("start_s", maintain_order=True, nulls_last=True).with_row_index("_at")
    rows = rows.with_columns(pl.col("_at").cast(pl.Int64))
    until = pl.max_horizontal("start_s", "end_s").cum_max().forward_fill().shift(1).over("execution")
    task_s = (pl.col("end_s") - pl.col("start_s")).median()
    others = pl.col("_at").diff().over("execution") > 1
    apart = (others & (pl.col("start_s") - until >= task_s)).fill_null(value=False)
    rows = rows.with_columns(turn=apart.cast(pl.Int64).cum_sum().over("execution"))
    alone = (pl.col("_at").max() - pl.col("_at").min() + 1).over("execution", "turn") == pl.len().over(
        "execution", "turn"
    )
    return rows.with_columns(turn=pl.when(alone.all().over("execution")).then("turn").otherwise(0))


def paused(cells: pl.DataFrame) -> list[str]:
    """Return a warning on executions that rest while others run, none if there are none.

    Args:
        cells: Columns `execution`, `start_s` and `end_s`, s in one clock.
    """
    rests = _in_turns(cells.drop_nulls("execution")).group_by("execution").agg(pl.col("turn").max())
    names = rests.filter(pl.col("turn") > 0).sort("execution")["execution"].to_list()
    if not names:
        return []
    several = f"executions that rest while others run: {len(names)}, such as {names[0]!r}; the rest counts in their "
    return [several + "cycle time. If such a name stands for several executions, give each its own name"]


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
