"""Candidates for the time of an unknown table and its unit, from names, steps and magnitude.

A unit is certain if the name gives it, if a count since 1970 proves it, or if it alone gives a usual sampling interval.
Otherwise all possible units are returned.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit_adapters.mapped.csv_map import SECONDS
from cyclekit_adapters.mapped.draft_names import COUNTS, OTHER, SET_POINT, TIME_UNITS, Name
from cyclekit_adapters.text.written_time import EPOCH_S, written_seconds

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from cyclekit_adapters.mapped.draft_table import DraftTable

    Vector = NDArray[np.float64]

_STEP_S = (0.0002, 1.2)
"""Range of sampling intervals of motion logs, s (5 kHz and slower)."""
_SLOWER_S = 60.0
_LIKELY_S = (5e-5, 600.0)
_PATTERNS = (
    "iso",
    *(f"{date} {clock}" for date in ("%d.%m.%Y", "%Y/%m/%d", "%Y.%m.%d") for clock in ("%H:%M:%S%.f", "%H:%M:%S:%3f")),
    *(f"{date} %H:%M:%S%.f" for date in ("%m/%d/%Y", "%d/%m/%Y")),
    *(f"{date} %I:%M:%S%.f %p" for date in ("%m/%d/%Y", "%d/%m/%Y")),
    *("%Y%m%d %H%M%S%.f", "%Y-%m-%d-%H:%M:%S%.f", "%Y-%m-%d_%H-%M-%S%.f", "%Y-%m-%d %H-%M-%S%.f", "%H:%M:%S%.f"),
)
_ZONED = re.compile(r"(?:Z|[+-]\d\d:?\d\d)\s*$")
_LOOKED_AT = 500


@dataclass(frozen=True)
class FoundTime:
    """A candidate for the time of a table.

    Attributes:
        columns: One column, or date and time of day, or seconds and a fraction of a second.
        units: Unit of each numeric column; for a single column all possible units, the most likely first.
        patterns: Possible formats of times in text, the most likely first; empty for numbers.
        epoch: The times count since 1970.
        why: Evidence for it.
        sure: The column is certainly the time.
    """

    columns: tuple[str, ...]
    units: tuple[str, ...] = ()
    patterns: tuple[str, ...] = ()
    epoch: bool = False
    zoned: bool = False
    why: str = ""
    sure: bool = True

    @property
    def rank(self) -> tuple[bool, bool, bool]:
        """Sort key: certain candidates with a known unit first, then certain ones, then those with a known unit."""
        decided = len(self.patterns) == 1 or len(self.units) == len(self.columns)
        return (self.sure and decided, self.sure, decided)


def found_times(table: DraftTable, names: Mapping[str, Name]) -> list[FoundTime]:
    """Return the candidates for the time of a table, the best first."""
    found = _split(table, names)
    taken = {column for time in found for column in time.columns}
    found += [one for name in names.values() if name.column not in taken and (one := _counted(table, name))]
    found += _written(table, names)
    if not found and not table.headed:
        found += [one for column in table.numbers if (one := _by_steps_alone(table, column))]
    return sorted(found, key=lambda time: tuple(not part for part in time.rank))


def counts_rows(table: DraftTable, names: Mapping[str, Name]) -> str | None:
    """Return a column that counts frames; None if there is none."""
    for column, values in table.numbers.items():
        name = names[column]
        if (name.says(COUNTS) or "unnamed" in name.words) and _rises(values) and (values % 1 == 0).all():
            return column
    return None


def _split(table: DraftTable, names: Mapping[str, Name]) -> list[FoundTime]:
    """Return pairs of a column of seconds and a column of fractions of a second with the same words."""
    found = []
    for whole in names.values():
        if whole.unit != "s" or whole.column not in table.numbers:
            continue
        for part in names.values():
            if part.unit not in ("ns", "us", "ms") or part.words != whole.words or part.column not in table.numbers:
                continue
            seconds, rest = table.numbers[whole.column], table.numbers[part.column]
            second = SECONDS[str(part.unit)]
            within = bool((rest >= 0).all() and (rest * second < 1.0).all() and (seconds % 1 == 0).all())
            if within and _rises(seconds + rest * second):
                epoch = _is_epoch(seconds, "s")
                units = ("s", str(part.unit))
                found.append(FoundTime((whole.column, part.column), units, epoch=epoch, why="seconds and their parts"))
    return found


def _counted(table: DraftTable, name: Name) -> FoundTime | None:
    """Return a rising numeric column whose name means a time."""
    values = table.numbers.get(name.column)
    if values is None or not _rises(values):
        return None
    named = name.is_time or (name.unit in TIME_UNITS and not name.words)
    if not named or name.says(OTHER) or name.says(SET_POINT - {"d"}):
        return None
    unit = name.unit if name.unit in TIME_UNITS else None
    units, epoch, why = _units(values, unit)
    agree = unit is None or units == (unit,)
    return FoundTime((name.column,), units, epoch=epoch, why=why, sure=agree) if units else None


def _by_steps_alone(table: DraftTable, column: str) -> FoundTime | None:
    values = table.numbers[column]
    if not _rises(values) or np.array_equal(values, np.floor(values)):
        return None
    units, epoch, why = _units(values, None)
    return FoundTime((column,), units, epoch=epoch, why=f"{why}; it rises in every row", sure=False) if units else None


def _units(values: Vector, unit: str | None) -> tuple[tuple[str, ...], bool, str]:
    """Return the possible units, whether they count since 1970, and the evidence."""
    steps = np.diff(values[np.isfinite(values)])
    step = float(np.median(steps[steps > 0]))
    if unit and _LIKELY_S[0] <= step * SECONDS[unit] <= _LIKELY_S[1]:
        return (unit,), _is_epoch(values, unit), f"its name says {unit}; steps of {step:g} are {_shown(step, unit)}"
    since = [unit for unit in SECONDS if _is_epoch(values, unit) and step * SECONDS[unit] <= _SLOWER_S]
    if len(since) == 1:
        return (since[0],), True, f"{since[0]} since 1970, by its size; steps of {_shown(step, since[0])}"
    usual = [unit for unit in SECONDS if _STEP_S[0] <= step * SECONDS[unit] <= _STEP_S[1]]
    slower = [unit for unit in SECONDS if _STEP_S[1] < step * SECONDS[unit] <= _SLOWER_S]
    fits = [*usual, *slower, *([unit] if unit and unit not in (*usual, *slower) else [])]
    likely = ", ".join(f"{_shown(step, unit)} if {unit}" for unit in fits)
    return tuple(fits), False, f"steps of {step:g}: {likely}"


def _shown(step: float, unit: str) -> str:
    seconds = step * SECONDS[unit]
    return f"{1000 * seconds:.4g} ms" if seconds < 1 else f"{seconds:.4g} s"


def _is_epoch(values: Vector, unit: str) -> bool:
    middle = float(np.nanmedian(values)) * SECONDS[unit]
    return EPOCH_S[0] <= middle <= EPOCH_S[1]


def _rises(values: Vector) -> bool:
    """Return whether numbers rise and almost never fall (below 1 % of steps, for restarts)."""
    known = values[np.isfinite(values)]
    steps = np.diff(known)
    return len(steps) > 0 and len(known) > 0.9 * len(values) and bool((steps < 0).mean() < 0.01 and (steps > 0).any())


def _written(table: DraftTable, names: Mapping[str, Name]) -> list[FoundTime]:
    """Return columns of times in text: single ones, or a date with a time of day."""
    clocks = [name for name in names.values() if name.column in table.texts and name.is_time]
    found = [time for name in clocks if (time := _patterned(table, (name.column,)))]
    dates = [name for name in clocks if name.says({"date", "datum"})]
    for date in dates:
        for clock in clocks:
            if clock is not date and (both := _patterned(table, (date.column, clock.column))):
                found.insert(0, both)
    return found


def _patterned(table: DraftTable, columns: tuple[str, ...]) -> FoundTime | None:
    rows = zip(*(table.cells[name][:_LOOKED_AT] for name in columns), strict=True)
    samples = [text for cells in rows if (text := " ".join(cell.strip() for cell in cells).strip())]
    if not samples:
        return None
    frame = pl.DataFrame({"text": [text.replace(",", ".") for text in samples]})
    zoned = all(_ZONED.search(text) for text in samples)
    fits = []
    for pattern in _PATTERNS:
        when = frame.select(written_seconds(pl.col("text"), pattern, None, zoned=zoned and pattern == "iso"))
        if when.to_series().null_count() <= 0.02 * len(samples):
            fits.append(pattern)
    if not fits:
        return None
    dated = fits[0] != "%H:%M:%S%.f"
    why = f"written as {samples[0][:30]!r}"
    return FoundTime(columns, patterns=tuple(fits), epoch=zoned and dated, zoned=zoned, why=why)
