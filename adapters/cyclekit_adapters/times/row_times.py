"""Times of rows in seconds, from the time column or columns of any table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import TimeUnit
from cyclekit.errors import LogError
from cyclekit_adapters.text.delimited import INDEX
from cyclekit_adapters.times.proof import prove
from cyclekit_adapters.times.units import COUNTED, EARLIEST_S, FRAME, LATEST_S
from cyclekit_adapters.times.written_time import forms_of, is_dated, names_zone, written_seconds

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.adapter import ClockKind
    from cyclekit_adapters.text.text_rows import TextRows
    from cyclekit_adapters.times.local_clock import LocalClock
    from cyclekit_adapters.times.proof import TimeEvidence
    from cyclekit_adapters.times.units import Unit

T_S = "\x1ft_s"  # a name that no column of a file has
_WHEN = "\x1fwhen"


@dataclass(frozen=True)
class TimeColumn:
    """Interpretation of the time column.

    Attributes:
        columns: One column; date and time of day; or a count and its smaller parts. None: rows are counted.
        pattern: `iso` or a strftime pattern; empty for numbers.
        units: Unit of each column of numbers, the largest first; empty if unknown.
        why: Evidence for this interpretation.
        sample: The first time as written.
        zoned: The times name their time zone.
        may_be: Units that numbers may have, the likeliest first, while the evidence in the log leaves several; or the
            one that is stated or taken without evidence in the log.
    """

    columns: tuple[str, ...]
    pattern: str = ""
    units: tuple[Unit, ...] = ()
    why: str = ""
    sample: str = ""
    zoned: bool = False
    may_be: tuple[Unit, ...] = ()

    @property
    def known(self) -> bool:
        """Whether the times can be read."""
        return bool(self.pattern or self.units or not self.columns)

    @property
    def is_local(self) -> bool:
        """Whether they are dates of a zone that the log does not name."""
        return (is_dated(self.pattern) and not self.zoned) or any(unit.local for unit in self.units)

    def clock(self, zone: str | None) -> ClockKind:
        """Return the kind of clock, with a zone for local times."""
        return "epoch" if self._dated and (zone or not self.is_local) else "relative"

    @property
    def time_units(self) -> tuple[TimeUnit, ...]:
        """The units that the times may have, for `Recording.time_units`; empty if the log shows its unit."""
        counts = ((unit.name, 0.0 if unit.name == FRAME else unit.seconds, unit.zero_s) for unit in self.may_be)
        return tuple(TimeUnit(*count) for count in counts)

    @property
    def _dated(self) -> bool:
        return is_dated(self.pattern) if self.pattern else any(unit.zero_s is not None for unit in self.units)

    def warnings(self, zone: str | None) -> list[str]:
        """Return a warning if times cannot be aligned with other logs without date or zone."""
        if self.is_local and zone is None:
            return ["its times have no time zone, so they cannot be aligned with other logs; give time_zone"]
        undated = self.pattern and not self._dated
        return ["its times have no date, so they cannot be aligned with other logs by them"] if undated else []


def time_column(
    columns: tuple[str, ...],
    sample: Sequence[str],
    evidence: TimeEvidence,
    *,
    unit: Unit | None = None,
    decimal_comma: bool = False,
    only_written: bool = False,
) -> TimeColumn | None:
    """Return the interpretation of times; None if they are not times.

    Args:
        columns: Their columns.
        sample: Some of them as written, at least one.
        evidence: What the table says of them.
        unit: Unit given in the cell file.
        decimal_comma: Numbers may be written `0,5`.
        only_written: Numbers do not count as times.
    """
    if forms := forms_of(sample):
        zoned = 2 * sum(map(names_zone, sample)) > len(sample)
        if len(forms) > 1:
            return TimeColumn(columns, why=f"it may be written as {' or as '.join(forms[:3])}", sample=sample[0])
        dated, zone = is_dated(forms[0]), "with a zone" if zoned else "without a zone"
        why = f"date and time {zone}" if dated else "time of day, without a date"
        return TimeColumn(columns, forms[0], why=why, sample=sample[0], zoned=zoned)
    numbers = [number for text in sample if (number := _number(text, decimal_comma=decimal_comma)) is not None]
    if only_written or 2 * len(numbers) < len(sample) or not numbers:
        return None
    if unit is not None:
        middle = sorted(numbers)[len(numbers) // 2]
        dated = unit.zero_s is None and EARLIEST_S <= middle * unit.seconds <= LATEST_S
        unit = unit.since_1970() if dated else unit
        return TimeColumn(columns, "", (unit,), f"{unit.said}, from the cell file", sample[0], may_be=(unit,))
    proof = prove(np.array(numbers), evidence)
    left = () if proof.unit or proof.contradiction else proof.left
    if any(number % 1.0 for number in numbers):
        left = tuple(sorted(left, key=lambda unit: unit != COUNTED["s"]))
    units, why = (proof.left, proof.why) if proof.unit else ((), proof.question)
    return TimeColumn(columns, "", units, why, sample[0], may_be=left)


def settled(path: Path, times: TimeColumn) -> TimeColumn:
    """Return times that can be read: of an open unit in the likeliest one, and `time_units` names the others.

    Raises:
        LogError: They contradict every unit or their name, or their form is open.
    """
    if times.known:
        return times
    if likeliest := next((unit for unit in times.may_be if unit.name != FRAME), None):
        others = (unit for unit in times.may_be if unit != likeliest)
        return replace(times, units=(likeliest,), may_be=(likeliest, *others))
    columns = " and ".join(map(repr, times.columns))
    cause = f"the times of column {columns} ({times.sample[:40]!r}) are ambiguous: {times.why}"
    cure = 'Give time_unit = "s" (or another of these) in [sources.map] of the cell file'
    cure += ', or map the columns with adapter = "csv" and its time_format.'
    raise LogError(path, cause, cure=cure)


def _number(text: str, *, decimal_comma: bool) -> float | None:
    try:
        value = float(text.replace(",", ".") if decimal_comma else text)
    except ValueError:
        return None
    return value if abs(value) < 1e19 else None


def timed(rows: TextRows, times: TimeColumn, clock: LocalClock, rate_hz: float | None = None) -> TextRows:
    """Add the time in seconds (column `T_S`), in the zone of `clock`; a row whose time cannot be read is set aside."""
    frame = rows.frame
    if not times.columns:
        return replace(rows, frame=frame.with_columns((pl.col(INDEX) / (rate_hz or 1.0)).alias(T_S)))
    if not times.pattern:
        return _counted(rows, times, clock)
    text = pl.concat_str(pl.col(times.columns), separator=" ")
    when = written_seconds(text, times.pattern, clock.zone, zoned=times.zoned and times.pattern == "iso")
    frame = frame.with_columns(text.alias(_WHEN), when.alias(T_S))
    bad = frame[T_S].is_null()
    first = frame.filter(bad)[_WHEN][:1].to_list()
    reason = f"its time does not match {times.pattern!r} (the first: {str(first[0])[:40]!r})" if first else ""
    rows = replace(rows, frame=frame).without(bad, reason)
    return replace(rows, frame=rows.frame.drop(_WHEN).with_columns(clock.in_order(rows.frame[T_S])))


def _counted(rows: TextRows, times: TimeColumn, clock: LocalClock) -> TextRows:
    """Add the time from numbers: of one column, or the sum of its parts."""
    (first, whole), *smaller = zip(times.columns, times.units, strict=True)
    for name, unit in smaller:  # a part longer than the larger unit belongs to another clock
        part = rows.frame[name] * unit.seconds
        reason = f"its part {name!r} of the time is not between 0 and one {whole.name} of {first!r}"
        rows = rows.without((part < 0.0) | (part >= whole.seconds), reason)
    parts = [pl.col(name) * unit.seconds for name, unit in smaller]
    frame = rows.frame.with_columns(pl.sum_horizontal(whole.to_seconds(pl.col(first), clock.zone), *parts).alias(T_S))
    if whole.local:
        unread = rows.frame.select(whole.to_seconds(pl.col(first), clock.zone).is_null()).to_series()
        return replace(rows, frame=frame).without(unread, f"its time is no date in {whole.name}, {whole.about}")
    return replace(rows, frame=frame)
