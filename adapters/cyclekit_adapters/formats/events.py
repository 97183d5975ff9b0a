"""Operator events: CSV of time, signal and value, or of a time and a column of 0 and 1 per signal.

Goal buttons, exports of PLC tags and digital inputs are logged in two forms. In the long form each row is one change of
one signal. In the wide form each row holds the states of all signals; the first states and all changes become events.
Columns are found by their usual names, English and German. Times are dates, times of day, or numbers whose unit is
proven, or left open for `ingest`, which has other logs. Values remain text.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import ConfigError, DamagedLog
from cyclekit.schema import EVENTS, conform
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.robots.controller_time import BackwardSteps
from cyclekit_adapters.tasks.event_table import EventTable, event_table
from cyclekit_adapters.tasks.safety_columns import is_safety_log
from cyclekit_adapters.tasks.state_changes import StateChanges
from cyclekit_adapters.tasks.task_columns import is_task_list
from cyclekit_adapters.text.delimited import TextLayout, TextRows, read_blocks
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import file_encoding, head_of
from cyclekit_adapters.times.coarse_stamps import share_stamps, spread_of
from cyclekit_adapters.times.local_clock import LocalClock
from cyclekit_adapters.times.proof import file_date
from cyclekit_adapters.times.row_times import T_S, settled, timed
from cyclekit_adapters.times.units import Unit, checked_unit
from cyclekit_adapters.times.written_time import checked_zone

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_WHERE = "[sources.map] of an event log"
_MARK = r"^\$RT_\w+\$$"
"""Signals that WinCC writes of its own logging."""


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
        times, steps, states = table.times, BackwardSteps(T_S), StateChanges()
        hour, clock = LocalClock(zone, times.pattern), times.clock(zone)

        def make(rows: TextRows) -> Recording:
            if table.signal:
                marks = rows.frame[table.signal].str.contains(_MARK).fill_null(value=False)
                rows = rows.without(marks, "a mark of WinCC, no event")
            rows = timed(rows, times, hour)
            rows = spread.rows(rows) if spread else rows
            events = states.changes(rows.frame, T_S, table.signals) if table.signals else _long(rows.frame, table)
            steps.add(rows.frame)
            return Recording(
                events=events,
                clock=clock,
                time_units=times.time_units,
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
            back = [f"time steps back {steps.count} time(s)"] if steps.count else []
            coarse = [spread.said] if spread else []
            return replace(last, warnings=(*times.warnings(zone), *coarse, *back, *hour.warnings()), facts=facts)

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
        blocks = partial(read_blocks, path, layout, numbers=numbers, texts=texts, required=required)
        stamps, spread = zip(*(table.cells[name] for name in times.columns), strict=True), None
        if share_stamps([" ".join(stamp) for stamp in stamps], table.cells[table.signal] if table.signal else ()):
            stamped = (timed(rows, times, LocalClock(zone, times.pattern)) for rows in blocks())
            spread = spread_of(path, stamped, (), track=table.signal, rate_hz=options.rate_hz, ask=False)
        yield from in_parts(path, blocks(), make, finish)


def _settings(options: ReadOptions) -> tuple[Unit | None, str | None]:
    """Return the unit and time zone of times given in the cell file."""
    rest = dict(options.map)
    rest.pop("time_zone", None)
    given = rest.pop("time_unit", None)
    words(replace(options, map=rest), "event", {"time_unit": (), "time_zone": ()})
    unit = None if given is None else checked_unit(str(given), _WHERE)
    if options.role not in (None, "events"):
        other = "task-list" if options.role == "tasks" else "csv"
        raise ConfigError(f"an event log cannot be read as {options.role}", cure=f'Map it with adapter = "{other}".')
    return unit, checked_zone(options.map.get("time_zone"), _WHERE)


def _table(path: Path, unit: Unit | None) -> EventTable:
    """Return the table with its time format.

    Raises:
        DamagedLog: It is not an event log.
        LogError: The unit of its times cannot be determined.
    """
    table = event_table(head_of(path), unit, file_date(path))
    if table is None:
        cause = "no columns for time, signal and value, and none for time and states of 0 and 1"
        raise DamagedLog(path, cause, cure='Map its columns with adapter = "csv".')
    return replace(table, times=settled(path, table.times))


def _long(frame: pl.DataFrame, table: EventTable) -> pl.DataFrame:
    signal, value = pl.col(str(table.signal)).alias("signal"), pl.col(str(table.value)).alias("value")
    return conform(frame.select(pl.col(T_S).alias("t_s"), signal, value, "source_row"), EVENTS)


ADAPTER: StreamingAdapter = _EventCsv()
