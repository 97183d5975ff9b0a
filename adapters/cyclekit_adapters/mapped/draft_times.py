"""Candidates for the time of an unknown table, from the names and cells of its columns.

The form of a time in text and the unit of a number are decided in `times`; here is which columns are times at all.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit_adapters.mapped.draft_names import COUNTS, JOINT, OTHER, SET_POINT, TIME_UNITS, Name
from cyclekit_adapters.times.proof import TimeEvidence, prove
from cyclekit_adapters.times.units import COUNTED, EARLIEST_S, LATEST_S, unit_in_name, unit_named
from cyclekit_adapters.times.written_time import forms_of, in_digits, is_dated, names_zone, written_seconds

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from cyclekit_adapters.mapped.draft_table import DraftTable
    from cyclekit_adapters.times.units import Unit

    Vector = NDArray[np.float64]

_LOOKED_AT = 500
_DATE = re.compile(r"\d{1,4}([/.-])\d\d?\1\d{1,4}")


@dataclass(frozen=True)
class FoundTime:
    """A candidate for the time of a table.

    Attributes:
        columns: One column, or date and time of day, or seconds and a fraction of a second.
        units: Unit of each numeric column; for a single column all possible units, the most likely first.
        patterns: Possible formats of times in text, the most likely first; empty for numbers, and if none is known.
        why: Evidence for it.
        sure: The column is certainly the time.
    """

    columns: tuple[str, ...]
    units: tuple[Unit, ...] = ()
    patterns: tuple[str, ...] = ()
    zoned: bool = False
    why: str = ""
    sure: bool = True

    @property
    def decided(self) -> bool:
        """Whether its unit or format is known."""
        return len(self.patterns) == 1 or (not self.patterns and len(self.units) == len(self.columns))

    @property
    def rank(self) -> tuple[bool, bool, bool]:
        """Sort key: certain candidates with a known unit first, then certain ones, then those with a known unit."""
        return (self.sure and self.decided, self.sure, self.decided)

    def keys(self) -> tuple[dict[str, object], bool, list[str]]:
        """Return the keys of the map, whether they are certain, and what to say of them."""
        one = len(self.columns) == 1
        keys: dict[str, object] = {"time": self.columns[0] if one else list(self.columns)}
        if self.patterns:
            keys["time_format"] = self.patterns[0]
        elif self.units:
            keys |= {"clock": "epoch"} if self.units[0].zero_s == 0.0 else {}
            keys["time_unit"] = self.units[0].name if one else [unit.name for unit in self.units]
        zone = 'its times have no time zone; time_zone, for example "Europe/Rome", aligns them with other logs'
        local = (self.patterns and is_dated(self.patterns[0]) and not self.zoned) or (
            self.units and self.units[0].local
        )
        return keys, self.sure and self.decided, [zone] if local else []

    @property
    def comment(self) -> str:
        """The evidence, with the other possible formats."""
        return "; ".join((self.why, *(f"{other} is possible too" for other in self.patterns[1:3])))


def found_times(table: DraftTable, names: Mapping[str, Name], motion: TimeEvidence) -> list[FoundTime]:
    """Return the candidates for the time of a table, the best first.

    Args:
        table: The table.
        names: Its parsed column names.
        motion: What the other columns say of each of its times.
    """
    written = _written(table, names)
    others = [
        (time.columns[0], seconds_of(table, time), is_dated(time.patterns[0])) for time in written if time.decided
    ]
    split = _split(table, names)
    taken = {column for time in (*split, *written) for column in time.columns}
    counts = [name for name in names.values() if name.column not in taken and name.column in table.numbers]
    counts = [name for name in counts if rises(table.numbers[name.column])]
    timed = [name for name in counts if _is_time(name)]
    found = [*written, *split]
    for name in sorted(timed, key=lambda name: _unit_of(table, name) is None):
        found.append(_counted(table, name, replace(motion, others=others)))
        if (unit := found[-1].units[:1]) and found[-1].decided:
            others.append((name.column, table.numbers[name.column] * unit[0].seconds + (unit[0].zero_s or 0.0), False))
    if not found:
        unknown = [name for name in counts if _means_nothing_else(name)]
        told = [_counted(table, name, motion) for name in unknown]
        found = [replace(time, why=f"it rises in every row; {time.why}", sure=False) for time in told]
        found += [
            FoundTime((name.column,), why=f"{table.texts[name.column][0][:30]!r} is of no known form: time_format?")
            for name in names.values()
            if name.is_time and name.column in table.texts
        ]
    return sorted(found, key=lambda time: tuple(not part for part in time.rank))


def counts_rows(table: DraftTable, names: Mapping[str, Name]) -> str | None:
    """Return a column that counts frames; None if there is none."""
    for column, values in table.numbers.items():
        name = names[column]
        if (name.says(COUNTS) or "unnamed" in name.words) and rises(values) and (values % 1 == 0).all():
            return column
    return None


def _is_time(name: Name) -> bool:
    named = name.is_time or (name.unit in TIME_UNITS and not name.words)
    return named and not name.says(OTHER - {"min", "max"}) and not name.says(SET_POINT - {"d"})


def _means_nothing_else(name: Name) -> bool:
    return not (name.axis or name.says(OTHER | SET_POINT | COUNTS | JOINT) or "unnamed" in name.words)


def _unit_of(table: DraftTable, name: Name) -> Unit | None:
    return unit_named(table.units.get(name.column, "").strip("[]() ")) or unit_in_name(
        table.titles.get(name.column, name.column)
    )


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
            unit = COUNTED[str(part.unit)]
            within = bool((rest >= 0).all() and (rest * unit.seconds < 1.0).all() and (seconds % 1 == 0).all())
            if within and rises(seconds + rest * unit.seconds):
                dated = EARLIEST_S <= float(np.median(seconds)) <= LATEST_S
                first = COUNTED["s"].since_1970() if dated else COUNTED["s"]
                found.append(FoundTime((whole.column, part.column), (first, unit), why="seconds and their parts"))
    return found


def _counted(table: DraftTable, name: Name, motion: TimeEvidence) -> FoundTime:
    """Return a column of numbers as a time, with the units that it may have."""
    column = table.titles.get(name.column, name.column)
    proof = prove(table.numbers[name.column], replace(motion, column=column, named=_unit_of(table, name)))
    return FoundTime((name.column,), proof.left, why=proof.contradiction or proof.why, sure=not proof.contradiction)


def rises(values: Vector) -> bool:
    """Return whether numbers rise and almost never fall (below 1 % of steps, for restarts)."""
    known = values[np.isfinite(values)]
    steps = np.diff(known)
    return len(steps) > 0 and len(known) > 0.9 * len(values) and bool((steps < 0).mean() < 0.01 and (steps > 0).any())


def _written(table: DraftTable, names: Mapping[str, Name]) -> list[FoundTime]:
    """Return columns of times in text, whatever their names: single ones, or a date with a time of day."""
    texts = [name for name in names.values() if name.column in table.texts]
    clocks = [name for name in texts if any(":" in cell for cell in table.texts[name.column][:5])]
    dates = [name for name in texts if name not in clocks and (name.says({"date", "datum"}) or _is_date(table, name))]
    clocks += [name for name in texts if name.is_time and name not in (*clocks, *dates)]
    numbers = (name for name in names.values() if name.column in table.numbers)
    clocks += [name for name in numbers if all(map(in_digits, table.cells[name.column][:5]))]
    found = [time for date in dates for clock in clocks if (time := _patterned(table, (date.column, clock.column)))]
    found += [time for name in clocks if (time := _patterned(table, (name.column,)))]
    named = {name.column for name in texts if name.is_time}
    return sorted(found, key=lambda time: (len(time.columns) == 1, time.columns[-1] not in named))


def _is_date(table: DraftTable, name: Name) -> bool:
    return all(map(_DATE.fullmatch, table.texts[name.column][:5]))


def _texts(table: DraftTable, columns: tuple[str, ...]) -> list[str]:
    rows = zip(*(table.cells[name] for name in columns), strict=True)
    return [" ".join(cell.strip() for cell in cells).strip() for cells in rows]


def _patterned(table: DraftTable, columns: tuple[str, ...]) -> FoundTime | None:
    sample = [text for text in _texts(table, columns)[:_LOOKED_AT] if text]
    forms = forms_of(sample)
    zoned = 2 * sum(map(names_zone, sample)) > len(sample)
    return FoundTime(columns, patterns=forms, zoned=zoned, why=f"written as {sample[0][:30]!r}") if forms else None


def seconds_of(table: DraftTable, time: FoundTime) -> Vector:
    """Return the seconds of a time in text, shape (N,); NaN where it is in another form."""
    frame = pl.DataFrame({"text": _texts(table, time.columns)})
    when = frame.select(written_seconds(pl.col("text"), time.patterns[0], None)).to_series()
    return when.cast(pl.Float64).fill_null(float("nan")).to_numpy()
