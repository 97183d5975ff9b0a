"""Times of a task list in seconds of one clock: starts, ends and planned times.

Each column is interpreted separately, because planners count planned times from the start of an execution and the
others since 1970. `event_table` interprets a time column from its first cells; `written_time` converts text to seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import LogError
from cyclekit_adapters.tasks.event_table import UNITS, TimeColumn, counted_in, times_of
from cyclekit_adapters.tasks.repeated_names import named_apart, named_apart_by_others, paused
from cyclekit_adapters.tasks.task_columns import TIMES, unit_of
from cyclekit_adapters.text.written_time import written_seconds

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from cyclekit.adapter import ClockKind
    from cyclekit_adapters.tasks.task_columns import Settings

_FIRST = 200
_NOTHING = ("", "nan", "null", "none", "na", "n/a", "-")
_NO_TIME = (*_NOTHING, "inf", "+inf", "-inf", "infinity", "+infinity", "-infinity")
_ZONED = r"(?:Z|[+-]\d{2}:?\d{2})$"
UNNAMED = "execution"
"""Name of executions that only their plans tell apart."""
_PLAN = ("planned_start", "planned_end")


@dataclass(frozen=True)
class Clocks:
    """Interpretation of the times of a task list.

    Attributes:
        clock: Kind of clock of starts and ends.
        plan: Reference of planned times: `clock` (same clock), `execution` (start of the execution), None (no plan).
        warnings: What the user should know, one sentence each.
        facts: Interpretation of each column.
    """

    clock: ClockKind
    plan: str | None
    warnings: tuple[str, ...]
    facts: Mapping[str, str]


def cleaned(name: str) -> pl.Expr:
    """Return a column of texts without surrounding blanks; words for missing values become null."""
    text = pl.col(name).str.strip_chars()
    unknown = _NO_TIME if name in TIMES else _NOTHING
    return pl.when(~text.str.to_lowercase().is_in(unknown)).then(text).alias(name)


def with_seconds(
    path: Path, cells: pl.DataFrame, columns: Mapping[str, str], settings: Settings, *, decimal_comma: bool
) -> tuple[pl.DataFrame, Clocks]:
    """Return the cells with `start_s`, `end_s`, ... added for each time column, and the interpretation of the times.

    Args:
        path: The log, for messages.
        cells: Texts, named after the fields; null where unknown.
        columns: Field -> column name in the log.
        settings: Unit and zone given in the cell file.
        decimal_comma: Numbers may be written `0,5`.

    Raises:
        LogError: The time format cannot be determined.
    """
    start = _times(path, cells, "start", columns, settings, None, decimal_comma=decimal_comma)
    cells = cells.with_columns(_seconds("start", start, settings.zone, decimal_comma))
    last = "end" if "end" in columns else "duration"
    read = {"start": start, last: _times(path, cells, last, columns, settings, start, decimal_comma=decimal_comma)}
    cells = cells.with_columns(_seconds(last, read[last], settings.zone, decimal_comma))
    if last == "duration":
        cells = cells.with_columns(end="duration", end_s=pl.col("start_s") + pl.col("duration_s"))
    for key in (key for key in _PLAN if key in cells.columns):
        read[key] = _times(path, cells, key, columns, settings, start, decimal_comma=decimal_comma)
    if last == "end" and _zone_named(start) != _zone_named(read["end"]) and settings.zone is None and start.pattern:
        cause = f"only one of {columns['start']!r} and {columns['end']!r} names its time zone"
        raise LogError(path, cause, cure='Give the zone of the other: time_zone = "Europe/Rome" in [sources.map].')
    cells = cells.with_columns(
        _seconds(key, times, settings.zone, decimal_comma) for key, times in read.items() if key in _PLAN
    )
    zoned = start.clock == "epoch" or (settings.zone is not None and _dated(start))
    plan = _plan_counts_from(cells, {key: _epoch(read[key], settings) for key in _PLAN if key in read}, zoned=zoned)
    repeated: list[str] = []
    if "execution" in cells.columns and not (plan == "execution" and "planned_start" in read):
        cells, repeated = named_apart_by_others(cells)
    if plan == "execution":
        if "planned_start" in read:
            named = "execution" in cells.columns
            apart, repeated = named_apart(cells if named else cells.with_columns(execution=pl.lit(UNNAMED)))
            cells = apart if named or repeated else cells
        begin = pl.col("start_s").min()
        if "planned_start" in read:  # the first task may be planned later than 0
            begin -= pl.col("planned_start_s").min().fill_null(0.0)
        begin = begin.over("execution") if "execution" in cells.columns else begin
        cells = cells.with_columns(pl.col(f"{key}_s") + begin for key in _PLAN if key in read)
    if "execution" in cells.columns:
        repeated += paused(cells)
    lacks = "have no time zone: give time_zone to align them" if _dated(start) else "have no date and cannot be aligned"
    warnings = repeated if zoned or not start.pattern else [*repeated, f"its times {lacks} with other logs"]
    facts = {key.replace("_", " "): f"{columns[key]}: {times.why}" for key, times in read.items()}
    if plan is not None:
        facts["plan counts from"] = "the start of each execution" if plan == "execution" else "the zero of the log"
    return cells, Clocks("epoch" if zoned else "relative", plan, tuple(warnings), facts)


def _times(
    path: Path,
    cells: pl.DataFrame,
    key: str,
    columns: Mapping[str, str],
    settings: Settings,
    start: TimeColumn | None,
    *,
    decimal_comma: bool,
) -> TimeColumn:
    """Return the interpretation of the times of a field.

    Raises:
        LogError: They are not times, or their unit is unknown.
    """
    name = columns[key]
    sample = cells[key].drop_nulls()[:_FIRST].to_list()
    if not sample:
        if start is None:
            raise LogError(path, f"no row has a start (column {name!r})", cure="Record again, or remove the file.")
        return replace(start, columns=(name,), why="empty")
    unit, first = unit_of(name), sample[0]
    times = times_of((name,), sample, unit, decimal_comma=decimal_comma)
    if times is None:  # some cells are garbled: their rows are checked one by one later
        count = len(sample)
        sample = [text for text in sample if times_of((name,), [text], unit, decimal_comma=decimal_comma)]
        if 2 * len(sample) >= count:
            times = times_of((name,), sample, unit, decimal_comma=decimal_comma)
    if times is None:
        cause = f"the times of column {name!r} ({first[:40]!r}) are neither numbers nor dates in a known format"
        raise LogError(path, cause, cure="Write them as ISO 8601, 2024-05-01T10:00:00+02:00, or as seconds.")
    if settings.unit is not None and not times.pattern and not (key == "duration" and unit):
        numbers = [float(text.replace(",", ".") if decimal_comma else text) for text in sample]
        times = counted_in((name,), settings.unit, "from the cell file", numbers, sample[0])
    if times.seconds is None and key in _PLAN and start is not None and (start.pattern or start.clock == "epoch"):
        times = _by_size(times, cells, key)
    if times.seconds is None and key == "duration":
        times = _by_next_start(times, cells)
    if times.seconds is None and start is not None and not start.pattern and start.seconds is not None:
        times = replace(times, seconds=start.seconds, why=f"in the unit of {start.columns[0]}")
    if times.seconds is None:
        cause = f"the times of column {name!r} ({sample[0][:40]!r}) are ambiguous: {times.why}"
        raise LogError(path, cause, cure='Give time_unit = "s" (ms, us, ns) in [sources.map].')
    if _zone_named(times) is False and cells[key].str.contains(_ZONED).any():
        cause = f"some times of column {name!r} name their time zone and some do not"
        if settings.zone is None:
            raise LogError(path, cause, cure='Give the zone of the others: time_zone = "Europe/Rome" in [sources.map].')
    return times


def _by_size(times: TimeColumn, cells: pl.DataFrame, key: str) -> TimeColumn:
    """Return planned times in the unit that best fits the actual times, both from the start of an execution."""
    by = "execution" if "execution" in cells.columns else pl.lit(0)
    done = pl.col("start_s" if key == "planned_start" else "end_s") - pl.col("start_s").min().over(by)
    planned = pl.col(key).cast(pl.Float64, strict=False)
    both = cells.select(done=done, planned=planned).filter((pl.col("done") > 0.0) & (pl.col("planned") > 0.0))
    if both.is_empty():
        return times
    ratio = float(np.log((both["done"] / both["planned"]).median()))  # type: ignore[arg-type]  # a number
    unit = min(UNITS, key=lambda name: abs(ratio - np.log(UNITS[name])))
    return replace(times, seconds=UNITS[unit], why=f"{unit}: by what was done")


def _by_next_start(times: TimeColumn, cells: pl.DataFrame) -> TimeColumn:
    """Return durations in the unit that best fits the time from a start to the next start of the same agent."""
    by = ["agent", "execution"] if "execution" in cells.columns else ["agent"]
    until = (pl.col("start_s").shift(-1) - pl.col("start_s")).over(by)
    both = cells.sort("start_s").select(until=until, took=pl.col("duration").cast(pl.Float64, strict=False))
    ratio = both.filter((pl.col("until") > 0.0) & (pl.col("took") > 0.0)).select(pl.col("until") / pl.col("took"))
    if ratio.is_empty():
        return times
    middle = float(np.log(ratio.to_series().median()))  # type: ignore[arg-type]  # a number
    unit = min(UNITS, key=lambda name: abs(middle - np.log(UNITS[name])))
    return replace(times, seconds=UNITS[unit], why=f"{unit}: by the next starts")


def _zone_named(times: TimeColumn) -> bool | None:
    """Return whether dates name their time zone; None for other times."""
    return times.clock == "epoch" if times.pattern and _dated(times) else None


def _dated(times: TimeColumn) -> bool:
    return "%d" in times.pattern or times.pattern == "iso"


def _epoch(times: TimeColumn, settings: Settings) -> bool:
    return times.clock == "epoch" or (settings.zone is not None and _dated(times))


def _seconds(key: str, times: TimeColumn, zone: str | None, decimal_comma: bool) -> pl.Expr:
    text = pl.col(key)
    if times.pattern:
        plain = text.str.replace(r"([+-]\d{2})(\d{2})$", "$1:$2").str.replace(",", ".", literal=True)
        found = written_seconds(plain.str.replace(". ", " ", literal=True), times.pattern, zone)
    else:
        plain = text.str.replace(",", ".", literal=True) if decimal_comma else text
        found = plain.cast(pl.Float64, strict=False) * times.seconds
    return pl.when(found.is_finite()).then(found).alias(f"{key}_s")


def _plan_counts_from(cells: pl.DataFrame, epochs: Mapping[str, bool], *, zoned: bool) -> str | None:
    """Return the reference of planned times, the log's clock or the start of their execution, whichever is closer."""
    if not epochs:
        return None
    if all(epochs.values()) or not zoned:
        key = next(iter(epochs))
        late = cells["start_s" if key == "planned_start" else "end_s"] - cells[f"{key}_s"]
        by = "execution" if "execution" in cells.columns else pl.lit(0)
        begin = cells.select(pl.col("start_s").min().over(by)).to_series()
        plain, shifted = (np.nanmedian(np.abs(x.to_numpy())) if x.count() else 0.0 for x in (late, late - begin))
        return "clock" if all(epochs.values()) or plain <= shifted else "execution"
    return "execution"
