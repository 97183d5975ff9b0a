"""The files of a dataset, verified before they are read: a changed file gives one message with its name.

Of a dataset whose card lists its files (`files`: size and BLAKE3) only listed files are read; of an older one, all that
exist. `dataset` defines the meaning of the tables.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.dataset.checksums import damage_of, damaged_files, reading, stamp_of, unreadable
from cyclekit.dataset.row_counts import check_rows, sample_files
from cyclekit.dataset.shared_index import INDEX, RECORDING, shared_rows
from cyclekit.errors import DatasetError, ReplacedDataset
from cyclekit.storage.identify import DATASET_CARD
from cyclekit.storage.memory import memory_limit_bytes
from cyclekit.storage.safe_path import safe_path
from cyclekit.text import numbers
from cyclekit.text.columns import in_one_line
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from collections.abc import Set as AbstractSet
    from pathlib import Path

    from cyclekit.dataset.cards import FileCard
    from cyclekit.dataset.checksums import Stamp
    from cyclekit.schema import Column


_VALUE_BYTES = 8
"""Bytes per decoded number; a flag needs less, a text more."""
_COPIES = 2
"""Number of copies of a table in memory while it is decoded or sorted."""
_SMALL_BYTES = 1 << 18
"""Total file size, bytes, below which the unpacked size is not looked up: that takes longer than reading."""
_TAIL_BYTES = 8
"""Bytes at the end of a Parquet file: the length of its footer, and the magic number."""
PARTLY_BYTES = 16 << 20
"""Table size, bytes, below which the whole file is verified: importing Arrow for partial reads takes longer."""
SMALL_TABLE_BYTES = 1 << 20
"""Table size, bytes, below which the whole file is read for any column (`table_layout`)."""
_CURE = (
    "Ingest fewer logs into one dataset, a month of them say, or work on a machine with more memory; train, estimate "
    "and evaluate hold fewer executions at a time where CYCLEKIT_MEMORY_ROWS is set to less than 10000000 samples."
)


class DatasetFiles:
    """The Parquet files of one dataset."""

    def __init__(self, path: Path, listed: Mapping[str, FileCard] | None, stamp: Stamp | None = None) -> None:
        """Store the folder, the list of files in the card (None = no list), and the stamp of the card."""
        self._path, self._listed, self._stamp = path, listed, stamp

    @property
    def listed(self) -> Mapping[str, FileCard] | None:
        """Size and digests of each file by name; None if the dataset holds none."""
        return self._listed

    def damaged(self) -> dict[str, str]:
        """Return the changed files, with the problem of each, by name; empty without checksums."""
        return damaged_files(self._path, self._listed or {})

    def path_of(self, name: str) -> Path:
        """Return the path of a file, which is not verified.

        Raises:
            OutsideFolder: The name, which comes from the card, leads out of the dataset.
        """
        return safe_path(self._path, *name.split("/"))

    def has(self, name: str) -> bool:
        """Return whether the dataset has a file; a listed file that is missing counts."""
        file = self.path_of(name)
        return file.is_file() if self._listed is None else name in self._listed

    def of_samples(self, parts: AbstractSet[str] | None) -> list[Path]:
        """Return the sample files with these names (without suffix), None = all, ordered by name.

        Raises:
            DatasetError: A file is missing or damaged.
        """
        if self._listed is None:
            names = [f"samples/{file.name}" for file in sample_files(self._path)]
        else:
            names = sorted(name for name in self._listed if name.startswith("samples/"))
        stems = {name: name.removeprefix("samples/").removesuffix(".parquet") for name in names}
        return [self.verified_file(name) for name in names if parts is None or stems[name] in parts]

    def verified_file(self, name: str) -> Path:
        """Return a file that will be read completely.

        Raises:
            DatasetError: It is missing or damaged.
        """
        return self._checked(name, None)

    def scan(
        self,
        files: Sequence[Path],
        columns: Mapping[str, Column],
        wanted: Sequence[str],
        *,
        added: Mapping[str, str | None] | None = None,
    ) -> pl.LazyFrame:
        """Return columns of tables as a lazy frame.

        Args:
            files: Tables with the same columns, verified before.
            columns: Type of each column.
            wanted: Columns to return.
            added: Columns that tables of earlier versions lack, and their value there.

        Raises:
            DatasetError: A file is no table, or a column is missing or has another type.
        """
        rows = pl.scan_parquet(list(files), glob=False)
        with self.reading(files[0]):
            found = rows.collect_schema()
        later = {name: value for name, value in (added or {}).items() if name in wanted and name not in found}
        rows = rows.with_columns(pl.lit(value, columns[name].dtype).alias(name) for name, value in later.items())
        for name in wanted:
            if name not in later and found.get(name) != columns[name].dtype:
                seen = f"column {name!r} is {found[name]}" if name in found else f"no column {name!r}"
                raise unreadable(files[0], self._path, f"{seen}, where {columns[name].dtype} is needed")
        return rows.select(wanted)

    def check_rows(self, name: str, most: int, what: str) -> None:
        """Refuse a table with more rows than the card states.

        Raises:
            DatasetError: It has more, or is no file.
        """
        with self.reading(self.path_of(name)):
            check_rows([self.path_of(name)], most, what)

    def check_memory(self, files: Sequence[Path], wanted: Sequence[str], most: int | None = None) -> None:
        """Refuse to read more than fits into memory; otherwise the process would be killed.

        Args:
            files: Tables, verified before.
            wanted: Columns to read.
            most: Maximum number of rows to keep; None = all.

        Raises:
            DatasetError: They need more memory than is free, or are no tables.
        """
        free = memory_limit_bytes()
        if free is None or not files:
            return
        with self.reading(files[0]):
            rows = int(pl.scan_parquet(list(files), glob=False).select(pl.len()).collect().item())
            needed = rows * len(wanted) * _VALUE_BYTES
            if sum(file.stat().st_size for file in files) > _SMALL_BYTES:
                from cyclekit.storage.parquet_layout import (
                    unpacked_bytes,  # local: reading logs does not need Arrow
                )

                needed = max(needed, sum(unpacked_bytes(file, wanted) for file in files))
        kept = rows if most is None else min(rows, most)
        needed = _COPIES * needed * kept // max(rows, 1)
        if needed > free:
            raise DatasetError(
                f"{files[0] if len(files) == 1 else files[0].parent}: {numbers.count(kept)} rows of "
                f"{len(wanted)} columns need {fixed(needed / 1e9, 1)} GB of memory, and this process may take "
                f"{fixed(free / 1e9, 1)} GB",
                cure=_CURE,
            )

    def between(self, name: str, first_s: float, last_s: float, columns: Sequence[str] | None = None) -> pl.LazyFrame:
        """Return rows of a native-rate table from `first_s` to `last_s`, clock of the log, as a lazy frame.

        Of a large file only the pieces to be read are verified: `t_s` and `columns`, None = all.

        Raises:
            DatasetError: The file is missing or damaged there.
        """
        near = pl.col("t_s").is_between(first_s, last_s)
        if self._size(name) < PARTLY_BYTES:
            return pl.scan_parquet(self.verified_file(name), glob=False).filter(near)
        from cyclekit.storage.parquet_layout import spans  # local: reading logs does not need Arrow

        file, wanted = self._with_footer(name), None if columns is None else {"t_s", *columns}
        with self.reading(file):
            within = spans(file, wanted, column="t_s", least=first_s, most=last_s)
        rows = pl.scan_parquet(self._checked(name, within), glob=False).filter(near)
        return rows if columns is None else rows.select(list(dict.fromkeys(["t_s", *columns])))

    def verified_columns(self, name: str, columns: Sequence[str]) -> Path:
        """Return a file of which only some columns will be read, by Arrow, which reads nothing else of a large file.

        Raises:
            DatasetError: It is missing or damaged there.
        """
        if self._size(name) < SMALL_TABLE_BYTES:
            return self.verified_file(name)
        from cyclekit.storage.parquet_layout import spans

        file = self._with_footer(name)
        with self.reading(file):
            within = spans(file, columns)
        return self._checked(name, within)

    def _size(self, name: str) -> int:
        """Return the size of a file according to the card; 0 if unknown."""
        card = (self._listed or {}).get(name)
        return 0 if card is None else card.size

    def _with_footer(self, name: str) -> Path:
        """Return a Parquet file with its footer verified, which locates the columns."""
        end = self._size(name)
        file = self._checked(name, [(end - _TAIL_BYTES, end)])
        with self.reading(file), file.open("rb") as handle:
            handle.seek(end - _TAIL_BYTES)
            length = int.from_bytes(handle.read(4), "little")
        return self._checked(name, [(max(end - _TAIL_BYTES - length, 0), end)])

    def shared(self, recording: str, table: str, count: int) -> pl.LazyFrame | None:
        """Return a native-rate table in a file shared by recordings, as a lazy frame; None if it is not in one.

        Args:
            recording: Id of the recording.
            table: Name of the table.
            count: Number of rows according to the card.

        Raises:
            DatasetError: The file or the index is missing or damaged, or the number of rows differs from the card.
        """
        if not self.has(INDEX):
            return None
        self.verified_file(INDEX)
        if (rows := shared_rows(self._path, recording, table)) is None:
            return None
        file = self.verified_file(rows.file)
        with self.reading(file):
            if rows.count != count:
                shown = numbers.count(rows.count), numbers.count(count)
                seen = f"the index states {shown[0]} rows of {recording}, dataset.json {shown[1]}"
                raise unreadable(file, self._path, seen)
            return pl.scan_parquet(file, glob=False).slice(rows.first, rows.count).drop(RECORDING)

    def collected(self, rows: pl.LazyFrame, name: str) -> pl.DataFrame:
        """Collect a lazy frame; line breaks in its texts are replaced, as the table may come from anywhere.

        Raises:
            DatasetError: It cannot be read.
        """
        with self.reading(self.path_of(name)):
            return in_one_line(rows.collect())

    @contextmanager
    def reading(self, file: Path) -> Iterator[None]:
        """Convert errors about an unreadable table into one message, also if the dataset was replaced meanwhile.

        Raises:
            ReplacedDataset: The card is no longer the one that was opened; what was read may be of either.
            DatasetError: The table cannot be read.
        """
        try:
            with reading(file, self._path):
                yield
        except DatasetError:
            self._refuse_replaced()
            raise
        self._refuse_replaced()

    def _refuse_replaced(self) -> None:
        if self._stamp is not None and stamp_of(self._path / DATASET_CARD) != self._stamp:
            raise ReplacedDataset(self._path)

    def _checked(self, name: str, spans: Sequence[tuple[int, int]] | None) -> Path:
        file = self.path_of(name)
        if self._listed is None:
            problem = None if file.is_file() else "missing"
        else:
            problem = damage_of(file, self._listed[name], spans) if name in self._listed else "missing"
        if problem is not None:
            self._refuse_replaced()
            raise unreadable(file, self._path, problem)
        return file
