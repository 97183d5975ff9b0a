"""Rows of a delimited text log, whole and never shifted, and the rows that cannot be trusted.

Every CSV adapter reads through here, because the traps are the same for all: a logger killed in the middle of a
number leaves a value that still parses, a doubled space moves every later column by one, a power cut leaves a block
of NUL bytes. A row is used only if it has as many fields as the header and ends with a line end; all others are set
aside with their line and the reason. What the columns mean is the adapters' business, how bytes become lines that of
`text_blocks`.

A block of lines is parsed by polars at once; only where it stumbles, or a row looks short, is the block halved, and
the lines around the trouble looked at one by one. So a log of any size takes the memory of a block.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.text_blocks import blocks_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

INDEX = "\x1findex"
"""Column of `Rows.frame`: number of the data row, from 0, blank lines and headers not counted."""
_BEYOND, _DOUBT = "\x1fbeyond", "\x1fdoubt"  # names that no column of a log has
_CELL = "\x1f"  # unit separator: delimiter of the lines that were taken apart here, never part of a log
_UNKNOWN = ("", "nan", "null", "none", "na", "n/a", "-")
_SET_ASIDE = {"source_row": pl.Int64(), "reason": pl.String()}
_ONE_BY_ONE = 1 << 17  # bytes; a block in trouble is halved down to here, then read line by line
_CUT = "the last line has no line end: it was cut while being written"
_NEWLINE = ord("\n")


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


@dataclass(frozen=True)
class Rows:
    """The usable rows.

    Attributes:
        frame: Columns asked for; `source_row`, the line of the file, from 1 as editors count; and INDEX.
        rows_read: Rows looked at, blank lines not counted.
        set_aside: Columns `source_row`, `reason`.
    """

    frame: pl.DataFrame
    rows_read: int
    set_aside: pl.DataFrame

    def or_refuse(self, path: Path) -> Rows:
        """Return these rows, or refuse the log if none of them can be used.

        Raises:
            DamagedLog: No row is usable; the message gives the first reason.
        """
        if self.frame.is_empty():
            raise nothing_usable(path, self.rows_read, self.set_aside)
        return self

    def without(self, bad: pl.Series, reason: str) -> Rows:
        """Return the rows with those for which `bad`, shape (N,), is true set aside."""
        if not bad.any():
            return self
        aside = self.frame.filter(bad).select("source_row", pl.lit(reason).alias("reason"))
        return Rows(self.frame.filter(~bad), self.rows_read, pl.concat([self.set_aside, aside]).sort("source_row"))


def nothing_usable(path: Path, rows_read: int, set_aside: pl.DataFrame) -> DamagedLog:
    """Return the error for a log without a usable row."""
    if rows_read == 0:
        return DamagedLog(path, "a header and no rows", cure="Nothing was recorded: record again or leave it out.")
    first = set_aside["reason"][0] if set_aside.height else "unknown"
    line = f" (line {set_aside['source_row'][0]})" if set_aside.height else ""
    cause = f"none of its {rows_read} rows can be used; the first{line}: {first}"
    return DamagedLog(path, cause, cure="Check how the file was written or copied.")


def delimiter_of(line: str, candidates: str = ",;\t ") -> str:
    """Return the candidate that occurs most often in `line`, the first of them where none is ahead."""
    return max(candidates, key=line.count)


def unique(names: Iterable[str]) -> tuple[str, ...]:
    """Return `names` stripped, with `#2`, `#3` behind repeated or nameless ones, so that no column hides another."""
    seen = {"source_row": 1}  # the name of the column that is added here
    out: list[str] = []
    for raw in names:
        name = raw.strip()
        seen[name] = seen.get(name, 0) + 1
        out.append(name if name and seen[name] == 1 else f"{name}#{seen[name]}")
    return tuple(out)


def header_names(line: str, delimiter: str) -> tuple[str, ...]:
    """Return the column names of a header line without the empty ones at its end."""
    cells = fields_of(line, delimiter)
    while cells and not cells[-1].strip():
        cells.pop()
    return unique(cells)


def fields_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line; quotes are taken off where they close."""
    text = line.rstrip("\r\n")
    if delimiter == "\\s+":
        return text.split()
    if '"' not in text or len(delimiter) > 1:
        return text.split(delimiter)
    try:
        return next(csv.reader([text], delimiter=delimiter), [])
    except csv.Error:
        return text.split(delimiter)


