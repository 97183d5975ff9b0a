"""How many rows the tables of a dataset hold, looked up in the ends of their files before any row is read.

A file of megabytes can hold more rows than memory takes. The card of the dataset says how many there are to be; a table
with more of them is not the one that was written.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import DatasetError
from cyclekit.storage.files import regular

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.dataset.cards import DatasetCard

_CURE = "Ingest the logs again."


def check_tables(path: Path, card: DatasetCard) -> None:
    """Refuse a dataset whose shared tables hold more rows than its card states, or are not files.

    Args:
        path: Folder of the dataset. What is missing in it, or is no table, is left to whoever reads it.
        card: Its card.

    Raises:
        DatasetError: A table holds too many rows, or is a pipe or a device.
    """
    seconds = sum(one.end_s - one.start_s for one in card.executions)
    samples = int(seconds * card.rate_hz) + 2 * len(card.executions)
    aside = sum(part.count for one in card.recordings for part in one.rows_set_aside)
    check_rows(sample_files(path), samples, "samples")
    check_rows([path / "tasks.parquet"], card.rows.tasks, "tasks")
    check_rows([path / "quarantine.parquet"], aside, "rows set aside")


def sample_files(path: Path) -> list[Path]:
    """Return the tables of samples of the dataset at `path`, in order of name; none where there is no such folder.

    Raises:
        DatasetError: The folder cannot be listed.
    """
    folder = path / "samples"
    try:
        return sorted(file for file in folder.iterdir() if file.suffix == ".parquet")
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:  # `glob` would find nothing, and say nothing
        cause = f"{folder}: cannot be listed ({error.strerror})"
        raise DatasetError(cause, cure="Check the permissions of the folder.") from error


def check_rows(files: Sequence[Path], most: int, what: str) -> None:
    """Refuse tables that together hold more than `most` rows, or are no files; what is missing or no table passes.

    Raises:
        DatasetError: They do, or are none.
    """
    files = [file for file in files if os.path.lexists(file)]
    for file in files:
        try:
            regular(file)
        except OSError as error:
            raise DatasetError(f"{file}: {error.strerror}", cure=_CURE) from error
    try:
        rows = pl.scan_parquet(files, glob=False).select(pl.len()).collect().item() if files else 0
    except (pl.exceptions.PolarsError, OSError):
        return
    if rows > most:
        where = files[0] if len(files) == 1 else files[0].parent
        raise DatasetError(f"{where}: holds {rows:,} rows, but dataset.json states {most:,} {what}", cure=_CURE)
