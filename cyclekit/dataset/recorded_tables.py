"""Tables at the native rate of each recording: in its own files, or in files shared by short recordings."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.dataset.shared_index import shared_rows

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from cyclekit.dataset.cards import ExecutionCard, RecordingCard
    from cyclekit.dataset.files import DatasetFiles
    from cyclekit.storage.parquet import StoredTable

_NEAR_S = 1e-3
"""Margin at both ends of a time span, s, because its ends in the log's clock are rounded."""


class RecordedTables:
    """The tables of a dataset's recordings, read on demand."""

    def __init__(self, path: Path, files: DatasetFiles, recordings: Sequence[RecordingCard]) -> None:
        """Store the arguments.

        Args:
            path: Folder of the dataset.
            files: Its files.
            recordings: Cards of its recordings.
        """
        self._path, self._files, self._recordings = path, files, recordings
        self._names: dict[str, list[str]] = {}
        self._counted: set[str] = set()

    def table(self, recording: str, table: str) -> pl.DataFrame | None:
        """Return one table (`robot`, `people` or `events`) of a recording; None if there is none."""
        if (shared := self._shared(recording, table)) is not None:
            return self._files.collected(shared, _recorded(recording, table))
        if (name := self._native(recording, table)) is None:
            return None
        file = self._files.verified_file(name)
        with self._files.reading(file):
            rows = pl.scan_parquet(file, glob=False)
            columns = rows.collect_schema().names()
        self._files.check_memory([file], columns)
        return self._files.collected(rows, name)

    def between(self, recording: str, table: str, first_s: float, last_s: float) -> pl.DataFrame | None:
        """Return rows of one table from `first_s` to `last_s`, clock of the log; None if there is none."""
        if (shared := self._shared(recording, table)) is not None:
            within = shared.filter(pl.col("t_s").is_between(first_s, last_s))
            return self._files.collected(within, _recorded(recording, table))
        if (name := self._native(recording, table)) is None:
            return None
        return self._files.collected(self._files.between(name, first_s, last_s), name)

    def times(self, recording: str, table: str) -> Iterator[pl.DataFrame]:
        """Yield the times (`t_s`) of one table in parts, as it may be larger than memory."""
        from cyclekit.storage.parquet import StoredTable  # local: reading logs does not need Arrow

        if (shared := self._shared(recording, table)) is not None:
            yield self._files.collected(shared.select("t_s"), _recorded(recording, table))
            return
        file = self._files.verified_columns(self._native(recording, table) or _recorded(recording, table), ["t_s"])
        with self._files.reading(file):
            stored = StoredTable(file, ("t_s",))
            for begin, end in stored.groups:
                yield pl.DataFrame({"t_s": stored.column("t_s", begin, end)})

    def stored(self, recording: str, columns: Sequence[str]) -> StoredTable:
        """Open the robot table of a recording for reading by ranges of rows; only `columns` may be read."""
        from cyclekit.dataset.shared_tables import SharedTable
        from cyclekit.storage.parquet import StoredTable

        if self._shared(recording, "robot") is not None and (rows := shared_rows(self._path, recording, "robot")):
            with self._files.reading(self._path / rows.file):
                return SharedTable(self._path, rows, columns)
        name = self._native(recording, "robot") or _recorded(recording, "robot")
        file = self._files.verified_columns(name, columns)
        with self._files.reading(file):
            return StoredTable(file, columns)

    def robot_of(
        self, entry: ExecutionCard, columns: Sequence[str] | None = None, if_there: Sequence[str] = ()
    ) -> pl.DataFrame | None:
        """Return the robot's rows of one execution, `t_s` in session time; None without a robot log.

        `columns`: columns to read; None = all. `if_there`: further columns, where the table has them.
        """
        for record in self._recordings:
            if record.session == entry.session and "robot" in record.tables:
                shared, name = self._shared(record.id, "robot"), _recorded(record.id, "robot")
                if shared is None:
                    self._native(record.id, "robot")  # checks its row count; a missing file is reported below
                rate, offset_s = record.clock.rate, record.clock.offset_s
                first, last = ((at_s - offset_s) / rate for at_s in (entry.start_s, entry.end_s))
                inside = pl.col("t_s").is_between(entry.start_s, entry.end_s)
                if columns is not None and if_there:
                    there = self._columns(name) if shared is None else shared.collect_schema().names()
                    columns = [*columns, *(each for each in if_there if each in there)]
                if shared is None:  # decode only rows near the span
                    shared = self._files.between(name, first - _NEAR_S, last + _NEAR_S, columns)
                rows = shared.with_columns(t_s=pl.col("t_s") * rate + offset_s).filter(inside)
                return self._files.collected(rows if columns is None else rows.select(columns), name)
        return None

    def _columns(self, name: str) -> list[str]:
        """Return the columns of a native-rate table; what is read of them is verified later."""
        if name not in self._names:
            file = self._files.path_of(name)
            with self._files.reading(file):
                self._names[name] = pl.scan_parquet(file, glob=False).collect_schema().names()
        return self._names[name]

    def _shared(self, recording: str, table: str) -> pl.LazyFrame | None:
        """Return a native-rate table in a file shared by recordings, as a lazy frame; None if it is not in one."""
        counts = self._row_counts.get(recording, {})
        return self._files.shared(recording, table, counts[table]) if table in counts else None

    @cached_property
    def _row_counts(self) -> dict[str, dict[str, int]]:
        return {entry.id: {str(name): rows for name, rows in entry.rows.items()} for entry in self._recordings}

    def _native(self, recording: str, table: str) -> str | None:
        """Return the name of a native-rate table, its row count checked against the card; None if there is none."""
        name = _recorded(recording, table)
        if not self._files.has(name):
            return None
        count = self._row_counts.get(recording, {}).get(table)
        if count is not None and name not in self._counted:  # once: a table is read again for each execution
            self._files.check_rows(name, count, f"in table {table}")
            self._counted.add(name)
        return name


def _recorded(recording: str, table: str) -> str:
    return f"recordings/{recording}/{table}.parquet"
