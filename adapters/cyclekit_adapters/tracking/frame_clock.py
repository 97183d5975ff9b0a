"""Clock of a take with frame numbers: frame / rate, unless its Time column contradicts the rate.

Trackers write both, and the Time column is less exact, because it may be rounded to milliseconds. The two disagree only
in manually edited files, where the rate is wrong. The first rows decide, so that a take of any length has one clock. A
later deviation is reported in a warning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.text.numbers import compact, given
from cyclekit_adapters.text.delimited import INDEX

if TYPE_CHECKING:
    from collections.abc import Sequence

FRAME, TIME = "Frame", "Time"
MAX_HZ = 1e6
"""Maximum plausible rate in a header, Hz."""
_LOOKED_AT = 1000  # rows


@dataclass
class FrameClock:
    """Converts the rows of a take to seconds.

    Attributes:
        names: Those of FRAME and TIME that the table has as columns.
        rate_hz: Frames per second; None if unknown.
        first: Number of the frame at time zero.
        by_time: The Time column is the clock.
    """

    names: tuple[str, ...]
    rate_hz: float | None
    first: int
    by_time: bool = False
    _begin: tuple[float, float] | None = None
    _off_s: float = 0.0
    _off_line: int = 0

    @property
    def known(self) -> bool:
        """True if there is a rate or a Time column."""
        return bool(self.rate_hz) or TIME in self.names

    @property
    def required(self) -> list[str]:
        """Columns without which a row has no time."""
        return [TIME] if self.by_time else [name for name in self.names if name == FRAME]

    def decide(self, rows: Sequence[str], delimiter: str, *, decimal_comma: bool = False) -> None:
        """Choose the clock from the first data rows of the log, as text."""
        if TIME not in self.names:
            return
        if not self.rate_hz:
            self.by_time = True
            return
        pairs = []
        for number, row in enumerate(rows[:_LOOKED_AT]):
            cells = dict(zip(self.names, row.split(delimiter, 2), strict=False))
            try:
                here = {name: float(cell.replace(",", ".") if decimal_comma else cell) for name, cell in cells.items()}
            except ValueError:
                continue
            if TIME in here:
                pairs.append((self._exact(here.get(FRAME, number + self.first)), here[TIME]))
        off = max((abs((t - pairs[0][1]) - (e - pairs[0][0])) for e, t in pairs), default=0.0)
        self.by_time = off > self._slack_s

    @property
    def _slack_s(self) -> float:
        return max(2e-3, 0.5 / self.rate_hz) if self.rate_hz else 0.0

    def _exact(self, frame: float) -> float:
        return (frame - self.first) / self.rate_hz if self.rate_hz else 0.0

    def at(self, frame: float) -> float | None:
        """Return the time of a frame number, s; None if the Time column is the clock."""
        return self._exact(frame) if self.rate_hz and not self.by_time else None

    def seconds(self, frame: pl.DataFrame) -> pl.Series:
        """Return the time of each row, shape (N,), s; `frame` holds `names`, INDEX and `source_row`."""
        if self.by_time or not self.rate_hz:
            return frame[TIME].alias("t_s")
        count = frame[FRAME].to_numpy() - self.first if FRAME in self.names else frame[INDEX].to_numpy()
        with np.errstate(over="ignore"):  # a garbled rate: such times are set aside
            exact = pl.Series("t_s", count / self.rate_hz, pl.Float64())
        if TIME in self.names and len(exact):
            self._compare(exact, frame[TIME], frame["source_row"])
        return exact

    def _compare(self, exact: pl.Series, logged: pl.Series, lines: pl.Series) -> None:
        if self._begin is None:
            at = int(logged.is_not_null().arg_max() or 0)
            if logged[at] is None:
                return
            self._begin = (float(exact[at]), float(logged[at]))
        off = ((logged - self._begin[1]) - (exact - self._begin[0])).abs().fill_nan(None)
        most = float(str(off.max() or 0.0))
        if most > self._slack_s:
            self._off_line = self._off_line or int(lines.filter((off > self._slack_s).fill_null(value=False))[0])
            self._off_s = max(self._off_s, most)

    def warnings(self) -> list[str]:
        """Return warnings about contradictions between Time column and rate, and which of them is used."""
        if self.by_time and self.rate_hz:
            return [f"the stated rate ({given(self.rate_hz)} Hz) does not fit the Time column: the Time column is used"]
        if self._off_line:
            off = f"up to {compact(self._off_s, 3)} s, first in line {self._off_line}"
            return [f"the Time column deviates from frame / rate by {off}: frame / rate is used"]
        return []


def positive(text: str, *, below: float) -> float | None:
    """Return a positive number from a header, with a decimal point or comma; None for anything else."""
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        return None
    return value if 0.0 < value < below else None
