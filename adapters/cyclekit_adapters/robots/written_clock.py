"""Time column of a robot log written by a user's program: controller time or PC time.

RTDE time counts seconds since controller start. Users' programs often write the PC's time instead, as text or as a
number since 1970.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import polars as pl

from cyclekit_adapters.times.coarse_stamps import share_stamps
from cyclekit_adapters.times.proof import dated_unit
from cyclekit_adapters.times.units import COUNTED, Unit
from cyclekit_adapters.times.written_time import written_seconds

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit_adapters.text.delimited import TextRows

_DATED = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")
_ZONED = re.compile(r"(?:Z|[+-]\d\d:?\d\d)$")
_NUMBER = re.compile(r"\d+(\.\d*)?([eE]\+?\d+)?")


@dataclass(frozen=True)
class WrittenClock:
    """Kind of time in a log, from its first rows.

    Attributes:
        column: The time column.
        kind: `epoch` for PC time, `relative` for PC time without a zone, `uptime` for controller time.
        is_text: The times are texts of date and time of day.
        zone: Time zone of texts that name none.
        unit: Unit of numbers.
        coarse: Neighbouring rows share the PC's time.
    """

    column: str
    kind: Literal["epoch", "relative", "uptime"]
    is_text: bool = False
    zone: str | None = None
    unit: Unit = COUNTED["s"]
    coarse: bool = False

    @classmethod
    def from_cells(cls, cells: Sequence[str], column: str, zone: str | None) -> WrittenClock:
        """Return the kind of time from the first cells of the time column, as texts without quotes."""
        written = [cell for cell in cells if _DATED.match(cell)]
        if 2 * len(written) > len(cells):
            zoned = zone is not None or all(_ZONED.search(cell) for cell in written)
            return cls(column, "epoch" if zoned else "relative", is_text=True, zone=zone, coarse=share_stamps(cells))
        pointed = [cell.replace(",", ".") for cell in cells]
        numbers = sorted(float(cell) for cell in pointed if _NUMBER.fullmatch(cell))
        middle = numbers[len(numbers) // 2] if numbers else 0.0
        if unit := dated_unit(middle):  # no controller has an uptime of thirty years
            return cls(
                column,
                "epoch" if zone or not unit.local else "relative",
                zone=zone,
                unit=unit,
                coarse=share_stamps(cells),
            )
        return cls(column, "uptime")

    def seconds(self, rows: TextRows) -> TextRows:
        """Return the rows with times in seconds; rows with an unreadable time are set aside."""
        if not self.is_text:
            seconds = self.unit.to_seconds(pl.col(self.column), self.zone).alias(self.column)
            return replace(rows, frame=rows.frame.with_columns(seconds))
        text = pl.col(self.column).str.strip_chars('"')
        zoned = self.kind == "epoch" and self.zone is None
        when = rows.frame.select(written_seconds(text, "iso", self.zone, zoned=zoned))[self.column]
        reason = f"its time in column {self.column!r} is no date and time of day of ISO 8601"
        rows = rows.without(when.is_null(), reason)
        return replace(rows, frame=rows.frame.with_columns(when.drop_nulls().alias(self.column)))

    def warnings(self) -> list[str]:
        """Return a warning if the times cannot be aligned with other logs."""
        if self.kind != "relative":
            return []
        return [
            f"column {self.column!r} is a PC's local time, and the log names no time zone: give time_zone, for example "
            '"Europe/Rome", in [sources.map] to align the log with logs in epoch time'
        ]

    def fact(self) -> str:
        """Return a description of the clock."""
        if self.kind == "uptime":
            return "seconds since the controller was started"
        return f"the PC's clock{f' in {self.zone}' if self.zone else ''}"
