"""Controller time of a robot log: a restarted controller counts from zero again, and that is reported."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from cyclekit_adapters.times.local_clock import newest_first

DAY_S = 86_400.0


@dataclass
class ClockRestarts:
    """Counts lasting backward steps of a controller's clock, block after block of one log.

    Attributes:
        time: Name of the time column; it has no nulls.
        back: Number of lasting backward steps of the clock so far. A single time that does not fit between its
            neighbours is a garbled number, set aside later, and no restart.
    """

    time: str
    _back: int = 0
    _ends: tuple[float, ...] = ()

    @property
    def back(self) -> int:
        """See the class. A backward step in the last row counts, because no later row can show that it is garbled."""
        ends = self._ends
        return self._back + (len(ends) > 1 and ends[-1] < ends[-2] and not (len(ends) > 2 and ends[-1] > ends[-3]))

    def add(self, frame: pl.DataFrame) -> None:
        """Count the backward steps among the times of a block; its last row is judged when its successor is known."""
        times = frame[self.time].to_numpy()
        times = times[np.diff(times, prepend=self._ends[-1] if self._ends else np.nan) != 0.0]
        if not len(times):
            return
        known = len(self._ends)
        seen = np.concatenate([self._ends, times])
        self._ends = tuple(seen[-3:].tolist())
        back = np.flatnonzero(seen[1:] < seen[:-1]) + 1  # index of the first row after a backward step
        back = back[(back >= known - 1) & (back < len(seen) - 1)]
        low = seen[back + 1] > seen[back - 1]  # this row alone is garbled
        high = (back > 1) & (seen[back] > seen[back - 2])  # the previous row alone is garbled
        self._back += int((~low & ~high).sum())

    def warnings(self) -> list[str]:
        """Return a warning about backward steps of the clock."""
        restarted = "it was restarted, each part is a separate run"
        return [f"the controller's clock steps back {self.back} time(s): {restarted}"] if self.back else []


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
