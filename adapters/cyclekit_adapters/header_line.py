"""The column names in the first line of a text log, and how the rows below them are written.

For logs that describe themselves this far and no further: delimiter and encoding follow from the first line. Logs with
lines above their names, or with none, state their layout themselves.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING

from cyclekit.errors import DamagedLog
from cyclekit_adapters.delimited import Layout, delimiter_of, fields_of, header_names
from cyclekit_adapters.text_blocks import file_encoding, head_lines, head_of

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
_LOOKED_AT = 20  # rows


def column_names(path: Path, delimiters: str = ",;\t ") -> tuple[str, ...]:
    """Return the names in the first line, as far as the first few KiB hold it, to recognise a log by.

    None for a folder, a binary file, one that cannot be opened, or a JSON document.
    """
    line = head_of(path).partition("\n")[0]
    return () if line.startswith(("{", "[")) else _names_in(line, delimiters)


@lru_cache(maxsize=16)  # several adapters ask for those of each file
def _names_in(line: str, delimiters: str) -> tuple[str, ...]:
    return header_names(line, delimiter_of(line, delimiters))


def has_decimal_comma(rows: Iterable[str], delimiter: str) -> bool:
    """Tell whether numbers are written `0,5`: where commas do not separate the fields, one in a number is decimal."""
    return delimiter != "," and any(
        _COMMA.fullmatch(cell.strip()) for row in rows for cell in fields_of(row, delimiter)
    )


def layout_below(path: Path, delimiters: str = ",;\t ") -> Layout:
    """Return how the rows below the first line are written.

    Args:
        path: The log.
        delimiters: Those that may separate; leave out what occurs inside names.

    Raises:
        DamagedLog: The first line is empty or binary.
        LogError: The file cannot be opened.
    """
    encoding = file_encoding(path)
    line, *rows = head_lines(path, 1 + _LOOKED_AT) or [""]
    if encoding is None or not line.strip():
        raise DamagedLog(path, "the file is empty or not text", cure="Check the copy.")
    delimiter = delimiter_of(line, delimiters)
    comma = has_decimal_comma(rows, delimiter)
    return Layout(header_names(line, delimiter), delimiter, header_lines=1, decimal_comma=comma, encoding=encoding)
