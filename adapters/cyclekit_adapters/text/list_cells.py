"""Lists of numbers in one cell (`"[0.1, -0.2, 0.3]"`), split into columns.

Programs that write a vector as one value produce them: exports of UR and LeRobot, numpy arrays through pandas. Any
brackets are accepted, with commas, semicolons or blanks between the numbers. A row is set aside if its list is cut, has
another length than the first list, or holds a word, because the missing number is unknown.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit_adapters.text.text_rows import CELL, UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cyclekit_adapters.text.text_rows import TextRows

_SHAPE = r"^\s*(?:[A-Za-z_.]+\(|p)?\s*[\[({]([^\[\](){}]*)[\])}](?:\s*,\s*\w+\s*=[^()]*)?\s*\)?\s*$"
_BETWEEN = r"\s*[,;]\s*|\s+"
_LIST, _PARTS = "\x1flist", "\x1fparts"


def parts_of(cell: str) -> list[str] | None:
    """Return the texts of the numbers of a list in a cell; None if the cell is no list."""
    found = re.match(_SHAPE, cell)
    inner = found[1].strip() if found else ""
    return re.split(_BETWEEN, inner) if inner else None


def first_width(cells: Iterable[str]) -> int | None:
    """Return the length of the first list among cells; None if there is none."""
    return next((len(parts) for cell in cells if (parts := parts_of(cell))), None)


@dataclass
class ListCells:
    """Splits lists into columns, block after block of one log.

    Attributes:
        wanted: For each column of lists: position of a number (from 0) -> name of the new column.
        required: New columns that must have a value; rows without it are set aside.
    """

    wanted: Mapping[str, Mapping[int, str]]
    required: tuple[str, ...] = ()
    _widths: dict[str, int] = field(default_factory=dict)

    def rows(self, rows: TextRows) -> TextRows:
        """Return the rows with the requested numbers as additional columns; doubtful rows are set aside."""
        for column, made in self.wanted.items():
            rows = self._taken_apart(rows, column, made)
        for name in self.required:
            rows = rows.without(rows.frame[name].is_null(), f"no value in column {name!r}")
        return rows

    def _taken_apart(self, rows: TextRows, column: str, made: Mapping[int, str]) -> TextRows:
        inner = pl.col(column).str.extract(_SHAPE, 1).str.strip_chars()
        parts = inner.str.replace_all(_BETWEEN, CELL).str.split(CELL)
        rows = replace(rows, frame=rows.frame.with_columns(inner.alias(_LIST), parts.alias(_PARTS)))
        non_empty = rows.frame[column].is_not_null()
        sample = _first(rows.frame.filter(non_empty & rows.frame[_LIST].is_null()), column)
        rows = rows.without(
            non_empty & rows.frame[_LIST].is_null(), f"{sample!r} in column {column!r} is not a list of numbers"
        )
        lengths = rows.frame[_PARTS].list.len()
        if column not in self._widths and (first := lengths.drop_nulls()[:1].to_list()):
            self._widths[column] = first[0]
        width = self._widths.get(column, 0)
        other = (lengths != width).fill_null(value=False)
        reason = f"a list in column {column!r} does not have {width} numbers as the first one does"
        rows = rows.without(other, reason)
        for place, name in made.items():
            rows = _with_number(rows, column, place, name)
        return replace(rows, frame=rows.frame.drop(_LIST, _PARTS))


def _with_number(rows: TextRows, column: str, place: int, name: str) -> TextRows:
    text = pl.col(_PARTS).list.get(place, null_on_oob=True).str.strip_chars("'\" ")
    known = pl.when(~text.str.to_lowercase().is_in(UNKNOWN)).then(text)
    number = known.cast(pl.Float64, strict=False)
    rows = replace(rows, frame=rows.frame.with_columns(pl.when(number.is_finite()).then(number).alias(name)))
    bad = rows.frame.select((known.is_not_null() & number.is_null()).alias("bad"))["bad"]
    sample = _first(rows.frame.filter(bad), column)
    return rows.without(bad, f"{sample!r} in column {column!r} holds a value that is not a number")


def _first(frame: pl.DataFrame, column: str) -> str:
    return str(frame[column][0])[:40] if frame.height else ""
