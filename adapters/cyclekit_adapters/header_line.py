"""The column names in the first line of a text log, and how the rows below them are written.

For logs that describe themselves this far and no further: delimiter and encoding follow from the first line. Logs with
lines above their names, or with none, state their layout themselves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.delimited import HEAD_BYTES, Layout, delimiter_of, encoding_of, head_of, header_names

if TYPE_CHECKING:
    from pathlib import Path


def column_names(path: Path, delimiters: str = ",;\t ") -> tuple[str, ...]:
    """Return the names in the first line; none for a folder, a binary file or one that cannot be opened."""
    line = _first_line(head_of(path))
    return header_names(line, delimiter_of(line, delimiters))


def layout_below(path: Path, delimiters: str = ",;\t ") -> Layout:
    """Return how the rows below the first line are written.

    Args:
        path: The log.
        delimiters: Those that may separate; leave out what occurs inside names.

    Raises:
        DamagedLog: The first line is empty or binary.
        LogError: The file cannot be opened.
    """
    try:
        with path.open("rb") as log:
            encoding = encoding_of(log.read(HEAD_BYTES))
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its rights.") from error
    line = _first_line(head_of(path))
    if encoding is None or not line.strip():
        raise DamagedLog(path, "the file is empty or not text", cure="Check the copy.")
    delimiter = delimiter_of(line, delimiters)
    return Layout(header_names(line, delimiter), delimiter, header_lines=1, encoding=encoding)


def _first_line(head: str) -> str:
    return head.removeprefix("\ufeff").partition("\n")[0]
