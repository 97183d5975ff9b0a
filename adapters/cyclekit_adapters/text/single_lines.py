"""Checks of single lines of a text log: their cells, or the reason why a line is no row; name lines, row fragments.

`row_parser` decides what that means for neighbouring lines.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import polars as pl

from cyclekit_adapters.text.block_table import mark_between
from cyclekit_adapters.text.text_layout import strict_fields_of, unique
from cyclekit_adapters.text.text_rows import CELL, UNDECODED, UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit_adapters.text.text_layout import TextLayout
    from cyclekit_adapters.text.text_rows import Wanted

_FAR_TOO_MANY = 50
_NUMBERISH = re.compile(r"[-+.,:0-9eE]+")
_BEGINS_NUMBER = re.compile(r"[-+.,]*\d")


def cells_of(text: str, layout: TextLayout) -> tuple[str | None, str]:
    """Return the cells of a line joined by `CELL` (None if their number is wrong), and the reason why it is no row."""
    delimiter, width = mark_between(layout), len(layout.names)
    if "\0" in text:
        return None, "NUL bytes in it: the disk was not written"
    if CELL in text and delimiter != CELL:
        return None, "a control character in it: it is garbled"
    found = text.count(delimiter) + 1
    if found > _FAR_TOO_MANY * width + _FAR_TOO_MANY:  # not worth the memory of splitting it
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
    """Return the message for a line with another number of fields than the header."""
    return f"{found} field{'' if found == 1 else 's'} where the header has {width}"


def is_name_line(fields: Sequence[str], layout: TextLayout, numbers: Sequence[str]) -> bool:
    """Return whether a line holds words instead of all its numbers, as another header or a row of units does."""
    non_empty = [cell for cell in fields if cell.lower() not in UNKNOWN]
    if len(fields) != len(layout.names) or len(non_empty) < max(2, len(fields) // 2) or len(set(non_empty)) < 2:
        return False
    if any(_BEGINS_NUMBER.match(cell) or UNDECODED in cell or _is_number(cell, layout) for cell in non_empty):
        return False
    due = [cell for cell, name in zip(fields, layout.names, strict=True) if name in numbers]
    return any(cell.lower() not in UNKNOWN for cell in due)


def other_header(text: str, layout: TextLayout, wanted: Wanted) -> tuple[str, ...]:
    """Return the names in a line that is another header of the same table; empty for any other line.

    A recording was continued with other columns, or in another order. Such a header names the required columns and at
    least one other that is read.
    """
    needed = wanted.required or wanted.columns
    if not needed or not all(name in text for name in needed):
        return ()
    fields = [cell.strip().strip('"') for cell in strict_fields_of(text, mark_between(layout)) or ()]
    while fields and not fields[-1]:
        fields.pop()
    names, others = unique(fields), set(wanted.columns).difference(needed)
    if layout.is_header(fields) or not set(needed) <= set(names) or (others and others.isdisjoint(names)):
        return ()
    return () if any(_BEGINS_NUMBER.match(cell) for cell in fields) else names


def is_fragment(text: str, layout: TextLayout) -> bool:
    """Return whether a line is only a number: the start or the end of a row that was torn inside its outermost cell."""
    return len(layout.names) > 1 and bool(_NUMBERISH.fullmatch(text.strip())) and mark_between(layout) not in text


def as_texts(kept: list[str], layout: TextLayout) -> pl.DataFrame:
    """Return lines from `cells_of` as a table of strings."""
    schema = dict.fromkeys(layout.names, pl.String())
    if not kept:
        return pl.DataFrame(schema=schema)
    body = ("\n".join(kept) + "\n").encode()
    return pl.read_csv(
        body, separator=CELL, has_header=False, schema=schema, quote_char=None, empty_string_is_null=False
    )


def _is_number(cell: str, layout: TextLayout) -> bool:
    try:
        float(cell.replace(",", ".", 1) if layout.decimal_comma else cell)
    except ValueError:
        return False
    return True
