"""Units of time that a log leaves open, proven by the other logs of its session or refused.

Logs that are given together were recorded together: in the right unit a log lies within the time of the others and
reaches through most of it. Another unit is out if the log would end long after the others, or if all of its rows would
lie in so small a share of their time, at its beginning, that it is no chance. All else is asked.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from msgspec import structs

from cyclekit.adapter import TimeUnit
from cyclekit.config import Source
from cyclekit.errors import LogError
from cyclekit.ingest.discover import key_of
from cyclekit.ingest.read.read_log import read_or_error
from cyclekit.text.numbers import compact

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import polars as pl

    from cyclekit.dataset.cards import LogCard
    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.ingest.discover import Log
    from cyclekit.ingest.read.log_checksums import Digests
    from cyclekit.ingest.read.read_log import ReadSettings

MOST = 0.5
"""Least share of two spans that is common to both, where logs were recorded together. Units differ by ten or more, so
that only below 0.32 two of them could have it; with twice of it, a log that ends sooner is asked about."""
NEARLY = 0.9
"""The same for 1/10 s, 1/100 s and other ticks: whole numbers may count cycles as well, and those of 8 or 12 ms are a
fifth off 1/100 s. Half of it takes them for it; twice of it would ask about all ticks."""
_SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "days": 86400.0}
_TICKS = {"1/10 s": 0.1, "1/100 s": 0.01, "10 us": 1e-5, "100 ns": 1e-7, "10 ns": 1e-8}
UNITS = tuple(TimeUnit(name, seconds) for name, seconds in (_SECONDS | _TICKS).items())
"""Units in which logs count: the usual ones, and ticks."""
CHANCE = 1e-4
"""Largest chance with which the rows of a log, were they spread evenly over the others' time, all lie at its beginning.
With units a thousand apart three rows are enough, with ten apart five; half and twice change that by at most one."""
_KINDS = ("robot", "people", "safety", "task_list", "events")
"""Tables with which a log is compared, the best first: a robot's runs from the first to the last sample."""


class _Fit(NamedTuple):
    """How a log lies beside another in one unit: its span, s; the share that is common; whether it may be left out."""

    unit: TimeUnit
    span_s: float
    share: float
    out: bool


def prove_units(
    logs: Sequence[Log],
    groups: Sequence[LogGroup],
    table: Callable[[str, str], pl.DataFrame | None],
    digests: Digests,
    staging: Path,
    settings: ReadSettings,
) -> dict[str, LogCard]:
    """Return new cards of the logs whose unit was open, by id.

    Args:
        logs: All logs.
        groups: Their sessions, as far as they are known.
        table: Function of a recording and a table: its rows.
        digests: Computes the checksums of logs that are read again, in another unit than before.
        staging: Folder of the dataset being built.
        settings: What to store of each log.

    Raises:
        LogError: The other logs leave several units, or none; or a log cannot be read in the proven one.
    """
    by_id = {log.id: log for log in logs}
    found: dict[str, tuple[LogCard, TimeUnit, str]] = {}
    for group in groups:
        known = [log for log in group.logs if len(log.time_units) < 2 and log.duration_s > 0.0]
        for card in (log for log in group.logs if len(log.time_units) > 1):
            other = min(known, key=lambda log: (_kind(log), -log.duration_s), default=None)
            times = table(card.id, card.tables[0])
            rows = 0 if times is None else times["t_s"].n_unique()
            unit, why = _proven(by_id[card.id], card, rows, other)
            found[card.id] = card, unit, why
    cards = {}
    for name, (card, unit, why) in found.items():
        if unit != card.time_units[0]:
            shutil.rmtree(staging / "recordings" / name)
            read = read_or_error(_with_unit(by_id[name], unit), digests, staging=staging, settings=settings)
            if isinstance(read, LogError):
                raise read
            card = structs.replace(read.card, key=card.key, facts=card.facts)  # the unit is none of the cell file
        cards[name] = structs.replace(card, time_units=(), facts=card.facts | {"time unit": why})
    return cards


