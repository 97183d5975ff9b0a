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
from cyclekit.text.numbers import compact
from cyclekit_adapters.tasks.repeated_names import named_apart, named_apart_by_others, paused
from cyclekit_adapters.tasks.task_columns import TIMES
from cyclekit_adapters.times.local_clock import LocalClock, is_of_hour
from cyclekit_adapters.times.proof import TimeEvidence, file_date, no_duration
from cyclekit_adapters.times.row_times import TimeColumn, settled, time_column
from cyclekit_adapters.times.units import COUNTED, unit_in_name
from cyclekit_adapters.times.written_time import is_dated, written_seconds

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from cyclekit.adapter import ClockKind, TimeUnit
    from cyclekit_adapters.tasks.task_columns import Settings
    from cyclekit_adapters.times.units import Unit

_FIRST = 200
_NOTHING = ("", "nan", "null", "none", "na", "n/a", "-")
_NO_TIME = (*_NOTHING, "inf", "+inf", "-inf", "infinity", "+infinity", "-infinity")
_ZONED = r"(?:Z|[+-]\d{2}:?\d{2})$"
UNNAMED = "execution"
"""Name of executions that only their plans tell apart."""
_PLAN = ("planned_start", "planned_end")
_WRITTEN_IN = ("ns", "us", "ms", "s", "min", "h")
"""Units in which durations are written."""
_TIGHT = 0.02
"""Relative difference to which a task ends at the next start. Half and twice of it change no test of task lists."""
_ZERO = 1e-6
"""A planned time below it is zero in any unit; planners round worse."""
_OFF_PLAN = 3.0
"""Factor by which tasks may be off their plan, or overlap; units that are told apart differ by ten."""


@dataclass(frozen=True)
class Clocks:
    """Interpretation of the times of a task list.

    Attributes:
        clock: Kind of clock of starts and ends.
        plan: Reference of planned times: `clock` (same clock), `execution` (start of the execution), None (no plan).
        time_units: Units that the times may have, while they are not proven.
        warnings: What the user should know, one sentence each.
        facts: Interpretation of each column.
    """

    clock: ClockKind
    plan: str | None
    time_units: tuple[TimeUnit, ...]
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
    clock = LocalClock(settings.zone, start.pattern or None)
    cells = _in_order(path, cells, clock)
    last = "end" if "end" in columns else "duration"
    read = {"start": start, last: _times(path, cells, last, columns, settings, start, decimal_comma=decimal_comma)}
    cells = cells.with_columns(_seconds(last, read[last], settings.zone, decimal_comma))
    if last == "duration":
        cells = cells.with_columns(end="duration", end_s=pl.col("start_s") + pl.col("duration_s"))
    else:
        cells = cells.with_columns(_after_start(read[last], moved=clock.moved > 0))
    for key in (key for key in _PLAN if key in cells.columns):
        read[key] = _times(path, cells, key, columns, settings, start, decimal_comma=decimal_comma)
    if last == "end" and _zone_named(start) != _zone_named(read["end"]) and settings.zone is None and start.pattern:
        cause = f"only one of {columns['start']!r} and {columns['end']!r} names its time zone"
        raise LogError(path, cause, cure='Give the zone of the other: time_zone = "Europe/Rome" in [sources.map].')
    cells = cells.with_columns(
        _seconds(key, times, settings.zone, decimal_comma) for key, times in read.items() if key in _PLAN
    )
    zoned = start.clock(settings.zone) == "epoch"
    epochs = {key: read[key].clock(settings.zone) == "epoch" for key in _PLAN if key in read}
    plan = _plan_counts_from(cells, epochs, zoned=zoned)
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
    warnings = [*repeated, *start.warnings(settings.zone), *clock.warnings()]
    facts = {key.replace("_", " "): f"{columns[key]}: {times.why}" for key, times in read.items()}
    if plan is not None:
        facts["plan counts from"] = "the start of each execution" if plan == "execution" else "the zero of the log"
    return cells, Clocks("epoch" if zoned else "relative", plan, start.time_units, tuple(warnings), facts)


