"""Times of a mapped table in seconds: numbers with a unit, frame counts, or dates and times of day in text.

Nothing is guessed, but settings that the first rows contradict are refused. `mapped_csv` interprets the other columns.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import polars as pl

from cyclekit.errors import LogError
from cyclekit_adapters.mapped.csv_map import EXCEL, FRAME, SECONDS, CsvMap
from cyclekit_adapters.text.delimited import INDEX, TextRows
from cyclekit_adapters.text.written_time import EPOCH_S, excel_seconds, written_seconds

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit_adapters.text.repeated_hour import RepeatedHour

T_S = "\x1ft_s"  # a name that no column of a file has
_JOINED = "\x1fwhen"
_ZONE = re.compile(r"(?:Z|[+-]\d\d:?\d\d)\s*$")


def name_their_zone(first_rows: Sequence[Sequence[str]], names: Sequence[str], mapping: CsvMap) -> bool:
    """Return whether the times in text, judged by the first rows, name their time zone."""
    pattern = mapping.time_format or ""
    if pattern != "iso":
        return "%z" in pattern or "%+" in pattern or "%:z" in pattern
    rows = [dict(zip(names, cells, strict=False)) for cells in first_rows]
    times = [" ".join(row.get(name, "").strip() for name in mapping.time).strip() for row in rows]
    zoned = [_ZONE.search(time) is not None for time in times if ":" in time]
    return 2 * sum(zoned) > len(zoned)


def require_epoch(path: Path, frame: pl.DataFrame, mapping: CsvMap) -> None:
    """Refuse times that do not count from 1970 although clock = "epoch", mostly because of a wrong unit.

    Raises:
        LogError: The median of the times in `frame` is not within the years 2000 to 2099.
    """
    middle = frame[T_S].drop_nulls().sort()[len(frame) // 2 :].to_list()[:1]
    if not middle or EPOCH_S[0] <= middle[0] <= EPOCH_S[1]:
        return
    unit = " and ".join(map(repr, mapping.time_unit))
    setting = f"time_format is {mapping.time_format!r}" if mapping.time_format else f"time_unit is {unit}"
    cause = f'clock = "epoch", but {middle[0]:.10g} s is not in the years 2000 to 2099; {setting}'
    cure = 'Give another time_unit or time_format, or clock = "uptime" or "relative".'
    raise LogError(path, cause, cure=cure)


def timed(rows: TextRows, mapping: CsvMap, rate_hz: float | None, hour: RepeatedHour, *, zoned: bool) -> TextRows:
    """Add the time in seconds as column T_S, in the zone of `hour`; a row with an unreadable time is set aside."""
    frame = rows.frame
    if not mapping.time:
        return replace(rows, frame=frame.with_columns((pl.col(INDEX) / cast("float", rate_hz)).alias(T_S)))
    if mapping.time_unit == (EXCEL,):
        frame = frame.with_columns(excel_seconds(pl.col(mapping.time[0]), mapping.time_zone).alias(T_S))
        return replace(rows, frame=frame).without(frame[T_S].is_null(), "its time is no day number of a spreadsheet")
    if mapping.time_format is None:
        return _counted(rows, mapping, rate_hz)
    text = pl.concat_str(mapping.time, separator=" ")
    plain = text if "," in str(mapping.time_format) else text.str.replace_all(",", ".", literal=True)  # 10:00:00,250
    when = written_seconds(plain, str(mapping.time_format), hour.zone, zoned=zoned)
    frame = frame.with_columns(text.alias(_JOINED), when.alias(T_S))
    rows = replace(rows, frame=frame)
    bad = frame[T_S].is_null()
    if bad.any():
        first = frame.filter(bad)[_JOINED][0]
        pattern = mapping.time_format
        rows = rows.without(bad, f"its time does not match {pattern!r} (the first: {str(first)[:40]!r})")
    return replace(rows, frame=rows.frame.drop(_JOINED).with_columns(hour.in_order(rows.frame[T_S])))


def _counted(rows: TextRows, mapping: CsvMap, rate_hz: float | None) -> TextRows:
    """Add the time from numbers: of one column, or the sum of its parts."""
    first, *smaller = [
        (name, 1.0 / cast("float", rate_hz) if unit == FRAME else SECONDS[unit])
        for name, unit in zip(mapping.time, mapping.time_unit, strict=True)
    ]
    for name, second in smaller:  # a part longer than the larger unit belongs to another clock
        part = rows.frame[name] * second
        reason = f"its part {name!r} of the time is not between 0 and one {mapping.time_unit[0]} of {first[0]!r}"
        rows = rows.without((part < 0.0) | (part >= first[1]), reason)
    time = pl.sum_horizontal(pl.col(name) * second for name, second in (first, *smaller))
    return replace(rows, frame=rows.frame.with_columns(time.alias(T_S)))
