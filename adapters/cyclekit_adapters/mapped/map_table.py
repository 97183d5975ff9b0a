"""Table that a map refers to: column names, first rows, and all rows block by block.

This module handles text tables, with delimiter and encoding from the header line and the cell file. `mapped_csv`
interprets the columns.
"""

from __future__ import annotations

import codecs
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Protocol

from cyclekit.errors import ConfigError, DamagedLog, LogError
from cyclekit_adapters.mapped.csv_map import WHERE
from cyclekit_adapters.mapped.map_columns import unresolved
from cyclekit_adapters.text.delimited import (
    TextLayout,
    delimiter_of,
    fields_of,
    header_names,
    read_blocks,
    row_blocks,
    unique,
)
from cyclekit_adapters.text.header_line import names_in
from cyclekit_adapters.text.text_blocks import blocks_of, file_encoding, head_lines
from cyclekit_adapters.text.text_rows import CELL

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    from cyclekit_adapters.mapped.csv_map import CsvMap
    from cyclekit_adapters.text.text_rows import TextRows, Wanted

_LINES_SEARCHED = 50  # for a header that is not in the expected line
_ROWS_LOOKED_AT = 50
_MAX_BYTES = 1 << 28
"""Maximum size of a transposed table: a size."""


class MapTable(Protocol):
    """A table in any file format."""

    @property
    def names(self) -> tuple[str, ...]:
        """Unique column names."""
        ...

    @property
    def first_rows(self) -> Sequence[Sequence[str]]:
        """Cells of the first rows, as texts."""
        ...

    @property
    def facts(self) -> dict[str, str]:
        """File format, as facts of the log."""
        ...

    def cure(self, wanted: Collection[str], mapping: CsvMap) -> str:
        """Return a hint for the case that wanted columns are missing."""
        ...

    def blocks(self, names: tuple[str, ...], wanted: Wanted) -> Iterator[TextRows]:
        """Yield the rows; `names` are the current column names."""
        ...


@dataclass(frozen=True)
class TextTable:
    """A delimited text table."""

    path: Path
    layout: TextLayout

    @property
    def names(self) -> tuple[str, ...]:
        """Column names."""
        return self.layout.names

    @property
    def first_rows(self) -> list[list[str]]:
        """Cells of the first rows."""
        layout = self.layout
        lines = head_lines(self.path, layout.header_lines + _ROWS_LOOKED_AT, layout.encoding)[layout.header_lines :]
        return [fields_of(line, layout.delimiter) for line in lines if line.strip()]

    @property
    def facts(self) -> dict[str, str]:
        """Delimiter and encoding."""
        return {"delimiter": repr(self.layout.delimiter), "encoding": self.layout.encoding}

    def cure(self, wanted: Collection[str], mapping: CsvMap) -> str:
        """Return where the columns were found, or which columns exist."""
        layout = self.layout
        named = {entry for entry in wanted if not entry.startswith("#")}  # numbers match in any line
        for number, line in enumerate(head_lines(self.path, _LINES_SEARCHED, layout.encoding)):
            for mark in dict.fromkeys((layout.delimiter, ",", ";", "\t", "|", " ")):
                if named and not mapping.columns and not unresolved(wanted, header_names(line, mark)):
                    return f"They are in line {number + 1}: give skip_rows = {number}, delimiter = {mark!r}."
        return f"Columns of line {mapping.skip_rows + 1}: {', '.join(name[:40] for name in layout.names[:60])}."

    def blocks(self, names: tuple[str, ...], wanted: Wanted) -> Iterator[TextRows]:
        """Yield the rows."""
        return read_blocks(
            self.path,
            replace(self.layout, names=names),
            numbers=wanted.numbers,
            texts=wanted.texts,
            required=wanted.required,
            any_of=wanted.any_of,
        )


