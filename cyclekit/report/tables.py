"""A table as the template sets it: caption, heads, rows of text, and which columns are numbers.

What stands in it is the business of the sections.
"""

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
        numeric: Columns that hold numbers, set flush right.
        silent: The caption repeats what stands above it; it is there for screen readers only.
        title: Heading above it, where it has one of its own.
        text, after: A sentence before and one after it.
        items: A plain list below the table or in its place.
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


def spell(task: str) -> str:
    """Write a task `a->b` as people read it."""
    return task.replace("->", " → ")
