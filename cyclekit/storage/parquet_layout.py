"""Layout of a Parquet table, cached for all readers; the numbers of a small table are read along with it."""

from __future__ import annotations

from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING, NamedTuple

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

if TYPE_CHECKING:
    from collections.abc import Container
    from pathlib import Path

SMALL_BYTES, SMALL_VALUES = 1 << 19, 1 << 20
"""Maximum size and number of values of a small table: a minute of robot rows has some 400,000 bytes and 150,000 values.
A file of few bytes may contain many values."""


class TableLayout(NamedTuple):
    """Layout of a table.

    Attributes:
        names: Names of its columns.
        starts: First row of each row group, and the end of the last one.
        unknown: Number of unknown rows of each column.
        whole: All columns of numbers of a small table, as reading a part takes as long; else None.
    """

    names: tuple[str, ...]
    starts: list[int]
    unknown: dict[str, int]
    whole: pl.DataFrame | None


@lru_cache(maxsize=8)  # a table is usually opened several times, for other columns
def layout_of(file: str, _written_ns: int, size: int) -> TableLayout:
    """Return the layout of a table.

    Args:
        file: The Parquet file.
        _written_ns: Time of its last change, as part of the cache key.
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
    return TableLayout(names, starts, unknown, whole)


def _unknown(about: pq.FileMetaData, column: int) -> int:
    total = 0
    for group in range(about.num_row_groups):
        said = about.row_group(group).column(column).statistics
        total += said.null_count if said is not None and said.has_null_count else about.row_group(group).num_rows
    return total


def spans(
    file: Path,
    columns: Container[str] | None = None,
    *,
    column: str | None = None,
    least: float = -inf,
    most: float = inf,
) -> list[tuple[int, int]]:
    """Return the byte ranges (begin, end) of columns in the row groups that may contain values of a range.

    A row group without statistics may contain them.

    Args:
        file: The Parquet file.
        columns: Columns whose bytes are returned; None = all.
        column: Column of the values; None = all row groups.
        least: Minimum of the range.
        most: Maximum of the range.
    """
    with pq.ParquetFile(file) as parquet:
        about, place = parquet.metadata, -1 if column is None else parquet.schema_arrow.get_field_index(column)
    found = []
    for number in range(about.num_row_groups):
        group = about.row_group(number)
        known = group.column(place).statistics if place >= 0 else None
        if known is None or not known.has_min_max or (known.min <= most and known.max >= least):
            parts = (group.column(index) for index in range(group.num_columns))
            for part in parts:
                if columns is None or part.path_in_schema in columns:
                    begin = part.dictionary_page_offset or part.data_page_offset
                    found.append((begin, begin + part.total_compressed_size))
    return found


def unpacked_bytes(file: Path, columns: Container[str]) -> int:
    """Return the size of some columns of a Parquet table after decompression, before decoding, in bytes."""
    with pq.ParquetFile(file) as parquet:
        about = parquet.metadata
    groups = (about.row_group(number) for number in range(about.num_row_groups))
    parts = (group.column(index) for group in groups for index in range(group.num_columns))
    return sum(part.total_uncompressed_size for part in parts if part.path_in_schema in columns)