@dataclass(frozen=True)
class TransposedTable:
    """A text table whose lines are series, held in memory as a whole; its rows are the columns of the file."""

    path: Path
    layout: TextLayout
    rows: list[list[str]]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the series."""
        return self.layout.names

    @property
    def first_rows(self) -> list[list[str]]:
        """Cells of the first rows."""
        return self.rows[:_ROWS_LOOKED_AT]

    @property
    def facts(self) -> dict[str, str]:
        """Form and encoding."""
        return {"form": "each line is a series: a row is a column of the file", "encoding": self.layout.encoding}

    def cure(self, _wanted: Collection[str], _mapping: CsvMap) -> str:
        """Return which series exist."""
        return f"Series: {', '.join(name[:40] for name in self.names[:60])}."

    def blocks(self, names: tuple[str, ...], wanted: Wanted) -> Iterator[TextRows]:
        """Yield the rows."""
        lines = "".join(f"{CELL.join(row)}\n" for row in self.rows).encode()
        layout = replace(self.layout, names=names, delimiter=CELL, header_lines=0, quotes=False)
        yield from row_blocks(
            [lines],
            layout,
            numbers=wanted.numbers,
            texts=wanted.texts,
            required=wanted.required,
            any_of=wanted.any_of,
        )


def transposed(lines: Iterable[Sequence[str]]) -> list[list[str]]:
    """Return the cells of lines column by column; missing ones are empty."""
    return [list(cells) for cells in zip_longest(*lines, fillvalue="")]


def _transposed_table(path: Path, mapping: CsvMap, encoding: str, delimiter: str) -> TransposedTable:
    if path.stat().st_size > _MAX_BYTES:
        cause = f"a transposed table of more than {_MAX_BYTES >> 20} MiB, which is held in memory as a whole"
        raise LogError(path, cause, cure="Export it with a line for each time.")
    text = b"".join(blocks_of(path, encoding, skip_lines=mapping.skip_rows)).decode()
    lines = [[cell.strip() for cell in fields_of(line, delimiter)] for line in text.splitlines() if line.strip()]
    head, *rows = transposed(lines)
    names = unique(mapping.columns or head)
    begin = next((at for at, row in enumerate(rows) if any(map(str.isdigit, "".join(row)))), len(rows))
    layout = TextLayout(names, delimiter, 0, decimal_comma=mapping.decimal == ",", encoding=encoding)
    return TransposedTable(path, layout, [row for row in rows[begin:] if any(row)])


def text_table(path: Path, mapping: CsvMap, wanted: Collection[str]) -> TextTable | TransposedTable:
    """Return a text table with the layout given in the map.

    Args:
        path: The log.
        mapping: The map.
        wanted: Its column entries, used to find a delimiter that is not given.

    Raises:
        ConfigError: The encoding is unknown.
        DamagedLog: The file is not text, or has no header in the expected line.
    """
    if mapping.sheet is not None:
        raise ConfigError(f"{WHERE}: sheet = {mapping.sheet!r}, but the log is a text file", cure="Remove the key.")
    try:
        encoding = mapping.encoding or file_encoding(path)
        codecs.getincrementaldecoder(encoding or "utf-8")("replace").decode("".encode(encoding or "utf-8"))
    except (LookupError, UnicodeError) as error:
        raise ConfigError(
            f"{WHERE}: unknown encoding {mapping.encoding!r}", cure="For example utf-8 or latin-1."
        ) from error
    if encoding is None:
        raise DamagedLog(path, "not a text file: it begins with NUL bytes", cure="Export the log as text again.")
    lines = head_lines(path, mapping.skip_rows + 1, encoding)
    if len(lines) <= mapping.skip_rows or not lines[mapping.skip_rows].strip():
        cause = f"no header in line {mapping.skip_rows + 1}"
        raise DamagedLog(path, cause, cure="The header line comes after skip_rows lines.")
    line = lines[mapping.skip_rows]
    delimiter = mapping.separator() or _delimiter(line, mapping, wanted)
    if mapping.transposed:
        return _transposed_table(path, mapping, encoding, mapping.separator() or delimiter_of(line, ",;\t"))
    names = unique(mapping.columns) if mapping.columns else names_in(path, line, delimiter)
    skipped = mapping.skip_rows + (not mapping.columns)
    comma = mapping.decimal == ","
    return TextTable(path, TextLayout(names, delimiter, skipped, decimal_comma=comma, encoding=encoding, quotes=True))


def _delimiter(line: str, mapping: CsvMap, wanted: Collection[str]) -> str:
    """Return the delimiter that gives the mapped columns, else the most likely one.

    With a decimal comma, a comma is tried last, because it separates fields only if numbers are quoted.
    """
    candidates = ";\t ," if mapping.decimal == "," else ",;\t "

    def fits(mark: str) -> bool:
        if mapping.columns:
            return len(fields_of(line.rstrip(mark), mark)) == len(mapping.columns)
        return not unresolved(wanted, header_names(line, mark))

    return next((mark for mark in candidates if fits(mark)), delimiter_of(line, candidates))
