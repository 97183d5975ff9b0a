"""Reuse of recordings without reading their logs, by links to existing files."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING

import polars as pl

from cyclekit import schema
from cyclekit.dataset.cards import TEXT, LogCard
from cyclekit.dataset.cards.recording import LogClock
from cyclekit.dataset.shared_index import INDEX, shared_rows
from cyclekit.errors import OutsideFolder
from cyclekit.ingest.read.read_log import QUARANTINE
from cyclekit.storage.parquet import TableWriter, parts_of
from cyclekit.storage.safe_path import safe_path

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence
    from pathlib import Path

    from cyclekit.ingest.discover import Log

_ALL = f"{QUARANTINE}.parquet"


def is_whole(entry: LogCard, old: Path, damaged: Container[str] = ()) -> bool:
    """Return whether everything that a card of the dataset `old` refers to still exists unchanged.

    A card with warnings of an earlier version is not reusable, because they do not show which were added after reading.

    Args:
        entry: Card of a recording.
        old: The dataset.
        damaged: Its files that have changed.
    """
    if any(one.code == TEXT for one in entry.warnings):
        return False
    shared = [rows.file for name in entry.tables if (rows := shared_rows(old, entry.id, name)) is not None]
    names = [INDEX, *shared] if shared else [f"recordings/{entry.id}/{name}.parquet" for name in entry.tables]
    names += [_ALL] if entry.rows_set_aside else []
    try:
        return all(safe_path(old, *name.split("/")).is_file() and name not in damaged for name in names)
    except OutsideFolder:  # a path outside of the dataset was not written by cyclekit
        return False


def _tables(entry: LogCard, old: Path) -> list[Path]:
    return [safe_path(old, "recordings", entry.id, f"{name}.parquet") for name in entry.tables]


def take_over(entry: LogCard, log: Log, old: Path, staging: Path) -> LogCard:
    """Link the tables of a recording of the dataset `old` into `staging`; return its card as after reading.

    Tables in files shared with other recordings are not linked (`shared_files`).
    """
    target = staging / "recordings" / log.id
    if not any(shared_rows(old, entry.id, name) for name in entry.tables):
        link_files(_tables(entry, old), target)
    if entry.rows_set_aside:
        with TableWriter(target / _ALL, schema.QUARANTINE) as table:
            for part in parts_of(old / _ALL):
                table.write(named_anew(part.filter(pl.col("recording") == entry.id), log))
    return as_read(entry, log)


def named_anew(quarantine: pl.DataFrame, log: Log) -> pl.DataFrame:
    """Return rows set aside, with the current name of their log."""
    rows = quarantine.with_columns(recording=pl.lit(log.id), file=pl.lit(log.shown))
    return schema.conform(rows, schema.QUARANTINE)


def as_read(entry: LogCard, log: Log) -> LogCard:
    """Return the card without later additions: session, clock and operator."""
    read = {name: getattr(entry, name) for name in LogCard.__struct_fields__}
    return LogCard(**{**read, "id": log.id, "clock": LogClock(kind=entry.clock.kind)})


def link_files(files: Iterable[Path], target: Path) -> None:
    """Hard-link files into a new folder, or copy them if links are not possible."""
    target.mkdir(parents=True)
    for file in files:
        try:
            os.link(file, target / file.name)
        except OSError:  # another file system, or one without hard links
            shutil.copy2(file, target / file.name)


def gather_quarantine(entries: Sequence[LogCard], staging: Path) -> None:
    """Move the rows that each recording set aside into one table of the dataset."""
    files = [staging / "recordings" / entry.id / _ALL for entry in entries if entry.rows_set_aside]
    with TableWriter(staging / _ALL, schema.QUARANTINE) as table:
        for file in files:
            for part in parts_of(file):  # a logger that repeats its rows may have set millions aside
                table.write(part)
    for file in files:
        file.unlink()
