"""Rows of a delimited text log, whole and never shifted, and the rows that cannot be trusted.

Every CSV adapter reads through here, because the traps are the same for all: a logger killed in the middle of a
number leaves a value that still parses, a doubled space moves every later column by one, a power cut leaves a block
of NUL bytes. A row is used only if it has as many fields as the header and ends with a line end; all others are set
aside with their row and the reason. What the columns mean is the adapters' business.

Polars parses the file where it stands; only if it stumbles, or a row looks short, are the lines looked at one by one.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import DamagedLog, LogError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

HEAD_BYTES = 16384
_BEYOND = "\x1ebeyond"  # a name that no column of a log has
_CELL = "\x1f"  # unit separator: delimiter of the lines that were taken apart here, never part of a log
_UNKNOWN = ("", "nan", "null", "none", "na", "n/a", "-")
_SET_ASIDE = {"source_row": pl.Int64(), "reason": pl.String()}


@dataclass(frozen=True)
class Layout:
    """How the rows of one text log are written.

    Attributes:
        names: Column names, one per field, all different; what follows the last one in a row must be empty.
        delimiter: One character.
        header_lines: Lines before the first data row.
        decimal_comma: Numbers are written `0,5`.
        encoding: Any that Python knows; other than UTF-8 the file is transcoded in memory.
        quotes: Cells may be quoted, with the delimiter inside; where they are not, a quote is a garbled cell.
        careful: Look at every line from the start (headerless logs, whose first bytes may be a BOM).
    """

    names: tuple[str, ...]
    delimiter: str
    header_lines: int
    decimal_comma: bool = False
    encoding: str = "utf-8"
    quotes: bool = False
    careful: bool = False


@dataclass(frozen=True)
class Rows:
    """The usable rows.

    Attributes:
        frame: Columns asked for, and `source_row`, 0-based among the data rows that are not blank.
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
        if not self.frame.is_empty():
            return self
        if self.rows_read == 0:
            raise DamagedLog(path, "a header and no rows", cure="Nothing was recorded: record again or leave it out.")
        first = self.set_aside["reason"][0] if self.set_aside.height else "unknown"
        cause = f"none of its {self.rows_read} rows can be used; the first: {first}"
        raise DamagedLog(path, cause, cure="Check how the file was written or copied.")


def encoding_of(first: bytes) -> str | None:
    """Return the encoding that the first bytes of a file speak for, or None for a binary file."""
    if first.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    line = first.partition(b"\n")[0]  # what follows it may be a binary part or a block that was never written
    if b"\0" not in line:
        return "utf-8-sig" if first.startswith(b"\xef\xbb\xbf") else "utf-8"
    if len(line) >= 4 and line[1::2].count(0) > 0.9 * len(line[1::2]) and 0 not in line[0::2]:
        return "utf-16-le"
    return None


