"""Sheets of an Excel workbook as tables, as RobotStudio and spreadsheet programs save logs.

Read by calamine through fastexcel, the engine of `polars.read_excel`. Number cells keep their exact value, texts are
parsed as in text tables, dates become `2024-05-01 10:00:00.250`. `mapped_csv` interprets the columns; `workbook` limits
the size.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import polars as pl

from cyclekit.errors import CyclekitError, DamagedLog, MissingExtra, UnknownName
from cyclekit_adapters.mapped.csv_map import WHERE
from cyclekit_adapters.text.text_layout import TextLayout, unique
from cyclekit_adapters.text.text_rows import (
    INDEX,
    TextRows,
    Wanted,
    as_numbers,
    finite,
    not_finite,
    stripped,
    trusted,
)
from cyclekit_adapters.text.workbook import safe_copy

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path

    from cyclekit_adapters.mapped.csv_map import CsvMap

Read = TypeVar("Read")
_ROWS_LOOKED_AT = 50
_BLOCK = 100_000
_EXACT = "\x1fexact "


class Workbook:
    """An open Excel workbook."""

    def __init__(self, path: Path) -> None:
        try:
            import fastexcel
        except ImportError as error:
            raise MissingExtra("fastexcel", "excel", f"{path}: reading an Excel workbook") from error
        self.path = path
        self._reader: Any = _guarded(path, lambda: fastexcel.read_excel(safe_copy(path)))

    @property
    def sheets(self) -> list[str]:
        """Names of its sheets."""
        return [str(name) for name in self._reader.sheet_names]

    def cells(
        self, sheet: str, kind: str, *, count: int | None = None, among: Collection[int] | None = None
    ) -> dict[int, pl.Series]:
        """Return the columns of a sheet, by number from 0, with all rows from the first.

        Args:
            sheet: Name of the sheet.
            kind: `string` or `float`; with `float`, cells without a number are null.
            count: Maximum number of rows; None = all.
            among: Column numbers to read; empty columns are left out; None = all.
        """
        some = None if among is None else sorted(among)
        if some == []:
            return {}
        how = {"header_row": None, "skip_rows": 0, "dtypes": kind, "n_rows": count, "use_columns": some}
        loaded = _guarded(self.path, lambda: self._reader.load_sheet(sheet, **how))
        places = [column.absolute_index for column in loaded.selected_columns]
        if not places or not loaded.height:
            return {}
        return dict(zip(places, loaded.to_polars().get_columns(), strict=True))


def _guarded(path: Path, read: Callable[[], Read]) -> Read:
    """Return the reader's result; turn any error of it, panics included, into one DamagedLog."""
    try:
        return read()
    except (CyclekitError, KeyboardInterrupt, MemoryError):
        raise
    except BaseException as error:
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        first = str(error).partition("\n")[0][:120]
        raise DamagedLog(path, f"not a workbook that can be read ({first})", cure="Save it as .xlsx again.") from error


