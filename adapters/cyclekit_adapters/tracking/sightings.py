"""Who was seen in a log of people, how often not, and whether its time goes on: gathered block after block.

A log that is larger than memory tells this only at its end. What is said about it is the adapters' business.
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
class Sightings:
    """What the rows so far say.

    Attributes:
        rows: Rows of each person, in order of appearance.
        unseen: Rows of each person without a place.
        back: How often the time of the log did not go on.
    """

    rows: dict[str, int] = field(default_factory=dict)
    unseen: dict[str, int] = field(default_factory=dict)
    back: int = 0
    _last_s: float | None = None

    def add(self, people: pl.DataFrame) -> None:
        """Take in the rows of a block: columns `person` and `x_m`."""
        counts = people.group_by("person", maintain_order=True).agg(rows=pl.len(), unseen=pl.col("x_m").null_count())
        for person, rows, unseen in counts.iter_rows():
            self.rows[person] = self.rows.get(person, 0) + rows
            self.unseen[person] = self.unseen.get(person, 0) + unseen

    def clock(self, t_s: pl.Series, *, repeats: bool = False) -> None:
        """Take in the times of a block, one per row of the log; `repeats` says that equal neighbours are no fault."""
        if t_s.is_empty():
            return
        before = t_s.shift(1, fill_value=self._last_s)
        self.back += int(((t_s < before) if repeats else (t_s <= before)).sum())
        self._last_s = float(t_s[-1])

    def hidden(self) -> list[str]:
        """Say of each person in how many frames they are not seen."""
        return [
            f"{person!r} is not seen in {count} of {self.rows[person]} frames"
            for person, count in self.unseen.items()
            if count
        ]

    def require(self, path: Path, body: str | None) -> None:
        """Refuse a body that the cell file names and the log does not have.

        Raises:
            LogError: `body` was in no row.
        """
        if body is not None and body not in self.rows:
            known = sorted(self.rows)
            cure = f"In the file: {', '.join(known[:_SHOWN])}{', ...' if len(known) > _SHOWN else ''}."
            raise LogError(path, f"no body {body!r}", nearest=nearest(body, known), cure=cure)


def only(people: pl.DataFrame, body: str | None) -> pl.DataFrame:
    """Return the rows of `body`, or all of them if none is named."""
    return people if body is None else people.filter(pl.col("person") == body)
