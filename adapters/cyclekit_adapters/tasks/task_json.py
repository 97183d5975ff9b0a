"""Task lists in JSON: an array of objects, one object per line, or an array inside an object.

MongoDB exports wrap types that JSON lacks: `{"$date": "2023-07-31T19:57:11Z"}`, `{"$numberDouble": "NaN"}`,
`{"$numberLong": "17"}`. These and all other values become text, so that task lists from JSON and from tables share one
parser. `task_cells` interprets the values.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from itertools import islice
from typing import TYPE_CHECKING

import polars as pl

from cyclekit_adapters.tasks.task_columns import is_task_list
from cyclekit_adapters.text.json_parts import BrokenJson, documents, json_pieces, parts

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

Record = dict[str, str]
_NUMBERS = ("$numberDouble", "$numberLong", "$numberInt", "$numberDecimal")
_1970 = datetime(1970, 1, 1, tzinfo=UTC)
_DEEPEST = 3
_DECODER = json.JSONDecoder()


def json_names(head: str) -> tuple[str, ...] | None:
    """Return the keys of the first record; None if these are not the first characters of a task list in JSON."""
    text = head.lstrip("\ufeff \t\r\n")
    for begin in _begins(text):
        try:
            value, _ = _DECODER.raw_decode(text, begin)
        except (ValueError, RecursionError):
            continue
        if isinstance(value, dict) and is_task_list(names := tuple(_flat(value))):
            return names
    return None


def _begins(text: str) -> Iterator[int]:
    """Yield possible offsets of the first record: in an array, at the top level, or in an array inside an object."""
    if text.startswith("["):
        yield text.find("{")
    elif text.startswith("{"):
        yield 0
        yield text.find("{", text.find("["))


class JsonRecords:
    """Records of a file, one at a time; after iteration, the attributes describe its faults.

    Attributes:
        broken: Position and cause of invalid JSON; None if the file is complete.
        others: Number of elements that are not objects.
    """

    def __init__(self, path: Path) -> None:
        """Store the path; the file is read on iteration."""
        self._path = path
        self.broken: BrokenJson | None = None
        self.others = 0

    def __iter__(self) -> Iterator[Record]:
        """Yield each record as key -> text.

        Raises:
            LogError: The file cannot be read.
        """
        pieces = json_pieces(self._path)
        first = next(pieces, "")
        whole = (piece for part in ([first.lstrip("\ufeff")], pieces) for piece in part)
        is_array = first.lstrip("\ufeff \t\r\n").startswith("[")
        try:
            for value in (value for _, value in parts(whole)) if is_array else documents(whole):
                yield from self._records(value)
        except BrokenJson as error:
            self.broken = error

    def _records(self, value: object, depth: int = 0) -> Iterator[Record]:
        if not isinstance(value, dict):
            self.others += 1
            return
        lists = [inner for inner in value.values() if isinstance(inner, list) and inner and isinstance(inner[0], dict)]
        if lists and depth < _DEEPEST and not is_task_list(tuple(_flat(value))):
            for inner in lists:
                for element in inner:
                    yield from self._records(element, depth + 1)
            return
        yield _flat(value)


def table_of(records: Iterator[Record], names: Sequence[str], most: int) -> pl.DataFrame:
    """Return the first `most` records as texts: columns `names` and `source_row`, the record number from 0."""
    schema = {"source_row": pl.Int64(), **dict.fromkeys(names, pl.String())}
    frames = [pl.DataFrame(schema=schema)]
    count = 0
    while block := list(islice(records, min(50_000, most - count))):
        columns = {name: [record.get(name) for record in block] for name in names}
        rows = range(count, count + len(block))
        frames.append(pl.DataFrame({"source_row": rows, **columns}, schema=schema))
        count += len(block)
    return pl.concat(frames)


def _flat(value: Mapping[str, object], before: str = "", depth: int = 0) -> Record:
    """Return the values of an object as texts; nested objects get keys `outer.inner`."""
    found: Record = {}
    for key, inner in value.items():
        name = f"{before}{key}"
        text = _text(inner)
        if text is not None:
            found[name] = text
        elif isinstance(inner, dict) and depth < _DEEPEST:
            found |= _flat(inner, f"{name}.", depth + 1)
    return found


def _text(value: object) -> str | None:
    """Return a value as text; None for null, arrays and objects."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return value
    if isinstance(value, int | float):
        return _number(value)
    if isinstance(value, dict) and len(value) == 1:
        (key, inner), *_ = value.items()
        if key in _NUMBERS or key == "$oid":
            return str(inner) if isinstance(inner, str | int | float) else None
        if key == "$date":
            return _date(inner)
    return None


def _number(value: float) -> str | None:
    try:
        return repr(float(value)) if isinstance(value, float) else str(value)
    except ValueError:  # an integer of thousands of digits
        return None


def _date(value: object) -> str | None:
    """Return a MongoDB date, text or milliseconds since 1970, as ISO 8601."""
    if isinstance(value, str):
        return value
    text = _text(value)
    try:
        return (_1970 + timedelta(milliseconds=float(text))).isoformat(timespec="milliseconds") if text else None
    except (ValueError, OverflowError):
        return None
