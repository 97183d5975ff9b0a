"""Rows of table SAMPLES as plain columns, put together to frames: one of many rows takes as long as one of few."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit import schema

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True)
class Coded:
    """Texts of N rows: `codes`, shape (N,), index into `texts`; -1 = null."""

    codes: NDArray[np.integer[Any]]
    texts: tuple[str, ...]


@dataclass(frozen=True)
class SampleRows:
    """Consecutive samples.

    Attributes:
        count: How many.
        columns: Columns of table SAMPLES: arrays of numbers (NaN = null), lists, or `Coded`; absent ones are null.
    """

    count: int
    columns: dict[str, Any]


def in_frames(rows: Iterator[SampleRows], most: int) -> Iterator[pl.DataFrame]:
    """Yield frames with exactly the columns of table SAMPLES, of at most so many rows if no rows come as more."""
    waiting, count = list[SampleRows](), 0
    for some in rows:
        if waiting and count + some.count > most:
            yield _frame(waiting)
            waiting, count = [], 0
        waiting.append(some)
        count += some.count
    if waiting:
        yield _frame(waiting)


def _frame(rows: Sequence[SampleRows]) -> pl.DataFrame:
    return pl.DataFrame([_series(name, column.dtype, rows) for name, column in schema.SAMPLES.items()])


def _series(name: str, dtype: pl.DataType, rows: Sequence[SampleRows]) -> pl.Series:
    parts = [some.columns.get(name) for some in rows]
    if all(part is None for part in parts):
        return pl.Series(name, [None], dtype=dtype).new_from_index(0, sum(some.count for some in rows))
    if dtype.is_float():
        nothing = (np.full(some.count, np.nan) for some in rows)
        values = [empty if part is None else part for part, empty in zip(parts, nothing, strict=True)]
        return pl.Series(name, np.concatenate(values), dtype=dtype, nan_to_null=True)
    texts = [value for part, some in zip(parts, rows, strict=True) for value in _values(part, some.count)]
    return pl.Series(name, texts, dtype=dtype)


def _values(part: Any, count: int) -> Sequence[Any]:  # noqa: ANN401 - of any column
    if part is None:
        return [None] * count
    if isinstance(part, Coded):
        texts = (*part.texts, None)
        return [texts[code] for code in part.codes.tolist()]
    return list(part)
