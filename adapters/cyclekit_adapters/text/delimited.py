"""Reader of delimited text logs: complete rows, never shifted, and the rows that cannot be trusted.

All CSV adapters read through this module, because all CSV logs share the same faults: a logger killed in the middle of
a number leaves a value that still parses, a doubled space shifts all later columns by one, a power cut leaves a block
of NUL bytes. A row is used only if nothing in it is doubtful (`row_parser`). All others are set aside with line and
reason. `text_blocks` turns bytes into lines; the adapters interpret the columns.

The log is read block by block, so memory does not grow with its size.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.text.row_parser import RowParser
from cyclekit_adapters.text.text_blocks import blocks_of
from cyclekit_adapters.text.text_layout import TextLayout, delimiter_of, fields_of, header_names, unique
from cyclekit_adapters.text.text_rows import INDEX, SET_ASIDE, TextRows, Wanted, nothing_usable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path
    from typing import Unpack

    from cyclekit_adapters.text.text_rows import ColumnArguments

__all__ = [
    "INDEX",
    "TextLayout",
    "TextRows",
    "delimiter_of",
    "fields_of",
    "header_names",
    "joined",
    "nothing_usable",
    "read_blocks",
    "read_rows",
    "row_blocks",
    "unique",
]


def read_rows(path: Path, layout: TextLayout, **columns: Unpack[ColumnArguments]) -> TextRows:
    """Read the columns `numbers` (Float64) and `texts` (String) of every trustworthy row, the whole log at once.

    Args:
        path: The log.
        layout: Format of its lines.
        columns: Columns to read, as the attributes of `Wanted`.

    Raises:
        DamagedLog: Two columns share a requested name, or a line is longer than any logger writes.
        LogError: The file cannot be opened.
    """
    return joined(read_blocks(path, layout, **columns), columns["numbers"], columns.get("texts", ()))


def read_blocks(
    path: Path,
    layout: TextLayout,
    **columns: Unpack[ColumnArguments],
) -> Iterator[TextRows]:
    """Yield the rows of `read_rows` in blocks of tens of thousands, for logs of any size.

    Raises:
        DamagedLog: Two columns share a requested name, or a line is longer than any logger writes.
        LogError: The file cannot be opened.
    """
    wanted = Wanted(**columns)
    for name in wanted.columns:
        if f"{name}#2" in layout.names:
            cause = f"two columns are called {name!r}: the name is ambiguous"
            raise DamagedLog(path, cause, cure="Name each column once in its header.")
    try:
        parser = RowParser(layout, wanted, line=layout.header_lines + 1)
        blocks = blocks_of(path, layout.encoding, skip_lines=layout.header_lines, delimiter=layout.delimiter)
        yield from parser.rows(blocks)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its permissions.") from error


def row_blocks(
    blocks: Iterable[bytes], layout: TextLayout, *, first_line: int = 1, **columns: Unpack[ColumnArguments]
) -> Iterator[TextRows]:
    """Yield rows as `read_blocks` does, but from lines in memory, such as one section of a file of several tables.

    Args:
        blocks: Whole lines of UTF-8 text with their line ends, in pieces of any size; the first `layout.header_lines`
            lines are skipped.
        layout: Format of the lines.
        first_line: Line number of the first line in its file.
        columns: As in `read_rows`.
    """
    parser = RowParser(layout, Wanted(**columns), line=first_line, skip=layout.header_lines)
    yield from parser.rows(blocks)


def joined(parts: Iterable[TextRows], numbers: Sequence[str] = (), texts: Sequence[str] = ()) -> TextRows:
    """Concatenate blocks of rows; `numbers` and `texts` give the columns if there is no block."""
    every = list(parts)
    if not every:
        columns = {"source_row": pl.Int64(), INDEX: pl.Int64()}
        schema = columns | dict.fromkeys(numbers, pl.Float64()) | dict.fromkeys(texts, pl.String())
        return TextRows(pl.DataFrame(schema=schema), 0, pl.DataFrame(schema=SET_ASIDE))
    if len(every) == 1:
        return every[0]
    frame = pl.concat([rows.frame for rows in every])
    aside = pl.concat([rows.set_aside for rows in every])
    return TextRows(frame, sum(rows.rows_read for rows in every), aside, sum(rows.not_finite for rows in every))
