"""Fast parsing of a block of whole lines by polars; refused where polars could silently misread it.

Polars fills short rows, cuts long ones, skips undecodable bytes and reads 1.234 as a number even where the comma is the
decimal mark, without an error. So each block is checked first. A doubtful block is left to `row_parser`, which reads it
line by line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit_adapters.text.text_rows import CELL, INDEX, UNDECODED, Wanted, finite, not_finite, number_in, stripped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit_adapters.text.text_layout import TextLayout

_BEYOND, _DOUBT, _SUM = "\x1fbeyond", "\x1fdoubt", "\x1fsum"  # names that no column of a log has
_LOOKED_AT = 1 << 17
_NEWLINE, _RETURN, _QUOTE, _BLANK = b'\n\r" '
_WHITE = np.frombuffer(b" \t\n\v\f\r", np.uint8)
_PLACES, _PLACE_BYTES = 32, 1024
_PLAIN_BYTES = 1 << 17
"""Maximum block size for the fast path, bytes: below it, planning a query costs more than checking each byte."""
_OF_NUMBERS = b"0123456789.eE+-\n"
_AS_IT_IS = pl.QueryOptFlags.none()


def mark_between(layout: TextLayout) -> str:
    """Return the field delimiter of a block, one character: `text_blocks` has replaced longer ones by CELL."""
    return layout.delimiter if len(layout.delimiter) == 1 else CELL


@dataclass(frozen=True)
class BlockTable:
    """Rows of consecutive lines.

    Attributes:
        frame: The requested columns, cleaned.
        lines: Number of lines of the block, blank ones included.
        not_finite: Number of values that are NaN or infinite.
        numbers: Line of each row within the block, from 0, shape (N,); None = consecutive lines.
    """

    frame: pl.DataFrame
    lines: int
    not_finite: int
    numbers: NDArray[np.int64] | None = None

    def placed(self, line: int, row: int) -> pl.DataFrame:
        """Return the rows with `source_row` and INDEX, counted from those of the block's first line."""
        rows = self.frame.height
        lines = np.arange(line, line + rows) if self.numbers is None else self.numbers + line
        places = [pl.Series("source_row", lines), pl.Series(INDEX, np.arange(row, row + rows))]
        return pl.DataFrame([*places, *self.frame.get_columns()])


def table_of(block: bytes, layout: TextLayout, wanted: Wanted) -> BlockTable | None:
    """Return the rows of whole lines; None if any row may be short, long or garbled.

    Args:
        block: The lines.
        layout: Format of the lines.
        wanted: Columns to read.
    """
    if _has_too_many_lines(block, layout) or _may_be_garbled(block, layout, wanted):
        return None
    if (found := _plain(block, layout, wanted) or _parsed(block, layout, wanted)) is not None:
        return found
    if not _has_blank_lines(block):
        return None
    compact, numbers = _without_blank_lines(block)
    if (found := _parsed(compact, layout, wanted)) is None:
        return None
    return replace(found, lines=block.count(b"\n"), numbers=numbers)


def _may_be_garbled(block: bytes, layout: TextLayout, wanted: Wanted) -> bool:
    if wanted.texts and UNDECODED.encode() in block:
        return True
    if _has_nul_or_two_blanks(block) if layout.delimiter == " " else b"\0" in block:
        return True
    return layout.quotes and b'"' in block and not _quotes_close(block, layout)


def _has_nul_or_two_blanks(block: bytes) -> bool:
    """Return whether the block holds a NUL byte or two adjacent blanks, for text too rich in blanks for a plain search.

    The OR of two adjacent bytes equals a blank only for two blanks, or a blank and a NUL byte. For most neighbours in a
    log it is larger, so the minimum over a piece usually decides. Pieces keep the data in the cache for the second
    look.
    """
    raw = np.frombuffer(block, np.uint8)
    for begin in range(0, len(raw), _LOOKED_AT):
        piece = raw[begin : begin + _LOOKED_AT + 1]
        either = piece[:-1] | piece[1:]
        if len(either) and either.min() <= _BLANK and (either == _BLANK).any():
            return True
        if block.find(b"\0", begin, begin + _LOOKED_AT) >= 0:
            return True
    return False