def head_of(path: Path, size: int = HEAD_BYTES) -> str:
    """Return the first `size` bytes of a text file, decoded; empty for a binary, unreadable or absent file."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as log:
            first = log.read(size)
    except OSError:
        return ""
    encoding = encoding_of(first)
    return first.decode(encoding, "replace") if encoding else ""


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
    if '"' not in text:
        return text.split(delimiter)
    try:
        return next(csv.reader([text], delimiter=delimiter), [])
    except csv.Error:
        return text.split(delimiter)


def read_rows(
    path: Path, layout: Layout, *, numbers: Sequence[str], texts: Sequence[str] = (), required: Sequence[str] = ()
) -> Rows:
    """Read the columns `numbers` (Float64) and `texts` (String) of every trustworthy row.

    Args:
        path: The log.
        layout: How it is written.
        numbers: Columns of numbers; an empty cell, NaN and infinity become null: unknown.
        texts: Columns of text; an empty cell becomes null.
        required: Columns without whose value a row is useless (its time): such rows are set aside.

    Raises:
        LogError: The file cannot be opened.
    """
    try:
        source = _source(path, layout)
        slow = layout.careful or (layout.quotes and _has_quotes(source, layout))
        rows = None if slow else _parse_whole(source, path, layout, numbers, texts)
        if rows is None:
            rows = _parse_by_line(_lines(source), layout, numbers, texts)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path and its rights.") from error
    return _without_unknown(rows, required)


def rows_of(
    lines: Iterable[bytes],
    layout: Layout,
    *,
    numbers: Sequence[str],
    texts: Sequence[str] = (),
    required: Sequence[str] = (),
) -> Rows:
    """Read rows as `read_rows` does, out of lines with their line ends: a section of a file of several tables."""
    return _without_unknown(_parse_by_line(lines, layout, numbers, texts), required)


def _source(path: Path, layout: Layout) -> Path | bytes:
    if layout.encoding in ("utf-8", "utf-8-sig"):
        return path
    return path.read_bytes().decode(layout.encoding, "replace").encode()


def _lines(source: Path | bytes) -> Iterator[bytes]:
    with io.BytesIO(source) if isinstance(source, bytes) else source.open("rb") as log:
        yield from log


def _has_quotes(source: Path | bytes, layout: Layout) -> bool:
    with io.BytesIO(source) if isinstance(source, bytes) else source.open("rb") as log:
        for _ in range(layout.header_lines):
            log.readline()
        return any(b'"' in block for block in iter(lambda: log.read(1 << 20), b""))


def _parse_whole(
    source: Path | bytes, path: Path, layout: Layout, numbers: Sequence[str], texts: Sequence[str]
) -> Rows | None:
    """Parse at full speed; None if any row is short, long or not a number where one is due."""
    last = layout.names[-1]
    wanted = set(numbers)
    types: dict[str, pl.DataType] = {
        name: pl.Float64() if name in wanted and name != last else pl.String() for name in (*layout.names, _BEYOND)
    }
    try:
        # Polars fills short rows and cuts long ones without a word. So two columns are always read as text: the
        # last one, which is empty in a short row, and one beyond it, which is empty in all but a long row.
        frame = pl.scan_csv(
            io.BytesIO(source) if isinstance(source, bytes) else source,
            separator=layout.delimiter,
            has_header=False,
            skip_lines=layout.header_lines,
            schema=types,
            quote_char=None,
            empty_string_is_null=False,
            raise_if_empty=False,
            decimal_comma=layout.decimal_comma,
            missing_columns="insert",
            glob=False,
        )
        table = frame.select(list(dict.fromkeys([*numbers, *texts, last, _BEYOND]))).collect()
        beyond = table[_BEYOND].fill_null("").str.strip_chars()
        if (beyond != "").any() or (table[last].str.strip_chars() == "").any():
            return None
        if last in wanted:
            table = table.with_columns(_number(last, layout).cast(pl.Float64, strict=True).alias(last))
    except pl.exceptions.PolarsError:
        return None
    table = table.with_row_index("source_row").with_columns(pl.col("source_row").cast(pl.Int64))
    rows = table.height
    aside: list[tuple[int, str]] = []
    if rows and not _ends_with_line_end(source, path):
        table, aside = table.head(rows - 1), [(rows - 1, _CUT)]
    return Rows(_tidied(table, numbers, texts), rows, _aside(aside))


_CUT = "the last line has no line end: it was cut while being written"


def _ends_with_line_end(source: Path | bytes, path: Path) -> bool:
    if isinstance(source, bytes):
        return source.endswith(b"\n")
    with path.open("rb") as log:
        log.seek(-1, io.SEEK_END)
        return log.read(1) == b"\n"


def _parse_by_line(lines: Iterable[bytes], layout: Layout, numbers: Sequence[str], texts: Sequence[str]) -> Rows:
    kept: list[str] = []
    kept_rows: list[int] = []
    aside: list[tuple[int, str]] = []
    row = -1
    for index, line in enumerate(lines):
        content = line.rstrip(b"\r\n")
        if index < layout.header_lines or not content.strip():
            continue
        row += 1
        cells, reason = _cells(line, layout)
        if cells is None:
            aside.append((row, reason))
        else:
            kept.append(cells)
            kept_rows.append(row)
    table = _as_texts(kept, layout).select(list(dict.fromkeys([*numbers, *texts])))
    table = table.with_columns(pl.Series("source_row", kept_rows, dtype=pl.Int64))
    table, garbled = _as_numbers(table, layout, numbers)
    return Rows(_tidied(table, numbers, texts), row + 1, _aside(sorted(aside + garbled)))


def _cells(line: bytes, layout: Layout) -> tuple[str | None, str]:
    """Return the cells of one line joined by `_CELL`, or None and the reason why the line is not used."""
    if not line.endswith(b"\n"):
        return None, _CUT
    text = line.decode("utf-8", "replace").rstrip("\r\n").removeprefix("\ufeff")
    text = _CELL.join(fields_of(text, layout.delimiter)) if layout.quotes else text.replace(layout.delimiter, _CELL)
    width, found = len(layout.names), text.count(_CELL) + 1
    if found > width:
        fields = text.split(_CELL)
        if not any(cell.strip() for cell in fields[width:]):
            return _CELL.join(fields[:width]), ""
    if found != width:
        nul = ", and NUL bytes: the disk was not written" if "\0" in text else ""
        return None, f"{found} fields where the header has {width}{nul}"
    return text, ""


def _as_texts(kept: list[str], layout: Layout) -> pl.DataFrame:
    schema = dict.fromkeys(layout.names, pl.String())
    if not kept:
        return pl.DataFrame(schema=schema)
    body = ("\n".join(kept) + "\n").encode()
    return pl.read_csv(
        io.BytesIO(body),
        separator=_CELL,
        has_header=False,
        schema=schema,
        quote_char=None,
        empty_string_is_null=False,
    )


def _number(name: str, layout: Layout) -> pl.Expr:
    text = pl.col(name).str.strip_chars()
    if layout.decimal_comma:
        text = text.str.replace(",", ".", literal=True)
    return pl.when(text.str.to_lowercase().is_in(_UNKNOWN)).then(None).otherwise(text)


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
    return table.filter(~pl.col("source_row").is_in(list(garbled))), list(garbled.items())


def _tidied(table: pl.DataFrame, numbers: Sequence[str], texts: Sequence[str]) -> pl.DataFrame:
    finite = [pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in numbers]
    clean = [pl.col(name).str.strip_chars().str.strip_chars('"').replace("", None).alias(name) for name in texts]
    return table.select("source_row", *finite, *clean)


def _without_unknown(rows: Rows, required: Sequence[str]) -> Rows:
    frame, aside = rows.frame, [rows.set_aside]
    for name in required:
        known = frame[name].is_not_null()
        reason = pl.lit(f"no value in column {name!r}").alias("reason")
        aside.append(frame.filter(~known).select("source_row", reason))
        frame = frame.filter(known)
    return Rows(frame, rows.rows_read, pl.concat(aside).sort("source_row"))


def _aside(rows: Sequence[tuple[int, str]]) -> pl.DataFrame:
    return pl.DataFrame(rows, schema=_SET_ASIDE, orient="row")
