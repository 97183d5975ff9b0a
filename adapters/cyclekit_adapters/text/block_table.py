"""A block of whole lines parsed by polars at once, or not at all where it could be read otherwise than it was meant.

Polars is fast and forgiving: it fills short rows, cuts long ones, skips what it cannot decode and takes 1.234 for a
number also where the comma is the decimal mark, all without a word. So a block is looked over first, and what is in
doubt is left to `row_parser`, which goes line by line.
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

    from cyclekit_adapters.text.text_layout import Layout

_BEYOND, _DOUBT, _SUM = "\x1fbeyond", "\x1fdoubt", "\x1fsum"  # names that no column of a log has
_LOOKED_AT = 1 << 17
_NEWLINE, _RETURN, _QUOTE, _BLANK = b'\n\r" '
_WHITE = np.frombuffer(b" \t\n\v\f\r", np.uint8)
_PLACES, _PLACE_BYTES = 32, 1024


def mark_between(layout: Layout) -> str:
    """Return what stands between the fields of a block: `text_blocks` has replaced what is not one character."""
    return layout.delimiter if len(layout.delimiter) == 1 else CELL


@dataclass(frozen=True)
class Table:
    """Rows of consecutive lines.

    Attributes:
        frame: The columns wanted, cleaned.
        lines: How many lines they stand in, blank ones included.
        not_finite: How many values are NaN or infinite.
        numbers: The line that each row stands in, from 0, shape (N,); None = one after the other.
    """

    frame: pl.DataFrame
    lines: int
    not_finite: int
    numbers: NDArray[np.int64] | None = None

    def placed(self, line: int, row: int) -> pl.DataFrame:
        """Return the rows with `source_row` and INDEX, given those of the first line."""
        rows = self.frame.height
        lines = np.arange(line, line + rows) if self.numbers is None else self.numbers + line
        places = [pl.Series("source_row", lines), pl.Series(INDEX, np.arange(row, row + rows))]
        return pl.DataFrame([*places, *self.frame.get_columns()])


def table_of(block: bytes, layout: Layout, wanted: Wanted) -> Table | None:
    """Return the rows of whole lines; None if any row may be short, long or garbled.

    Args:
        block: The lines.
        layout: How they are written.
        wanted: The columns to be read.
    """
    if _has_too_many_lines(block, layout) or _may_be_garbled(block, layout, wanted):
        return None
    if (found := _parsed(block, layout, wanted)) is not None:
        return found
    if not _has_blank_lines(block):
        return None
    compact, numbers = _without_blank_lines(block)
    if (found := _parsed(compact, layout, wanted)) is None:
        return None
    return replace(found, lines=block.count(b"\n"), numbers=numbers)


def _may_be_garbled(block: bytes, layout: Layout, wanted: Wanted) -> bool:
    if wanted.texts and UNDECODED.encode() in block:
        return True
    if _has_nul_or_two_blanks(block) if layout.delimiter == " " else b"\0" in block:
        return True
    return layout.quotes and b'"' in block and not _quotes_close(block, layout)


def _has_nul_or_two_blanks(block: bytes) -> bool:
    """Tell whether there is a NUL byte, or two blanks side by side: so many blanks that to search for two is slow.

    Two bytes are both blanks, or a blank and NUL, if the bits that are set in either are those of a blank; the bits of
    two neighbours in a log are mostly more, so that the least of many tells at once. Piece by piece, so that what is
    looked at twice is fetched from memory once.
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


def _quotes_close(block: bytes, layout: Layout) -> bool:
    """Tell whether each quote opens at the begin of a cell and closes at its end, or is doubled inside one."""
    raw = np.frombuffer(block, np.uint8)
    quotes = np.flatnonzero(raw == _QUOTE)
    if len(quotes) % 2:
        return False
    beside = [ord(mark_between(layout)), _NEWLINE, _QUOTE]
    before = raw[quotes[0::2] - 1]  # before the first byte of all this is the last one, a line end
    after = raw[np.minimum(quotes[1::2] + 1, len(raw) - 1)]
    return bool(np.isin(before, beside).all() and np.isin(after, [*beside, ord("\r")]).all())


