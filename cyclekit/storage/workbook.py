"""Write tables as an Excel workbook, atomically; texts never become formulas, links or numbers."""

from __future__ import annotations

import math
from numbers import Real
from typing import TYPE_CHECKING, Any

from cyclekit.errors import MissingExtra
from cyclekit.storage.atomic import replaced
from cyclekit.text.plain_text import is_formula, one_line

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    Rows = Sequence[Sequence[object]]

MARK = "written by cyclekit"
"""Comment in the workbook's properties, by which `guard` recognises it before it is replaced."""
SHOWN, LEAST = "0.000", 0.0005
"""How a cell shows a number that is not whole, and the least part of one that this shows; it holds every digit."""
LONGEST = 32_767
"""Maximum length of a text in a cell of Excel, characters."""


def write_workbook(file: Path, sheets: Mapping[str, Rows]) -> None:
    """Write a workbook atomically.

    Args:
        file: The workbook, `.xlsx`.
        sheets: Rows by name of the sheet; the first row is the header. Texts stay texts; numbers that are not finite
            give empty cells.

    Raises:
        MissingExtra: XlsxWriter is not installed.
        CyclekitError: The file cannot be written; the old one is unchanged.
    """
    try:
        from xlsxwriter import Workbook
    except ImportError as error:
        raise MissingExtra("xlsxwriter", "excel", f"{file}: writing an Excel workbook") from error
    with replaced(file) as temporary:
        book = Workbook(str(temporary), {"in_memory": True})
        book.set_properties({"comments": MARK})
        looks = {"head": book.add_format({"bold": True}), "quoted": book.add_format({"quote_prefix": True})}
        looks["number"] = book.add_format({"num_format": SHOWN})
        for name, rows in sheets.items():
            sheet = book.add_worksheet(name)
            for at, row in enumerate(rows):
                for column, value in enumerate(row):
                    _write(sheet, at, column, value, looks)
            sheet.freeze_panes(1, 0)
            sheet.autofit()
        book.close()


def _write(sheet: Any, row: int, column: int, value: object, looks: Mapping[str, Any]) -> None:  # noqa: ANN401
    head = looks["head"] if row == 0 else None
    if isinstance(value, bool):
        sheet.write_boolean(row, column, value)
    elif isinstance(value, Real):
        if math.isfinite(value):
            shown = looks["number"] if abs(float(value) % 1.0 - 0.5) <= 0.5 - LEAST else None
            sheet.write_number(row, column, value, shown)
    elif value is not None:
        text = one_line(str(value))[:LONGEST]
        sheet.write_string(row, column, text, looks["quoted"] if is_formula(text) else head)
