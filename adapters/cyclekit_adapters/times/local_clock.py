"""Local times whose clock begins again: at midnight, at the full hour, and when summer time ends.

A time of day without a date that steps back by more than half of its day (of its hour, if only minutes are written) is
of the next one. A time of the hour that is repeated when summer time ends is read as the first one; a row that then
lies before its predecessor is of the second one. Exports of events often have their newest row first: they are read
from their end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from cyclekit_adapters.times.written_time import is_dated

HOUR_S = 3600.0
"""How far clocks are set back, s."""
BACK_S = 60.0
"""Maximum time, s, by which rows that are not quite in order lie before their predecessor."""

NEWEST_FIRST = 5
"""Minimum number of steps back in a log whose newest row comes first."""


def is_of_hour(pattern: str) -> bool:
    """Return whether times of a form without a date are minutes and seconds alone."""
    return not any(part in pattern for part in ("%H", "%I", "%T", "%R"))


def newest_first(t_s: pl.Series) -> bool:
    """Return whether most rows of a log with times (N,), s, lie before their predecessor."""
    steps = t_s.drop_nulls().diff().drop_nulls()
    return int((steps < 0.0).sum()) >= max(NEWEST_FIRST, 2 * int((steps > 0.0).sum()))


@dataclass
class LocalClock:
    """Places the times of one log, block after block.

    Attributes:
        zone: Time zone of the log; None = dates are left as they are.
        pattern: Form of the times in text; None for numbers.
        moved: Number of times taken for the second hour so far.
        midnights: Number of days (hours) that began so far, for times without a date.
        set_back: Number of steps back by an hour so far, of dates without a zone.
    """

    zone: str | None
    pattern: str | None = None
    moved: int = 0
    midnights: int = 0
    set_back: int = 0
    _last: float | None = None
    _before: tuple[float, ...] = ()

    def in_order(self, t_s: pl.Series) -> pl.Series:
        """Return seconds, those of the second hour and of later days moved.

        Args:
            t_s: Seconds since 1970 or midnight, shape (N,), in the order of the rows; of repeated times the first;
                null = unknown.
        """
        if self.pattern and not is_dated(self.pattern) and t_s.len():
            return self._on_later_days(t_s)
        if self.zone is None or not t_s.len():
            self._look_back(t_s)
            return t_s
        if newest_first(t_s):
            self._last = None
            return self._placed(t_s.reverse()).reverse()
        return self._placed(t_s)

    def _look_back(self, t_s: pl.Series) -> None:
        """Count steps back by an hour of dates whose zone is unknown."""
        known = t_s.drop_nulls()
        if self.pattern is None or not len(known):
            return
        steps = np.diff(known.to_numpy(), prepend=known[0] if self._last is None else self._last)
        self.set_back += int((np.abs(steps + HOUR_S) < BACK_S).sum())
        self._last = float(known[-1])

    def _on_later_days(self, t_s: pl.Series) -> pl.Series:
        """Return times of day, moved by the days since the first; a single garbled time begins no day."""
        day_s = HOUR_S if is_of_hour(str(self.pattern)) else 24 * HOUR_S
        known = t_s.is_not_null()
        here = t_s.filter(known).to_numpy()
        seen = np.concatenate([self._before, here])
        back = np.diff(seen, prepend=seen[:1]) < -0.5 * day_s
        back[2:] &= seen[2:] < seen[:-2]
        days = self.midnights + np.cumsum(back[len(self._before) :])
        self._before, self.midnights = tuple(seen[-2:]), int(days[-1]) if len(days) else self.midnights
        moved = pl.Series(t_s.name, here + days * day_s, pl.Float64)
        return t_s.scatter(known.arg_true(), moved) if days.any() else t_s

    def _placed(self, t_s: pl.Series) -> pl.Series:
        twice = (self._on_the_clock(t_s) == self._on_the_clock(t_s + HOUR_S)).fill_null(value=False)
        times = t_s.to_list()
        for row in twice.arg_true().to_list():
            last = times[row - 1] if row else self._last
            if last is not None and times[row] < last - BACK_S <= times[row] + HOUR_S:
                times[row] += HOUR_S
                self.moved += 1
        known = t_s.drop_nulls()
        self._last = times[-1] if times[-1] is not None else (known[-1] if len(known) else self._last)
        return pl.Series(t_s.name, times, pl.Float64) if twice.any() else t_s

    def warnings(self) -> list[str]:
        """Return warnings with the number of times in the second hour, and of days that began."""
        said = []
        if self.moved:
            of = "of the hour repeated at the end of summer time: the second one, by their order"
            said.append(f"{self.moved} times are {of}")
        if self.midnights:
            what = "hour" if is_of_hour(str(self.pattern)) else "day"
            said.append(f"its times have no date and begin again {self.midnights} time(s): a new {what} each time")
        if self.set_back:
            said.append("its times step back by an hour: at the end of summer time? time_zone places them")
        return said

    def _on_the_clock(self, t_s: pl.Series) -> pl.Series:
        """Return the local date and time of day."""
        when = pl.from_epoch((t_s * 1e6).round().cast(pl.Int64), "us").dt.replace_time_zone("UTC")
        return when.dt.convert_time_zone(str(self.zone)).dt.replace_time_zone(None)