def _in_order(path: Path, cells: pl.DataFrame, clock: LocalClock) -> pl.DataFrame:
    """Return the tasks with starts of later days, and of the hour that summer time repeats, moved.

    Rows in the order of time tell where a clock begins again. In others, such as those of one agent after the other,
    times of day are of one day or night: it begins after the longest time without a start.

    Raises:
        LogError: They are of more days than one, and their rows do not tell which.
    """
    start = cells["start_s"]
    steps, known = start.drop_nulls().diff().drop_nulls(), start.drop_nulls().sort()
    if not clock.pattern or not len(steps):
        return cells
    day_s = 3600.0 if is_of_hour(clock.pattern) else 86_400.0
    if is_dated(clock.pattern) or float(steps.max() or 0.0) <= 0.5 * day_s:  # type: ignore[arg-type]  # a number
        back = steps.filter(steps < 0.0)
        in_order = not is_dated(clock.pattern) or ((back + 3600.0).abs() < 600.0).all()
        return cells.with_columns(start_s=clock.in_order(start)) if in_order else cells
    if float(steps.min() or 0.0) >= -0.5 * day_s:  # type: ignore[arg-type]  # a number
        return cells
    gaps = known.diff().drop_nulls()
    at = int(gaps.arg_max() or 0)
    if float(gaps[at]) < 0.5 * day_s:
        cause = "its times have no date, are of several days, and its rows are not in the order of time"
        raise LogError(path, cause, cure="Write them with the date, 2024-05-01T10:00:00.")
    clock.midnights = 1
    late = pl.col("start_s") <= float(known[at])
    return cells.with_columns(start_s=pl.col("start_s") + late.cast(pl.Float64) * day_s)


def _after_start(end: TimeColumn, *, moved: bool) -> pl.Expr:
    """Return the ends, those of the next day (hour), or of the hour that summer time repeats, after their starts.

    Args:
        end: Interpretation of the ends.
        moved: Whether starts were moved to the repeated hour.
    """
    before_s = pl.col("start_s") - pl.col("end_s")
    if not end.pattern or (is_dated(end.pattern) and not moved):
        return pl.col("end_s")
    if is_dated(end.pattern):
        return pl.col("end_s") + pl.when(before_s.is_between(0.0, 3600.0, closed="right")).then(3600.0).otherwise(0.0)
    day_s = 3600.0 if is_of_hour(end.pattern) else 86_400.0
    return pl.col("end_s") + day_s * (before_s / day_s + 0.5).floor().clip(0.0)


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
            cure = 'Name the column of the starts in [sources.map]: start = "COLUMN"'
            raise LogError(path, f"no row has a start (column {name!r})", cure=cure)
        return replace(start, columns=(name,), why="empty")
    named = unit_in_name(name)
    stated = settings.unit if key != "duration" or named is None else None  # a duration may have a unit of its own
    evidence = TimeEvidence(name, named, before_s=file_date(path), lasts=_lasts(cells, key, decimal_comma))
    times = time_column((name,), sample, evidence, unit=stated, decimal_comma=decimal_comma)
    if times is None:
        cause = f"the times of column {name!r} ({sample[0][:40]!r}) are neither numbers nor dates in a known format"
        raise LogError(path, cause, cure="Write them as ISO 8601, 2024-05-01T10:00:00+02:00, or as seconds.")
    if key == "duration" and not stated and not times.pattern:
        times = _by_next_start(path, times, named, cells)
    if not times.known and key in _PLAN and start is not None and (start.pattern or start.clock(None) == "epoch"):
        times = _by_size(times, cells, key)
    if not times.known and start is not None and not start.pattern and start.units:
        unit = start.units[0]._replace(zero_s=None, local=False)
        times = replace(times, units=(unit,), why=f"in the unit of {start.columns[0]}")
    times = settled(path, times if key == "start" else replace(times, may_be=()))
    if _zone_named(times) is False and cells[key].str.contains(_ZONED).any():
        cause = f"some times of column {name!r} name their time zone and some do not"
        if settings.zone is None:
            raise LogError(path, cause, cure='Give the zone of the others: time_zone = "Europe/Rome" in [sources.map].')
    return times


def _lasts(cells: pl.DataFrame, key: str, decimal_comma: bool) -> list[float]:
    """Return the ends of tasks less their starts, for numbers of one unit; empty for others and for other times."""
    if key not in ("start", "end") or "end" not in cells.columns:
        return []
    start, end = (_numbers(cells, name, decimal_comma) for name in ("start", "end"))
    far = float((end / start).median() or 0.0)  # type: ignore[arg-type]  # a number
    return (end - start).drop_nulls().to_list() if far < _OFF_PLAN else []  # else they count in two units, or from zero


