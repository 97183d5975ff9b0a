"""Column names and format of a text log whose first line holds its column names.

Delimiter and encoding follow from the first line. Logs with lines above the names, or without names, define their
layout themselves.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog
from cyclekit.text.numbers import count
from cyclekit_adapters.text.text_blocks import file_encoding, head_lines, head_of
from cyclekit_adapters.text.text_layout import (
    MAX_COLUMNS,
    TextLayout,
    delimiter_of,
    fields_of,
    header_names,
    strict_fields_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
_POINT = re.compile(r"[+-]?\d+\.\d+(?:[eE][+-]?\d+)?")
_LOOKED_AT = 20  # rows


def column_names(path: Path, delimiters: str = ",;\t ") -> tuple[str, ...]:
    """Return the column names in the first line, to recognise a log by; at most those in the first few KiB.

    Empty for a folder, a binary file, a file that cannot be opened, or a JSON document.
    """
    line = head_of(path).partition("\n")[0]
    return () if line.startswith(("{", "[")) else _names_in(line, delimiters)


@lru_cache(maxsize=16)  # several adapters ask for the names of each file
def _names_in(line: str, delimiters: str) -> tuple[str, ...]:
    return header_names(line, delimiter_of(line, delimiters))


def names_in(path: Path, line: str, delimiter: str) -> tuple[str, ...]:
    """Return the names in a header line.

    Raises:
        DamagedLog: There are more names than any logger writes, or the line is not text.
    """
    if "\0" in line:
        raise DamagedLog(path, "its header holds NUL bytes: it is damaged, or not a text file", cure="Check the copy.")
    names = header_names(line, delimiter)
    if len(names) > MAX_COLUMNS:
        cause = f"a header of more than {count(MAX_COLUMNS)} columns: no logger writes that"
        raise DamagedLog(path, cause, cure="Check what the file is.")
    return names


def has_decimal_comma(rows: Iterable[str], delimiter: str) -> bool:
    """Return whether numbers are written `0,5`: a comma inside a number that is not a delimiter is a decimal mark.

    If commas also separate fields, such numbers are quoted. If commas and points both occur in numbers, the more
    frequent one is the decimal mark.
    """
    cells = [cell.strip() for row in rows if "," in row for cell in fields_of(row, delimiter)]
    return sum(map(bool, map(_COMMA.fullmatch, cells))) > sum(map(bool, map(_POINT.fullmatch, cells)))


def layout_below(path: Path, delimiters: str = ",;\t ") -> TextLayout:
    """Return the layout of the rows below the first line; if names or cells are quoted, any cell may be.

    Args:
        path: The log.
        delimiters: Possible delimiters; leave out characters that occur inside names.

    Raises:
        DamagedLog: The first line is empty or binary, or has more names than any logger writes.
        LogError: The file cannot be opened.
    """
    encoding = file_encoding(path)
    line, *rows = head_lines(path, 1 + _LOOKED_AT) or [""]
    if encoding is None or not line.strip():
        raise DamagedLog(path, "the file is empty or not text", cure="Check the copy.")
    delimiter = delimiter_of(line, delimiters)
    names, comma = names_in(path, line, delimiter), has_decimal_comma(rows, delimiter)
    quotes = '"' in line or any(_is_quoted(row, delimiter, len(names)) for row in rows)
    return TextLayout(names, delimiter, 1, decimal_comma=comma, encoding=encoding, quotes=quotes)


def _is_quoted(row: str, delimiter: str, width: int) -> bool:
    """Return whether a row has one cell per name only if its quotes are respected."""
    if '"' not in row:
        return False
    cells = strict_fields_of(row, delimiter)
    return cells is not None and len(cells) == width != len(row.split(delimiter))
