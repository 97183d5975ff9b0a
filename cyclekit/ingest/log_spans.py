"""Spans of logs whose clocks are taken as known: logs that hardly overlap, and dates after the file was written.

A clock that counts since 1970 on another computer may be off by hours (a time zone) or years (another epoch), and
nothing else would show it: the people are simply not there. The time between the spans names the usual causes.
"""

from __future__ import annotations

from itertools import pairwise, product
from typing import TYPE_CHECKING, NamedTuple

from msgspec import structs

from cyclekit.alignment.clocks import ASSUMED
from cyclekit.dataset.cards import note
from cyclekit.dataset.sessions import OVERLAP_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from cyclekit.dataset.cards import Note, RecordingCard

    Span = tuple[float, float]

HALF = 0.5
"""Share of the shorter span below which logs hardly overlap: the larger part of it has no counterpart."""
DAY_S, HALF_HOUR_S, MOST_HOURS = 86400.0, 1800.0, 14.0
"""A date is in the future of its file from a day on (time zones, and archives that store local times); time zones
differ by whole or half hours, at most 14 from UTC."""
EPOCHS = {"counts since 1904 (LabVIEW)": 2082844800.0, "counts since 1900": 2208988800.0, "GPS time": -315964782.0}
"""Time at 1970 on clocks that count from another date, s; the others fall outside of 2000 to 2099, and are refused."""


DATED_S = 9.4e8
"""Times above it, s, are dates: since 1970 those from 1999 on. No controller runs for 30 years."""


class _Cause(NamedTuple):
    """What may explain the time between two spans: how far the log is late, s, and in words."""

    late_s: float
    words: str


def with_span_notes(
    recordings: Sequence[RecordingCard], copies: Mapping[str, str], files: Mapping[str, Path]
) -> list[RecordingCard]:
    """Return the recordings, with a note at the clock of those whose times cannot be those of their session's robot.

    Args:
        recordings: All recordings.
        copies: Id of each recording that is a part of another log, and the id of that one.
        files: File of each log, by its shown path.
    """
    main = {one.session: one for one in recordings if one.clock.method == "own"}
    members: dict[str, list[RecordingCard]] = {}
    for one in recordings:
        if one is not main[one.session]:
            members.setdefault(copies.get(one.id, one.id), []).append(one)
    noted = {name: found for name, mine in members.items() if (found := _apart(mine, main)) is not None}
    made = []
    for one in recordings:
        new = [noted[one.id]] if one.id in noted else [*_alone(one, recordings)] if one is main[one.session] else []
        new += _in_future(one, files.get(one.shown))
        clock = structs.replace(one.clock, warnings=(*one.clock.warnings, *new))
        made.append(structs.replace(one, clock=clock) if new else one)
    return made


def robots_at_once(logs: Sequence[RecordingCard]) -> list[Note]:
    """Return a note if robot logs with dates overlap: they are of several robots, which are a dataset each.

    Without a time zone such times count as relative, but those of all robots are probably of the same zone.
    """
    robots = [log for log in logs if "robot" in log.tables and (log.clock.kind == "epoch" or log.first_s > DATED_S)]
    robots.sort(key=lambda log: (log.clock.kind, log.first_s))
    pairs = [
        (one, other)
        for one, other in pairwise(robots)
        if one.clock.kind == other.clock.kind and other.first_s < one.last_s - OVERLAP_S
    ]
    return [note("robots-at-once", one=pairs[0][0].shown, other=pairs[0][1].shown)] if pairs else []


def _apart(parts: Sequence[RecordingCard], main: Mapping[str, RecordingCard]) -> Note | None:
    """Return a note if a log hardly overlaps the robot's logs of its sessions."""
    log = parts[0]
    if log.clock.method in (ASSUMED, "same-log") or not all(one.duration_s for one in (log, main[log.session])):
        return None
    robots = [main[one.session] for one in parts]
    spans = [one.span_s for one in robots]
    found = sum(_overlap(one.span_s, span) for one, span in zip(parts, spans, strict=True))
    if found >= HALF * min(_length(log.span_s), sum(map(_length, spans))):
        return None
    return _note(log, log.span_s, [robots[0]], spans[:1], log.clock.offset_s + robots[0].first_s)


def _alone(log: RecordingCard, recordings: Sequence[RecordingCard]) -> Iterable[Note]:
    """Yield a note for a log since 1970 beside robot logs since 1970 of other times, to none of which it belongs."""
    robots = [one for one in recordings if "robot" in one.tables and one.clock.kind == "epoch"]
    if log.clock.kind == "epoch" and "people" in log.tables and "robot" not in log.tables and robots:
        yield _note(log, (log.first_s, log.last_s), robots, [(one.first_s, one.last_s) for one in robots], 0.0)


def _note(
    log: RecordingCard, mine: Span, robots: Sequence[RecordingCard], spans: Sequence[Span], offset_s: float
) -> Note:
    cause = _cause(mine, spans)
    away_s = [mine[0] - (0.0 if cause is None else cause.late_s) - span[0] for span in spans]
    near = min(range(len(spans)), key=lambda number: abs(away_s[number]))
    late_s = away_s[near] if cause is None else cause.late_s
    told: dict[str, str | float] = {} if cause is None else {"cause": cause.words, "offset_s": offset_s - late_s}
    share = _overlap(mine, spans[near]) / max(min(_length(mine), _length(spans[near])), 1e-9)
    return note("clock-apart", robot=robots[near].shown, outside=1.0 - share, late=_duration(late_s), **told)


def _cause(mine: Span, spans: Sequence[Span]) -> _Cause | None:
    """Return the time zone or epoch with which a log lies best within others, the nearest zone first; None: none."""
    hours = sorted((n / 2.0 for n in range(-round(2 * MOST_HOURS), round(2 * MOST_HOURS) + 1)), key=abs)
    found, best = None, HALF
    for (epoch, late_s), zone in product([("", 0.0), *EPOCHS.items()], hours):
        late = late_s + zone * 2.0 * HALF_HOUR_S
        moved = (mine[0] - late, mine[1] - late)
        share = max(_overlap(moved, span) / max(min(_length(mine), _length(span)), 1e-9) for span in spans)
        if late and share > best:
            words = " and ".join(filter(None, (epoch, "another time zone" if zone else "")))
            found, best = _Cause(late, words), share
    return found


def _in_future(log: RecordingCard, file: Path | None) -> list[Note]:
    """Return a note if a log's dates are later than its file."""
    if log.clock.kind != "epoch" or file is None or not file.exists():
        return []
    late_s = log.last_s - file.stat().st_mtime
    return [note("clock-future", late=_duration(late_s))] if late_s > DAY_S else []


def _length(span: Span) -> float:
    return span[1] - span[0]


def _overlap(one: Span, other: Span) -> float:
    return max(min(one[1], other[1]) - max(one[0], other[0]), 0.0)


def _duration(time_s: float) -> str:
    """Return a time in the two largest units, with "later" or "earlier"."""
    left = abs(time_s)
    parts: list[str] = []
    for unit, size_s in (("years", 365.25 * DAY_S), ("d", DAY_S), ("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        count = int(left // size_s) if unit != "s" else round(left)
        left -= count * size_s
        parts += [f"{count} {unit}"] if count or parts else []
    return f"{' '.join(parts[:2]) or '0 s'} {'later' if time_s > 0 else 'earlier'}"
