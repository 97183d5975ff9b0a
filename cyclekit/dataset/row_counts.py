"""Row counts of the tables of a dataset, read from the footers of their files before any row is read.

A file of megabytes can hold more rows than fit into memory. The card of the dataset states the number of rows; a table
with more rows is not the one that was written.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import DatasetError
from cyclekit.storage.files import regular
from cyclekit.text.numbers import count

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.dataset.cards import DatasetCard

_CURE = "Ingest the logs again."


def check_tables(path: Path, card: DatasetCard) -> None:
    """Refuse a dataset whose shared tables hold more rows than its card states, or are not regular files.

    Args:
        path: Folder of the dataset. Missing files and files that are no tables are left to the reader.
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
    """Return the sample tables of the dataset at `path`, ordered by name; none if there is no such folder.

    Raises:
        DatasetError: The folder cannot be listed.
    """
    folder = path / "samples"
    try:
        return sorted(file for file in folder.iterdir() if file.suffix == ".parquet")
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:  # `glob` would find nothing, without an error
        cause = f"{folder}: cannot be listed ({error.strerror})"
        raise DatasetError(cause, cure="Check the permissions of the folder.") from error


def check_rows(files: Sequence[Path], most: int, what: str) -> None:
    """Refuse tables that together hold more than `most` rows, or are no regular files; missing or invalid ones pass.

    Raises:
        DatasetError: They do, or a table is no regular file.
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
        raise DatasetError(
            f"{where}: holds {count(rows)} rows, but dataset.json states {count(most)} {what}", cure=_CURE
        )
