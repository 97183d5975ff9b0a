"""Which columns of a table the map of a cell file means: by name, number or pattern, or one number of a list.

A key says `tcp_x`; `#3`, the third column, where names repeat or say nothing; `pose[0]`, the first number of the lists
in column `pose`. A key of several columns may say `joint_*` or `#2..#7` or `pose[*]` as well. What stands in the header
literally always goes before what it could stand for. What the keys mean is the business of `csv_map`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from fnmatch import translate
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError, DamagedLog
from cyclekit_adapters.mapped.csv_map import WHERE, CsvMap

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

ONE = (
    "x",
    "y",
    "z",
    "person",
    "confidence",
    "slider",
    "speed",
    "state",
    "digital_in",
    "digital_out",
    "register",
    "signal",
    "value",
    "quality",
)
"""Keys of one column."""
MANY = ("time", "scaling", "joints", "tags")
"""Keys of one column or several."""
_NUMBER = re.compile(r"#([1-9]\d{0,5})")
_RANGE = re.compile(r"#([1-9]\d{0,5})\.\.#?([1-9]\d{0,5})")
_ELEMENT = re.compile(r"(.+)\[(\d{1,4}|\*)\]", re.DOTALL)


@dataclass(frozen=True)
class Columns:
    """The columns of one table, and those that a map means.

    Attributes:
        mapping: The map, each column in it by the name that it has here.
        names: The names of the table's columns; one that was meant by its number, since its name repeats, is `#3`.
        lists: Of each column of lists the columns made of it, by the place of their number.
    """

    mapping: CsvMap
    names: tuple[str, ...]
    lists: Mapping[str, Mapping[int, str]] = field(default_factory=dict)


def unresolved(entries: Iterable[str], names: Sequence[str]) -> set[str]:
    """Return which entries of a map mean no column among `names`."""
    return {entry for entry in entries if not _meant(entry, names)}


def columns_of(path: Path, mapping: CsvMap, names: Sequence[str], widths: Mapping[str, int]) -> Columns:
    """Return the columns that a map means; an entry that means none stays as it is, to be refused with the others.

    Args:
        path: The table, for the message.
        mapping: The map as it was written.
        names: The names of its columns, all different.
        widths: Of the columns of lists, how many numbers those of the first rows have.

    Raises:
        ConfigError: A key of one column means several, or a list has no such number.
        DamagedLog: A name that several columns have.
    """
    finder = _Finder(path, list(names), widths)
    found: dict[str, object] = {}
    for key in ONE:
        if (entry := getattr(mapping, key)) is not None:
            found[key] = finder.one(key, entry)
    for key in MANY:
        found[key] = tuple(dict.fromkeys(name for entry in getattr(mapping, key) for name in finder.many(entry)))
    return Columns(replace(mapping, **found), tuple(finder.names), finder.lists)  # type: ignore[arg-type]  # by key


def _meant(entry: str, names: Sequence[str]) -> list[int]:
    """Return the places, from 0, of the columns that an entry means; of a list, that of its column."""
    if entry in names:
        return [names.index(entry)]
    if found := _NUMBER.fullmatch(entry):
        return [place] if (place := int(found[1]) - 1) < len(names) else []
    if found := _RANGE.fullmatch(entry):
        first, last = int(found[1]) - 1, int(found[2]) - 1
        return list(range(first, last + 1)) if last < len(names) else []
    if found := _ELEMENT.fullmatch(entry):
        return _meant(found[1], names)
    if "*" in entry or "?" in entry:
        pattern = re.compile(translate(entry.replace("[", "[[]")))
        return [place for place, name in enumerate(names) if pattern.match(name)]
    return []


class _Finder:
    """Finds the columns of one table; remembers what was renamed and which lists are taken apart."""

    def __init__(self, path: Path, names: list[str], widths: Mapping[str, int]) -> None:
        self.path, self.names, self.widths = path, names, widths
        self.lists: dict[str, dict[int, str]] = {}
        self._header = tuple(names)

    def one(self, key: str, entry: str) -> str:
        names = self.many(entry)
        if len(names) > 1:
            shown = ", ".join(names[:6])
            raise ConfigError(f"{WHERE}: {key} = {entry!r} means several columns ({shown})", cure="Name one of them.")
        return names[0]

    def many(self, entry: str) -> list[str]:
        element = None if entry in self._header else _ELEMENT.fullmatch(entry)
        if element is None:
            return [self._named(entry, place) for place in _meant(entry, self._header)] or [entry]
        if len(places := _meant(element[1], self._header)) != 1:
            return [entry]
        column = self._named(element[1], places[0])
        width = self.widths.get(self._header[places[0]])
        if element[2] == "*":
            return [self._element(column, place) for place in range(width or 0)] or [entry]
        if width is not None and int(element[2]) >= width:
            seen = f"{WHERE}: {entry!r}, but the lists in column {column!r} have {width} numbers"
            raise ConfigError(seen, cure=f"They are counted from 0: {column}[0] to {column}[{width - 1}].")
        return [self._element(column, int(element[2]))]

    def _element(self, column: str, place: int) -> str:
        return self.lists.setdefault(column, {}).setdefault(place, f"{column}[{place}]")

    def _named(self, entry: str, place: int) -> str:
        """Return the name of a column; the first one of several is known by its number only."""
        name = self._header[place]
        if f"{name}#2" not in self._header:
            return name
        if name == entry:
            numbers = [f'"#{at}"' for at, other in enumerate(self._header, 1) if re.sub(r"#\d+$", "", other) == name]
            count = "two" if len(numbers) == 2 else len(numbers)
            cause = f"{count} columns are called {name!r}: the name is ambiguous"
            raise DamagedLog(self.path, cause, cure=f"Name it by its number: {' or '.join(numbers[:6])}.")
        self.names[place] = f"#{place + 1}"
        return self.names[place]
