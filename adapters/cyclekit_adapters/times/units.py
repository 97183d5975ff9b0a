"""Units and zeros in which logs count time, and the words for them.

A unit is written in the cell file as here, or as a number of a smaller one: `4 ms` are cycles of 4 ms. `proof` decides
which unit a column has.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import polars as pl

from cyclekit.errors import UnknownName
from cyclekit_adapters.times.written_time import in_zone

DAY_S = 86_400.0
FRAME = "frame"
"""Unit of a count of rows or frames, whose rate the source gives."""


class Unit(NamedTuple):
    """A way to count time.

    Attributes:
        name: Its name in the cell file.
        seconds: One count, s.
        zero_s: Zero of the count, s since 1970; None if the log sets it.
        local: It counts local time of a zone that the log does not name.
        about: Who counts so.
    """

    name: str
    seconds: float
    zero_s: float | None = None
    local: bool = False
    about: str = ""

    @property
    def said(self) -> str:
        """Name and meaning, for messages."""
        return f"{self.name} ({self.about})" if self.about else self.name

    def since_1970(self) -> Unit:
        """Return the unit as a count since 1970."""
        return self._replace(zero_s=0.0, about="since 1970")

    def to_seconds(self, count: pl.Expr, zone: str | None = None) -> pl.Expr:
        """Return seconds: since 1970 if the zero is known, else since the log's own zero.

        Args:
            count: The numbers. Of local dates those before 1900 and after 2099 give null.
            zone: Zone of local times; without it UTC is assumed, so the absolute time is not reliable.
        """
        if self.zero_s is None:
            return count * self.seconds
        when = count * self.seconds + self.zero_s
        if self.name == "gps":
            when = when - sum((when >= leap).cast(pl.Float64) for leap in _LEAPS_S)
        if not self.local:
            return when
        known = pl.when(when.is_between(_YEAR_1900_S, LATEST_S)).then(when)
        return in_zone((known * 1e6).round().cast(pl.Int64).cast(pl.Datetime("us")), zone)


_YEAR_1900_S, EARLIEST_S, LATEST_S = -2_203_891_200.0, 946_684_800.0 - 7e6, 4_102_444_800.0
"""March 1900, the last weeks of 1999 and the year 2100, s since 1970: dates of logs lie between the latter two."""
_LEAPS_S = (
    *(362793600, 394329600, 425865600, 489024000, 567993600, 631152000, 662688000, 709948800, 741484800, 773020800),
    *(820454400, 867715200, 915148800, 1136073600, 1230768000, 1341100800, 1435708800, 1483228800),
)
"""Leap seconds since 1980, s since 1970 (IERS Bulletin C): GPS time does not have them."""
COUNTED = {
    one.name: one
    for one in (
        Unit("ns", 1e-9),
        Unit("10 ns", 1e-8),
        Unit("100 ns", 1e-7),
        Unit("us", 1e-6),
        Unit("10 us", 1e-5),
        Unit("ms", 1e-3),
        Unit("1/100 s", 0.01),
        Unit("1/10 s", 0.1),
        Unit("s", 1.0),
        Unit("min", 60.0),
        Unit("h", 3600.0),
        Unit("days", DAY_S),
    )
}
"""Units of counts from any zero, the smallest first."""
DATED = {
    one.name: one
    for one in (
        Unit("excel", DAY_S, -25_569 * DAY_S, local=True, about="days since 1900, as spreadsheets count"),
        Unit("wincc", DAY_S * 1e-6, -25_569 * DAY_S, local=True, about="days since 1900 x 10^6, as WinCC counts"),
        Unit("matlab", DAY_S, -719_529 * DAY_S, local=True, about="days since the year 0, MATLAB's datenum"),
        Unit("filetime", 1e-7, -11_644_473_600.0, about="100 ns since 1601, Windows"),
        Unit("ticks", 1e-7, -62_135_596_800.0, local=True, about="100 ns since the year 1, .NET"),
        Unit("gps", 1.0, 315_964_800.0, about="s since 1980 without leap seconds, GPS"),
        Unit("1904", 1.0, -2_082_844_800.0, about="s since 1904, LabVIEW and Mac"),
    )
}
"""Units of counts from a known zero other than 1970."""
_WORDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek", "sekunde", "sekunden"), "s"),
    **dict.fromkeys(
        ("ms", "msec", "msecs", "millis", "millisec", "milliseconds", "millisecond", "millisekunden"), "ms"
    ),
    **dict.fromkeys(("us", "µs", "μs", "usec", "usecs", "micros", "microseconds", "microsec", "mikrosekunden"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanoseconds", "nanosekunden"), "ns"),
    **dict.fromkeys(("min", "mins", "minute", "minutes", "minuten"), "min"),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours", "stunde", "stunden"), "h"),
    **dict.fromkeys(("days", "tage"), "days"),
    **dict.fromkeys(("filetime",), "filetime"),
    **dict.fromkeys(("datenum",), "matlab"),
    **dict.fromkeys(("excel", "exceldate", "exceltime"), "excel"),
    **dict.fromkeys(("gps", "gpstime"), "gps"),
}
_SAY_IT = ("filetime", "datenum", "exceldate", "exceltime", "gps", "gpstime")
"""Words that say the unit wherever they stand in a name."""
_BRACKETED = re.compile(r"[\[({<]\s*([^\[\](){}<>]+?)\s*[\])}>]\s*(?:#\d+)?$")
_WORD = re.compile(r"[A-Z]+(?![a-zµ])|[A-Z]?[a-zµμäöü]+|\d+|/")
_TOO_SHORT = {"s", "h", "min"}
"""Units that a name has to say with another word."""
_PARTS = re.compile(r"(?:(\d+(?:[.,]\d+)?)(?:\s*/\s*(\d+))?\s*[*x]?\s*)?([A-Za-zµμ]+)")
_BESIDE_EACH_OTHER = 1e-9


def unit_named(text: str) -> Unit | None:
    """Return the unit that a text names, as written in the cell file or in a column's name: `4 ms`, `1/10 s`, `sec`."""
    text = text.strip()
    if known := COUNTED.get(text) or DATED.get(text):
        return known
    found = _PARTS.fullmatch(text)
    word = _WORDS.get(found[3].lower()) if found else None
    if found is None or word is None:
        return None
    unit = COUNTED.get(word) or DATED[word]
    if found[1] is None:
        return unit
    times = float(found[1].replace(",", ".")) / float(found[2] or 1.0) if float(found[2] or 1.0) else 0.0
    seconds = times * unit.seconds
    if seconds <= 0.0 or unit.zero_s is not None:
        return None
    same = [one for one in COUNTED.values() if abs(one.seconds / seconds - 1.0) < _BESIDE_EACH_OTHER]
    return same[0] if same else Unit(text, seconds)


def unit_in_name(column: str) -> Unit | None:
    """Return the unit that the name of a column of times says: `Time [ms]`, `duration_min`, `t_s`, `FILETIME`."""
    if (found := _BRACKETED.search(column)) and (unit := unit_named(found[1])):
        return unit
    words = [word.lower() for word in _WORD.findall(column)]
    if said := [word for word in words if word in _SAY_IT] + ["".join(words)] * ("".join(words) in _SAY_IT):
        return unit_named(said[0])
    if not words or words[-1] not in _WORDS or (len(words) == 1 and words[0] in _TOO_SHORT):
        return None
    return unit_named(words[-1])


def checked_unit(text: str, where: str, others: tuple[str, ...] = ()) -> Unit | None:
    """Return a unit of the cell file; None for one of `others`, such as a count of frames.

    Raises:
        UnknownName: It is no unit.
    """
    if text in others:
        return None
    unit = unit_named(text)
    if unit is None:
        raise UnknownName(where, "time_unit", text, [*COUNTED, "4 ms", *DATED, *others])
    return unit
