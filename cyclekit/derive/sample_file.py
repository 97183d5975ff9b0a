"""Files of samples: which sessions share one, and how it is written; a file may be larger than memory.

Sessions share files because a file takes as much time as many samples, and there may be thousands of sessions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, cast

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.storage.atomic import write_parquet
from cyclekit.storage.parquet import GROUP_ROWS, TableWriter

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.dataset.sessions import Session

Item = TypeVar("Item")

AT_ONCE = 1 << 14
"""Maximum number of samples per table: building one takes four times the bytes of its numbers."""
FEW_SESSIONS = 50
"""Maximum number of sessions for one file each."""
MAX_SESSIONS = 200
"""Maximum number of sessions per file: one worker makes them together, and repeats all after a crash."""
SHORT = AT_ONCE // 8
"""Maximum number of samples for a session to share a file."""


def shared_files(sessions: Sequence[Session], rate_hz: float) -> list[list[int]]:
    """Return the indices of the sessions in each file of samples; a file is named after its first session.

    Files sorted by name hold the sessions sorted by name.

    Args:
        sessions: All sessions, with their spans.
        rate_hz: Rate of the samples.
    """
    numbers = sorted(range(len(sessions)), key=lambda number: f"{sessions[number].name}.parquet")
    if len(sessions) <= FEW_SESSIONS:
        return [[number] for number in numbers]
    files: list[list[int]] = []
    free = 0.0
    for number in numbers:
        first_s, last_s = sessions[number].span_s
        count = (last_s - first_s) * rate_hz + 1
        if not files or count > min(free, SHORT) or len(files[-1]) >= MAX_SESSIONS:
            files.append([])
            free = float(AT_ONCE) if count <= SHORT else 0.0
        files[-1].append(number)
        free -= count
    return files


def in_order(found: Iterable[tuple[Sequence[int], Sequence[Item]]]) -> list[Item]:
    """Return the results of the sessions, given per file, in the order of the sessions."""
    by_number = {number: one for numbers, mine in found for number, one in zip(numbers, mine, strict=True)}
    return [by_number[number] for number in range(len(by_number))]


def write_samples(frames: Iterator[pl.DataFrame], file: Path) -> int:
    """Write samples given in parts, in one call if they are few, which is faster; return their number.

    Args:
        frames: At least one part, each with exactly the columns of table SAMPLES.
        file: Path of the file.

    Raises:
        OSError: The file cannot be written.
    """
    first, rows = list[pl.DataFrame](), 0
    for frame in frames:
        first.append(frame)
        rows += frame.height
        if rows > GROUP_ROWS:
            break
    else:
        write_parquet(pl.concat(first, rechunk=True), file)
        return rows
    with TableWriter(file, schema.SAMPLES) as writer:
        while first:
            writer.write(first.pop(0))
        for frame in frames:
            writer.write(frame)
    return writer.rows


@dataclass(frozen=True)
class Coded:
    """Texts of N rows as indices `codes`, shape (N,), into `texts`; -1 = null."""

    codes: NDArray[np.integer[Any]]
    texts: tuple[str, ...]


Column: TypeAlias = "NDArray[Any] | Sequence[object] | Coded"


@dataclass(frozen=True)
class SampleRows:
    """Consecutive samples.

    Attributes:
        count: Number of samples.
        columns: Columns of table SAMPLES: arrays of numbers (NaN = null), lists, or `Coded`; missing ones are null.
    """

    count: int
    columns: Mapping[str, Column]


def in_frames(rows: Iterator[SampleRows], most: int) -> Iterator[pl.DataFrame]:
    """Yield frames with the columns of table SAMPLES, of at most `most` rows unless a single part has more."""
    waiting, count = list[SampleRows](), 0
    for some in rows:
        if waiting and count + some.count > most:
            yield _frame(waiting)
            waiting, count = [], 0
        waiting.append(some)
        count += some.count
    if waiting:
        yield _frame(waiting)


def _frame(rows: Sequence[SampleRows]) -> pl.DataFrame:
    return pl.DataFrame([_series(name, column.dtype, rows) for name, column in schema.SAMPLES.items()])


def _series(name: str, dtype: pl.DataType, rows: Sequence[SampleRows]) -> pl.Series:
    parts = [some.columns.get(name) for some in rows]
    if all(part is None for part in parts):
        return pl.Series(name, [None], dtype=dtype).new_from_index(0, sum(some.count for some in rows))
    if dtype.is_float():
        nothing = (np.full(some.count, np.nan) for some in rows)
        values = [empty if part is None else part for part, empty in zip(parts, nothing, strict=True)]
        return pl.Series(name, np.concatenate(cast("list[NDArray[Any]]", values)), dtype=dtype, nan_to_null=True)
    texts = [value for part, some in zip(parts, rows, strict=True) for value in _values(part, some.count)]
    return pl.Series(name, texts, dtype=dtype)


def _values(part: Column | None, count: int) -> Sequence[object]:
    if part is None:
        return [None] * count
    if isinstance(part, Coded):
        texts = (*part.texts, None)
        return [texts[code] for code in part.codes.tolist()]
    return list(part)
