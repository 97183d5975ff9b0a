"""Rows of a controller log on its own clock: each instant once, and what a person must know of steps back.

A logger that is faster than its controller writes the last sample again, and a controller that was restarted counts
from zero. Both are the same in every robot log, whatever its columns mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from cyclekit_adapters.delimited import Rows

REPEATED = "repeats the controller sample before it"


@dataclass
class Once:
    """Keeps each instant once, block after block of one log.

    Attributes:
        time: Name of the time column; it has no nulls.
        repeated: Rows so far that repeat the one before them.
        back: How often so far the clock stepped back.
    """

    time: str
    repeated: int = 0
    back: int = 0
    _last: float | None = None

    def rows(self, rows: Rows, reason: str = REPEATED) -> Rows:
        """Return the rows that go on (or step back: a new run), with the repeats set aside."""
        times = rows.frame[self.time].to_numpy()
        if not len(times):
            return rows
        steps = np.diff(times, prepend=np.nan if self._last is None else self._last)
        again = steps == 0.0
        self.repeated += int(again.sum())
        self.back += int((steps < 0.0).sum())
        self._last = float(times[-1])
        return rows.without(pl.Series(again), reason) if again.any() else rows

    def warnings(self) -> list[str]:
        """Say where the controller's clock steps back, and how many rows were repeats."""
        said = []
        if self.back:
            said.append(
                f"the controller's clock steps back {self.back} time(s): it was restarted, each part is its own run"
            )
        if self.repeated:
            said.append(f"{self.repeated} rows repeat the controller sample before them and are left out")
        return said


@dataclass
class Spread:
    """Least and greatest value of some columns, block after block; None while all was unknown."""

    columns: tuple[str, ...]

    def __post_init__(self) -> None:
        self.least: dict[str, float] = {}
        self.most: dict[str, float] = {}

    def add(self, frame: pl.DataFrame) -> None:
        """Take in the columns that `frame` has."""
        for name in dict.fromkeys(self.columns):
            if name not in frame.columns or frame[name].null_count() == frame.height:
                continue
            low, high = float(str(frame[name].min())), float(str(frame[name].max()))
            self.least[name] = min(low, self.least.get(name, low))
            self.most[name] = max(high, self.most.get(name, high))
