"""Draws logged executions as a time chart: a block per execution, a lane per agent, then one per signal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.plots import colours
from cyclekit.plots.gantt import Bar, BarLabel, Block, draw_gantt
from cyclekit.text.numbers import span
from cyclekit.text.plain_text import shown_task

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from typing import Any

    import polars as pl

MOST_EXECUTIONS = 6
"""Maximum number of executions in one picture."""
_LEGEND = {
    "robot in motion": colours.NOMINAL,
    "operator on his way": "#a3d1c9",
    "at work": colours.DWELL,
    "operator at a place": colours.OPERATOR,
    "waits": colours.WAIT,
    "signal is on": "#f2b53c",
}


def draw_history(path: Path, history: pl.DataFrame, kinds: Mapping[str, str]) -> None:
    """Draw the first MOST_EXECUTIONS executions.

    Args:
        path: File to write, `.svg`, `.png` or `.pdf`.
        history: Table HISTORY.
        kinds: `robot` or `operator` of each agent, `signal` of signals.
    """
    some = history.partition_by("execution", maintain_order=True)[:MOST_EXECUTIONS]
    blocks = [_block(rows, kinds) for rows in some]
    drawn = {bar.colour for block in blocks for bar in block.bars}
    draw_gantt(path, blocks, {text: colour for text, colour in _LEGEND.items() if colour in drawn})


def _block(rows: pl.DataFrame, kinds: Mapping[str, str]) -> Block:
    agents = [name for kind in ("robot", "operator") for name in rows["agent"].unique().sort() if kinds[name] == kind]
    signals = sorted({name for agent, name in rows.select("agent", "activity").rows() if kinds[agent] == "signal"})
    lane = {name: number for number, name in enumerate([*agents, *signals])}
    end_s = max(max(rows[name].drop_nulls().to_list(), default=0.0) for name in ("begin_s", "there_s", "end_s"))
    bars, labels = list[Bar](), list[BarLabel]()
    for row in rows.iter_rows(named=True):
        kind = kinds[row["agent"]]
        at = lane[row["activity"] if kind == "signal" else row["agent"]]
        bars += _bars(row, kind, at, end_s)
        if kind != "signal":
            texts = tuple(dict.fromkeys((shown_task(row["activity"]), row["place"] or row["activity"])))
            labels.append(BarLabel(at, row["begin_s"] or 0.0, row["end_s"] or end_s, texts))
    return Block((rows["execution"][0],), tuple(lane), tuple(bars), tuple(labels))


def _bars(row: Mapping[str, Any], kind: str, lane: int, last_s: float) -> Iterator[Bar]:
    begin_s, end_s = row["begin_s"] or 0.0, last_s if row["end_s"] is None else row["end_s"]
    name = row["activity"] if kind == "signal" else f"{row['agent']}: {shown_task(row['activity'])}"
    there_s = begin_s if row["there_s"] is None else row["there_s"]
    ready_s = end_s if row["ready_s"] is None else max(row["ready_s"], there_s)
    moves, works = {"robot": (0, 2), "operator": (1, 3), "signal": (5, 5)}[kind]
    tints = list(_LEGEND.values())
    cut = ", cut by the log" if row["cut"] else ""
    for first_s, until_s, colour in ((begin_s, there_s, moves), (there_s, ready_s, works), (ready_s, end_s, 4)):
        if until_s > first_s:
            tip = f"{name}: {span(first_s, until_s, 1)} s{cut}"
            yield Bar(lane, first_s, until_s, tints[colour], colour == 4, tip, name)
