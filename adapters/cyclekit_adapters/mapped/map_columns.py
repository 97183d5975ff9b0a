"""Table columns that the map of a cell file refers to: by name, number or pattern, or one number of a list.

An entry is `tcp_x`; `#3`, the third column, for repeated or meaningless names; or `pose[0]`, the first number of the
lists in column `pose`. A key of several columns also accepts `joint_*`, `#2..#7` and `pose[*]`. A literal match with
the header takes precedence over a pattern. A column of lists that is named as `joints` stands for all their numbers.
`csv_map` defines the keys.
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
    "value",
    "quality",
)
"""Keys that take one column."""
_OF_NUMBERS = {"x", "y", "z", "confidence", "slider", "speed", "digital_in", "digital_out", "register"}
SEVERAL = ("time", "scaling", "joints", "signal", "tags")
"""Keys that take one or several columns."""
_NUMBER = re.compile(r"#([1-9]\d{0,5})")
_RANGE = re.compile(r"#([1-9]\d{0,5})\.\.#?([1-9]\d{0,5})")
_ELEMENT = re.compile(r"(.+)\[(\d{1,4}|\*)\]", re.DOTALL)


@dataclass(frozen=True)
class Columns:
    """Columns of one table, and the map resolved to them.

    Attributes:
        mapping: The map, with each column by its name in `names`.
        names: Column names of the table; a column with a repeated name that the map refers to by number is `#3`.
        lists: For each column of lists: position of a number -> name of the new column.
    """

    mapping: CsvMap
    names: tuple[str, ...]
    lists: Mapping[str, Mapping[int, str]] = field(default_factory=dict)


def unresolved(entries: Iterable[str], names: Sequence[str]) -> set[str]:
    """Return the entries of a map that match no column among `names`."""
    return {entry for entry in entries if not _meant(entry, names)}


def columns_of(path: Path, mapping: CsvMap, names: Sequence[str], widths: Mapping[str, int]) -> Columns:
    """Return the columns that a map refers to; an entry without a match is kept, to be refused with the others later.

    Args:
        path: The table, for messages.
        mapping: The map as written.
        names: Unique names of its columns.
        widths: Column of lists -> length of its lists in the first rows.

    Raises:
        ConfigError: A key of one column matches several, or a list has no number at that position.
        DamagedLog: A name that several columns share.
    """
    finder = _Finder(path, list(names), widths)
    found: dict[str, object] = {}
    for key in ONE:
        if (entry := getattr(mapping, key)) is not None:
            found[key] = finder.one(key, entry)
    for key in SEVERAL:
        several = (name for entry in getattr(mapping, key) for name in finder.many(entry, whole=key == "joints"))
        found[key] = tuple(dict.fromkeys(several))
    found["only"] = {finder.one("only", entry): values for entry, values in mapping.only.items()}
    return Columns(replace(mapping, **found), tuple(finder.names), finder.lists)  # type: ignore[arg-type]  # by key


def _meant(entry: str, names: Sequence[str]) -> list[int]:
    """Return the positions, from 0, of the columns that an entry matches; for a list element, of the list's column."""
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
    """Resolves entries to columns of one table, and records renamed columns and split lists."""

    def __init__(self, path: Path, names: list[str], widths: Mapping[str, int]) -> None:
        self.path, self.names, self.widths = path, names, widths
        self.lists: dict[str, dict[int, str]] = {}
        self._header = tuple(names)

    def one(self, key: str, entry: str) -> str:
        names = self.many(entry)
        if len(names) > 1:
            shown = ", ".join(names[:6])
            raise ConfigError(f"{WHERE}: {key} = {entry!r} means several columns ({shown})", cure="Name one of them.")
        if names[0] in self.widths and key in _OF_NUMBERS:
            seen = f"{WHERE}: {key} = {entry!r}, but that column holds lists of {self.widths[names[0]]} numbers"
            raise ConfigError(seen, cure=f'Name one of them: {key} = "{names[0]}[0]", counted from 0.')
        return names[0]

    def many(self, entry: str, *, whole: bool = False) -> list[str]:
        """Return the columns that an entry matches; with `whole`, of a column of lists all their numbers."""
        element = None if entry in self._header else _ELEMENT.fullmatch(entry)
        if element is None:
            found = [self._named(entry, place) for place in _meant(entry, self._header)] or [entry]
            widths = [self.widths.get(column, 0) if whole else 0 for column in found]
            lists = (
                [self._element(column, place) for place in range(width)] or [column]
                for column, width in zip(found, widths, strict=True)
            )
            return [name for names in lists for name in names]
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
        """Return the name of a column; if its name repeats, the first one can only be given by number."""
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
