"""Rows of a controller log on its own clock: each instant once, and what a person must know of steps back.

A logger that is faster than its controller writes the last sample again, and a controller that was restarted counts
from zero. Both are the same in every robot log, whatever its columns mean.
"""

from __future__ import annotations

import polars as pl

from cyclekit_adapters.delimited import Rows


def once(rows: Rows, time: str) -> tuple[Rows, int]:
    """Keep each instant of column `time` once, and count the rows that repeat the one before them.

    Args:
        rows: Rows in the order of the log; `time` has no nulls.
        time: Name of the time column.

    Returns:
        The rows that go on (or step back: a new run), with the repeats set aside, and the number of repeats.
    """
    again = rows.frame[time].eq(rows.frame[time].shift()).fill_null(value=False)
    reason = pl.lit("repeats the controller sample before it").alias("reason")
    aside = pl.concat([rows.set_aside, rows.frame.filter(again).select("source_row", reason)]).sort("source_row")
    return Rows(rows.frame.filter(~again), rows.rows_read, aside), int(again.sum())


def clock_warnings(times: pl.Series, repeated: int) -> list[str]:
    """Say where the controller's clock steps back, and how many rows were repeats."""
    said = []
    back = int((times.diff() < 0).sum())
    if back:
        said.append(f"the controller's clock steps back {back} time(s): it was restarted, each part is its own run")
    if repeated:
        said.append(f"{repeated} rows repeat the controller sample before them and are left out")
    return said
