"""First lines of an unknown table: position of the header, delimiter, and values of its columns.

The only assumption is that rows hold values in equal number of cells. `draft` interprets the columns.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np

from cyclekit_adapters.mapped.draft_names import UNITS, name_of
from cyclekit_adapters.mapped.map_table import transposed
from cyclekit_adapters.mapped.sheets import Workbook, rows_of
from cyclekit_adapters.text.encodings import WINDOWS
from cyclekit_adapters.text.header_line import has_decimal_comma
from cyclekit_adapters.text.list_cells import parts_of
from cyclekit_adapters.text.text_blocks import begins_in_windows, file_encoding, head_lines
from cyclekit_adapters.text.text_layout import fields_of, unique
from cyclekit_adapters.text.text_rows import UNKNOWN
from cyclekit_adapters.times.proof import file_date
from cyclekit_adapters.times.units import unit_named

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

LINES = 2000
"""Maximum number of lines read."""
DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "|", "\\s+": "whitespace"}
_LINES_SEARCHED = 50
_MAX_COLUMNS = 2000
_VALUE = re.compile(
    r"[+-]?(?:\d+(?:[.,]\d+|\.)?|[.,]\d+)(?:[eE][+-]?\d+)?"  # a number
    r"|[+-]?\d{1,3}(?:['’.,\s]\d{3})+(?:[.,]\d+)?"  # with marks of thousands
    r"|\d{1,4}[/.-]\d\d?[/.-]\d{1,4}"  # a date
)
_CLOCK = re.compile(r"(?<!\d)\d\d?:\d\d")
_SAYS_NAMES = {"name", "names", "item", "tag", "tagname", "variable", "signal", "bezeichnung", "parameter"}
_NUMERIC = 0.9  # minimum share of numbers in a numeric column


@dataclass(frozen=True)
class DraftTable:
    """First rows of a table.

    Attributes:
        names: Unique column names; numbers of a list in one cell are also columns, `pose[0]`.
        cells: Cells of each column as texts, one per row.
        units: Entry of a second header line per column; empty without one.
        keys: Keys of the map for the file format, without those of columns.
        titles: Header names of columns that `names` refers to by number.
        comma: Numbers have a decimal comma.
        headed: The table has a line of names.
        in_lists: Columns that are numbers of a list in one cell.
        before_s: Date of the file, s since 1970; None if unknown.
    """

    names: tuple[str, ...]
    cells: dict[str, list[str]]
    units: dict[str, str] = field(default_factory=dict)
    keys: dict[str, object] = field(default_factory=dict)
    titles: dict[str, str] = field(default_factory=dict)
    comma: bool = False
    headed: bool = True
    in_lists: frozenset[str] = frozenset()
    before_s: float | None = None

    @cached_property
    def numbers(self) -> dict[str, NDArray[np.float64]]:
        """Numeric columns, all of equal length; NaN where unknown."""
        found = {name: [_number(cell, comma=self.comma) for cell in cells] for name, cells in self.cells.items()}
        kept = {name: values for name, values in found.items() if _is_numeric(values)}
        return {name: np.array([np.nan if v is None else v for v in values]) for name, values in kept.items()}

    @cached_property
    def texts(self) -> dict[str, list[str]]:
        """Other non-empty columns, without their empty cells."""
        texts = {name: [text for cell in cells if (text := cell.strip())] for name, cells in self.cells.items()}
        return {name: kept for name, kept in texts.items() if kept and name not in self.numbers}


def text_draft_table(path: Path) -> DraftTable | None:
    """Return the first rows of a text table; None if the file is not a table."""
    lines, keys = draft_lines(path)
    marks = [mark for mark in DELIMITERS if mark == "\\s+" or any(mark in line for line in lines)]
    found = [rows for mark in marks if (rows := _rows_by(lines, mark)) is not None]
    if not any(rows.header is not None for rows in found):
        found += [rows for mark in marks if mark != "\\s+" and (rows := _transposed(lines, mark)) is not None]
    if not found:
        return None
    best = max(found, key=lambda rows: (rows.header is not None, rows.values, rows.mark != "\\s+"))
    keys |= {"delimiter": DELIMITERS[best.mark]} | ({"transposed": True} if best.is_transposed else {})
    return replace(_table(best, keys), before_s=file_date(path))


def draft_lines(path: Path) -> tuple[list[str], dict[str, object]]:
    """Return the first lines of a text file, and the keys of the map that say how they are written; none if no text."""
    encoding = file_encoding(path)
    if encoding is None:
        return [], {}
    lines = head_lines(path, LINES, encoding)
    keys: dict[str, object] = {"encoding": WINDOWS} if begins_in_windows(path) else {}
    return lines[:-1] if len(lines) < LINES or not lines[-1] else lines, keys  # the last line may be incomplete


def sheet_draft_table(path: Path) -> DraftTable | None:
    """Return the first rows of the first sheet of a workbook that holds a table; None if there is none.

    Raises:
        MissingExtra: fastexcel is not installed.
        LogError: The workbook cannot be read.
    """
    workbook = Workbook(path)
    for number, sheet in enumerate(workbook.sheets):
        columns = workbook.cells(sheet, "string", count=LINES)
        found = _Rows("", rows_of(columns, 0, LINES, max(columns, default=-1) + 1))
        if found.width > 1 and found.values:
            return replace(_table(found, {"sheet": sheet} if number else {}), before_s=file_date(path))
    return None


class _Rows:
    """Lines split by one delimiter, with the header and the rows below it.

    A column of values has numbers, lists or written times in most lines. The rows begin with the first line that has no
    word there; a line of names stands above them, with a word for each column that is ever filled. Of several, the
    names are those that differ from each other and are no units; the others' line of most units has the units.
    """

    def __init__(self, mark: str, lines: list[list[str]], *, is_transposed: bool = False) -> None:
        self.mark, self.lines, self.is_transposed = mark, lines, is_transposed
        widths = Counter(len(cells) for cells in lines if sum(map(_is_value, cells)) > (len(cells) == 1))
        self.width = widths.most_common(1)[0][0] if widths else 0
        columns = zip_longest(*(cells[: self.width] for cells in lines if self._fits(cells)), fillvalue="")
        self._of_values = [_are_values(cells) for cells in columns]
        self.first = next((at for at, cells in enumerate(lines) if self._is_row(cells)), len(lines))
        self.body = [cells for cells in lines[self.first :] if self._fits(cells)]
        self.filled = max((len(_trimmed(cells)) for cells in self.body), default=0)
        self.values = sum(map(_count, self.body)) if self.first <= _LINES_SEARCHED else 0
        above = range(min(self.first, _LINES_SEARCHED + 1))
        able = [at for at in above if self._may_be_names(at)]
        self.header = max(able, key=lambda at: self._as_names(self.named(at)), default=None)
        units = {at: sum(map(_is_unit, self.named(at))) for at in above if at != self.header}
        self.units = max(units, key=lambda at: units[at]) if any(units.values()) else None

    def _fits(self, cells: list[str]) -> bool:
        return any(cells) and (len(cells) <= self.width or not any(cells[self.width :]))

    def _is_row(self, cells: list[str]) -> bool:
        told = [cell for cell, wanted in zip(cells, self._of_values, strict=False) if wanted and not _is_unknown(cell)]
        return self._fits(cells) and bool(told) and all(map(_is_value, told))

    def is_commented(self, at: int) -> bool:
        """Return whether a line begins with a mark that stands above no column."""
        return self.mark == "\\s+" and self.lines[at][:1] in (["#"], ["%"])

    def named(self, at: int) -> list[str]:
        """Return the cells of a line above the rows."""
        return self.lines[at][self.is_commented(at) :]

    def _may_be_names(self, at: int) -> bool:
        cells = self.named(at)
        non_empty = [cell for cell in cells if cell]
        whole = self._is_as_wide(cells) or (self.mark != "\\s+" and len(_trimmed(cells)) > self.width)
        return whole and len(non_empty) > 1 and sum(map(_is_value, non_empty)) < 0.3 * len(non_empty)

    def _is_as_wide(self, cells: list[str]) -> bool:
        """Return whether a line has a cell for each column; a longer one is of rows that leave out their last cells."""
        return len(cells) == self.width or self.filled <= len(_trimmed(cells)) <= self.width

    def _as_names(self, cells: list[str]) -> tuple[bool, bool, bool, bool]:
        """Return what speaks for names: as many as columns, no units and different, few empty, a word that says so."""
        non_empty = [cell.lower() for cell in cells if cell]
        differ = len(set(non_empty)) == len(non_empty) and 2 * sum(map(_is_unit, cells)) < len(non_empty)
        return self._is_as_wide(cells), differ, len(non_empty) >= 0.8 * self.filled, name_of(cells[0]).says(_SAYS_NAMES)


def _rows_by(lines: Sequence[str], mark: str) -> _Rows | None:
    rows = _Rows(mark, [[cell.strip() for cell in fields_of(line, mark)] for line in lines])
    usable = 1 < rows.width <= _MAX_COLUMNS and rows.values
    return rows if usable and len(rows.body) >= 0.5 * (len(rows.lines) - _LINES_SEARCHED) else None


def _transposed(lines: Sequence[str], mark: str) -> _Rows | None:
    """Return the table of which each line is a series, a word and values; None if the lines are none."""
    cells = [[cell.strip() for cell in fields_of(line, mark)] for line in lines if line.strip()]
    named = [row[0] for row in cells if row[0] and not _is_value(row[0])]
    if not 2 <= len(named) == len(set(named)) == len(cells) <= _LINES_SEARCHED:
        return None
    rows = _Rows(mark, transposed(cells), is_transposed=True)
    return rows if rows.header == 0 and rows.values else None


def _table(rows: _Rows, keys: dict[str, object]) -> DraftTable:
    keys, header = dict(keys), rows.header
    if header is None:
        names: tuple[str, ...] = tuple(f"#{number}" for number in range(1, rows.width + 1))
    else:
        said = [*rows.named(header), *[""] * rows.width]
        names = unique(said[: min(max(len(_trimmed(rows.named(header))), rows.filled), rows.width)])
    beside = header is None or rows.is_commented(header) or len(_trimmed(rows.named(header))) != len(names)
    if rows.is_transposed:
        pass  # what is between the names and the first values is skipped
    elif header is None or beside or any(any(cells) for cells in rows.lines[header + 1 : rows.first]):
        keys |= {"columns": list(names)} | ({"skip_rows": rows.first} if rows.first else {})
    else:
        keys |= {"skip_rows": header} if header else {}
    units = rows.named(rows.units) if rows.units is not None else []
    comma = has_decimal_comma((";".join(f'"{cell}"' for cell in row) for row in rows.body[:50]), ";")
    keys |= {"decimal": ","} if comma else {}
    cells = {name: [row[at] if at < len(row) else "" for row in rows.body] for at, name in enumerate(names)}
    called = {name: _called(name, names, at) for at, name in enumerate(names)}
    apart = dict(pair for name in names for pair in _taken_apart(called[name], cells[name]))
    said_units = {called[name]: unit for name, unit in zip(names, units, strict=False)}
    titles = {called[name]: re.sub(r"(.)#\d+$", r"\1", name) for name in names if called[name] != name}
    in_lists = frozenset(apart) - frozenset(called.values())
    return DraftTable(tuple(apart), apart, said_units, keys, titles, comma, header is not None, in_lists)


def _called(name: str, names: Sequence[str], at: int) -> str:
    """Return the name of a column in a map: its header name, or its number if that name repeats."""
    return f"#{at + 1}" if f"{name}#2" in names or re.search(r".#\d+$", name) else name


def _taken_apart(name: str, cells: list[str]) -> list[tuple[str, list[str]]]:
    """Return the column, or one column per number if its cells hold lists."""
    lists = [parts_of(cell) for cell in cells if cell]
    widths = Counter(len(parts) if parts else 0 for parts in lists)
    if not lists or widths.most_common(1)[0][0] < 2:
        return [(name, cells)]
    width = widths.most_common(1)[0][0]
    split = [parts if (parts := parts_of(cell)) and len(parts) == width else [""] * width for cell in cells]
    return [(f"{name}[{place}]", [parts[place] for parts in split]) for place in range(width)]


def _trimmed(cells: list[str]) -> list[str]:
    return cells[: max((at for at, cell in enumerate(cells, 1) if cell), default=0)]


def _is_unknown(cell: str) -> bool:
    return cell.lower() in UNKNOWN


def _is_unit(cell: str) -> bool:
    plain = cell.strip("[]() ")
    return plain.lower() in UNITS or unit_named(plain) is not None


def _is_value(cell: str) -> bool:
    return bool(_VALUE.fullmatch(cell) or _CLOCK.search(cell) or _in_list(cell))


def _in_list(cell: str) -> int:
    """Return the count of numbers in a cell that holds a list; 0 if it holds none, such as `[LOGGING]`."""
    return len(parts_of(cell) or ()) if cell[-1:] in ("]", ")", "}") and any(map(str.isdigit, cell)) else 0


def _are_values(cells: Iterable[str]) -> bool:
    known = [cell for cell in cells if not _is_unknown(cell)]
    return 2 * sum(map(_is_value, known)) > len(known)


def _count(cells: Sequence[str]) -> int:
    return sum(_in_list(cell) or _is_value(cell) for cell in cells)


def _number(cell: str, *, comma: bool) -> float | None:
    text = cell.strip()
    if text.lower() in UNKNOWN:
        return np.nan
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return None


def _is_numeric(values: Sequence[float | None]) -> bool:
    not_nan = [value for value in values if value is None or not np.isnan(value)]
    return bool(not_nan) and sum(value is not None for value in not_nan) >= _NUMERIC * len(not_nan)