def read_rows(
    path: Path, layout: Layout, *, numbers: Sequence[str], texts: Sequence[str] = (), required: Sequence[str] = ()
) -> Rows:
    """Read the columns `numbers` (Float64) and `texts` (String) of every trustworthy row, the whole log at once.

    Args:
        path: The log.
        layout: How it is written.
        numbers: Columns of numbers; an empty cell, NaN and infinity become null: unknown.
        texts: Columns of text; an empty cell becomes null.
        required: Columns without whose value a row is useless (its time): such rows are set aside.

    Raises:
        LogError: The file cannot be opened.
    """
    return joined(read_blocks(path, layout, numbers=numbers, texts=texts, required=required), numbers, texts)


def read_blocks(
    path: Path, layout: Layout, *, numbers: Sequence[str], texts: Sequence[str] = (), required: Sequence[str] = ()
) -> Iterator[Rows]:
    """Yield what `read_rows` returns, some tens of thousands of rows at a time, for logs of any size.

    Raises:
        LogError: The file cannot be opened, or holds a line longer than any logger writes.
    """
    try:
        parser = _Parser(layout, numbers, texts, required, line=layout.header_lines + 1)
        for block in blocks_of(path, layout.encoding, skip_lines=layout.header_lines, delimiter=layout.delimiter):
            yield from parser.rows(block)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its rights.") from error


def rows_of(
    blocks: Iterable[bytes],
    layout: Layout,
    *,
    numbers: Sequence[str],
    texts: Sequence[str] = (),
    required: Sequence[str] = (),
    first_line: int = 1,
) -> Rows:
    """Read rows as `read_rows` does, out of lines with their line ends: a section of a file of several tables.

    Args:
        blocks: Whole lines of UTF-8 text, in pieces of any size; the first `layout.header_lines` of them are no rows.
        layout: How they are written.
        numbers: As in `read_rows`.
        texts: As in `read_rows`.
        required: As in `read_rows`.
        first_line: Line of the file that the first of these is.
    """
    lines = row_blocks(blocks, layout, numbers=numbers, texts=texts, required=required, first_line=first_line)
    return joined(lines, numbers, texts)


def row_blocks(
    blocks: Iterable[bytes],
    layout: Layout,
    *,
    numbers: Sequence[str],
    texts: Sequence[str] = (),
    required: Sequence[str] = (),
    first_line: int = 1,
) -> Iterator[Rows]:
    """Yield what `rows_of` returns, piece by piece."""
    parser = _Parser(layout, numbers, texts, required, line=first_line, skip=layout.header_lines)
    for block in blocks:
        yield from parser.rows(block)


def joined(parts: Iterable[Rows], numbers: Sequence[str] = (), texts: Sequence[str] = ()) -> Rows:
    """Put blocks of rows together; the columns are given for the case that there is none."""
    every = list(parts)
    if not every:
        columns = {"source_row": pl.Int64(), INDEX: pl.Int64()}
        schema = columns | dict.fromkeys(numbers, pl.Float64()) | dict.fromkeys(texts, pl.String())
        return Rows(pl.DataFrame(schema=schema), 0, pl.DataFrame(schema=_SET_ASIDE))
    if len(every) == 1:
        return every[0]
    frame = pl.concat([rows.frame for rows in every])
    return Rows(frame, sum(rows.rows_read for rows in every), pl.concat([rows.set_aside for rows in every]))