def better_unit(log: LogCard, other: LogCard) -> TimeUnit | None:
    """Return the unit in which a log lasts about as long as another, if it does not in the one that is stated.

    Args:
        log: The log, with the unit in which it was read.
        other: The log of the robot that was recorded with it.
    """
    if len(log.time_units) != 1 or log.clock.kind != "relative" or log.time_units[0].zero_s is not None:
        return None
    rows = log.rows.get(log.tables[0], 0)
    if not _fit(log, log.time_units[0], rows, other).out:
        return None
    fits = [fit for fit in (_fit(log, unit, rows, other) for unit in UNITS) if _fits(fit)]
    return fits[0].unit if len(fits) == 1 else None


def _kind(log: LogCard) -> int:
    return min(_KINDS.index(name) if name in _KINDS else len(_KINDS) for name in log.tables)


def _with_unit(log: Log, unit: TimeUnit) -> Log:
    source = log.source or Source(log.shown, log.adapter)
    changed = replace(log, source=replace(source, map={**source.map, "time_unit": unit.name}))
    return replace(changed, key=key_of(changed))


def _proven(log: Log, card: LogCard, rows: int, other: LogCard | None) -> tuple[TimeUnit, str]:
    """Return the unit that another log proves, and why.

    Raises:
        LogError: There is none.
    """
    fits = [] if other is None else [_fit(card, unit, rows, other) for unit in card.time_units]
    best = [fit for fit in fits if _fits(fit)]
    if other is not None and len(best) == 1 and all(fit.out for fit in fits if fit is not best[0]):
        (fit,) = best
        beside = f"{compact(fit.span_s)} s beside {compact(other.duration_s)} s of {other.id}"  # no file's name
        return fit.unit, f"{fit.unit.name}: {beside}; no other unit fits"
    names = [f'"{unit.name}"' for unit in card.time_units]
    cause = f"the unit of its times is not stated: it may be {' or '.join(names)}"
    if other is not None:
        spans = ", ".join(f"{compact(fit.span_s)} s in {fit.unit.name}" for fit in fits if fit.unit.seconds)
        cause += f"; {other.shown} lasts {compact(other.duration_s)} s, and these {rows} times would last {spans}"
    source = f'path = "{log.shown}", adapter = "{log.adapter}"'
    cure = f"State it in the cell file: [[sources]] {source}, [sources.map] time_unit = {names[0]}"
    cure += ' (or another of these, or "4 ms" for cycles); or in the name of its column: time [s].'
    raise LogError(log.path, cause, cure=cure)


def _fit(card: LogCard, unit: TimeUnit, rows: int, other: LogCard) -> _Fit:
    """Return how a log lies beside another in a unit, on one clock or each on a clock that began with it."""
    if not unit.seconds:  # a count of rows
        return _Fit(unit, 0.0, 0.0, out=False)
    first_s, last_s = (_in(unit, at_s, card.time_units[0]) for at_s in (card.first_s, card.last_s))
    ends = [
        (first_s - zero_s, last_s - zero_s) for zero_s in {other.first_s, 0.0 if unit.zero_s is None else other.first_s}
    ]
    ends = [(begin, end) for begin, end in ends if begin > -(1.0 - MOST) * other.duration_s]
    share = max((_common(begin, end, other.duration_s) for begin, end in ends), default=0.0)
    least = min((end / other.duration_s for _, end in ends), default=float("inf"))
    out = not ends or least > 1.0 / MOST or min(least, 1.0) ** max(rows - 1, 0) < CHANCE
    return _Fit(unit, last_s - first_s, share, out)


def _fits(fit: _Fit) -> bool:
    return fit.share >= (MOST if fit.unit.name in _SECONDS else NEARLY)


def _in(unit: TimeUnit, time_s: float, read: TimeUnit) -> float:
    return (time_s - (read.zero_s or 0.0)) / read.seconds * unit.seconds + (unit.zero_s or 0.0)


def _common(begin_s: float, end_s: float, whole_s: float) -> float:
    """Return the share of a span, and of one from 0 to `whole_s`, that is common to both: the smaller one."""
    common = max(min(end_s, whole_s) - max(begin_s, 0.0), 0.0)
    return common / max(end_s - begin_s, whole_s)
