"""Rows of one recording in a file shared by many short ones, read like a table with its own file.

A few such files stay decoded in memory: reading the recordings in order reads each file once.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import groupby
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.dataset.shared_index import RECORDING
from cyclekit.storage.files import regular
from cyclekit.storage.parquet import StoredTable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from cyclekit.dataset.shared_index import SharedRows
    from cyclekit.storage.parquet import Columns


def shared_frame(dataset: Path, rows: SharedRows) -> pl.DataFrame:
    """Return the rows of one recording, with the columns of its table.

    Args:
        dataset: Folder of the dataset.
        rows: Location of the rows.
    """
    return _whole(*_version(dataset / rows.file))[rows.first : rows.end]


def _version(file: Path) -> tuple[Path, int, int]:
    about = regular(file).stat()
    return file, about.st_mtime_ns, about.st_size


@lru_cache(maxsize=4)
def _whole(file: Path, _written_ns: int, _size: int) -> pl.DataFrame:
    return pl.read_parquet(file, glob=False).drop(RECORDING).rechunk()


@lru_cache(maxsize=32)
def _numbers(file: Path, written_ns: int, size: int, column: str) -> NDArray[np.float64]:
    """Return a column of all recordings as float64, shape (N,), NaN = unknown."""
    return _whole(file, written_ns, size).get_column(column).cast(pl.Float64).to_numpy()


class SharedTable(StoredTable):
    """The rows of one recording as a `StoredTable`."""

    def __init__(self, dataset: Path, rows: SharedRows, columns: Sequence[str]) -> None:
        """Locate the rows.

        Args:
            dataset: Folder of the dataset.
            rows: Location of the rows.
            columns: Columns that will be read, all numeric.
        """
        self._version, self._where = _version(dataset / rows.file), rows
        self._columns, self.columns = list(columns), tuple(columns)
        self.names, self.rows = tuple(_whole(*self._version).columns), rows.count
        self.groups = [(0, rows.count)] if rows.count else []
        self._unknown = {name: self._column(name).null_count() for name in columns}

    def _column(self, name: str) -> pl.Series:
        return _whole(*self._version).get_column(name).slice(self._where.first, self._where.count)

    def _rows(self, names: Sequence[str], first: int, end: int) -> Columns:
        begin, after = self._where.first + first, min(self._where.first + end, self._where.end)
        return {name: _numbers(*self._version, name)[begin:after] for name in names}

    def whole_numbers(self, number: int, column: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return a column of whole numbers at full 64-bit precision, and which are known, shape (N,)."""
        values = self._column(column)
        return values.fill_null(0).cast(pl.Int64).to_numpy(), values.is_not_null().to_numpy()

    def _stretches(self, column: str) -> Iterator[tuple[int, int, str | None]]:
        first = 0
        for text, rows in groupby(self._column(column).to_list()):
            count = sum(1 for _ in rows)
            yield first, first + count - 1, text
            first += count
