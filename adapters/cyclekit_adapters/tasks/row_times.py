"""Times of rows in seconds, from the time column of an event log or safety log."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit_adapters.text.written_time import written_seconds

if TYPE_CHECKING:
    from cyclekit_adapters.tasks.event_table import TimeColumn
    from cyclekit_adapters.text.repeated_hour import RepeatedHour
    from cyclekit_adapters.text.text_rows import TextRows

T_S = "\x1ft_s"  # a name that no column of a file has
_WHEN = "\x1fwhen"


def timed(rows: TextRows, times: TimeColumn, hour: RepeatedHour) -> TextRows:
    """Add the time in seconds (column `T_S`), in the zone of `hour`; a row with another format is set aside."""
    frame = rows.frame
    if not times.pattern:
        return replace(rows, frame=frame.with_columns((pl.col(times.columns[0]) * times.seconds).alias(T_S)))
    text = pl.concat_str(pl.col(times.columns), separator=" ").str.replace(r"([+-]\d{2})(\d{2})$", "$1:$2")
    plain = text.str.replace(",", ".", literal=True).str.replace(". ", " ", literal=True)  # 01.05.2024, 10:00
    frame = frame.with_columns(text.alias(_WHEN), written_seconds(plain, times.pattern, hour.zone).alias(T_S))
    bad = frame[T_S].is_null()
    first = frame.filter(bad)[_WHEN][:1].to_list()
    rows = replace(rows, frame=frame).without(bad, f"its time has another format ({first[0][:40]!r})" if first else "")
    return replace(rows, frame=rows.frame.drop(_WHEN).with_columns(hour.in_order(rows.frame[T_S])))
