"""Time of the computer that wrote a log, paired with the device time of the same row.

A client that writes the time of day often writes whole seconds, so all rows of a second carry its start, up to a second
too early. Only a row at which the second changes is precise: the change happened between it and the previous row. So
only those rows are kept, and only if no row is missing before them. Their host times are early by at most one device
cycle. Other modules decide how to use both clocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import polars as pl

from cyclekit.schema import STAMPS, conform
from cyclekit_adapters.times.local_clock import LocalClock

_EPOCH_S = 1e8  # s; a smaller number is not a time since 1970
_GAP_CYCLES = 2.5
_TIME_OF_DAY = r"\d:\d\d"
_DAY_FIRST, _YEAR_FIRST = r"^(\d\d)\.(\d\d)\.(\d{4})", r"^(\d{4})/(\d\d)/(\d\d)"


@dataclass
class HostClock:
    """Collects the time stamps of a log, block after block.

    Attributes:
        column: Host time: ISO text, or seconds since 1970.
        zone: Time zone of texts without one, for example "Europe/Rome"; None = such texts are not usable.
        read: Number of texts parsed as a time so far; `unread`: number of texts that look like a time but were not
            parsed.
    """

    column: str
    zone: str | None
    read: int = 0
    unread: int = 0
    hour: LocalClock = field(init=False)
    _last: tuple[float, float] | None = None
    _cycle_s: float | None = None
    _tells: bool | None = None

    def __post_init__(self) -> None:
        self.hour = LocalClock(self.zone)

    def stamps(self, t_s: pl.Series, text: pl.Series) -> pl.DataFrame | None:
        """Return table STAMPS of the next rows; always None if no zone is given and the first block holds no host time.

        Args:
            t_s: Device time, shape (N,), s.
            text: Host time as written, shape (N,).
        """
        host = self.hour.in_order(pl.select(seconds_since_1970(text, self.zone).alias("host_s")).to_series())
        self.read += len(host) - host.null_count()
        self.unread += int((host.is_null() & text.str.contains(_TIME_OF_DAY)).sum())
        self._tells = self.zone is not None or self.read > 0 if self._tells is None else self._tells
        if not self._tells:
            return None
        both = pl.DataFrame({"t_s": t_s, "host_s": host}).drop_nulls()
        if both.is_empty():
            return conform(both, STAMPS)
        if self._cycle_s is None:
            cycle = both["t_s"].diff().median()
            self._cycle_s = None if cycle is None else float(str(cycle))
        before = self._last or (None, None)
        shifted = both.shift(1).with_columns(
            pl.when(pl.int_range(pl.len()) == 0).then(pl.lit(old)).otherwise(pl.col(name)).alias(name)
            for name, old in zip(("t_s", "host_s"), before, strict=True)
        )
        self._last = both.row(-1)
        step = both["t_s"] - shifted["t_s"]
        changed = (both["host_s"] != shifted["host_s"]) & (step > 0) & (step <= _GAP_CYCLES * (self._cycle_s or 0.0))
        return conform(both.filter(changed.fill_null(value=False)), STAMPS)


def seconds_since_1970(text: pl.Series, zone: str | None) -> pl.Expr:
    """Return texts as seconds since 1970; null if they hold no time."""
    iso = pl.lit(text).str.strip_chars().str.replace(" ", "T", literal=True).str.replace(",", ".", literal=True)
    zoned = iso.str.replace("Z$", "+00:00").str.to_datetime("%+", time_unit="us", time_zone="UTC", strict=False)
    number = pl.lit(text).cast(pl.Float64, strict=False)
    known = [zoned.dt.epoch("us") * 1e-6, pl.when(number > _EPOCH_S).then(number)]
    if zone is not None:
        ordered = iso.str.replace(_DAY_FIRST, "$3-$2-$1").str.replace(_YEAR_FIRST, "$1-$2-$3")
        plain = ordered.str.to_datetime("%Y-%m-%dT%H:%M:%S%.f", time_unit="us", strict=False)
        placed = plain.dt.replace_time_zone(zone, ambiguous="earliest", non_existent="null")
        known.append(placed.dt.convert_time_zone("UTC").dt.epoch("us") * 1e-6)
    return pl.coalesce(known)
