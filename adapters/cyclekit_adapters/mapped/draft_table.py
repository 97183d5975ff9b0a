"""First lines of an unknown table: position of the header, delimiter, and values of its columns.

The only assumption is that rows hold numeric cells in equal number. `draft` interprets the columns.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cyclekit_adapters.mapped.sheets import Workbook, rows_of
from cyclekit_adapters.text.encodings import WINDOWS
from cyclekit_adapters.text.header_line import has_decimal_comma
from cyclekit_adapters.text.list_cells import parts_of
from cyclekit_adapters.text.text_blocks import begins_in_windows, file_encoding, head_lines
from cyclekit_adapters.text.text_layout import fields_of, unique
from cyclekit_adapters.text.text_rows import UNKNOWN
from cyclekit_adapters.times.proof import file_date

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

LINES = 2000
"""Maximum number of lines read."""
DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "|", "\\s+": "whitespace"}
_LINES_SEARCHED = 50
_MAX_COLUMNS = 2000
_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d+|\.)?|[.,]\d+)(?:[eE][+-]?\d+)?")
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
    if not found:
        return None
    best = max(found, key=lambda rows: (rows.numbers, rows.mark != "\\s+"))
    return replace(_table(best, {**keys, "delimiter": DELIMITERS[best.mark]}), before_s=file_date(path))


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
        if found.width > 1 and found.body and found.numbers:
            return replace(_table(found, {"sheet": sheet} if number else {}), before_s=file_date(path))
    return None


class _Rows:
    """Lines split by one delimiter, with the header and the rows below it."""

    def __init__(self, mark: str, lines: list[list[str]]) -> None:
        self.mark, self.lines = mark, [_trimmed(cells) for cells in lines]
        widths = Counter(len(cells) for cells in self.lines if _is_row(cells))
        self.width = widths.most_common(1)[0][0] if widths else 0
        first = next((at for at, cells in enumerate(self.lines) if self._fits(cells) and _is_row(cells)), len(lines))
        self.body = [cells for cells in self.lines[first:] if self._fits(cells)]
        self.numbers = sum(map(_count, self.body)) if first <= _LINES_SEARCHED else 0
        above = [at for at in range(first) if self._names(self.lines[at])]
        self.header = next((at for at in above if self._fills(self.lines[at])), above[-1] if above else None)
        self.units = next((at for at in above if self.header is not None and at > self.header), None)

    def _fits(self, cells: list[str]) -> bool:
        return 0 < len(cells) <= self.width or (len(cells) > self.width and not any(cells[self.width :]))

    def _fills(self, cells: list[str]) -> bool:
        return sum(map(bool, cells)) >= 0.8 * self.width

    def _names(self, cells: list[str]) -> bool:
        """Return whether cells may be column names: one per column, apart from a leading `#`, and few numbers."""
        non_empty = [cell for cell in cells if cell]
        commented = self.mark == "\\s+" and cells[:1] in (["#"], ["%"])
        return len(cells) - commented == self.width and len(non_empty) > 1 and _count(non_empty) < 0.3 * len(non_empty)


def _rows_by(lines: Sequence[str], mark: str) -> _Rows | None:
    rows = _Rows(mark, [[cell.strip() for cell in fields_of(line, mark)] for line in lines])
    usable = 1 < rows.width <= _MAX_COLUMNS and rows.numbers
    return rows if usable and len(rows.body) >= 0.5 * (len(rows.lines) - _LINES_SEARCHED) else None


def _table(rows: _Rows, keys: dict[str, object]) -> DraftTable:
    keys = dict(keys)
    if rows.header is None:
        first = next(at for at, cells in enumerate(rows.lines) if cells is rows.body[0])
        names: tuple[str, ...] = tuple(f"#{number}" for number in range(1, rows.width + 1))
        keys |= {"columns": list(names)} | ({"skip_rows": first} if first else {})
    else:
        header = rows.lines[rows.header]
        commented = rows.mark == "\\s+" and header[:1] in (["#"], ["%"])
        names = unique(header[1:] if commented else header)
        keys |= {"columns": list(names), "skip_rows": rows.header + 1} if commented else {}
        keys |= {"skip_rows": rows.header} if rows.header and not commented else {}
    units = rows.lines[rows.units] if rows.units is not None else []
    comma = has_decimal_comma((";".join(f'"{cell}"' for cell in row) for row in rows.body[:50]), ";")
    keys |= {"decimal": ","} if comma else {}
    cells = {name: [row[at] if at < len(row) else "" for row in rows.body] for at, name in enumerate(names)}
    called = {name: _called(name, names, at) for at, name in enumerate(names)}
    apart = dict(pair for name in names for pair in _taken_apart(called[name], cells[name]))
    said_units = {called[name]: unit for name, unit in zip(names, units, strict=False)}
    titles = {called[name]: re.sub(r"(.)#\d+$", r"\1", name) for name in names if called[name] != name}
    in_lists = frozenset(apart) - frozenset(called.values())
    return DraftTable(tuple(apart), apart, said_units, keys, titles, comma, rows.header is not None, in_lists)


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
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _is_row(cells: list[str]) -> bool:
    return _count(cells) >= max(2, 0.3 * len(cells)) or any(parts_of(cell) for cell in cells)


def _count(cells: Sequence[str]) -> int:
    lists = sum(len(parts_of(cell) or ()) for cell in cells if cell.startswith(("[", "(")))
    return lists + sum(1 for cell in cells if _NUMBER.fullmatch(cell))


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
