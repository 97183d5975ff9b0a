"""Index of the files shared by short recordings: which rows of which file belong to which recording.

A file costs more time than the rows of a short log, and there may be ten thousand of them. A recording that is not in
the index has its own files, `recordings/<id>/<table>.parquet`.
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
"""Column of a shared file with the id of the recording; it comes before those of the table."""


class SharedRows(msgspec.Struct, frozen=True, array_like=True):
    """A range of rows in a shared file.

    Attributes:
        file: Path of the file in the dataset.
        first: First row.
        count: Number of rows.
    """

    file: Annotated[str, msgspec.Meta(pattern=rf"^{FOLDER}/[a-z_0-9-]+\.parquet$", max_length=80)]
    first: Annotated[int, msgspec.Meta(ge=0)]
    count: Annotated[int, msgspec.Meta(ge=0)]

    @property
    def end(self) -> int:
        """One past the last row."""
        return self.first + self.count


Index = dict[str, dict[str, SharedRows]]
"""Row ranges by recording and table."""


def shared_rows(dataset: Path, recording: str, table: str) -> SharedRows | None:
    """Return the rows of a table of a recording; None if it is not in a shared file.

    An unreadable index counts as missing, so that its tables are missing, too.

    Args:
        dataset: Folder of the dataset.
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
