"""Sessions concatenated, far apart in time, and the commanded level of a file of samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.dataset.time_grid import stretches
from cyclekit.scaling.commanded import commanded_levels

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from cyclekit.scaling.response import SafetyResponse
    from cyclekit.schema import Ints, Vector

APART_S = 1e5
"""Time between the end of a part and the start of the next one, s: longer than any delay, and than a signal logged on
after the last execution of a session."""


def shifts_apart(spans_s: Iterable[tuple[float, float]]) -> list[float]:
    """Return what to add to the times of each part so that it starts APART_S after the one before, the first at 0.

    Args:
        spans_s: First and last time of each part, s.
    """
    shifts, free_s = list[float](), 0.0
    for first_s, last_s in spans_s:
        shifts.append(free_s - first_s)
        free_s = last_s + shifts[-1] + APART_S
    return shifts


class Commanded(NamedTuple):
    """Samples of one file, in order.

    Attributes:
        frame: The columns asked for; an unknown number is NaN.
        t_s: Time, shape (N,).
        stretch: Number of the stretch without a gap, shape (N,).
        level: Commanded level, shape (N,), -1 = unknown.
    """

    frame: pl.DataFrame
    t_s: Vector
    stretch: Ints
    level: Ints


def commanded_samples(
    file: Path,
    chosen: Sequence[str],
    columns: Sequence[str],
    numbers: Sequence[str],
    levels: Sequence[float],
    response: SafetyResponse,
) -> Commanded | None:
    """Return the samples of some executions in a file, with the commanded level; None if it holds none of them.

    Args:
        file: File of samples.
        chosen: The executions.
        columns: Columns to read in addition to `execution`, `t_s` and `scaling`.
        numbers: Those of them that are numbers.
        levels: Levels of the scaling, ascending.
        response: Response with the ramps to remove.
    """
    rows = pl.scan_parquet(file, glob=False).select("execution", "t_s", "scaling", *columns)
    frame = rows.filter(pl.col("execution").is_in(list(chosen))).collect(engine="streaming")
    if not frame.height:
        return None
    frame = frame.with_columns(pl.col("scaling", *numbers).fill_null(np.nan))
    t_s, scaling = frame["t_s"].to_numpy(), frame["scaling"].to_numpy()
    period_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.1
    stretch = stretches(frame, 1.0 / period_s)
    ends = np.flatnonzero(np.diff(stretch)) + 1
    pairs = zip(np.split(t_s, ends), np.split(scaling, ends), strict=True)
    level = np.concatenate([commanded_levels(t, s, levels, response).level for t, s in pairs]).astype(np.int64)
    return Commanded(frame, t_s, stretch, level)
