"""Rows of a text log as tables of numbers and texts: requested columns, unknown values, garbled cells.

This module handles cells only; `row_parser` and `text_blocks` handle lines and files.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Required, TypedDict

import polars as pl

from cyclekit.adapter import NO_VALUE
from cyclekit.errors import DamagedLog, EmptyLog

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit_adapters.text.text_layout import TextLayout

INDEX = "\x1findex"
"""Column of `TextRows.frame`: number of the data row, from 0, without blank lines and headers."""
CELL = "\x1f"
"""Unit separator: our own delimiter for split lines, never part of a log."""
SET_ASIDE = {"source_row": pl.Int64(), "reason": pl.String()}
UNKNOWN = ("", "nan", "null", "none", "na", "n/a", "-")
_NO_VALUE = tuple(word for word in UNKNOWN if word != "nan")  # polars parses "nan" as a number, and it is counted
UNDECODED = "\ufffd"
_IN_QUOTES = r"""^(?:"([^"]*)"|'([^']*)')$"""


@dataclass(frozen=True)
class Wanted:
    """Columns to read, and the values that a row must have.

    Attributes:
        numbers: Columns of numbers; an empty cell, NaN and infinity become null (unknown).
        texts: Columns of text; an empty cell becomes null.
        required: Columns that must have a value, such as the time; rows without it are set aside.
        any_of: Columns of which at least one must have a value, if any are given.
    """

    numbers: Sequence[str]
    texts: Sequence[str] = ()
    required: Sequence[str] = ()
    any_of: Sequence[str] = ()

    @property
    def columns(self) -> list[str]:
        """Return the names of all columns, each once."""
        return list(dict.fromkeys([*self.numbers, *self.texts]))


class ColumnArguments(TypedDict, total=False):
    """The attributes of `Wanted` as keyword arguments."""

    numbers: Required[Sequence[str]]
    texts: Sequence[str]
    required: Sequence[str]
    any_of: Sequence[str]


@dataclass(frozen=True)
class TextRows:
    """The usable rows.

    Attributes:
        frame: Requested columns; `source_row`, the line in the file, from 1 as in editors; and INDEX.
        rows_read: Number of rows read, without blank lines.
        set_aside: Columns `source_row`, `reason`.
        not_finite: Number of values written as NaN or infinity, which are unknown.
    """

    frame: pl.DataFrame
    rows_read: int
    set_aside: pl.DataFrame
    not_finite: int = 0

    def without(self, bad: pl.Series, reason: str) -> TextRows:
        """Return the rows with those where `bad`, shape (N,), is true set aside."""
        if not bad.any():
            return self
        aside = self.frame.filter(bad).select("source_row", pl.lit(reason).alias("reason"))
        set_aside = pl.concat([self.set_aside, aside]).sort("source_row")
        return replace(self, frame=self.frame.filter(~bad), set_aside=set_aside)


def nothing_usable(path: Path, rows_read: int, set_aside: pl.DataFrame) -> DamagedLog:
    """Return the error for a log without a usable row."""
    if rows_read == 0:
        return EmptyLog(path)
    first = set_aside["reason"][0] if set_aside.height else "unknown"
    line = f" (line {set_aside['source_row'][0]})" if set_aside.height else ""
    cause = f"none of its {rows_read} rows can be used; the first{line}: {first}"
    comma = re.search(r"'[+-]?\d+,\d+'.* is not a number", first)
    cure = 'Where commas are decimal marks, map it with adapter = "csv" and decimal = ",".' if comma else None
    return DamagedLog(path, cause, cure=cure or "Check how the file was written or copied.")


def number_in(name: str, layout: TextLayout) -> pl.Expr:
    """Return the cells of a column ready for a cast: trimmed, null where unknown, with a decimal point.

    If the comma is the decimal mark, a cell with a point is rejected: 1.234 may mean 1234.
    """
    text = pl.col(name).str.strip_chars()
    text = pl.when(text.str.to_lowercase().is_in(_NO_VALUE)).then(None).otherwise(text)
    if not layout.decimal_comma:
        return text
    pointed = text.str.contains(".", literal=True)
    return pl.when(pointed).then(text + "?").otherwise(text.str.replace(",", ".", literal=True))


def as_numbers(table: pl.DataFrame, layout: TextLayout, wanted: Wanted) -> tuple[pl.DataFrame, list[tuple[int, str]]]:
    """Return a table of texts with number columns cast and garbled rows removed, and the garbled rows with reasons."""
    garbled: dict[int, str] = {}
    ready = table.select(number_in(name, layout).alias(name) for name in wanted.numbers)
    numbers = ready.select(pl.col(name).cast(pl.Float64, strict=False) for name in wanted.numbers)
    for name in wanted.numbers:
        if numbers[name].null_count() == ready[name].null_count():
            continue
        bad = table.filter(ready[name].is_not_null() & numbers[name].is_null())
        for row, text in bad.select("source_row", pl.col(name).str.strip_chars()).iter_rows():
            garbled.setdefault(row, f"{text[:40]!r} in column {name!r} is not a number")
    unread = table.select(pl.col(name).str.contains(UNDECODED, literal=True).any() for name in wanted.texts)
    for name in [one.name for one in unread.get_columns() if unread.height and one[0]]:
        bad = table.filter(pl.col(name).str.contains(UNDECODED, literal=True))
        for row, text in bad.select("source_row", name).iter_rows():
            cause = f"{text[:40]!r} in column {name!r} is not written in {layout.encoding}: see `encoding`"
            garbled.setdefault(row, cause)
    table = table.with_columns(numbers.get_columns())
    if not garbled:
        return table, []
    return table.filter(~pl.col("source_row").is_in(list(garbled))), list(garbled.items())


def not_finite(wanted: Wanted) -> pl.Expr:
    """Return the number of NaN and infinite values of a table before cleaning."""
    return pl.sum_horizontal(pl.lit(0), *((~pl.col(name).is_finite()).sum() for name in wanted.numbers))


def finite(wanted: Wanted) -> list[pl.Expr]:
    """Return the number columns, null where NaN or infinite."""
    return [pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in wanted.numbers]


def stripped(wanted: Wanted) -> list[pl.Expr]:
    """Return the text columns without surrounding blanks and quotes, null where empty."""
    bare = {name: pl.col(name).str.strip_chars().str.replace(_IN_QUOTES, "$1$2") for name in wanted.texts}
    return [text.replace("", None).alias(name) for name, text in bare.items()]


def trusted(
    table: pl.DataFrame, aside: Sequence[tuple[int, str]], rows_read: int, wanted: Wanted, not_finite: int
) -> TextRows:
    """Return the rows of a table that have all required values; the others are also set aside.

    Args:
        table: `source_row`, INDEX and the cleaned columns.
        aside: Rows already set aside: line and reason.
        rows_read: Number of rows read.
        wanted: Required columns.
        not_finite: Number of NaN or infinite values.
    """
    set_aside = pl.DataFrame(aside, schema=SET_ASIDE, orient="row") if aside else pl.DataFrame(schema=SET_ASIDE)
    rows = TextRows(table, rows_read, set_aside, not_finite)
    if wanted.any_of and all(rows.frame[name].null_count() for name in wanted.any_of):
        nothing = rows.frame.select(pl.all_horizontal(pl.col(wanted.any_of).is_null())).to_series()
        rows = rows.without(nothing, NO_VALUE)
    for name in wanted.required:
        if rows.frame[name].null_count():
            rows = rows.without(rows.frame[name].is_null(), f"no value in column {name!r}")
    return rows
