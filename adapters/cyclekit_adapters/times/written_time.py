"""Dates and times of day written as text: which forms a column has, and their seconds.

Seconds count since 1970, or since midnight (since the full hour) for times without a date. The adapters decide how
reliable a clock without a zone is.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING
from zoneinfo import available_timezones

import polars as pl

from cyclekit.errors import UnknownName

if TYPE_CHECKING:
    from collections.abc import Sequence

_FIRST_YEAR = 1900
"""Earliest year of any log: `06.03.25` read with %Y would give the year 25."""
_CLOCKS = ("%H:%M:%S%.f", "%I:%M:%S%.f %p", "%H:%M", "%I:%M %p")
_DATES = (
    *("%d.%m.%Y", "%Y/%m/%d", "%Y.%m.%d", "%d-%m-%Y", "%m/%d/%Y", "%d/%m/%Y", "%d.%m.%y", "%m/%d/%y", "%d/%m/%y"),
    *("%y/%m/%d", "%d-%b-%Y", "%d %b %Y", "%b %d %Y"),
)
_FORMS = (
    *("iso", "%Y-%m-%d %H:%M", "%Y-%m-%d %I:%M:%S%.f %p"),
    *(f"{date} {clock}" for date in _DATES for clock in _CLOCKS),
    *("%Y%m%d %H%M%S%.f", "%Y%m%dT%H%M%S%.f", "%Y-%m-%d-%H:%M:%S%.f", "%Y-%m-%d_%H-%M-%S%.f", "%Y-%m-%d %H-%M-%S%.f"),
    *("%d.%m.%Y %H.%M.%S%.f", "%a %b %d %H:%M:%S%.f %Y"),
    *(*_CLOCKS, "%M:%S%.f"),
)
_FRACTION = r"(\d:\d\d:\d\d)[;:](\d{1,9})"
"""A fraction of a second after a colon or a semicolon."""
_DIGITS = r"^((?:19|20)\d\d(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01]))((?:[01]\d|2[0-3])[0-5]\d[0-5]\d)\.?(\d{0,3})$"
"""Date and time in digits alone, YYYYMMDDhhmmss, with milliseconds or without."""
_PREFIX = r"^(?:L?DT#|L?TOD#|0 days )"
"""What IEC 61131 and pandas write before a date, a time of day and a time."""
_OF_A_PATTERN = re.compile(r"(?<=%[ST])[,;:.]?%[.\d]*f")
_ABBREVIATIONS = {
    "UTC": "+00:00",
    "GMT": "+00:00",
    "CEST": "+02:00",
    "MESZ": "+02:00",
    "CET": "+01:00",
    "MEZ": "+01:00",
}
_ZONE = re.compile(rf"(?:Z|[+-]\d\d:?\d\d|{'|'.join(_ABBREVIATIONS)})\s*$")
_MINUTES_FIRST = re.compile(r"\s*(?:\d\d?:\d\d[.,]\d|(?:2[4-9]|[3-5]\d):\d\d\s*$)")
"""A time as spreadsheets show it, mm:ss.0; without a fraction it is told from hours by its size alone."""
_GARBLED = 0.5
"""Maximum share of cells in another form, such as a footer; their rows are set aside; a column of something else
has no time at all. Half and twice of it change no test of units."""


def checked_zone(zone: object, where: str) -> str | None:
    """Return a time zone of the cell file; `where` names its section in messages.

    Raises:
        UnknownName: There is no such zone.
    """
    if zone is None or zone in available_timezones():
        return None if zone is None else str(zone)
    cure = "Use a name of the IANA list, for example Europe/Rome."
    raise UnknownName(where, "time_zone", str(zone), available_timezones(), cure=cure)


def is_dated(pattern: str) -> bool:
    """Return whether times of this form have a date."""
    return pattern == "iso" or any(part in pattern for part in ("%d", "%j", "%D", "%F", "%+"))


def names_zone(text: str) -> bool:
    """Return whether a time as written names its zone."""
    return _ZONE.search(text) is not None


def in_digits(text: str) -> bool:
    """Return whether a number is a date and time in digits alone."""
    return re.match(_DIGITS, text.strip()) is not None


def forms_of(sample: Sequence[str]) -> tuple[str, ...]:
    """Return the forms in which some times may be written, `iso` or strftime patterns; empty if they are no times."""
    frame = pl.DataFrame({"text": list(sample)}, schema={"text": pl.String})
    digits = frame.select(pl.col("text").str.contains(rf"\d\D+\d|{_DIGITS}").sum()).item()
    if not sample or digits < (1.0 - _GARBLED) * len(sample):
        return ()
    frame = frame.select(pl.col("text"), plain=_plain(pl.col("text")))
    zoned = 2 * sum(map(names_zone, sample)) > len(sample)
    forms = ["iso", *(f"{form}%z" for form in _FORMS[1:] if is_dated(form))] if zoned else list(_FORMS)
    if not any(_MINUTES_FIRST.match(text) for text in sample):
        forms = [form for form in forms if form != "%M:%S%.f"]
    unread = dict.fromkeys(forms, 0)
    for some in (frame.gather_every(max(1, frame.height // 5)), frame):
        unread = {form: some.select(_seconds(pl.col("plain"), form, None)).to_series().null_count() for form in unread}
        unread = {form: count for form, count in unread.items() if count < some.height}
    least = min(unread.values(), default=frame.height)
    return tuple(form for form, count in unread.items() if count == least <= _GARBLED * frame.height)


def written_seconds(text: pl.Expr, pattern: str, zone: str | None, *, zoned: bool = False) -> pl.Expr:
    """Return seconds since 1970 (since midnight or the full hour, if the pattern has no date) of times written as text.

    Args:
        text: The times; null, and text that does not match the pattern, give null.
        pattern: `iso`, or a strftime pattern.
        zone: Time zone of times that name none; without it UTC is assumed, so the absolute time is not reliable.
        zoned: The times of this log name their zone, so with `iso` a time without a zone gives null.
    """
    return _seconds(_plain(text), pattern, zone, zoned=zoned)


def _plain(text: pl.Expr) -> pl.Expr:
    """Return times with a point before the fraction, one blank after the date, and the zone as an offset."""
    plain = (
        text.str.strip_chars()
        .str.replace(_PREFIX, "")
        .str.replace(r"([+-]\d{2})(\d{2})$", "$1:$2")
        .str.replace(_FRACTION, "$1.$2")
        .str.replace(_DIGITS, "$1 $2.${3}0")
    )
    plain = plain.str.replace(r"(\d),(\d)", "$1.$2")
    plain = plain.str.replace(r"(\d)\.?,?\s+(\d)", "$1 $2")  # 01.05.2024, 10:00
    for word, offset in _ABBREVIATIONS.items():
        plain = plain.str.replace(rf"\s*{word}$", offset)
    return plain.str.replace(r"(?i)\s*([ap])\.?m\.?$", " ${1}M")


def _seconds(text: pl.Expr, pattern: str, zone: str | None, *, zoned: bool = False) -> pl.Expr:
    if pattern == "iso":
        text = text.str.replace(" ", "T", literal=True)
        named = text.str.replace("Z$", "+00:00").str.to_datetime("%+", time_unit="ns", time_zone="UTC", strict=False)
        if zoned:
            return _since_1970(named)
        plain = text.str.to_datetime("%Y-%m-%dT%H:%M:%S%.f", time_unit="ns", strict=False)
        return pl.coalesce(_since_1970(named), in_zone(plain, zone))
    pattern = _OF_A_PATTERN.sub("%.f", pattern)
    if not is_dated(pattern):
        hours = "" if any(part in pattern for part in ("%H", "%I", "%T", "%R")) else "%H:"
        text = pl.concat_str(pl.lit("00:"), text) if hours else text
        return text.str.to_time(hours + pattern, strict=False).cast(pl.Int64) * 1e-9
    if "%z" in pattern or "%+" in pattern or "%:z" in pattern:
        offset = text.str.replace(r"\s*(Z|[+-]\d\d:\d\d)$", "$1").str.replace("Z$", "+00:00")
        when = offset.str.to_datetime(re.sub(r"\s*%:?z", "%z", pattern), time_unit="ns", time_zone="UTC", strict=False)
        return _since_1970(pl.when(when.dt.year() >= _FIRST_YEAR).then(when))
    when = text.str.to_datetime(pattern, time_unit="ns", strict=False)
    return in_zone(pl.when(when.dt.year() >= _FIRST_YEAR).then(when), zone)


def in_zone(when: pl.Expr, zone: str | None) -> pl.Expr:
    """Return seconds since 1970 of local dates and times; those that a zone skips, and dates of no zone, as of UTC."""
    return _since_1970(when.dt.replace_time_zone(zone or "UTC", ambiguous="earliest", non_existent="null"))


def _since_1970(when: pl.Expr) -> pl.Expr:
    """Return seconds, from whole seconds and the rest apart: nanoseconds since 1970 exceed the precision of a float."""
    count = when.dt.epoch("ns")
    return (count // 1_000_000_000).cast(pl.Float64) + (count % 1_000_000_000) * 1e-9
