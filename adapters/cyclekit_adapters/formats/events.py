"""Operator events: CSV of time, signal and value, or of a time and a column of 0 and 1 per signal.

Goal buttons, exports of PLC tags and digital inputs are logged in two forms. In the long form each row is one change of
one signal. In the wide form each row holds the states of all signals; the first states and all changes become events.
Columns are found by their usual names, English and German. Times are dates (ISO 8601, or day.month.year), counts since
1970, or numbers with a unit in the column's name. Other integers may be seconds, milliseconds or cycles, and are
refused. Values remain text.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import ConfigError, DamagedLog, LogError
from cyclekit.schema import EVENTS, conform
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.robots.controller_time import BackwardSteps
from cyclekit_adapters.tasks.event_table import UNITS, EventTable, TimeColumn, counted_in, event_table
from cyclekit_adapters.tasks.row_times import T_S, timed
from cyclekit_adapters.tasks.safety_columns import is_safety_log
from cyclekit_adapters.tasks.state_changes import StateChanges
from cyclekit_adapters.tasks.task_columns import is_task_list
from cyclekit_adapters.text.delimited import TextLayout, TextRows, read_blocks
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.repeated_hour import RepeatedHour
from cyclekit_adapters.text.text_blocks import file_encoding, head_of
from cyclekit_adapters.text.written_time import checked_zone

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_WHERE = "[sources.map] of an event log"


class _EventCsv:
    def recognises(self, path: Path) -> bool:
        head = head_of(path)
        table = event_table(head) if head else None
        return table is not None and not is_task_list(table.names) and not is_safety_log(path.name, table.names)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        unit, zone = _settings(options)
        table = _table(path, unit)
        times, steps, states, hour = table.times, BackwardSteps(T_S), StateChanges(), RepeatedHour(zone)
        clock = "epoch" if times.clock == "epoch" or (zone and _has_date(times)) else "relative"

        def make(rows: TextRows) -> Recording:
            rows = timed(rows, times, hour)
            events = states.changes(rows.frame, T_S, table.signals) if table.signals else _long(rows.frame, table)
            steps.add(rows.frame)
            return Recording(
                events=events,
                clock=clock,  # type: ignore[arg-type]  # one of two words
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {
                "form": "a column per signal: first state and changes" if table.signals else "a row per event",
                "time": f"{' and '.join(times.columns)}: {times.why}",
                "columns": ", ".join(table.names[:60]),
            }
            return replace(last, warnings=(*_warnings(times, zone, steps.count), *hour.warnings()), facts=facts)

        texts = [*(times.columns if times.pattern else ()), *table.signals]
        texts += [name for name in (table.signal, table.value) if name is not None]
        numbers = [] if times.pattern else list(times.columns)
        required = [*times.columns, *([table.signal] if table.signal else [])]
        layout = TextLayout(
            table.names,
            table.delimiter,
            1,
            decimal_comma=table.decimal_comma and not times.pattern,
            encoding=file_encoding(path) or "utf-8",
            quotes=True,
        )
        blocks = read_blocks(path, layout, numbers=numbers, texts=texts, required=required)
        yield from in_parts(path, blocks, make, finish)


def _settings(options: ReadOptions) -> tuple[str | None, str | None]:
    """Return the unit and time zone of times given in the cell file."""
    rest = dict(options.map)
    rest.pop("time_zone", None)
    unit = words(replace(options, map=rest), "event", {"time_unit": tuple(UNITS), "time_zone": ()}).get("time_unit")
    if options.role not in (None, "events"):
        other = "task-list" if options.role == "tasks" else "csv"
        raise ConfigError(f"an event log cannot be read as {options.role}", cure=f'Map it with adapter = "{other}".')
    return unit, checked_zone(options.map.get("time_zone"), _WHERE)


def _table(path: Path, unit: str | None) -> EventTable:
    """Return the table with its time format.

    Raises:
        DamagedLog: It is not an event log.
        LogError: The unit of its times cannot be determined.
    """
    table = event_table(head_of(path))
    if table is None:
        cause = "no columns for time, signal and value, and none for time and states of 0 and 1"
        raise DamagedLog(path, cause, cure='Map its columns with adapter = "csv".')
    times = table.times
    if unit is not None and not times.pattern:
        times = counted_in(times.columns, unit, "from the cell file", [], times.sample)
    if times.seconds is None:
        cause = f"the times of column {times.columns[0]!r} ({times.sample[:40]!r}) are ambiguous: {times.why}"
        cure = 'Give time_unit in [sources.map], or map the columns with adapter = "csv" and its time_format.'
        raise LogError(path, cause, cure=cure)
    return replace(table, times=times)


def _long(frame: pl.DataFrame, table: EventTable) -> pl.DataFrame:
    signal, value = pl.col(str(table.signal)).alias("signal"), pl.col(str(table.value)).alias("value")
    return conform(frame.select(pl.col(T_S).alias("t_s"), signal, value, "source_row"), EVENTS)


def _has_date(times: TimeColumn) -> bool:
    return "%d" in times.pattern or times.pattern == "iso"


def _warnings(times: TimeColumn, zone: str | None, steps_back: int) -> list[str]:
    messages = []
    if "fractions" in times.why:
        messages.append(
            "the unit of time is not stated: seconds assumed, because the numbers have fractions; check time_unit"
        )
    if times.pattern and times.clock != "epoch" and zone is None:
        messages.append("its times have no time zone, so they cannot be aligned with other logs; give time_zone")
    if steps_back:
        messages.append(f"time steps back {steps_back} time(s)")
    return messages


ADAPTER: StreamingAdapter = _EventCsv()
