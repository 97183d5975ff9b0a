"""The tables of short recordings put into files that many of them share, as they come.

Which recordings share a file is told by their logs' order alone, so that the same logs make the same files, whoever
read them first.
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

FEW_LOGS = 50
"""In datasets of up to so many logs, each recording has files of its own."""
AT_ONCE = 64
"""Logs whose recordings may share a file."""


class Together:
    """Puts the tables of short recordings into the files of a dataset in the making."""

    def __init__(self, logs: Sequence[Log], staging: Path) -> None:
        """Begin.

        Args:
            logs: Of all recordings; each is to be `put` once.
            staging: Folder of the dataset in the making.
        """
        self.shares = len(logs) > FEW_LOGS
        self._staging = staging
        self._number = {log.id: number for number, log in enumerate(logs)}
        self._missing = Counter(number // AT_ONCE for number in self._number.values())
        self._waiting: dict[int, dict[str, Tables]] = {}
        self._index: Index = {}

    def put(self, recording: str, tables: Tables) -> None:
        """Take the tables of a short recording; none of one that has files of its own, or could not be read.

        Raises:
            OSError: They cannot be written.
        """
        if not self.shares:
            for name, frame in tables.items():
                _write(self._staging / "recordings" / recording / f"{name}.parquet", name, frame)
            return
        batch = self._number[recording] // AT_ONCE
        waiting = self._waiting.setdefault(batch, {})
        if tables:
            waiting[recording] = tables
        self._missing[batch] -= 1
        if not self._missing[batch]:
            del self._waiting[batch]
            self._write_out(batch, {name: waiting[name] for name in sorted(waiting, key=self._number.__getitem__)})

    def close(self) -> None:
        """Write down whose rows lie where.

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
    """Return the tables of a recording of a dataset that lie in files it shares; none where it has its own."""
    where = {name: shared_rows(dataset, entry.id, name) for name in entry.tables}
    return {name: shared_frame(dataset, rows) for name, rows in where.items() if rows is not None}


def _write(file: Path, name: str, frame: pl.DataFrame, before: Mapping[str, Column] | None = None) -> None:
    columns = {**(before or {}), **schema.OF_LOGS[name]}
    with TableWriter(file, columns, more=[joint for joint in frame.columns if joint not in columns]) as table:
        table.write(frame)
