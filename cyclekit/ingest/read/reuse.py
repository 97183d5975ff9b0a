"""Recordings taken over without reading their logs: links to files that were written before."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING, Any

import polars as pl

from cyclekit import schema
from cyclekit.alignment.recording_clocks import CLOCK
from cyclekit.dataset.sessions import LISTED
from cyclekit.errors import OutsideFolder
from cyclekit.ingest.read.read_log import QUARANTINE
from cyclekit.people.activity import OPERATOR
from cyclekit.storage.inside import inside
from cyclekit.storage.parquet import TableWriter, parts_of

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence
    from pathlib import Path

    from cyclekit.ingest.discover import Log

_ALL = f"{QUARANTINE}.parquet"


def is_whole(entry: dict[str, Any], old: Path, damaged: Container[str] = ()) -> bool:
    """Tell whether everything that an entry of the dataset `old` speaks of is still there, and as it was written.

    Args:
        entry: Of a recording.
        old: The dataset.
        damaged: Its files that are not what they were.
    """
    names = [f"recordings/{entry['id']}/{name}.parquet" for name in entry["tables"]]
    names += [_ALL] if entry["rows_set_aside"] else []
    try:
        return all(inside(old, *name.split("/")).is_file() and name not in damaged for name in names)
    except OutsideFolder:  # what the card names was never ours
        return False


def _tables(entry: dict[str, Any], old: Path) -> list[Path]:
    return [inside(old, "recordings", entry["id"], f"{name}.parquet") for name in entry["tables"]]


def take_over(entry: dict[str, Any], log: Log, old: Path, staging: Path) -> dict[str, Any]:
    """Link the tables of a recording of the dataset `old` into `staging`; return its entry as it was after reading."""
    target = staging / "recordings" / log.id
    link_files(_tables(entry, old), target)
    if entry["rows_set_aside"]:
        with TableWriter(target / _ALL, schema.QUARANTINE) as table:
            for part in parts_of(old / _ALL):
                table.write(named_anew(part.filter(pl.col("recording") == entry["id"]), log))
    return as_read(entry, log)


def named_anew(quarantine: pl.DataFrame, log: Log) -> pl.DataFrame:
    """Return rows set aside under the name that their log has now."""
    rows = quarantine.with_columns(recording=pl.lit(log.id), file=pl.lit(log.shown))
    return schema.conform(rows, schema.QUARANTINE)


def as_read(entry: dict[str, Any], log: Log) -> dict[str, Any]:
    """Return the entry without what was found out later: session, clock and operator."""
    clock = {"kind": entry["clock"]["kind"]}
    warnings = [text for text in entry["warnings"] if not text.startswith((CLOCK, OPERATOR, LISTED))]
    return {**entry, "id": log.id, "session": "", "clock": clock, "warnings": warnings}


def link_files(files: Iterable[Path], target: Path) -> None:
    """Give files a second name in a new folder, or copies where there are no links."""
    target.mkdir(parents=True)
    for file in files:
        try:
            os.link(file, target / file.name)
        except OSError:  # another file system, or one without hard links
            shutil.copy2(file, target / file.name)


def gather_quarantine(entries: Sequence[dict[str, Any]], staging: Path) -> None:
    """Put what each recording set aside into one table of the dataset."""
    files = [staging / "recordings" / entry["id"] / _ALL for entry in entries if entry["rows_set_aside"]]
    with TableWriter(staging / _ALL, schema.QUARANTINE) as table:
        for file in files:
            for part in parts_of(file):  # a logger that repeats its rows may have set millions aside
                table.write(part)
    for file in files:
        file.unlink()
