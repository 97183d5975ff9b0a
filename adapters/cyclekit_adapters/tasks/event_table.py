"""Column meanings and time unit of an event log, from its first lines.

The time unit is never guessed. It follows from a date, a unit in the column's name, a count since 1970, or, for plain
numbers, from fractions, which are not used with milliseconds. Otherwise the cell file has to give it. `events` reads
the rows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit_adapters.text.delimited import delimiter_of, fields_of, unique
from cyclekit_adapters.text.text_blocks import HEAD_BYTES
from cyclekit_adapters.text.written_time import EPOCH_S

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from cyclekit.adapter import ClockKind

TIME_NAMES = {
    *("t", "time", "timestamp", "timestring", "datetime", "dateandtime", "utc", "utctime", "localtime", "when"),
    *("epoch", "epochtime", "unixtime", "unixtimestamp", "zeit", "zeitstempel", "zeitpunkt", "uhrzeit", "datumzeit"),
    *("datumuhrzeit", "datumundzeit", "datumunduhrzeit", "timeofday"),
}
_DATES = {"date", "datum"}
_SIGNALS = {
    *("signal", "signalname", "tag", "tagname", "variable", "variablename", "varname", "variablenname", "symbol"),
    *("symbolname", "channel", "channelname", "kanal", "input", "eingang", "button", "taster", "io", "iopoint"),
    *("item", "bezeichnung", "event", "ereignis", "name"),
}
_VALUES = (
    {"value", "val", "varvalue", "tagvalue", "signalvalue", "newvalue", "wert", "neuerwert"},
    {"state", "newstate", "zustand", "status", "level"},  # next to a value column, these hold its quality
)
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_UNIT_WORDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek", "sekunden"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "milliseconds", "millisekunden"), "ms"),
    **dict.fromkeys(("us", "µs", "usec", "micros", "microseconds", "mikrosekunden"), "us"),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), "ns"),
}
_DIGITAL = {"0", "1", "true", "false", "on", "off", "ein", "aus", "high", "low"}
_MEASURED = re.compile(r"^(?:state|cmd|actual|target)[._]|^q?d?[xyzq]?\d+$|^[xyz]$|[._][xyz]$", re.IGNORECASE)
"""Names of measured quantities: a robot at rest at zero also logs only 0 and 1."""
_TELLING = re.compile(r"time|zeit|dat|epoch|utc|when|\bt\b|\bt_", re.IGNORECASE)
_IN_UNIT = re.compile(r"^(.*?)(?:\s*[\[(]\s*(\w+)\s*[\])]|[ _.](\w+))$")
_PLAIN = re.compile(r"[^0-9a-zäöüß]+")
_DAY = r"(?:\d{4}-\d{2}-\d{2}[T ]|\d{4}/\d{2}/\d{2} |\d{1,2}\.\d{1,2}\.\d{4},? )"
_CLOCK = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+)?)?"
_WRITTEN = re.compile(rf"^({_DAY})?({_CLOCK})\s*(Z|[+-]\d{{2}}:?\d{{2}})?$")
_WIDEST = 512
_LOOKED_AT = 200


@dataclass(frozen=True)
class TimeColumn:
    """Interpretation of the time column.

    Attributes:
        columns: One column, or date and time of day.
        pattern: `iso` or a strftime pattern; empty for numbers.
        seconds: Unit of numbers, s; None if unknown.
        clock: Kind of clock.
        why: Evidence for this interpretation.
        sample: The first time as written.
    """

    columns: tuple[str, ...]
    pattern: str
    seconds: float | None
    clock: ClockKind
    why: str
    sample: str


@dataclass(frozen=True)
class EventTable:
    """Layout of an event log: rows of time, signal and value, or a time and one column per signal."""

    names: tuple[str, ...]
    delimiter: str
    decimal_comma: bool
    times: TimeColumn
    signal: str | None
    value: str | None
    signals: tuple[str, ...] = ()


def event_table(head: str) -> EventTable | None:
    """Return the layout of an event log; None if these are not the first lines of one."""
    first = head.partition("\n")[0]
    delimiter = delimiter_of(first, ",;\t")
    if not 1 <= first.count(delimiter) < _WIDEST or not _TELLING.search(first):
        return None
    lines = head.split("\n", _LOOKED_AT)
    del lines[_LOOKED_AT:]
    if len(head) >= HEAD_BYTES // 4 and len(lines) < _LOOKED_AT and len(lines) > 1:
        lines.pop()  # it may be incomplete
    names = unique(cell.strip().strip('"') for cell in fields_of(lines[0], delimiter))
    stems = {name: _stem(name)[0] for name in names}
    if not any(stem in TIME_NAMES or stem in _DATES for stem in stems.values()):
        return None
    known = set(stems.values())
    if not (known & _SIGNALS and known & (_VALUES[0] | _VALUES[1])) and not _may_be_wide(lines[1:2], stems, delimiter):
        return None
    rows = [[cell.strip() for cell in fields_of(line, delimiter)] for line in lines[1:] if line.strip()]
    rows = [row for row in rows if len(row) == len(names)]
    cells = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    return _long(names, stems, cells, delimiter) or _wide(names, stems, cells, delimiter)


def _may_be_wide(first: list[str], stems: dict[str, str], delimiter: str) -> bool:
    """Return whether the first row is a time and states, as a quick check before all other rows."""
    cells = [cell.strip().lower() for line in first for cell in fields_of(line, delimiter)]
    pairs = zip(cells, stems.values(), strict=False)
    return all(cell in _DIGITAL or not cell or stem in TIME_NAMES or stem in _DATES for cell, stem in pairs)


def _long(
    names: tuple[str, ...], stems: dict[str, str], cells: dict[str, list[str]], delimiter: str
) -> EventTable | None:
    values = next((found for words in _VALUES if (found := [name for name in names if stems[name] in words])), [])
    signals = [name for name in names if stems[name] in _SIGNALS and name not in values]
    if len(values) != 1 or not signals:
        return None
    best = min(signals, key=lambda name: (stems[name] == "name", names.index(name)))
    times = _times([name for name in names if name not in (best, values[0])], stems, cells, delimiter)
    if times is None:
        return None
    return EventTable(names, delimiter, _has_comma(times, cells, delimiter), times, best, values[0])


def _wide(
    names: tuple[str, ...], stems: dict[str, str], cells: dict[str, list[str]], delimiter: str
) -> EventTable | None:
    clock = [name for name in names if stems[name] in TIME_NAMES or stems[name] in _DATES]
    signals = tuple(name for name in names if name not in clock)
    seen = {name: {cell.lower() for cell in cells[name]} - {""} for name in signals}
    if (
        not signals
        or any(_MEASURED.search(name) for name in signals)
        or not all(seen.values())
        or not all(found <= _DIGITAL for found in seen.values())
    ):
        return None
    if not any(len(found) > 1 or not found <= {"0", "1"} for found in seen.values()):
        return None  # numbers that never change may mean anything
    times = _times(clock, stems, cells, delimiter)
    if times is None or set(times.columns) != set(clock):
        return None
    return EventTable(names, delimiter, _has_comma(times, cells, delimiter), times, None, None, signals)


def _stem(name: str) -> tuple[str, str | None]:
    return stem_of(name, TIME_NAMES)


def stem_of(name: str, times: Container[str]) -> tuple[str, str | None]:
    """Return a column name without blanks, case and unit, and its unit: `Time [ms]` gives ("time", "ms").

    Args:
        name: Name in the header.
        times: Names of time columns in this form; a unit is split off only from these.
    """
    lower = name.lower()
    if found := _IN_UNIT.match(lower):
        unit = _UNIT_WORDS.get(found[2] or found[3] or "")
        stem = _PLAIN.sub("", found[1])
        if unit and stem in times:
            return stem, unit
    return _PLAIN.sub("", lower), None


def _times(
    names: Sequence[str], stems: dict[str, str], cells: dict[str, list[str]], delimiter: str
) -> TimeColumn | None:
    """Return the best time column: a date with its time, then a count since 1970, then any other."""
    dates = [name for name in names if stems[name] in _DATES]
    clocks = [name for name in names if stems[name] in TIME_NAMES]
    found = [times for name in (*clocks, *dates) if (times := _times_of((name,), stems, cells, delimiter))]
    if dates and clocks and (both := _times_of((dates[0], clocks[0]), stems, cells, delimiter)):
        found.insert(0, both)
    order = {"epoch": 0, "relative": 1, "uptime": 1}
    return min(found, key=lambda times: (not times.pattern, order[times.clock], times.seconds is None), default=None)


def _times_of(
    columns: tuple[str, ...], stems: dict[str, str], cells: dict[str, list[str]], delimiter: str
) -> TimeColumn | None:
    rows = zip(*(cells[name] for name in columns), strict=True)
    sample = [text for row in rows if (text := " ".join(cell.strip('"') for cell in row).strip())]
    if not sample:
        return None
    is_date = len(columns) > 1 or stems[columns[0]] in _DATES
    return times_of(columns, sample, _stem(columns[0])[1], decimal_comma=delimiter != ",", only_written=is_date)


def times_of(
    columns: tuple[str, ...],
    sample: Sequence[str],
    unit: str | None,
    *,
    decimal_comma: bool = False,
    only_written: bool = False,
) -> TimeColumn | None:
    """Return the interpretation of times; None if they are not times.

    Args:
        columns: Their columns.
        sample: Some of them as written, at least one.
        unit: Unit of numbers, from the column's name.
        decimal_comma: Numbers may be written `0,5`.
        only_written: Numbers do not count as times.
    """
    if all(found := [_WRITTEN.match(text) for text in sample]):
        return _written(columns, sample, [match for match in found if match])
    numbers = [_number(text, decimal_comma=decimal_comma) for text in sample]
    if only_written or any(number is None for number in numbers):
        slashes = any(re.match(r"\d{1,2}/\d{1,2}/\d{2,4}\b", text) for text in sample)
        return (
            TimeColumn(columns, "", None, "relative", "month and day cannot be told apart", sample[0])
            if slashes
            else None
        )
    return _counted(columns, unit, sample, [number for number in numbers if number is not None])


def _written(columns: tuple[str, ...], sample: Sequence[str], found: list[re.Match[str]]) -> TimeColumn | None:
    if len({match[1] is None for match in found}) > 1:
        return None
    day, clock = found[0][1], found[0][2]
    second = "%H:%M:%S%.f" if clock.count(":") == 2 else "%H:%M"
    if day is None:
        return TimeColumn(columns, second, 1.0, "relative", "time of day, without a date", sample[0])
    zoned = all(match[3] for match in found)
    date = "%Y-%m-%d" if "-" in day else "%Y/%m/%d" if "/" in day else "%d.%m.%Y"
    pattern = "iso" if date == "%Y-%m-%d" and second != "%H:%M" else f"{date} {second}"
    if zoned and pattern != "iso":
        return None  # no known program writes that
    why = "date and time with a zone" if zoned else "date and time without a zone"
    return TimeColumn(columns, pattern, 1.0, "epoch" if zoned else "relative", why, sample[0])


def _counted(columns: tuple[str, ...], unit: str | None, sample: Sequence[str], numbers: list[float]) -> TimeColumn:
    if unit is not None:
        return counted_in(columns, unit, "by the column's name", numbers, sample[0])
    for name, seconds in UNITS.items():
        if all(EPOCH_S[0] <= number * seconds <= EPOCH_S[1] for number in numbers):
            return TimeColumn(columns, "", seconds, "epoch", f"{name} since 1970, by its size", sample[0])
    if any(number % 1 for number in numbers):
        return TimeColumn(columns, "", 1.0, "relative", "seconds, since it has fractions and names no unit", sample[0])
    return TimeColumn(columns, "", None, "relative", "its unit is not named", sample[0])


def counted_in(columns: tuple[str, ...], unit: str, why: str, numbers: Sequence[float], sample: str) -> TimeColumn:
    """Return the interpretation of numbers with a known unit."""
    seconds = UNITS[unit]
    since_1970 = bool(numbers) and all(EPOCH_S[0] <= number * seconds <= EPOCH_S[1] for number in numbers)
    why = f"{unit}, {why}{'; since 1970, by its size' if since_1970 else ''}"
    return TimeColumn(columns, "", seconds, "epoch" if since_1970 else "relative", why, sample)


def _number(text: str, *, decimal_comma: bool) -> float | None:
    try:
        value = float(text.replace(",", ".") if decimal_comma else text)
    except ValueError:
        return None
    return value if abs(value) < 1e19 else None


def _has_comma(times: TimeColumn, cells: dict[str, list[str]], delimiter: str) -> bool:
    return delimiter != "," and any("," in cell for cell in cells[times.columns[0]])
