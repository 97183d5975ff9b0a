"""Waits of the robot without a known condition, and the error that they cause for orders that were never logged.

Whatever the robot waits for continues while it is away. So its wait depends on its time away from the place, and thus
on the order. An estimate without the condition uses the mean over all orders.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Collection

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Vector

MIN_PART = 0.005
"""Minimum share of unexplained waits in the executions' time that is considered."""
MIN_VISITS = 10


class Unexplained(NamedTuple):
    """Mean unexplained wait per execution, and its standard deviation due to the order, s."""

    wait_s: float
    by_order_s: float


def unexplained_waits(
    dataset: Dataset, executions: Collection[str], mean_s: float, *, learned: bool = True
) -> Unexplained:
    """Return the robot's waits without a known condition, in executions of mean duration `mean_s`; 0.0 if small.

    Without `learned`, what ended the waits in the logs is not known either.
    """
    visits = dataset.tasks().filter(pl.col("execution").is_in(list(executions)), pl.col("arrival_s").is_not_null())
    explained = pl.col("waited_for").is_not_null() & learned
    waits = visits.with_columns(wait_s=pl.when(~explained).then("wait_s").fill_null(0.0))
    total_s = float(waits["wait_s"].sum()) / max(len(executions), 1)
    if total_s < MIN_PART * mean_s:
        return Unexplained(0.0, 0.0)
    there = ["execution", "goal_place"]
    begin = pl.col("start_s").min().over("execution")
    away = pl.col("arrival_s") - pl.col("end_s").shift().over(there, order_by="index").fill_null(begin)
    first = pl.col("index") == pl.col("index").min().over(there)
    waits = waits.with_columns(away_s=away, first=first)
    fitted = [
        place.select("execution", usual_s=pl.Series(_by_time_away(place), dtype=pl.Float64))
        for place in waits.partition_by("goal_place", maintain_order=True)
        if place.height >= MIN_VISITS
    ]
    if not fitted:
        return Unexplained(total_s, 0.0)
    sums = pl.concat(fitted).group_by("execution").agg(pl.col("usual_s").sum())["usual_s"].to_numpy()
    return Unexplained(total_s, float(sums.std(ddof=1)) if len(sums) > 1 else 0.0)


def _by_time_away(visits: pl.DataFrame) -> Vector:
    """Return a linear fit of waits at a place by the time away, shape (N,), s; first visits are fitted apart."""
    first, away = visits["first"].to_numpy() * 1.0, visits["away_s"].to_numpy()
    by = np.column_stack([first, first * away, 1.0 - first, (1.0 - first) * away])
    return np.asarray(by @ np.linalg.lstsq(by, visits["wait_s"].to_numpy(), rcond=None)[0])