def _without_blank_lines(block: bytes) -> tuple[bytes, NDArray[np.int64]]:
    """Return whole lines without the blank ones, and which of the lines each was, from 0, shape (N,)."""
    begins, ends, _ = _lines_of(block, None)
    numbers = np.flatnonzero(_is_told(block, begins, ends))
    spans = zip(begins[numbers].tolist(), ends[numbers].tolist(), strict=True)
    return b"".join(block[begin : end + 1] for begin, end in spans), numbers


def short_lines(block: bytes, layout: Layout) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return which lines are not blank, from 0, and how many fields each has, where none has enough; else None.

    A garbled log may have millions of such lines, too many to look at one by one.
    """
    if b"\0" in block or block.count(b"\r") != block.count(b"\r\n"):
        return None
    _, ends, fields = _lines_of(block, mark_between(layout).encode())
    if not len(fields) or fields.max() >= len(layout.names):
        return None
    there = np.flatnonzero(~np.isin(np.frombuffer(block, np.uint8), _WHITE))
    told = np.flatnonzero(np.diff(np.searchsorted(there, ends), prepend=0))
    return told, fields[told]


def _lines_of(block: bytes, mark: bytes | None) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return where the lines of a block begin and end, and how many fields each has, each of shape (N,)."""
    raw = np.frombuffer(block, np.uint8)
    ends = np.flatnonzero(raw == _NEWLINE)
    begins = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
    if mark is None:
        return begins, ends, np.zeros(len(ends), np.int64)
    marks = np.flatnonzero(raw == mark[0])
    return begins, ends, np.diff(np.searchsorted(marks, ends), prepend=0) + 1


def _is_told(block: bytes, begins: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell of each line whether there is anything in it but a carriage return."""
    first = np.frombuffer(block, np.uint8)[begins]
    return np.asarray((ends > begins + 1) | ((ends == begins + 1) & (first != _RETURN)))


def _has_too_many_lines(block: bytes, layout: Layout) -> bool:
    """Tell from a few places of a block whether its lines are too short for the rows of this log.

    Polars would fill up each of them, and need many times the memory of the block.
    """
    step = max(len(block) // _PLACES, _PLACE_BYTES)
    seen = [block[begin : begin + _PLACE_BYTES] for begin in range(0, len(block), step)]
    return sum(part.count(b"\n") for part in seen) * len(layout.names) > sum(map(len, seen))


def _parsed(block: bytes, layout: Layout, wanted: Wanted) -> Table | None:
    first, last = layout.names[0], layout.names[-1]
    quoted = layout.quotes and b'"' in block
    as_text = {last, *(wanted.numbers if layout.decimal_comma and b"." in block else ())}
    types: dict[str, pl.DataType] = {
        name: pl.Float64() if name in wanted.numbers and name not in as_text else pl.String()
        for name in (*layout.names, _BEYOND)
    }
    # Two columns are always read as text: the last one, which is empty in a short row, and one beyond it, which is
    # empty in all but a long row. Where a blank stands between cells, the first one is empty behind a blank.
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
    sure = not quoted and layout.delimiter != " "  # that a field stands where its mark is
    if table.height > 0 and table[_DOUBT][0] and not (sure and _is_even(block, layout)):
        return None
    if quoted and table.height != block.count(b"\n"):
        return None  # a quote that was never closed spans lines
    frame = pl.DataFrame(table.get_columns()[:-2])
    if table.height == 0 or math.isfinite(table[_SUM][0]):
        return Table(frame, table.height, 0)
    unknown = int(frame.select(not_finite(wanted)).item())
    return Table(frame.with_columns(finite(wanted)) if unknown else frame, table.height, unknown)


def _sum_of(numbers: Sequence[str]) -> pl.Expr:
    """Return the sum of all numbers: finite only if each is, and sooner found than whether each is."""
    return pl.sum_horizontal(pl.lit(0.0), *(pl.col(name).sum() for name in numbers), ignore_nulls=False)


def _scanned(block: bytes, layout: Layout, types: dict[str, pl.DataType], *, quoted: bool) -> pl.LazyFrame:
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


def _is_even(block: bytes, layout: Layout) -> bool:
    """Tell whether every line has exactly as many fields as there are names: an empty cell is no missing one."""
    _, _, fields = _lines_of(block, mark_between(layout).encode())
    return bool((fields == len(layout.names)).all())
