"""How the rows of one delimited text log are written, told by the line of its column names.

Delimiter, names and cells of single lines. What rows of such a layout hold is the business of `row_parser`.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


@dataclass(frozen=True)
class Layout:
    r"""How the rows of one text log are written.

    Attributes:
        names: Column names, one per field, all different; what follows the last one in a row must be empty.
        delimiter: What stands between fields: one character, or several (`||`); `\s+` is any run of blanks.
        header_lines: Lines before the first data row.
        decimal_comma: Numbers are written `0,5`.
        encoding: Any that Python knows.
        quotes: Cells may be quoted, with the delimiter inside; where they are not, a quote is a garbled cell.
    """

    names: tuple[str, ...]
    delimiter: str
    header_lines: int
    decimal_comma: bool = False
    encoding: str = "utf-8"
    quotes: bool = False

    def is_header(self, fields: Sequence[str]) -> bool:
        """Tell whether the cells of a line are the names once more; `#3` stands for any name of the third column."""
        return len(fields) == len(self.names) and all(
            name in (said, f"#{number}")
            for number, (name, said) in enumerate(zip(self.names, unique(fields), strict=True), 1)
        )


def delimiter_of(line: str, candidates: str = ",;\t ") -> str:
    """Return the candidate that occurs most often in `line`, the first of them where none is ahead.

    A blank separates only where nothing else does: names such as `X [mm]` hold blanks.
    """
    others = [mark for mark in candidates if mark != " " and mark in line]
    return max(others or candidates, key=line.count)


def unique(names: Iterable[str]) -> tuple[str, ...]:
    """Return `names` stripped, so that no column hides another.

    The second column of a name has `#2` behind it; one without a name is `#` and its number, from 1.
    """
    seen = {"source_row": 1}  # the name of the column that is added here
    out: list[str] = []
    for number, raw in enumerate(names, 1):
        name = raw.strip()
        seen[name] = seen.get(name, 0) + 1
        out.append(f"#{number}" if not name else name if seen[name] == 1 else f"{name}#{seen[name]}")
    return tuple(out)


def header_names(line: str, delimiter: str) -> tuple[str, ...]:
    """Return the column names of a header line without the empty ones at its end."""
    cells = fields_of(line, delimiter)
    while cells and not cells[-1].strip():
        cells.pop()
    return unique(cells)


def fields_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line; quotes are taken off where they close."""
    return strict_fields_of(line, delimiter) or line.rstrip("\r\n").split(delimiter)


def strict_fields_of(line: str, delimiter: str) -> list[str] | None:
    """Return the cells of one line, None where a quote is open, or closed inside a cell: nobody knows what it holds."""
    text = line.rstrip("\r\n")
    if delimiter == "\\s+":
        return text.split()
    if '"' not in text or len(delimiter) > 1:
        return text.split(delimiter)
    try:
        return next(csv.reader([text], delimiter=delimiter, strict=True), [])
    except csv.Error:
        return None
