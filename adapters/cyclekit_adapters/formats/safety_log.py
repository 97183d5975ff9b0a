"""Logs of safety systems: speed override, distance between robot and person, or both over time, as CSV.

A safety node or PLC writes at changes of the override, or at 10 to 30 Hz: a time, the override in percent or the
distance in m, possibly with its standard deviation and the name of the execution. The logs hold no positions. Several
overrides are multiplied. An override is in percent by convention, never by its values, because 1 % looks like full
speed as a fraction; `override_max = 1` in `[sources.map]` declares a fraction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import ConfigError, EmptyLog, LogError
from cyclekit.schema import SAFETY, conform
from cyclekit.text.numbers import fixed, given
from cyclekit_adapters.robots.controller_time import BackwardSteps
from cyclekit_adapters.tasks.safety_columns import LENGTHS, WHERE, SafetyColumns, is_safety_log, mapped_columns
from cyclekit_adapters.text.delimited import TextLayout, TextRows, delimiter_of, fields_of, header_names, read_blocks
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import file_encoding, head_lines, head_of
from cyclekit_adapters.times.coarse_stamps import share_stamps, spread_of
from cyclekit_adapters.times.local_clock import LocalClock
from cyclekit_adapters.times.proof import TimeEvidence, file_date
from cyclekit_adapters.times.row_times import T_S, TimeColumn, settled, time_column, timed
from cyclekit_adapters.times.units import Unit, checked_unit, unit_in_name
from cyclekit_adapters.times.written_time import checked_zone

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

FAR_M = 100.0
"""Maximum plausible distance measured by a safety system, m."""
_FIRST = 200
_DECIMALS = 12
_UNKNOWN = {"", "nan", "null", "none", "na", "n/a", "-"}


@dataclass
class _Seen:
    """Counts over the rows so far.

    Attributes:
        max_override: Maximum override as written.
        outside: Number of rows with an override below zero or above full speed.
        far_m: Maximum distance, m.
    """

    max_override: float = 0.0
    outside: int = 0
    far_m: float = 0.0


@dataclass(frozen=True)
class _Settings:
    """Settings of the cell file: full speed (`full_given`: the file states it), unit and zone of times, columns."""

    full: float
    full_given: bool
    unit: Unit | None
    zone: str | None
    columns: dict[str, object]


class _SafetyCsv:
    def recognises(self, path: Path) -> bool:
        line = head_of(path).partition("\n")[0]
        delimiter = delimiter_of(line, ",;\t")
        return delimiter in line and is_safety_log(path.name, _names(line, delimiter))

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        settings = _settings(options)
        line = next(iter(head_lines(path)), "")
        delimiter = delimiter_of(line, ",;\t")
        names = _names(line, delimiter)
        columns = mapped_columns(path, names, settings.columns)
        sample = _sample(path, names.index(columns.time), columns.time, delimiter)
        times = _times(path, sample, columns.time, delimiter, settings)
        clock = times.clock(settings.zone)
        seen, steps, hour = _Seen(), BackwardSteps(T_S), LocalClock(settings.zone, times.pattern)

        def make(rows: TextRows) -> Recording:
            rows = timed(rows, times, hour)
            rows = spread.rows(rows) if spread else rows
            steps.add(rows.frame)
            return Recording(
                safety=_table(rows.frame, columns, settings.full, seen),
                clock=clock,
                time_units=times.time_units,
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            _check(path, columns, settings, seen)
            coarse = [spread.said] if spread else []
            warnings = (*times.warnings(settings.zone), *coarse, *_warnings(seen, steps.count), *hour.warnings())
            return replace(last, warnings=warnings, facts=_facts(columns, times, settings))

        numbers = [*columns.overrides, *(name for name in (columns.distance, columns.deviation) if name)]
        texts = [name for name in (columns.execution, columns.time if times.pattern else None) if name]
        layout = TextLayout(
            names,
            delimiter,
            1,
            decimal_comma=delimiter != "," and not times.pattern and _has_comma(path, delimiter),
            encoding=file_encoding(path) or "utf-8",
            quotes=True,
        )
        wanted = [*([] if times.pattern else [columns.time]), *numbers]
        blocks = partial(
            read_blocks, path, layout, numbers=wanted, texts=texts, required=[columns.time], any_of=numbers
        )
        spread = None
        if share_stamps(sample):
            stamped = (timed(rows, times, LocalClock(settings.zone, times.pattern)) for rows in blocks())
            spread = spread_of(path, stamped, (), rate_hz=options.rate_hz, ask=False)
        yield from in_parts(path, blocks(), make, finish)


def _names(line: str, delimiter: str) -> tuple[str, ...]:
    return tuple(name.strip('"') for name in header_names(line, delimiter))


def _settings(options: ReadOptions) -> _Settings:
    if options.role is not None:
        cure = 'Leave role out, or map it with adapter = "csv".'
        raise ConfigError(f"a safety log cannot be read as {options.role}", cure=cure)
    rest = dict(options.map)
    full, unit, zone = rest.pop("override_max", 100), rest.pop("time_unit", None), rest.pop("time_zone", None)
    if full not in (1, 100):
        raise ConfigError(
            f"{WHERE}: override_max = {full!r} is neither 1 nor 100", cure="Give override_max = 1 or 100."
        )
    known = None if unit is None else checked_unit(str(unit), WHERE)
    return _Settings(float(str(full)), "override_max" in options.map, known, checked_zone(zone, WHERE), rest)


def _sample(path: Path, at: int, column: str, delimiter: str) -> list[str]:
    """Return the first times as written; `at` is the place of their column.

    Raises:
        EmptyLog: There is no row.
        LogError: No row has a time.
    """
    rows = [fields_of(line, delimiter) for line in head_lines(path, _FIRST)[1:]]
    sample = [text for row in rows if at < len(row) and (text := row[at].strip().strip('"')).lower() not in _UNKNOWN]
    if not sample and any(any(cell.strip() for cell in row) for row in rows):
        raise LogError(path, f"no row has a time (column {column!r})", cure="Check which column is the time.")
    if not sample:
        raise EmptyLog(path)
    return sample


def _has_comma(path: Path, delimiter: str) -> bool:
    return any("," in cell for line in head_lines(path, _FIRST)[1:] for cell in fields_of(line, delimiter))


def _times(path: Path, sample: list[str], column: str, delimiter: str, settings: _Settings) -> TimeColumn:
    comma = delimiter != ","
    evidence = TimeEvidence(column, unit_in_name(column), before_s=file_date(path))
    times = time_column((column,), sample, evidence, unit=settings.unit, decimal_comma=comma)
    times = times or TimeColumn((column,), why="neither numbers nor times in a known form", sample=sample[0])
    return settled(path, times)


def _table(frame: pl.DataFrame, columns: SafetyColumns, full: float, seen: _Seen) -> pl.DataFrame:
    """Return table SAFETY of some rows, with the override as a fraction."""
    known = {"source_row": pl.col("source_row"), "t_s": pl.col(T_S)}
    for name in columns.overrides:
        seen.max_override = max(seen.max_override, float(frame[name].max() or 0.0))  # type: ignore[arg-type]  # a number
    if columns.overrides:
        parts = [pl.when(pl.col(name).is_between(0.0, full)).then(pl.col(name) / full) for name in columns.overrides]
        inside = pl.all_horizontal(pl.col(name).is_between(0.0, full) for name in columns.overrides)
        seen.outside += frame.select((~inside).sum()).item()
        product: pl.Expr = parts[0]
        for part in parts[1:]:
            product = product * part
        known["override"] = product.round(_DECIMALS)  # so that 47 percent is exactly 0.47
    if columns.distance:
        known["distance_m"] = pl.col(columns.distance) * columns.metres
        seen.far_m = max(seen.far_m, float(frame[columns.distance].max() or 0.0) * columns.metres)  # type: ignore[arg-type]
    if columns.deviation:
        known["distance_sd_m"] = pl.col(columns.deviation) * columns.metres
    if columns.execution:
        known["execution"] = pl.col(columns.execution)
    return conform(frame.select(value.alias(name) for name, value in known.items()), SAFETY)


def _check(path: Path, columns: SafetyColumns, settings: _Settings, seen: _Seen) -> None:
    """Refuse an override that may be percent or a fraction.

    Raises:
        LogError: It never exceeds 1, and override_max is not given.
    """
    if columns.overrides and not settings.full_given and 0.0 < seen.max_override <= 1.0:
        cause = f"the override never exceeds {given(seen.max_override)}: it may be percent or a fraction"
        raise LogError(path, cause, cure="Give override_max = 1 (or 100) in [sources.map].")


def _warnings(seen: _Seen, steps_back: int) -> Iterator[str]:
    if seen.outside:
        yield f"the override is below 0 or above full speed in {seen.outside} rows: unknown there"
    if seen.far_m > FAR_M:
        yield f"distances reach {fixed(seen.far_m, 0)} m: check the unit and give length_unit"
    if steps_back:
        yield f"time steps back {steps_back} time(s)"


def _facts(columns: SafetyColumns, times: TimeColumn, settings: _Settings) -> dict[str, str]:
    unit = "percent" if settings.full > 1.0 else "fraction"
    facts = {"time": f"{columns.time}: {times.why}"}
    facts |= {"override": f"{' * '.join(columns.overrides)}: {unit}"} if columns.overrides else {}
    length = next(name for name, metres in LENGTHS.items() if metres == columns.metres)
    return facts | ({"distance": f"{columns.distance}: {length}"} if columns.distance else {})


ADAPTER: StreamingAdapter = _SafetyCsv()