def _has_blank_lines(block: bytes) -> bool:
    return block.startswith((b"\n", b"\r\n")) or b"\n\n" in block or b"\n\r\n" in block


def _quotes_close(block: bytes, layout: TextLayout) -> bool:
    """Return whether each quote opens at the start of a cell and closes at its end, or is doubled inside a cell."""
    raw = np.frombuffer(block, np.uint8)
    quotes = np.flatnonzero(raw == _QUOTE)
    if len(quotes) % 2:
        return False
    neighbours = [ord(mark_between(layout)), _NEWLINE, _QUOTE]
    before = raw[quotes[0::2] - 1]  # the byte before the first one is the last one of the block, a line end
    after = raw[np.minimum(quotes[1::2] + 1, len(raw) - 1)]
    return bool(np.isin(before, neighbours).all() and np.isin(after, [*neighbours, ord("\r")]).all())


def _without_blank_lines(block: bytes) -> tuple[bytes, NDArray[np.int64]]:
    """Return the block without its blank lines, and the original number of each kept line, from 0, shape (N,)."""
    begins, ends, _ = _lines_of(block, None)
    numbers = np.flatnonzero(_non_blank(block, begins, ends))
    spans = zip(begins[numbers].tolist(), ends[numbers].tolist(), strict=True)
    return b"".join(block[begin : end + 1] for begin, end in spans), numbers


def short_lines(block: bytes, layout: TextLayout) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the numbers of non-blank lines, from 0, and their field counts, if every line is too short; else None.

    A garbled log may have millions of such lines, too many to read one by one.
    """
    if b"\0" in block or block.count(b"\r") != block.count(b"\r\n"):
        return None
    _, ends, fields = _lines_of(block, mark_between(layout).encode())
    if not len(fields) or fields.max() >= len(layout.names):
        return None
    there = np.flatnonzero(~np.isin(np.frombuffer(block, np.uint8), _WHITE))
    non_blank = np.flatnonzero(np.diff(np.searchsorted(there, ends), prepend=0))
    return non_blank, fields[non_blank]


def _lines_of(block: bytes, mark: bytes | None) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return start, end and field count of each line of a block, each of shape (N,)."""
    raw = np.frombuffer(block, np.uint8)
    ends = np.flatnonzero(raw == _NEWLINE)
    begins = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
    if mark is None:
        return begins, ends, np.zeros(len(ends), np.int64)
    marks = np.flatnonzero(raw == mark[0])
    return begins, ends, np.diff(np.searchsorted(marks, ends), prepend=0) + 1