@dataclass(frozen=True)
class SheetTable:
    """One sheet as the table that a column map refers to."""

    workbook: Workbook
    sheet: str
    header: int | None
    skip: int
    columns: tuple[str, ...]
    comma: bool

    @cached_property
    def _head(self) -> dict[int, pl.Series]:
        return self.workbook.cells(self.sheet, "string", count=self.skip + _ROWS_LOOKED_AT)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Column names; an empty column gets its number as name."""
        if self.columns:
            return unique(self.columns)
        width = max(self._head, default=-1) + 1
        return unique(self._cell(at, self.header or 0) for at in range(width))

    @property
    def first_rows(self) -> list[list[str]]:
        """Cells of the first rows."""
        return rows_of(self._head, self.skip, _ROWS_LOOKED_AT, len(self.names))

    @property
    def facts(self) -> dict[str, str]:
        """Name of the sheet, as a fact of the log."""
        return {"sheet": self.sheet}

    def cure(self, _wanted: Collection[str], _mapping: CsvMap) -> str:
        """Return a hint with the existing columns and sheets."""
        others = ", ".join(name[:40] for name in self.workbook.sheets[:20])
        return f"Columns of sheet {self.sheet!r}: {', '.join(n[:40] for n in self.names[:60])}. Sheets: {others}."

    def blocks(self, names: tuple[str, ...], wanted: Wanted) -> Iterator[TextRows]:
        """Yield the non-empty rows; `source_row` is the row number of the spreadsheet."""
        places = {name: at for at, name in enumerate(names)}
        there = {name: at for name in wanted.columns if (at := places[name]) in self._head}
        numbers = [there[name] for name in wanted.numbers if name in there]
        texts = self.workbook.cells(self.sheet, "string", among=set(there.values()))
        floats = self.workbook.cells(self.sheet, "float", among=set(numbers))
        height = max(map(len, texts.values()), default=0)
        none = pl.Series(values=[None], dtype=pl.String).extend_constant(None, max(height, 1) - 1)
        table = pl.DataFrame({name: texts.get(places[name], none) for name in wanted.columns})
        table = table.with_columns(
            **{f"{_EXACT}{name}": floats[there[name]] for name in wanted.numbers if name in there}
        )
        non_empty = pl.any_horizontal(pl.col(wanted.columns).str.strip_chars() != "").fill_null(value=False)
        table = table.with_row_index("source_row", offset=1).slice(self.skip).filter(non_empty)
        table = table.with_row_index(INDEX).with_columns(pl.col("source_row", INDEX).cast(pl.Int64))
        layout = TextLayout(names, ";", 0, decimal_comma=self.comma)
        for block in table.iter_slices(_BLOCK):
            yield _block(block, layout, wanted)

    def _cell(self, column: int, row: int) -> str:
        cells = self._head.get(column)
        return str(cells[row] or "") if cells is not None and row < len(cells) else ""


def _block(table: pl.DataFrame, layout: TextLayout, wanted: Wanted) -> TextRows:
    """Return rows of texts as numbers and texts; number cells keep their exact value."""
    rows_read = table.height
    table, garbled = as_numbers(table, layout, wanted)
    exact = [name for name in wanted.numbers if f"{_EXACT}{name}" in table.columns]
    table = table.with_columns(pl.coalesce(f"{_EXACT}{name}", name).alias(name) for name in exact)
    unknown = int(table.select(not_finite(wanted)).item() or 0) if table.height else 0
    table = table.select("source_row", INDEX, *finite(wanted), *stripped(wanted))
    return trusted(table, sorted(garbled), rows_read, wanted, unknown)


def rows_of(columns: dict[int, pl.Series], skip: int, count: int, width: int) -> list[list[str]]:
    """Return the cells of some rows as texts; an empty cell becomes ""."""
    some = {at: [cell or "" for cell in cells.slice(skip, count).to_list()] for at, cells in columns.items()}
    length = max(map(len, some.values()), default=0)
    return [[some[at][row] if at in some else "" for at in range(width)] for row in range(length)]


def sheet_table(path: Path, mapping: CsvMap) -> SheetTable:
    """Return the sheet named in the map, else the first that holds a table.

    Raises:
        MissingExtra: fastexcel is not installed.
        UnknownName: The workbook has no sheet of that name.
        DamagedLog: The workbook is damaged, or holds no table.
    """
    workbook = Workbook(path)
    if mapping.sheet is not None and mapping.sheet not in workbook.sheets:
        raise UnknownName(f"{path} and {WHERE}", "sheet", mapping.sheet, workbook.sheets)
    for sheet in [mapping.sheet] if mapping.sheet is not None else workbook.sheets:
        header = None if mapping.columns else mapping.skip_rows
        skip = mapping.skip_rows + (not mapping.columns)
        table = SheetTable(workbook, sheet, header, skip, mapping.columns, mapping.decimal == ",")
        if len([name for name in table.names if name]) > 1 and any(any(row) for row in table.first_rows):
            return table
    cause = "no sheet of it holds a table" if mapping.sheet is None else f"its sheet {mapping.sheet!r} holds no table"
    raise DamagedLog(path, cause, cure="Name another sheet, or the rows above the header: skip_rows = ...")
