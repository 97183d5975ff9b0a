"""Rows of a binary UR RTDE recording (`record.py --binary`), equal to those of its text form.

The file starts with two lines of text: the column names and one type word per column, separated by spaces. Then rows
follow without separators, each the packed big-endian values of one controller sample. A lost byte thus shifts
everything after it. A row with an implausible controller time is set aside, and so is an incomplete last row. `ur_rtde`
interprets the columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.text.delimited import INDEX, TextRows, header_names
from cyclekit_adapters.text.text_rows import SET_ASIDE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_TYPES = {"DOUBLE": ">f8", "INT32": ">i4", "UINT32": ">u4", "UINT64": ">u8", "UINT8": "u1", "BOOL": "u1"}
_LINE_BYTES = 1 << 20  # far more than all RTDE fields together
_LONGEST_UPTIME_S = 1e9  # thirty years: a larger value comes from shifted bytes
_ROWS = 1 << 16  # rows per block


@dataclass(frozen=True)
class BinaryLayout:
    """Layout of the binary rows.

    Attributes:
        names: Column names.
        row: Packed big-endian record with fields `f0`, `f1`, ... in the order of `names`.
        offset: Number of bytes before the first row.
    """

    names: tuple[str, ...]
    row: np.dtype[np.void]
    offset: int


def is_binary(head: str) -> bool:
    """Return whether the second line of a log, given its beginning, is a line of RTDE types."""
    lines = head.split("\n", 2)
    return len(lines) > 1 and lines[1].split(" ", 1)[0].strip() in _TYPES


def binary_layout(path: Path) -> BinaryLayout:
    """Read the two lines above the rows.

    Raises:
        DamagedLog: A type is not an RTDE type, or the numbers of types and names differ.
        LogError: The file cannot be opened.
    """
    try:
        with path.open("rb") as log:
            first, second = log.readline(_LINE_BYTES), log.readline(_LINE_BYTES)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its permissions.") from error
    names = header_names(first.decode("utf-8", "replace"), " ")
    words = second.decode("utf-8", "replace").split()
    cure = "Check the copy: it must have been copied as binary, not as text."
    if not second.endswith(b"\n"):
        raise DamagedLog(path, "a binary recording cut in its line of types", cure=cure)
    if unknown := [word for word in words if word not in _TYPES]:
        raise DamagedLog(path, f"{unknown[0][:40]!r} is not a type of a binary RTDE recording", cure=cure)
    if len(words) != len(names):
        raise DamagedLog(path, f"{len(words)} types for {len(names)} columns", cure=cure)
    row = np.dtype([(f"f{index}", _TYPES[word]) for index, word in enumerate(words)])
    return BinaryLayout(names, row, len(first) + len(second))


def read_binary_rows(path: Path, layout: BinaryLayout, *, numbers: Sequence[str], time: str) -> Iterator[TextRows]:
    """Yield the columns `numbers` (Float64) of every complete row, block by block; NaN and infinity become null.

    Args:
        path: The log.
        layout: Its layout, from `binary_layout`.
        numbers: Columns to read.
        time: The column among them with the seconds since controller start.

    Raises:
        LogError: The file cannot be opened.
    """
    try:
        data = path.stat().st_size - layout.offset
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its permissions.") from error
    whole, rest = divmod(max(data, 0), layout.row.itemsize)
    fields = {name: f"f{layout.names.index(name)}" for name in numbers}
    for first in range(0, whole, _ROWS):
        part = _mapped(path, layout, first, min(_ROWS, whole - first))
        number = np.arange(first, first + len(part), dtype=np.int64)
        columns = {name: part[place].astype(np.float64) for name, place in fields.items()}
        frame = pl.DataFrame({"source_row": number, INDEX: number, **columns})
        finite = [pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in numbers]
        rows = TextRows(frame.with_columns(finite), len(part), pl.DataFrame(schema=SET_ASIDE))
        wrong = ~rows.frame[time].is_between(0.0, _LONGEST_UPTIME_S).fill_null(value=False)
        yield rows.without(wrong, f"{time} is not a plausible controller time")
    if rest:
        cut = f"the last row has {rest} of {layout.row.itemsize} bytes: it was cut while being written"
        none = pl.DataFrame(
            schema={"source_row": pl.Int64(), INDEX: pl.Int64(), **dict.fromkeys(numbers, pl.Float64())}
        )
        yield TextRows(none, 1, pl.DataFrame([(whole, cut)], schema=SET_ASIDE, orient="row"))


def _mapped(path: Path, layout: BinaryLayout, first: int, count: int) -> NDArray[np.void]:
    """Return rows as a memory map, so that only the requested columns of a wide row are loaded.

    A separate map for each block releases the memory of the previous one.
    """
    try:
        return np.memmap(path, layout.row, "r", layout.offset + first * layout.row.itemsize, (count,))
    except (OSError, ValueError) as error:  # ValueError if the file was truncated meanwhile
        raise LogError(path, f"cannot be read: {error}", cure="Check the path and its permissions.") from error
