"""Layout of a delimited text log: delimiter, column names and the cells of single lines.

`row_parser` interprets the rows.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


MAX_COLUMNS = 100_000
"""Maximum number of columns: no logger writes more, and reading a million would take gigabytes."""


@dataclass(frozen=True)
class TextLayout:
    r"""Format of the rows of one text log.

    Attributes:
        names: Column names, one per field, all different; fields after the last one must be empty.
        delimiter: Text between fields: one character, or several (`||`); `\s+` is any run of blanks.
        header_lines: Number of lines before the first data row.
        decimal_comma: Numbers are written `0,5`.
        encoding: Any encoding that Python knows.
        quotes: Cells may be quoted, with the delimiter inside; otherwise a quote marks a garbled cell.
    """

    names: tuple[str, ...]
    delimiter: str
    header_lines: int
    decimal_comma: bool = False
    encoding: str = "utf-8"
    quotes: bool = False

    def is_header(self, fields: Sequence[str]) -> bool:
        """Return whether the cells of a line repeat the names; `#3` matches any name of the third column."""
        return len(fields) == len(self.names) and all(
            name in (said, f"#{number}")
            for number, (name, said) in enumerate(zip(self.names, unique(fields), strict=True), 1)
        )


def delimiter_of(line: str, candidates: str = ",;\t ") -> str:
    """Return the most frequent candidate in `line`; the first one among equals.

    A blank is a delimiter only if no other candidate occurs: names such as `X [mm]` contain blanks.
    """
    others = [mark for mark in candidates if mark != " " and mark in line]
    return max(others or candidates, key=line.count)


def unique(names: Iterable[str]) -> tuple[str, ...]:
    """Return `names` stripped and made unique.

    The second column of a name gets the suffix `#2`; a column without a name is `#` and its number, from 1.
    """
    seen = {"source_row": 1}  # reserved for the added column
    out: list[str] = []
    for number, raw in enumerate(names, 1):
        name = raw.strip()
        seen[name] = seen.get(name, 0) + 1
        out.append(f"#{number}" if not name else name if seen[name] == 1 else f"{name}#{seen[name]}")
    return tuple(out)


def header_names(line: str, delimiter: str) -> tuple[str, ...]:
    """Return the column names of a header line, without empty ones at its end; at most one more than MAX_COLUMNS."""
    mark = None if delimiter == "\\s+" else delimiter
    if len(line) > MAX_COLUMNS and len(found := line.split(mark, MAX_COLUMNS + 1)) > MAX_COLUMNS + 1:
        return unique(found[:-1])
    cells = fields_of(line, delimiter)
    while cells and not cells[-1].strip():
        cells.pop()
    return unique(cells)


def fields_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line; quotes are removed if they are balanced."""
    return strict_fields_of(line, delimiter) or line.rstrip("\r\n").split(delimiter)


def strict_fields_of(line: str, delimiter: str) -> list[str] | None:
    """Return the cells of one line; None if a quote is not closed, or closed inside a cell."""
    text = line.rstrip("\r\n")
    if delimiter == "\\s+":
        return text.split()
    if '"' not in text or len(delimiter) > 1:
        return text.split(delimiter)
    try:
        return next(csv.reader([text], delimiter=delimiter, strict=True), [])
    except csv.Error:
        return None
