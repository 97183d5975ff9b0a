"""The rows of one recording in a file that many short ones share, read as a table of its own is.

A few such files are kept decoded: who goes through the recordings in order reads each file once.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import groupby
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.files import regular
from cyclekit.shared_index import RECORDING
from cyclekit.tables import StoredTable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from cyclekit.shared_index import SharedRows
    from cyclekit.tables import Columns


def shared_frame(dataset: Path, rows: SharedRows) -> pl.DataFrame:
    """Return the rows of one recording, with the columns of its table.

    Args:
        dataset: Its folder.
        rows: Where they lie.
    """
    file = dataset / rows.file
    about = regular(file).stat()
    return _whole(file, about.st_mtime_ns, about.st_size)[rows.first : rows.end]


@lru_cache(maxsize=4)
def _whole(file: Path, _written_ns: int, _size: int) -> pl.DataFrame:
    return pl.read_parquet(file, glob=False).drop(RECORDING).rechunk()


class SharedTable(StoredTable):
    """As `StoredTable`, of the rows of one recording."""

    def __init__(self, dataset: Path, rows: SharedRows, columns: Sequence[str]) -> None:
        """Look at the rows.

        Args:
            dataset: Folder of the dataset.
            rows: Where they lie in it.
            columns: The columns that will be read, all of numbers.
        """
        self._dataset, self._where = dataset, rows
        self._columns, self.columns = list(columns), tuple(columns)
        frame = self._frame()
        self.names, self.rows = tuple(frame.columns), frame.height
        self.groups = [(0, frame.height)] if frame.height else []
        self._unknown = {name: frame.get_column(name).null_count() for name in columns}

    def _frame(self) -> pl.DataFrame:
        return shared_frame(self._dataset, self._where)

    def _rows(self, names: Sequence[str], first: int, end: int) -> Columns:
        frame = self._frame()
        return {name: _floats(frame.get_column(name))[first:end] for name in names}

    def whole_numbers(self, number: int, column: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return a column of whole numbers, all 64 bits of them, and which are known, shape (N,)."""
        values = self._frame().get_column(column)
        return values.fill_null(0).cast(pl.Int64).to_numpy(), values.is_not_null().to_numpy()

    def _stretches(self, column: str) -> Iterator[tuple[int, int, str | None]]:
        first = 0
        for text, rows in groupby(self._frame().get_column(column).to_list()):
            count = sum(1 for _ in rows)
            yield first, first + count - 1, text
            first += count


def _floats(values: pl.Series) -> NDArray[np.float64]:
    return (values if values.dtype == pl.Float64 else values.cast(pl.Float64)).to_numpy()
