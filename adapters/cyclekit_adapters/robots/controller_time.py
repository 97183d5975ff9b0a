"""Controller time of a robot log: repeated samples are set aside, backward steps of the clock are reported.

A logger faster than its controller writes a sample twice, and a restarted controller counts from zero again. Both occur
in every robot log, whatever its columns mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit_adapters.times.local_clock import newest_first

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit_adapters.text.delimited import TextRows

DAY_S = 86_400.0
REPEATED = "repeats the controller sample before it"


@dataclass
class RepeatFilter:
    """Sets repeated times aside, block after block of one log.

    Attributes:
        time: Name of the time column; it has no nulls.
        repeated: Number of rows so far that repeat the previous one.
        back: Number of lasting backward steps of the clock so far. A single time that does not fit between its
            neighbours is a garbled number, set aside later, and no restart.
    """

    time: str
    repeated: int = 0
    _back: int = 0
    _ends: tuple[float, ...] = ()

    @property
    def back(self) -> int:
        """See the class. A backward step in the last row counts, because no later row can show that it is garbled."""
        ends = self._ends
        return self._back + (len(ends) > 1 and ends[-1] < ends[-2] and not (len(ends) > 2 and ends[-1] > ends[-3]))

    def rows(self, rows: TextRows, reason: str = REPEATED) -> TextRows:
        """Return the rows with repeated times set aside; a row after a backward step is kept, as the start of a run."""
        times = rows.frame[self.time].to_numpy()
        if not len(times):
            return rows
        again = np.diff(times, prepend=self._ends[-1] if self._ends else np.nan) == 0.0
        self.repeated += int(again.sum())
        self._count(times[~again])
        return rows.without(pl.Series(again), reason) if again.any() else rows

    def _count(self, times: NDArray[np.float64]) -> None:
        """Count backward steps among distinct times, shape (N,); the last row is judged when its successor is known."""
        known = len(self._ends)
        seen = np.concatenate([self._ends, times])
        self._ends = tuple(seen[-3:].tolist())
        back = np.flatnonzero(seen[1:] < seen[:-1]) + 1  # index of the first row after a backward step
        back = back[(back >= known - 1) & (back < len(seen) - 1)]
        low = seen[back + 1] > seen[back - 1]  # this row alone is garbled
        high = (back > 1) & (seen[back] > seen[back - 2])  # the previous row alone is garbled
        self._back += int((~low & ~high).sum())

    def warnings(self) -> list[str]:
        """Return warnings about backward steps of the clock and about repeated rows."""
        messages = []
        if self.back:
            messages.append(
                f"the controller's clock steps back {self.back} time(s): it was restarted, each part is a separate run"
            )
        if self.repeated:
            messages.append(f"{self.repeated} rows repeat the controller sample before them and are left out")
        return messages


@dataclass
class BackwardSteps:
    """Counter of backward time steps, block after block of one log; rows may share a time.

    Attributes:
        time: Name of the time column; it has no nulls.
        of: Name of the column that identifies the track; each track has its own order of rows.
        count: Number of backward steps within a track so far.
        days: Number of backward steps of more than a day so far, across tracks: no track ends that long before another.
    """

    time: str
    of: str | None = None
    count: int = 0
    days: int = 0

    def __post_init__(self) -> None:
        self._last: dict[object, float] = {}
        self._before: float | None = None
        self._newest_first = False

    def add(self, frame: pl.DataFrame) -> None:
        """Add the rows of a block."""
        if frame.is_empty():
            return
        self._newest_first |= newest_first(frame[self.time])
        far = frame[self.time].diff() < -DAY_S
        self.days += int(far.sum()) + (self._before is not None and frame[self.time][0] < self._before - DAY_S)
        self._before = float(frame[self.time][-1])
        track = pl.lit("") if self.of is None else pl.col(self.of)
        back = (pl.col(self.time).diff() < 0).sum().alias("back")
        ends = (pl.col(self.time).first().alias("first"), pl.col(self.time).last().alias("last"))
        for name, count, first, last in frame.group_by(track.alias("track")).agg(back, *ends).iter_rows():
            self.count += count + (first < self._last.get(name, first))
            self._last[name] = last

    def warnings(self) -> list[str]:
        """Return a warning with the number of backward steps."""
        likely = "rows out of order, or several recordings in one file"
        if self._newest_first:
            return ["its newest rows come first"]
        messages = [f"time steps back {self.count} time(s): {likely}"] if self.count else []
        if self.days and not self.count:
            messages.append(f"time steps back by more than a day {self.days} time(s): {likely}")
        return messages


@dataclass
class Range:
    """Minimum and maximum of some columns, block after block; None while all values are unknown."""

    columns: tuple[str, ...]

    def __post_init__(self) -> None:
        self.least: dict[str, float] = {}
        self.most: dict[str, float] = {}

    def add(self, frame: pl.DataFrame) -> None:
        """Add those of the columns that `frame` has."""
        for name in dict.fromkeys(self.columns):
            if name not in frame.columns or frame[name].null_count() == frame.height:
                continue
            low, high = float(str(frame[name].min())), float(str(frame[name].max()))
            self.least[name] = min(low, self.least.get(name, low))
            self.most[name] = max(high, self.most.get(name, high))