@dataclass
class _Parser:
    """Parses blocks of lines one after the other, and knows which line comes next.

    Attributes:
        line: Number of the next line in its file.
        skip: Lines still to be passed over.
        row: Number of the next data row.
        ended: Why nothing is read any more: another table began.
    """

    layout: Layout
    numbers: Sequence[str]
    texts: Sequence[str]
    required: Sequence[str]
    line: int = 1
    skip: int = 0
    row: int = 0
    ended: str = ""
    _wanted: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self._wanted = list(dict.fromkeys([*self.numbers, *self.texts]))

    def rows(self, block: bytes) -> Iterator[Rows]:
        """Yield the rows of a block of lines; of the last block of a file the last line may lack its end."""
        while self.skip and block:
            _, _, block = block.partition(b"\n")
            self.skip, self.line = self.skip - 1, self.line + 1
        whole = block.rfind(b"\n") + 1
        if whole:
            yield from self._halved(block[:whole])
        if tail := block[whole:]:
            if tail.strip():
                yield self._rows([], [], [(self.line, _CUT)], rows_read=1)
                self.row += 1
            self.line += 1

    def _halved(self, block: bytes) -> Iterator[Rows]:
        """Yield the rows of whole lines: at once where all is well, else half by half."""
        if not self.ended and (rows := self._at_once(block)) is not None:
            yield rows
            return
        middle = block.find(b"\n", len(block) // 2) + 1
        if self.ended or len(block) <= _ONE_BY_ONE or not 0 < middle < len(block):
            yield self._one_by_one(block)
            return
        yield from self._halved(block[:middle])
        yield from self._halved(block[middle:])

    def _at_once(self, block: bytes) -> Rows | None:
        """Parse whole lines at full speed; None if any row is short, long or not a number where one is due."""
        table, lines = self._table(block), None
        if table is None and _has_blank_lines(block):
            compact, lines = _without_blank_lines(block)
            table = self._table(compact)
        if table is None:
            return None
        if lines is not None:
            table = table.with_columns((lines + self.line).alias("source_row"))
        self.line += table.height if lines is None else block.count(b"\n")
        self.row += table.height
        return self._trusted(table, [], table.height)

    def _table(self, block: bytes) -> pl.DataFrame | None:
        layout, last = self.layout, self.layout.names[-1]
        quoted = layout.quotes and b'"' in block
        types: dict[str, pl.DataType] = {
            name: pl.Float64() if name in self.numbers and name != last else pl.String()
            for name in (*layout.names, _BEYOND)
        }
        # Polars fills short rows and cuts long ones without a word. So two columns are always read as text: the last
        # one, which is empty in a short row, and one beyond it, which is empty in all but a long row.
        short, long = pl.col(last).str.strip_chars() == "", pl.col(_BEYOND).str.strip_chars() != ""
        number = _number(last, layout).cast(pl.Float64, strict=True).alias(last)
        place = pl.int_range(pl.len(), dtype=pl.Int64)
        places = (place + self.line).alias("source_row"), (place + self.row).alias(INDEX)
        try:
            table = (
                _scan(block, layout, types, quoted=quoted)
                .with_columns((short.any() | long.any()).alias(_DOUBT), *([number] if last in self.numbers else []))
                .select(*places, *self._clean(), _DOUBT)
                .collect(engine="in-memory")
            )
        except pl.exceptions.PolarsError:
            return None
        doubtful = table.height > 0 and table[_DOUBT][0]
        if doubtful and (quoted or not _is_even(block, layout)):
            return None
        if quoted and table.height != block.count(b"\n"):
            return None  # a quote that was never closed
        return pl.DataFrame(table.get_columns()[:-1])

    def _clean(self) -> list[pl.Expr]:
        """Return the columns asked for: numbers that are finite, texts without blanks and quotes around them."""
        finite = [pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in self.numbers]
        texts = [pl.col(name).str.strip_chars().str.strip_chars('"') for name in self.texts]
        return [*finite, *(text.replace("", None).alias(name) for text, name in zip(texts, self.texts, strict=True))]

    def _one_by_one(self, block: bytes) -> Rows:
        kept: list[str] = []
        places: list[tuple[int, int]] = []
        aside: list[tuple[int, str]] = []
        begin = self.row
        for content in block.split(b"\n")[:-1]:
            line, self.line = self.line, self.line + 1
            if not content.strip():
                continue
            row, self.row = self.row, self.row + 1
            cells, reason = (None, self.ended) if self.ended else self._cells(content)
            if cells is None:
                aside.append((line, reason))
            elif said := self._as_header(cells, line):
                aside.append((line, said))
            else:
                kept.append(cells)
                places.append((line, row))
        return self._rows(kept, places, aside, rows_read=self.row - begin)

    def _cells(self, content: bytes) -> tuple[str | None, str]:
        """Return the cells of one line joined by `_CELL`, or None and the reason why the line is not used."""
        layout = self.layout
        text = content.decode("utf-8", "replace").rstrip("\r")
        if layout.quotes and '"' in text:
            text = _CELL.join(fields_of(text, _polars_delimiter(layout)))
        else:
            text = text.replace(_polars_delimiter(layout), _CELL)
        width, found = len(layout.names), text.count(_CELL) + 1
        if found > width:
            fields = text.split(_CELL)
            if not any(cell.strip() for cell in fields[width:]):
                return _CELL.join(fields[:width]), ""
        if found != width:
            nul = ", and NUL bytes: the disk was not written" if "\0" in text else ""
            return None, f"{found} fields where the header has {width}{nul}"
        return text, ""

    def _as_header(self, cells: str, line: int) -> str:
        """Return why a row is no row because it names columns, empty if it does not.

        The same names again are a recording that was continued; other names are another table, whose numbers must
        not be taken for this one's.
        """
        fields = [cell.strip() for cell in cells.split(_CELL)]
        if tuple(fields) == self.layout.names:
            return "the header once more"
        named = [fields[at] for at, name in enumerate(self.layout.names) if name in self.numbers]
        words = all(cell.lower() not in _UNKNOWN and _parsed(cell, self.layout) is None for cell in fields)
        if not named or not words or len(set(fields)) < max(2, len(fields)) or "\ufffd" in cells or "\0" in cells:
            return ""
        shown = ", ".join(fields)[:60]
        self.ended = f"another table begins in line {line} ({shown}): cut the file there to read it"
        return self.ended

    def _rows(
        self, kept: list[str], places: list[tuple[int, int]], aside: list[tuple[int, str]], rows_read: int
    ) -> Rows:
        table = _as_texts(kept, self.layout).select(self._wanted)
        where = pl.DataFrame(places, schema={"source_row": pl.Int64(), INDEX: pl.Int64()}, orient="row")
        table, garbled = _as_numbers(pl.concat([where, table], how="horizontal"), self.layout, self.numbers)
        return self._trusted(table.select("source_row", INDEX, *self._clean()), sorted(aside + garbled), rows_read)

    def _trusted(self, table: pl.DataFrame, aside: Sequence[tuple[int, str]], rows_read: int) -> Rows:
        rows = Rows(table, rows_read, pl.DataFrame(aside, schema=_SET_ASIDE, orient="row"))
        for name in self.required:
            if rows.frame[name].null_count():
                rows = rows.without(rows.frame[name].is_null(), f"no value in column {name!r}")
        return rows


def _has_blank_lines(block: bytes) -> bool:
    return block.startswith((b"\n", b"\r\n")) or b"\n\n" in block or b"\n\r\n" in block


def _scan(block: bytes, layout: Layout, types: dict[str, pl.DataType], *, quoted: bool) -> pl.LazyFrame:
    return pl.scan_csv(
        block,
        separator=_polars_delimiter(layout),
        has_header=False,
        schema=types,
        quote_char='"' if quoted else None,
        empty_string_is_null=False,
        raise_if_empty=False,
        decimal_comma=layout.decimal_comma,
        missing_columns="insert",
        glob=False,
    )


def _polars_delimiter(layout: Layout) -> str:
    """Return what stands between the fields of a block: `text_blocks` has replaced what is not one character."""
    return layout.delimiter if len(layout.delimiter) == 1 else _CELL


def _without_blank_lines(block: bytes) -> tuple[bytes, pl.Series]:
    """Return whole lines without the blank ones, and which of the lines each was, from 0, shape (N,)."""
    lines = block.split(b"\n")[:-1]
    numbers = [number for number, line in enumerate(lines) if line.strip(b"\r")]
    compact = b"\n".join([*(lines[number] for number in numbers), b""]) if numbers else b""
    return compact, pl.Series(numbers, dtype=pl.Int64)


def _is_even(block: bytes, layout: Layout) -> bool:
    """Tell whether every line has exactly as many fields as there are names: an empty cell is no missing one."""
    raw = np.frombuffer(block, np.uint8)
    ends = np.flatnonzero(raw == _NEWLINE)
    marks = np.flatnonzero(raw == ord(_polars_delimiter(layout)))
    per_line = np.diff(np.searchsorted(marks, ends), prepend=0)
    return bool((per_line == len(layout.names) - 1).all())


def _as_texts(kept: list[str], layout: Layout) -> pl.DataFrame:
    schema = dict.fromkeys(layout.names, pl.String())
    if not kept:
        return pl.DataFrame(schema=schema)
    body = ("\n".join(kept) + "\n").encode()
    return pl.read_csv(
        body, separator=_CELL, has_header=False, schema=schema, quote_char=None, empty_string_is_null=False
    )


def _number(name: str, layout: Layout) -> pl.Expr:
    text = pl.col(name).str.strip_chars()
    if layout.decimal_comma:
        text = text.str.replace(",", ".", literal=True)
    return pl.when(text.str.to_lowercase().is_in(_UNKNOWN)).then(None).otherwise(text)


def _parsed(cell: str, layout: Layout) -> float | None:
    try:
        return float(cell.replace(",", ".", 1) if layout.decimal_comma else cell)
    except ValueError:
        return None


def _as_numbers(
    table: pl.DataFrame, layout: Layout, numbers: Sequence[str]
) -> tuple[pl.DataFrame, list[tuple[int, str]]]:
    garbled: dict[int, str] = {}
    for name in numbers:
        pair = table.select("source_row", text=_number(name, layout))
        pair = pair.with_columns(number=pl.col("text").cast(pl.Float64, strict=False))
        bad = pair.filter(pl.col("text").is_not_null() & pl.col("number").is_null())
        for row, text in bad.select("source_row", "text").iter_rows():
            garbled.setdefault(row, f"{text[:40]!r} in column {name!r} is not a number")
        table = table.with_columns(pair["number"].alias(name))
    if not garbled:
        return table, []
    return table.filter(~pl.col("source_row").is_in(list(garbled))), list(garbled.items())
