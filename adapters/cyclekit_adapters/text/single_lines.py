"""One line of a text log at a time: its cells, or the reason why it is no row; lines of names, pieces of rows.

What follows from it for the lines around is the business of `row_parser`.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import polars as pl

from cyclekit_adapters.text.block_table import mark_between
from cyclekit_adapters.text.text_layout import strict_fields_of
from cyclekit_adapters.text.text_rows import CELL, UNDECODED, UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit_adapters.text.text_layout import Layout

_FAR_TOO_MANY = 50
_NUMBERISH = re.compile(r"[-+.,:0-9eE]+")
_BEGINS_NUMBER = re.compile(r"[-+.,]*\d")


def cells_of(text: str, layout: Layout) -> tuple[str | None, str]:
    """Return the cells of one line joined by `CELL`, None where their number is wrong, and why it is no row."""
    delimiter, width = mark_between(layout), len(layout.names)
    if "\0" in text:
        return None, "NUL bytes in it: the disk was not written"
    if CELL in text and delimiter != CELL:
        return None, "a control character in it: it is garbled"
    found = text.count(delimiter) + 1
    if found > _FAR_TOO_MANY * width + _FAR_TOO_MANY:  # not worth the memory to take it apart
        return None, miscounted(found, width)
    if layout.quotes and '"' in text:
        quoted = strict_fields_of(text, delimiter)
        if quoted is None or text.count('"') % 2:
            return None, "a quote in it is not closed, or stands inside a cell"
        fields = quoted
    else:
        fields = text.split(delimiter)
    if len(fields) > width and not any(cell.strip() for cell in fields[width:]):
        fields = fields[:width]
    if len(fields) != width:
        return None, miscounted(len(fields), width)
    moved = delimiter == " " and "" in fields
    return CELL.join(fields), "two blanks side by side: a field is missing or has moved" if moved else ""


def miscounted(found: int, width: int) -> str:
    """Say that a line has not as many fields as the header."""
    return f"{found} field{'' if found == 1 else 's'} where the header has {width}"


def is_name_line(fields: Sequence[str], layout: Layout, numbers: Sequence[str]) -> bool:
    """Tell whether a line has words in place of all its numbers, as the names of another table or a row of units."""
    told = [cell for cell in fields if cell.lower() not in UNKNOWN]
    if len(fields) != len(layout.names) or len(told) < max(2, len(fields) // 2) or len(set(told)) < 2:
        return False
    if any(_BEGINS_NUMBER.match(cell) or UNDECODED in cell or _is_number(cell, layout) for cell in told):
        return False
    due = [cell for cell, name in zip(fields, layout.names, strict=True) if name in numbers]
    return any(cell.lower() not in UNKNOWN for cell in due)


def is_torn(text: str, layout: Layout) -> bool:
    """Tell whether a line is a number alone: the begin or the end of a row that was torn inside its outermost cell."""
    return len(layout.names) > 1 and bool(_NUMBERISH.fullmatch(text.strip())) and mark_between(layout) not in text


def as_texts(kept: list[str], layout: Layout) -> pl.DataFrame:
    """Return lines from `cells_of` as a table of texts."""
    schema = dict.fromkeys(layout.names, pl.String())
    if not kept:
        return pl.DataFrame(schema=schema)
    body = ("\n".join(kept) + "\n").encode()
    return pl.read_csv(
        body, separator=CELL, has_header=False, schema=schema, quote_char=None, empty_string_is_null=False
    )


def _is_number(cell: str, layout: Layout) -> bool:
    try:
        float(cell.replace(",", ".", 1) if layout.decimal_comma else cell)
    except ValueError:
        return False
    return True
