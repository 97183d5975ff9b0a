"""Column meanings and time unit of an event log, from its first lines.

Times are dates, or counts whose unit is proven (`times.proof`); otherwise the cell file has to give it. `events` reads
the rows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from cyclekit_adapters.text.delimited import delimiter_of, fields_of, unique
from cyclekit_adapters.text.text_blocks import HEAD_BYTES
from cyclekit_adapters.times.proof import TimeEvidence
from cyclekit_adapters.times.row_times import TimeColumn, time_column
from cyclekit_adapters.times.units import unit_in_name

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence

    from cyclekit_adapters.times.units import Unit

TIME_NAMES = {
    *("t", "time", "timestamp", "timestring", "datetime", "dateandtime", "utc", "utctime", "localtime", "when"),
    *("epoch", "epochtime", "unixtime", "unixtimestamp", "zeit", "zeitstempel", "zeitpunkt", "uhrzeit", "datumzeit"),
    *("datumuhrzeit", "datumundzeit", "datumunduhrzeit", "timeofday", "filetime", "datenum", "gpstime", "ticks"),
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
_DIGITAL = {"0", "1", "true", "false", "on", "off", "ein", "aus", "high", "low"}
_MEASURED = re.compile(r"^(?:state|cmd|actual|target)[._]|^q?d?[xyzq]?\d+$|^[xyz]$|[._][xyz]$", re.IGNORECASE)
"""Names of measured quantities: a robot at rest at zero also logs only 0 and 1."""
_TELLING = re.compile(r"time|zeit|dat|epoch|utc|when|\bt\b|\bt_", re.IGNORECASE)
_UNIT_LAST = re.compile(r"\s*(?:[\[({<][^\[\](){}<>]*[\])}>]|[ _.][a-zµ]+)$")
_PLAIN = re.compile(r"[^0-9a-zäöüß]+")
_WIDEST = 512
_LOOKED_AT = 200


@dataclass(frozen=True)
class EventTable:
    """Layout of an event log: rows of time, signal and value, or a time and one column per signal; its first cells."""

    names: tuple[str, ...]
    delimiter: str
    decimal_comma: bool
    times: TimeColumn
    signal: str | None
    value: str | None
    signals: tuple[str, ...] = ()
    cells: Mapping[str, Sequence[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Head:
    """First rows of a table: cells by column, the stems of the names, and what is known of its times."""

    names: tuple[str, ...]
    stems: dict[str, str]
    cells: dict[str, list[str]]
    delimiter: str
    unit: Unit | None
    before_s: float | None


def event_table(head: str, unit: Unit | None = None, before_s: float | None = None) -> EventTable | None:
    """Return the layout of an event log; None if these are not the first lines of one.

    Args:
        head: The lines.
        unit: Unit of times that are numbers, from the cell file.
        before_s: Date of the file, s since 1970.
    """
    first = head.partition("\n")[0]
    delimiter = delimiter_of(first, ",;\t")
    if not 1 <= first.count(delimiter) < _WIDEST or not _TELLING.search(first):
        return None
    lines = head.split("\n", _LOOKED_AT)
    del lines[_LOOKED_AT:]
    if len(head) >= HEAD_BYTES // 4 and len(lines) < _LOOKED_AT and len(lines) > 1:
        lines.pop()  # it may be incomplete
    names = unique(cell.strip().strip('"') for cell in fields_of(lines[0], delimiter))
    stems = {name: stem_of(name, TIME_NAMES) for name in names}
    if not any(stem in TIME_NAMES or stem in _DATES for stem in stems.values()):
        return None
    known = set(stems.values())
    if not (known & _SIGNALS and known & (_VALUES[0] | _VALUES[1])) and not _may_be_wide(lines[1:2], stems, delimiter):
        return None
    rows = [[cell.strip() for cell in fields_of(line, delimiter)] for line in lines[1:] if line.strip()]
    rows = [row for row in rows if len(row) == len(names)]
    cells = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    table = _Head(names, stems, cells, delimiter, unit, before_s)
    found = _long(table) or _wide(table)
    return replace(found, cells=cells) if found else None


def _may_be_wide(first: list[str], stems: dict[str, str], delimiter: str) -> bool:
    """Return whether the first row is a time and states, as a quick check before all other rows."""
    cells = [cell.strip().lower() for line in first for cell in fields_of(line, delimiter)]
    pairs = zip(cells, stems.values(), strict=False)
    return all(cell in _DIGITAL or not cell or stem in TIME_NAMES or stem in _DATES for cell, stem in pairs)


def _long(head: _Head) -> EventTable | None:
    stems, names = head.stems, head.names
    values = next((found for words in _VALUES if (found := [name for name in names if stems[name] in words])), [])
    signals = [name for name in names if stems[name] in _SIGNALS and name not in values]
    if len(values) != 1 or not signals:
        return None
    best = min(signals, key=lambda name: (stems[name] == "name", names.index(name)))
    times = _times([name for name in names if name not in (best, values[0])], head)
    if times is None:
        return None
    return EventTable(names, head.delimiter, _has_comma(times, head), times, best, values[0])


def _wide(head: _Head) -> EventTable | None:
    clock = [name for name in head.names if head.stems[name] in TIME_NAMES or head.stems[name] in _DATES]
    signals = tuple(name for name in head.names if name not in clock)
    seen = {name: {cell.lower() for cell in head.cells[name]} - {""} for name in signals}
    if (
        not signals
        or any(_MEASURED.search(name) for name in signals)
        or not all(seen.values())
        or not all(found <= _DIGITAL for found in seen.values())
    ):
        return None
    if not any(len(found) > 1 or not found <= {"0", "1"} for found in seen.values()):
        return None  # numbers that never change may mean anything
    times = _times(clock, head)
    if times is None or set(times.columns) != set(clock):
        return None
    return EventTable(head.names, head.delimiter, _has_comma(times, head), times, None, None, signals)


def stem_of(name: str, times: Container[str]) -> str:
    """Return a column name without blanks, case and unit: `Time [ms]` gives "time".

    Args:
        name: Name in the header.
        times: Names of time columns in this form; a unit is split off only from these.
    """
    stem = _PLAIN.sub("", _UNIT_LAST.sub("", name.lower()))
    return stem if stem in times and unit_in_name(name) else _PLAIN.sub("", name.lower())


def _times(names: Sequence[str], head: _Head) -> TimeColumn | None:
    """Return the best time column: a date with its time, then a count of known unit, then any other."""
    dates = [name for name in names if head.stems[name] in _DATES]
    clocks = [name for name in names if head.stems[name] in TIME_NAMES]
    if dates and clocks and (both := _times_of((dates[0], clocks[0]), head)):
        return both
    found = [times for name in (*clocks, *dates) if (times := _times_of((name,), head))]
    return min(found, key=lambda times: (not times.pattern, not times.known), default=None)


def _times_of(columns: tuple[str, ...], head: _Head) -> TimeColumn | None:
    rows = zip(*(head.cells[name] for name in columns), strict=True)
    sample = [text for row in rows if (text := " ".join(cell.strip('"') for cell in row).strip())]
    if not sample:
        return None
    is_date, comma = len(columns) > 1 or head.stems[columns[0]] in _DATES, head.delimiter != ","
    evidence = TimeEvidence(columns[0], unit_in_name(columns[0]), before_s=head.before_s)
    return time_column(columns, sample, evidence, unit=head.unit, decimal_comma=comma, only_written=is_date)


def _has_comma(times: TimeColumn, head: _Head) -> bool:
    return head.delimiter != "," and any("," in cell for cell in head.cells[times.columns[0]])
