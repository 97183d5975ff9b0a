"""Times of a mapped table: how the columns that the map names count or write them.

Nothing is guessed: a unit that the map does not give is the one that the column's name says, that is proven, or
seconds, the default; settings that the first rows contradict are refused. `mapped_csv` interprets the other columns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import LogError
from cyclekit.text.numbers import compact
from cyclekit_adapters.mapped.csv_map import CsvMap
from cyclekit_adapters.times.proof import TimeEvidence, contradicted, dated_unit, file_date, prove
from cyclekit_adapters.times.row_times import T_S, TimeColumn
from cyclekit_adapters.times.units import COUNTED, EARLIEST_S, FRAME, LATEST_S, Unit, unit_in_name, unit_named
from cyclekit_adapters.times.written_time import forms_of, is_dated, names_zone, written_seconds

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit_adapters.times.proof import Vector

DEFAULT, FROM_CELL = "the default", "from the cell file"
"""Evidence that is none in the log."""


def mapped_times(path: Path, mapping: CsvMap, cells: Mapping[str, Sequence[str]], rate_hz: float | None) -> TimeColumn:
    """Return how the times of a table are read.

    Args:
        path: The log.
        mapping: Its map.
        cells: Cells of the first rows, by column.
        rate_hz: Rate of its rows or frames.

    Raises:
        LogError: The first rows contradict the unit, or none is given and they leave several.
    """
    if not mapping.time:
        return TimeColumn((), why="row number / rate_hz")
    form = mapping.time_format
    if form is None and not np.isfinite(_numbers(cells.get(mapping.time[0], ()), mapping)).any():
        form = _only_form(path, mapping, _written(mapping, cells))
    if form is not None:
        written = [text for text in _written(mapping, cells) if ":" in text]
        zoned = "%z" in form or "%+" in form or "%:z" in form
        zoned = zoned or (form == "iso" and 2 * sum(map(names_zone, written)) > len(written))
        return TimeColumn(mapping.time, form, why=f"written as {form!r}", zoned=zoned)
    if FRAME in mapping.time_unit:
        return TimeColumn(
            mapping.time, "", (Unit(FRAME, 1.0 / (rate_hz or 1.0)),), f"frames at {compact(rate_hz, 6)} Hz"
        )
    units = tuple(unit for text in mapping.time_unit if (unit := unit_named(text)))
    why = ", ".join(unit.said for unit in units) + f", {FROM_CELL}"
    if len(mapping.time) == 1:
        units, why = _of_one(path, mapping, cells, units)
    if mapping.clock == "epoch" and units[0].zero_s is None:
        units = (units[0].since_1970(), *units[1:])
    stated = units if len(units) == 1 and why.endswith((FROM_CELL, DEFAULT)) else ()
    return TimeColumn(mapping.time, "", units, why, may_be=stated)


def _written(mapping: CsvMap, cells: Mapping[str, Sequence[str]]) -> list[str]:
    return [" ".join(row).strip() for row in zip(*(cells.get(name, ()) for name in mapping.time), strict=False)]


def _only_form(path: Path, mapping: CsvMap, sample: Sequence[str]) -> str | None:
    """Return the form of times that are text, although the map gives none; None if the first rows hold no times.

    Raises:
        LogError: They may have several forms, or the map gives their unit.
    """
    forms = forms_of([text for text in sample if text])
    if forms and (len(forms) > 1 or mapping.time_unit):
        cause = (
            f"the times of column {mapping.time[0]!r} are written ({sample[0][:40]!r}), and the map does not say how"
        )
        how = " or ".join(f'time_format = "{form}"' for form in forms[:3])
        raise LogError(path, cause, cure=f"Give {how}, and no time_unit, in [sources.map].")
    return forms[0] if forms else None


def _of_one(
    path: Path, mapping: CsvMap, cells: Mapping[str, Sequence[str]], given: tuple[Unit, ...]
) -> tuple[tuple[Unit, ...], str]:
    """Return the unit of a single column of numbers, and the evidence for it."""
    column = mapping.time[0]
    values, others = _numbers(cells.get(column, ()), mapping), _other_times(cells, mapping)
    if given and len(values):
        if (reason := contradicted(given[0], values, others)) is not None:
            cause = f'time_unit = "{given[0].name}" for column {column!r}, but {reason}'
            left = prove(values, TimeEvidence(column, others=others, before_s=file_date(path))).left
            names = " or ".join(f'"{unit.name}"' for unit in left)
            raise LogError(path, cause, cure=f"It fits {names}." if left else "Check which column is the time.")
        return given, f"{given[0].said}, {FROM_CELL}"
    if given or not len(values):
        return given or (COUNTED["s"],), f"s, {DEFAULT}"
    named = unit_in_name(column)
    proof = prove(values, TimeEvidence(column, named, others, before_s=file_date(path)))
    if proof.unit and (named or proof.unit.zero_s is not None or others):
        return (proof.unit,), proof.why
    if not others and not (named and proof.contradiction):
        return (COUNTED["s"],), f"s, {DEFAULT}"
    cure = 'Give it in [sources.map] of the cell file: time_unit = "ms", for example.'
    cause = f"no time_unit is given for column {column!r}, and {proof.question}"
    raise LogError(path, cause, cure=cure)


def _numbers(cells: Sequence[str], mapping: CsvMap) -> Vector:
    """Return cells as numbers, shape (N,); NaN where they are none."""
    text = pl.Series("cells", list(cells), pl.String).str.strip_chars()
    plain = text.str.replace(",", ".", literal=True) if mapping.decimal == "," else text
    return plain.cast(pl.Float64, strict=False).fill_null(float("nan")).to_numpy()


def _other_times(cells: Mapping[str, Sequence[str]], mapping: CsvMap) -> list[tuple[str, Vector, bool]]:
    """Return the times written as text in columns that the map does not use for the time."""
    found = []
    for name, texts in cells.items():
        sample = [text.strip() for text in texts if text.strip()]
        if name in mapping.time or not sample or ":" not in sample[0]:
            continue
        if len(forms := forms_of(sample)) == 1:
            frame = pl.DataFrame({"text": list(texts)}, schema={"text": pl.String})
            when = frame.select(written_seconds(pl.col("text"), forms[0], None)).to_series()
            seconds = when.cast(pl.Float64).fill_null(float("nan")).to_numpy()
            found.append((name, seconds, is_dated(forms[0])))
    return found


def require_epoch(path: Path, frame: pl.DataFrame, times: TimeColumn) -> None:
    """Refuse times that do not count from 1970 although clock = "epoch", mostly because of a wrong unit.

    Raises:
        LogError: The median of the times in `frame` is not within the years 2000 to 2099.
    """
    middle = frame[T_S].drop_nulls().sort()[len(frame) // 2 :].to_list()[:1]
    if not middle or EARLIEST_S <= middle[0] <= LATEST_S:
        return
    cause = f'clock = "epoch", but {compact(middle[0], 10)} s is not in the years 2000 to 2099 (time: {times.why})'
    fits = dated_unit(middle[0] / times.units[0].seconds, file_date(path)) if len(times.units) == 1 else None
    cure = f'It is a date in time_unit = "{fits.name}", {fits.about}. ' if fits else ""
    cure += 'Give another time_unit or time_format, or clock = "uptime" or "relative".'
    raise LogError(path, cause, cure=cure)
