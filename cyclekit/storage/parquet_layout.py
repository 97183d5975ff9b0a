"""What a Parquet table is made of, looked up once for all that read it; a small table is read along with it."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

SMALL_BYTES, SMALL_VALUES = 1 << 19, 1 << 20
"""Of a small table: a minute of robot rows has some 400,000 and 150,000. A file of few bytes may hold many values."""


class Layout(NamedTuple):
    """What a table is made of.

    Attributes:
        names: Of its columns.
        starts: Where its row groups begin, and where the last one ends.
        unknown: The unknown rows of each column.
        whole: All columns of numbers of a small table: to read a part of it takes as long.
    """

    names: tuple[str, ...]
    starts: list[int]
    unknown: dict[str, int]
    whole: pl.DataFrame | None


@lru_cache(maxsize=8)  # whoever opens a table opens it several times, for other columns
def layout_of(file: str, _written_ns: int, size: int) -> Layout:
    """Return what a table is made of.

    Args:
        file: The Parquet file.
        _written_ns: When it was last written: a file that was written again is another one.
        size: Its size in bytes.
    """
    with pq.ParquetFile(file) as parquet:
        about, names = parquet.metadata, tuple(parquet.schema_arrow.names)
        numbers = [field.name for field in parquet.schema_arrow if pa.types.is_primitive(field.type)]
        small = size <= SMALL_BYTES and about.num_rows * len(numbers) <= SMALL_VALUES
        whole = pl.DataFrame(parquet.read(columns=numbers, use_threads=False)) if small else None
    starts = [0]
    for group in range(about.num_row_groups):
        starts.append(starts[-1] + about.row_group(group).num_rows)
    unknown = {name: _unknown(about, column) for column, name in enumerate(names)}
    return Layout(names, starts, unknown, whole)


def _unknown(about: pq.FileMetaData, column: int) -> int:
    total = 0
    for group in range(about.num_row_groups):
        said = about.row_group(group).column(column).statistics
        total += said.null_count if said is not None and said.has_null_count else about.row_group(group).num_rows
    return total
