"""Conversion of written times to seconds since 1970, or since midnight for times without a date.

The adapters choose the pattern and decide how reliable a clock without a zone is.
"""

from __future__ import annotations

from zoneinfo import available_timezones

import polars as pl

from cyclekit.errors import UnknownName

EPOCH_S = (9.4e8, 4.1e9)
"""Plausible times of a log since 1970, s: the years 2000 to 2099."""
_FIRST_YEAR = 1900
"""Earliest year of any log: `06.03.25` read with %Y would give the year 25."""
_EXCEL_1970 = 25_569
_EXCEL_FIRST, _EXCEL_LAST = 61, 73_050


def checked_zone(zone: object, where: str) -> str | None:
    """Return a time zone of the cell file; `where` names its section in messages.

    Raises:
        UnknownName: There is no such zone.
    """
    if zone is None or zone in available_timezones():
        return None if zone is None else str(zone)
    cure = "Use a name of the IANA list, for example Europe/Rome."
    raise UnknownName(where, "time_zone", str(zone), available_timezones(), cure=cure)


def written_seconds(text: pl.Expr, pattern: str, zone: str | None, *, zoned: bool = False) -> pl.Expr:
    """Return seconds since 1970 (since midnight, if the pattern has no date) of times written as text.

    Args:
        text: The times; null, and text that does not match the pattern, give null.
        pattern: `iso`, or a strftime pattern.
        zone: Time zone of times that name none; without it UTC is assumed, so the absolute time is not reliable.
        zoned: The times of this log name their zone, so with `iso` a time without a zone gives null.
    """
    if pattern == "iso":
        text = text.str.replace(" ", "T", literal=True).str.replace(",", ".", literal=True)
        named = text.str.replace("Z$", "+00:00").str.to_datetime("%+", time_unit="ns", time_zone="UTC", strict=False)
        if zoned:
            return _since_1970(named)
        plain = text.str.to_datetime("%Y-%m-%dT%H:%M:%S%.f", time_unit="ns", strict=False)
        return pl.coalesce(_since_1970(named), _since_1970(_in_zone(plain, zone)))
    if "%d" not in pattern and "%j" not in pattern and "%D" not in pattern and "%F" not in pattern:
        return text.str.to_time(pattern, strict=False).cast(pl.Int64) * 1e-9
    if "%z" in pattern or "%+" in pattern:
        when = text.str.to_datetime(pattern, time_unit="ns", time_zone="UTC", strict=False)
    else:
        when = _in_zone(text.str.to_datetime(pattern, time_unit="ns", strict=False), zone)
    return _since_1970(pl.when(when.dt.year() >= _FIRST_YEAR).then(when))


def excel_seconds(days: pl.Expr, zone: str | None) -> pl.Expr:
    """Return seconds since 1970 of spreadsheet days: 1 is 1 January 1900, and 29 February 1900 exists.

    Args:
        days: Day numbers with the time of day as fraction, from 1 March 1900 to 2099; others give null.
        zone: Time zone of the times; without it UTC is assumed, so the absolute time is not reliable.
    """
    whole = pl.when(days.is_between(_EXCEL_FIRST, _EXCEL_LAST)).then((days - _EXCEL_1970) * 86_400e6)
    return _since_1970(_in_zone(whole.round().cast(pl.Int64).cast(pl.Datetime("us")), zone))


def _in_zone(when: pl.Expr, zone: str | None) -> pl.Expr:
    return when.dt.replace_time_zone(zone or "UTC", ambiguous="earliest", non_existent="null")


def _since_1970(when: pl.Expr) -> pl.Expr:
    """Return seconds, from whole seconds and the rest apart: nanoseconds since 1970 exceed the precision of a float."""
    count = when.dt.epoch("ns")
    return (count // 1_000_000_000).cast(pl.Float64) + (count % 1_000_000_000) * 1e-9