def _non_blank(block: bytes, begins: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a mask of the lines that hold more than a carriage return."""
    first = np.frombuffer(block, np.uint8)[begins]
    return np.asarray((ends > begins + 1) | ((ends == begins + 1) & (first != _RETURN)))


def _has_too_many_lines(block: bytes, layout: TextLayout) -> bool:
    """Return whether the lines of a block, sampled at a few places, are too short for the rows of this log.

    Polars would fill each of them and need many times the memory of the block.
    """
    step = max(len(block) // _PLACES, _PLACE_BYTES)
    seen = [block[begin : begin + _PLACE_BYTES] for begin in range(0, len(block), step)]
    return sum(part.count(b"\n") for part in seen) * len(layout.names) > sum(map(len, seen))


def _plain(block: bytes, layout: TextLayout, wanted: Wanted) -> BlockTable | None:
    """Return the rows of a small block of finite numbers only, with one field per name in each line; else None.

    Gives the same result as `_parsed`, faster: a plant may have tens of thousands of logs with few rows each.
    """
    if len(block) > _PLAIN_BYTES or wanted.texts or layout.decimal_comma:
        return None
    block = block.replace(b"\r\n", b"\n")
    if not _is_of_numbers(block, layout):
        return None
    last = layout.names[-1]  # read as text, as in `_parsed`, so that both give the same number
    types: dict[str, pl.DataType] = {
        n: pl.Float64() if n in wanted.numbers and n != last else pl.String() for n in layout.names
    }
    try:
        table = _scanned(block, layout, types, quoted=False).collect(engine="in-memory", optimizations=_AS_IT_IS)
        columns = [table.get_column(name) for name in wanted.numbers]
        columns = [one.cast(pl.Float64, strict=True) if one.name == last else one for one in columns]
        frame = pl.DataFrame(columns)
    except pl.exceptions.PolarsError:
        return None
    sure = table.height == block.count(b"\n") and math.isfinite(sum(float(one.sum()) for one in columns))
    return BlockTable(frame, table.height, 0) if sure else None


def _is_of_numbers(block: bytes, layout: TextLayout) -> bool:
    """Return whether a block holds only numbers, one field per name, and no empty first or last field."""
    mark = mark_between(layout).encode()
    if mark in _OF_NUMBERS or block.translate(None, _OF_NUMBERS + mark) or not _is_even(block, layout):
        return False
    raw = np.frombuffer(block, np.uint8)
    ends = np.flatnonzero(raw == _NEWLINE)
    neighbours = np.concatenate([raw[:1], raw[ends[:-1] + 1], raw[ends - 1]])
    return bool(((neighbours != mark[0]) & (neighbours != _NEWLINE)).all())


def _parsed(block: bytes, layout: TextLayout, wanted: Wanted) -> BlockTable | None:
    first, last = layout.names[0], layout.names[-1]
    quoted = layout.quotes and b'"' in block
    as_text = {last, *(wanted.numbers if layout.decimal_comma and b"." in block else ())}
    types: dict[str, pl.DataType] = {
        name: pl.Float64() if name in wanted.numbers and name not in as_text else pl.String()
        for name in (*layout.names, _BEYOND)
    }
    # The last column and one column beyond it are always read as text. The last one is empty only in a short row, the
    # one beyond it is filled only in a long row. With blanks as delimiters, a leading blank leaves the first column
    # empty.
    doubt = (pl.col(last).str.strip_chars() == "").any() | (pl.col(_BEYOND).str.strip_chars() != "").any()
    if layout.delimiter == " ":
        empty = pl.col(first) == "" if types[first] == pl.String else pl.col(first).is_null()
        doubt |= empty.any()
    numbers = [number_in(n, layout).cast(pl.Float64, strict=True).alias(n) for n in wanted.numbers if n in as_text]
    try:
        table = (
            _scanned(block, layout, types, quoted=quoted)
            .with_columns(doubt.alias(_DOUBT), *numbers)
            .select(*wanted.numbers, *stripped(wanted), _sum_of(wanted.numbers).alias(_SUM), _DOUBT)
            .collect(engine="in-memory")
        )
    except pl.exceptions.PolarsError:
        return None
    sure = not quoted and layout.delimiter != " "  # without quotes and blanks, each delimiter is the end of a field
    if table.height > 0 and table[_DOUBT][0] and not (sure and _is_even(block, layout)):
        return None
    if quoted and table.height != block.count(b"\n"):
        return None  # a quote that was never closed spans lines
    frame = pl.DataFrame(table.get_columns()[:-2])
    if table.height == 0 or math.isfinite(table[_SUM][0]):
        return BlockTable(frame, table.height, 0)
    unknown = int(frame.select(not_finite(wanted)).item())
    return BlockTable(frame.with_columns(finite(wanted)) if unknown else frame, table.height, unknown)


def _sum_of(numbers: Sequence[str]) -> pl.Expr:
    """Return the sum of all numbers, finite only if each number is: faster than a check of each."""
    return pl.sum_horizontal(pl.lit(0.0), *(pl.col(name).sum() for name in numbers), ignore_nulls=False)


def _scanned(block: bytes, layout: TextLayout, types: dict[str, pl.DataType], *, quoted: bool) -> pl.LazyFrame:
    return pl.scan_csv(
        block,
        separator=mark_between(layout),
        has_header=False,
        schema=types,
        quote_char='"' if quoted else None,
        empty_string_is_null=False,
        raise_if_empty=False,
        decimal_comma=layout.decimal_comma,
        missing_columns="insert",
        glob=False,
    )


def _is_even(block: bytes, layout: TextLayout) -> bool:
    """Return whether every line has exactly as many fields as there are names; an empty cell counts as a field."""
    _, _, fields = _lines_of(block, mark_between(layout).encode())
    return bool((fields == len(layout.names)).all())
