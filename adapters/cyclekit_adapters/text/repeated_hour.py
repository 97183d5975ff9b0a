"""Local times of the hour that is repeated when summer time ends: the order of the rows tells the two apart.

A time of that hour is read as the first one. In a log in order of time, a row that then lies before its predecessor is
of the second one. Exports of events often have their newest row first: they are read from their end.
"""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

HOUR_S = 3600.0
"""How far clocks are set back, s."""
BACK_S = 60.0
"""Maximum time, s, by which rows that are not quite in order lie before their predecessor."""

NEWEST_FIRST = 5
"""Minimum number of steps back in a log whose newest row comes first."""


def newest_first(t_s: pl.Series) -> bool:
    """Return whether most rows of a log with times (N,), s, lie before their predecessor."""
    steps = t_s.drop_nulls().diff().drop_nulls()
    return int((steps < 0.0).sum()) >= max(NEWEST_FIRST, 2 * int((steps > 0.0).sum()))


@dataclass
class RepeatedHour:
    """Places the times of one log, block after block.

    Attributes:
        zone: Time zone of the log; None = its times are left as they are.
        moved: Number of times taken for the second hour so far.
    """

    zone: str | None
    moved: int = 0
    _last: float | None = None

    def in_order(self, t_s: pl.Series) -> pl.Series:
        """Return seconds since 1970, with those of the second hour moved.

        Args:
            t_s: Seconds since 1970, shape (N,), in the order of the rows; of repeated times the first; null = unknown.
        """
        if self.zone is None or not t_s.len():
            return t_s
        if newest_first(t_s):
            self._last = None
            return self._placed(t_s.reverse()).reverse()
        return self._placed(t_s)

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
        """Return a warning with the number of times in the second hour."""
        if not self.moved:
            return []
        return [
            f"{self.moved} times are of the hour repeated at the end of summer time: the second one, by their order"
        ]

    def _on_the_clock(self, t_s: pl.Series) -> pl.Series:
        """Return the local date and time of day."""
        when = pl.from_epoch((t_s * 1e6).round().cast(pl.Int64), "us").dt.replace_time_zone("UTC")
        return when.dt.convert_time_zone(str(self.zone)).dt.replace_time_zone(None)
