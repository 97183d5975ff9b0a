"""Where the tables of short recordings lie that share files: which rows of which file are whose.

A file takes more time than the rows of a short log, and there may be ten thousand of them. A recording that is not in
the index has files of its own, `recordings/<id>/<table>.parquet`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Annotated

import msgspec

if TYPE_CHECKING:
    from pathlib import Path

FOLDER = "shared"
INDEX = f"{FOLDER}/index.json"
RECORDING = "recording"
"""The column of a shared file that says whose a row is, before those of the table."""


class SharedRows(msgspec.Struct, frozen=True, array_like=True):
    """Rows of a file.

    Attributes:
        file: Its name in the dataset.
        first: The first of the rows.
        count: How many there are.
    """

    file: Annotated[str, msgspec.Meta(pattern=rf"^{FOLDER}/[a-z_0-9-]+\.parquet$", max_length=80)]
    first: Annotated[int, msgspec.Meta(ge=0)]
    count: Annotated[int, msgspec.Meta(ge=0)]

    @property
    def end(self) -> int:
        """The row behind the last one."""
        return self.first + self.count


Index = dict[str, dict[str, SharedRows]]
"""Rows by recording and table."""


def shared_rows(dataset: Path, recording: str, table: str) -> SharedRows | None:
    """Return where a table of a recording lies, None where it does not share a file.

    An index that cannot be read counts as none, so that what it speaks of is missing.

    Args:
        dataset: Its folder.
        recording: Id of the recording.
        table: Name of the table.
    """
    file = dataset / FOLDER / "index.json"
    try:
        about = file.stat()
        return _read(file, about.st_ino, about.st_size, about.st_mtime_ns).get(recording, {}).get(table)
    except (OSError, msgspec.MsgspecError, ValueError, RecursionError):
        return None


@lru_cache(maxsize=2)
def _read(file: Path, _number: int, _size: int, _written_ns: int) -> Index:
    return msgspec.json.decode(file.read_bytes(), type=Index)
