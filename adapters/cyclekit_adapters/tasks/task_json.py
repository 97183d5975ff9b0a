"""Task lists in JSON: an array of objects, one object per line, arrays inside of objects, or an OCEL.

An object around an array of tasks may hold what they share, such as the execution or the agent.

MongoDB exports wrap types that JSON lacks: `{"$date": "2023-07-31T19:57:11Z"}`, `{"$numberDouble": "NaN"}`,
`{"$numberLong": "17"}`. These and all other values become text, so that task lists from JSON and from tables share one
parser. `task_cells` interprets the values.
"""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime, timedelta
from itertools import islice
from typing import TYPE_CHECKING

import polars as pl

from cyclekit_adapters.tasks.lifecycle import Record
from cyclekit_adapters.tasks.ocel import is_ocel, ocel_events
from cyclekit_adapters.tasks.task_columns import is_task_list
from cyclekit_adapters.text.json_parts import BrokenJson, documents, json_pieces, parts

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

_NUMBERS = ("$numberDouble", "$numberLong", "$numberInt", "$numberDecimal")
_1970 = datetime(1970, 1, 1, tzinfo=UTC)
_DEEPEST = 3
_KEY = re.compile(r'"([^"\\]{1,80})"\s*:\s*(?!\s*\[)')
"""A key of a value that is no array."""
_IDENTITY = ("id", "_id", "name")
_DECODER = json.JSONDecoder()


def json_names(head: str) -> tuple[str, ...] | None:
    """Return the keys of the first record; None if these are not the first characters of a task list in JSON."""
    text = head.lstrip("\ufeff \t\r\n")
    around: list[str] = []
    last = 0
    for begin in _begins(text):
        around += _KEY.findall(text, last, begin)
        last = max(begin, 0)
        try:
            value, _ = _DECODER.raw_decode(text, begin)
        except (ValueError, RecursionError):
            continue
        if isinstance(value, dict) and is_task_list(names := tuple(dict.fromkeys([*_flat(value), *around]))):
            return names
    return None


def _begins(text: str) -> Iterator[int]:
    """Yield possible offsets of the first record: at the top level, and in arrays, also inside of objects."""
    at = 0
    if text.startswith("{"):
        yield 0
    elif not text.startswith("["):
        return
    for _ in range(_DEEPEST + 1):
        at = text.find("{", text.find("[", at)) if text.find("[", at) >= 0 else -1
        if at < 0:
            return
        yield at


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
            if is_ocel(first):
                yield from map(_flat, ocel_events(self._path))
                return
            for number, (_, value) in enumerate(parts(whole), 1) if is_array else ():
                yield from self._records(value, _shared({}, "executions", number, value))
            for value in () if is_array else documents(whole):
                yield from self._records(value)
        except BrokenJson as error:
            self.broken = error

    def _records(self, value: object, shared: Record | None = None, depth: int = 0) -> Iterator[Record]:
        if not isinstance(value, dict):
            self.others += 1
            return
        record = {**(shared or {}), **_flat(value)}
        lists = {key: inner for key, inner in value.items() if isinstance(inner, list) and inner}
        lists = {key: inner for key, inner in lists.items() if isinstance(inner[0], dict)}
        if not lists or depth >= _DEEPEST or is_task_list(tuple(record)):
            yield record
            return
        for key, inner in lists.items():
            for number, element in enumerate(inner, 1):
                yield from self._records(element, _shared(record, key, number, element), depth + 1)


def _shared(around: Record, key: str, number: int, element: object) -> Record:
    """Return what an object shares with the records of one of its arrays.

    The identity of an element of `executions` that holds further arrays is its `execution_id`: its own, else its
    number. An `id` or `name` of what is around it is no task's.
    """
    found = {name: text for name, text in around.items() if name not in _IDENTITY}
    one = key.lower().removesuffix("s")
    if isinstance(element, dict) and any(isinstance(inner, list) for inner in element.values()):
        own = next((text for name in _IDENTITY if (text := _text(element.get(name))) is not None), str(number))
        found.setdefault(f"{one}_id", own)
    return found


def table_of(records: Iterator[Record], names: Sequence[str], most: int) -> pl.DataFrame:
    """Return the first `most` records as texts: columns `names` and `source_row`, their own or the number from 0."""
    schema = {"source_row": pl.Int64(), **dict.fromkeys(names, pl.String())}
    frames = [pl.DataFrame(schema=schema)]
    count = 0
    while block := list(islice(records, min(50_000, most - count))):
        columns = {name: [record.get(name) for record in block] for name in names}
        rows = [int(record.get("source_row", at)) for at, record in enumerate(block, count)]
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
