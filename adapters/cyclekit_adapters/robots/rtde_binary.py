"""Rows of a binary UR RTDE recording (`record.py --binary`), the same as those of its text form.

Two lines of text, the column names and one type word per column, both separated by spaces; then rows without any
mark between them, each the packed big-endian values of one controller sample. So a lost byte shifts everything
behind it: a row whose time no controller can have is set aside, and so is a last row that was cut. What the columns
mean is the business of `ur_rtde`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.text.delimited import INDEX, TextRows, header_names

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_TYPES = {"DOUBLE": ">f8", "INT32": ">i4", "UINT32": ">u4", "UINT64": ">u8", "UINT8": "u1", "BOOL": "u1"}
_LINE_BYTES = 1 << 20  # far more than all fields of RTDE together
_LONGEST_UPTIME_S = 1e9  # thirty years: a larger time is no time but the bytes of something else
_ROWS = 1 << 16  # rows taken at once
_SET_ASIDE = {"source_row": pl.Int64(), "reason": pl.String()}


@dataclass(frozen=True)
class BinaryLayout:
    """Where the rows begin and how each is packed.

    Attributes:
        names: Column names.
        row: Packed big-endian record; its fields are called `f0`, `f1`, ... in the order of `names`.
        offset: Bytes before the first row.
    """

    names: tuple[str, ...]
    row: np.dtype[np.void]
    offset: int


def is_binary(head: str) -> bool:
    """Tell from the beginning of a log whether its second line is a line of RTDE types."""
    lines = head.split("\n", 2)
    return len(lines) > 1 and lines[1].split(" ", 1)[0].strip() in _TYPES


def binary_layout(path: Path) -> BinaryLayout:
    """Read the two lines above the rows.

    Raises:
        DamagedLog: A type is none of RTDE's, or there are more types than names or fewer.
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
    """Yield the columns `numbers` (Float64) of every whole row, block by block; NaN and infinity become null: unknown.

    Args:
        path: The log.
        layout: What `binary_layout` says of it.
        numbers: Columns to read.
        time: The column among them that holds the seconds since the controller was started.

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
        rows = TextRows(frame.with_columns(finite), len(part), pl.DataFrame(schema=_SET_ASIDE))
        wrong = ~rows.frame[time].is_between(0.0, _LONGEST_UPTIME_S).fill_null(value=False)
        yield rows.without(wrong, f"{time} is not a plausible controller time")
    if rest:
        cut = f"the last row has {rest} of {layout.row.itemsize} bytes: it was cut while being written"
        none = pl.DataFrame(
            schema={"source_row": pl.Int64(), INDEX: pl.Int64(), **dict.fromkeys(numbers, pl.Float64())}
        )
        yield TextRows(none, 1, pl.DataFrame([(whole, cut)], schema=_SET_ASIDE, orient="row"))


def _mapped(path: Path, layout: BinaryLayout, first: int, count: int) -> NDArray[np.void]:
    """Return some rows as a map of the file: of a wide row only the columns asked for come into memory.

    A map of its own for each block gives back the memory of the one before.
    """
    try:
        return np.memmap(path, layout.row, "r", layout.offset + first * layout.row.itemsize, (count,))
    except (OSError, ValueError) as error:  # the latter where somebody has cut the file meanwhile
        raise LogError(path, f"cannot be read: {error}", cure="Check the path and its permissions.") from error