def _numbers(cells: pl.DataFrame, key: str, decimal_comma: bool) -> pl.Series:
    """Return cells as numbers, null where they are none."""
    text = pl.col(key).str.replace(",", ".", literal=True) if decimal_comma else pl.col(key)
    return cells.select(text.cast(pl.Float64, strict=False).alias("number")).to_series()


def _by_size(times: TimeColumn, cells: pl.DataFrame, key: str) -> TimeColumn:
    """Return planned times in the unit in which they run, from task to task, as the actual times."""
    planned = cells.select(pl.col(key).cast(pl.Float64, strict=False)).to_series()
    if (planned.abs().max() or 0.0) < _ZERO:  # type: ignore[operator]  # a number
        return replace(times, units=(COUNTED["s"],), why="all are 0")
    done = cells["start_s" if key == "planned_start" else "end_s"]
    both = pl.DataFrame({"done": done.diff(), "planned": planned.diff()}).filter(
        (pl.col("done") > 0.0) & (pl.col("planned") > 0.0)
    )
    middle = float((both["done"] / both["planned"]).median() or 0.0)  # type: ignore[arg-type]  # a number
    fits = [unit for unit in COUNTED.values() if 1.0 / _OFF_PLAN <= middle / unit.seconds <= _OFF_PLAN]
    return replace(times, units=(fits[0],), why=f"{fits[0].name}: by what was done") if len(fits) == 1 else times


def _by_next_start(path: Path, times: TimeColumn, named: Unit | None, cells: pl.DataFrame) -> TimeColumn:
    """Return durations in the unit that their name says or the next starts of the same agent prove.

    A task ends before the next start of its agent, and lists without idle time have it end there.

    Raises:
        LogError: The next starts contradict the unit in the name.
    """
    by = ["agent", "execution"] if "execution" in cells.columns else ["agent"]
    until = (pl.col("start_s").shift(-1) - pl.col("start_s")).over(by)
    both = cells.sort("start_s").select(until=until, took=pl.col("duration").cast(pl.Float64, strict=False))
    both = both.filter((pl.col("until") > 0.0) & (pl.col("took") > 0.0))
    took, ratio = cells["duration"].cast(pl.Float64, strict=False), (both["until"] / both["took"]).to_numpy()
    if named is not None:
        if len(ratio) and float(np.median(ratio)) < named.seconds / _OFF_PLAN:
            cause = (
                f"the name of column {times.columns[0]!r} says {named.name}, but then most tasks would last past the"
            )
            cause += f" next start of their agent, by {compact(named.seconds / float(np.median(ratio)), 3)} times"
            raise LogError(path, cause, cure="Correct the name, or the column that [sources.map] names for duration.")
        return replace(times, units=(named,), why=f"its name says {named.name}")
    lasts = took.drop_nulls().to_list()
    units = [COUNTED[name] for name in _WRITTEN_IN if no_duration(COUNTED[name], lasts) is None]
    units = [unit for unit in units if not len(ratio) or float(np.median(ratio)) >= unit.seconds * (1.0 - _TIGHT)]
    tight = [unit for unit in units if len(ratio) and (np.abs(ratio / unit.seconds - 1.0) <= _TIGHT).mean() >= 0.5]
    left = tight if len(tight) == 1 else units
    if len(left) == 1:
        how = "tasks end at the next starts" if tight else "no other unit fits the next starts"
        return replace(times, units=tuple(left), why=f"{left[0].name}: {how}")
    names = " or ".join(unit.name for unit in left) or "none"
    return replace(times, units=(), why=f"the next starts fit {names}")


def _zone_named(times: TimeColumn) -> bool | None:
    """Return whether dates name their time zone; None for other times."""
    return times.zoned if is_dated(times.pattern) else None


def _seconds(key: str, times: TimeColumn, zone: str | None, decimal_comma: bool) -> pl.Expr:
    text = pl.col(key)
    if times.pattern:
        found = written_seconds(text, times.pattern, zone)
    else:
        plain = text.str.replace(",", ".", literal=True) if decimal_comma else text
        found = times.units[0].to_seconds(plain.cast(pl.Float64, strict=False), zone)
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
