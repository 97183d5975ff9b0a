"""Counts over a log of people, block after block: rows per person, rows without position, backward time steps.

For a log larger than memory, the counts are complete only at its end. The adapters turn them into messages.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.errors import LogError, nearest

if TYPE_CHECKING:
    from pathlib import Path

_SHOWN = 40


@dataclass
class PersonCounts:
    """Counts over the rows so far.

    Attributes:
        rows: Number of rows of each person, in order of appearance.
        unseen: Number of rows of each person without a position.
        back: Number of rows at which the time did not increase.
    """

    rows: dict[str, int] = field(default_factory=dict)
    unseen: dict[str, int] = field(default_factory=dict)
    back: int = 0
    _last_s: float | None = None

    def add(self, people: pl.DataFrame) -> None:
        """Add the rows of a block: columns `person` and `x_m`."""
        counts = people.group_by("person", maintain_order=True).agg(rows=pl.len(), unseen=pl.col("x_m").null_count())
        for person, rows, unseen in counts.iter_rows():
            self.rows[person] = self.rows.get(person, 0) + rows
            self.unseen[person] = self.unseen.get(person, 0) + unseen

    def clock(self, t_s: pl.Series, *, repeats: bool = False) -> None:
        """Add the times of a block, one per row of the log; `repeats`: equal successive times are no fault."""
        if t_s.is_empty():
            return
        before = t_s.shift(1, fill_value=self._last_s)
        self.back += int(((t_s < before) if repeats else (t_s <= before)).sum())
        self._last_s = float(t_s[-1])

    def unseen_messages(self, flange: str | None = None) -> list[str]:
        """Return messages with the number of frames in which each person is not seen; `flange` is no person."""
        return [
            f"{person!r} is not seen in {count} of {self.rows[person]} frames"
            for person, count in self.unseen.items()
            if count and person != flange
        ]

    def require(self, path: Path, body: str | None) -> None:
        """Refuse a body from the cell file that the log does not have.

        Raises:
            LogError: No row has `body`.
        """
        if body is not None and body not in self.rows:
            known = sorted(self.rows)
            cure = f"In the file: {', '.join(known[:_SHOWN])}{', ...' if len(known) > _SHOWN else ''}."
            raise LogError(path, f"no body {body!r}", nearest=nearest(body, known), cure=cure)


def only(people: pl.DataFrame, body: str | None) -> pl.DataFrame:
    """Return the rows of `body`, or all rows if it is None."""
    return people if body is None else people.filter(pl.col("person") == body)
