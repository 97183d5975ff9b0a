"""Storage of the tables of short recordings in shared files, as they arrive.

The order of the logs alone decides which recordings share a file, so the same logs give the same files, whichever
worker reads them first.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import msgspec
import polars as pl

from cyclekit import schema
from cyclekit.dataset.shared_index import FOLDER, INDEX, RECORDING, Index, SharedRows, shared_rows
from cyclekit.dataset.shared_tables import shared_frame
from cyclekit.storage.parquet import TableWriter

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.dataset.cards import LogCard
    from cyclekit.ingest.discover import Log
    from cyclekit.schema import Column

    Tables = Mapping[str, pl.DataFrame]

MAX_SEPARATE_LOGS = 50
"""Maximum number of logs in a dataset in which each recording has its own files."""
LOGS_PER_BATCH = 64
"""Number of consecutive logs whose recordings may share a file."""


class SharedFileWriter:
    """Writes the tables of short recordings into shared files of a dataset being built."""

    def __init__(self, logs: Sequence[Log], staging: Path) -> None:
        """Set up the batches.

        Args:
            logs: Logs of all recordings; `put` must be called once for each.
            staging: Folder of the dataset being built.
        """
        self.shares = len(logs) > MAX_SEPARATE_LOGS
        self._staging = staging
        self._number = {log.id: number for number, log in enumerate(logs)}
        self._missing = Counter(number // LOGS_PER_BATCH for number in self._number.values())
        self._waiting: dict[int, dict[str, Tables]] = {}
        self._index: Index = {}

    def put(self, recording: str, tables: Tables) -> None:
        """Add the tables of a short recording; `tables` is empty for one with its own files, or one that failed.

        Raises:
            OSError: They cannot be written.
        """
        if not self.shares:
            for name, frame in tables.items():
                _write(self._staging / "recordings" / recording / f"{name}.parquet", name, frame)
            return
        batch = self._number[recording] // LOGS_PER_BATCH
        waiting = self._waiting.setdefault(batch, {})
        if tables:
            waiting[recording] = tables
        self._missing[batch] -= 1
        if not self._missing[batch]:
            del self._waiting[batch]
            self._write_out(batch, {name: waiting[name] for name in sorted(waiting, key=self._number.__getitem__)})

    def close(self) -> None:
        """Write the index of rows and files.

        Raises:
            OSError: It cannot be written.
        """
        if self._index:
            (self._staging / INDEX).write_bytes(msgspec.json.encode(self._index, order="deterministic") + b"\n")

    def _write_out(self, batch: int, waiting: Mapping[str, Tables]) -> None:
        alike: dict[tuple[str, tuple[str, ...]], dict[str, pl.DataFrame]] = {}
        for recording, tables in waiting.items():
            for name, frame in tables.items():
                alike.setdefault((name, tuple(frame.columns)), {})[recording] = frame
        for number, ((name, _), frames) in enumerate(alike.items()):
            file, first = f"{FOLDER}/{name}-{batch:05d}-{number}.parquet", 0
            for recording, frame in frames.items():
                self._index.setdefault(recording, {})[name] = SharedRows(file, first, frame.height)
                first += frame.height
            whose = [pl.Series(RECORDING, [recording]).new_from_index(0, f.height) for recording, f in frames.items()]
            rows = pl.concat(frames.values(), rechunk=True).insert_column(0, pl.concat(whose))
            _write(self._staging / file, name, rows, {RECORDING: schema.QUARANTINE[RECORDING]})


def tables_shared(entry: LogCard, dataset: Path) -> Tables:
    """Return the tables of a recording that are in shared files; empty if it has its own files."""
    where = {name: shared_rows(dataset, entry.id, name) for name in entry.tables}
    return {name: shared_frame(dataset, rows) for name, rows in where.items() if rows is not None}


def _write(file: Path, name: str, frame: pl.DataFrame, before: Mapping[str, Column] | None = None) -> None:
    columns = {**(before or {}), **schema.OF_LOGS[name]}
    with TableWriter(file, columns, more=[joint for joint in frame.columns if joint not in columns]) as table:
        table.write(frame)
