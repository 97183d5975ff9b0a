"""A table for the template: caption, heads, rows of text, numeric columns. The sections fill it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True)
class ReportTable:
    """Rows of ready text.

    Attributes:
        caption: What the table shows; also its name for screen readers.
        heads: Column heads.
        rows: One text per column; the first names the row.
        numeric: Columns that hold numbers, aligned right.
        silent: The caption repeats the text above the table and is for screen readers only.
        title: Heading of its own; empty without one.
        text, after: Sentence before and after the table.
        items: List below the table, or without a table.
    """

    caption: str = ""
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    numeric: frozenset[int] = field(default_factory=frozenset)
    silent: bool = False
    title: str = ""
    text: str = ""
    after: str = ""
    items: Sequence[str] = ()
