"""Spans of logs whose clocks are taken as known: logs that hardly overlap, and dates after the file was written.

A clock that counts since 1970 on another computer may be off by hours (a time zone) or years (another epoch), and
nothing else would show it: the people are simply not there. The time between the spans names the usual causes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import structs

from cyclekit.alignment.clocks import ASSUMED
from cyclekit.alignment.spans import HALF, cause_of, overlap, robots_beside, share
from cyclekit.dataset.cards import note
from cyclekit.derive.robot_clocks import WRONG
from cyclekit.ingest.open_units import better_unit
from cyclekit.text.numbers import compact

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from cyclekit.alignment.spans import Cause, Span
    from cyclekit.config import Source
    from cyclekit.dataset.cards import LogCard, Note, RecordingCard

DAY_S = 86400.0
"""A date is in the future of its file from a day on (time zones, and archives that store local times)."""


def with_span_notes(
    recordings: Sequence[RecordingCard],
    copies: Mapping[str, str],
    files: Mapping[str, Path],
    sources: Mapping[str, Source | None],
) -> list[RecordingCard]:
    """Return the recordings, with a note at the clock of those whose times cannot be those of their robot, or robots.

    Args:
        recordings: All recordings.
        copies: Id of each recording that is a part of another log, and the id of that one.
        files: File of each log, by its shown path.
        sources: Section of the cell file for each recording, by id.
    """
    main = {one.session: one for one in recordings if one.clock.method == "own"}
    members: dict[str, list[RecordingCard]] = {}
    for one in recordings:
        if one is not main[one.session]:
            members.setdefault(copies.get(one.id, one.id), []).append(one)
    doubtful = {one.id: _unit(one, main[one.session]) for one in recordings if one.clock.method == ASSUMED}
    noted = {name: found for name, mine in members.items() if (found := _apart(mine, main)) is not None}
    proven = {one.id for one in recordings for said in one.clock.warnings if said.code == WRONG}
    for log, robot, cause in robots_beside((one for one in recordings if one.id not in copies), sources):
        if cause is not None and log.id not in proven:
            mine, span = (log.first_s, log.last_s), (robot.first_s, robot.last_s)
            given_s = ((source := sources[log.id]) and source.clock_offset_s) or 0.0
            noted[log.id] = _note(mine, [robot], [span], given_s, cause, role="robot")
    made = []
    for one in recordings:
        new = [noted[one.id]] if one.id in noted else [*_alone(one, recordings)] if one is main[one.session] else []
        new += [*doubtful.get(one.id, ()), *_in_future(one, files.get(one.shown))]
        clock = structs.replace(one.clock, warnings=(*one.clock.warnings, *new))
        made.append(structs.replace(one, clock=clock) if new else one)
    return made


def robots_at_once(logs: Sequence[LogCard], sources: Mapping[str, Source | None]) -> list[Note]:
    """Return a note if robot logs with dates overlap: they are of several robots, which are a dataset each."""
    at_once = (one for one in robots_beside(logs, sources) if one.cause is None)
    return [note("robots-at-once", one=one.robot.shown, other=one.log.shown) for one in at_once][:1]


def _apart(parts: Sequence[RecordingCard], main: Mapping[str, RecordingCard]) -> Note | None:
    """Return a note if a log hardly overlaps the robot's logs of its sessions."""
    log = parts[0]
    if log.clock.method in (ASSUMED, "same-log") or not all(one.duration_s for one in (log, main[log.session])):
        return None
    robots = [main[one.session] for one in parts]
    spans = [one.span_s for one in robots]
    found = sum(overlap(one.span_s, span) for one, span in zip(parts, spans, strict=True))
    if found >= HALF * min(_length(log.span_s), sum(map(_length, spans))):
        return None
    return _note(log.span_s, robots[:1], spans[:1], log.clock.offset_s + robots[0].first_s)


def _unit(log: RecordingCard, robot: RecordingCard) -> list[Note]:
    """Return a note if a log lasts as long as the robot's in another unit than the one that is stated."""
    if not robot.duration_s or (unit := better_unit(log, robot)) is None:
        return []
    read = log.time_units[0]
    lasts_s = log.duration_s / read.seconds * unit.seconds
    told = {"read": read.name, "unit": unit.name, "lasts": _lasts(log.duration_s), "would_last": _lasts(lasts_s)}
    return [note("clock-unit", robot=robot.shown, robot_lasts=_lasts(robot.duration_s), **told)]


def _alone(log: RecordingCard, recordings: Sequence[RecordingCard]) -> Iterable[Note]:
    """Yield a note for a log since 1970 beside robot logs since 1970 of other times, to none of which it belongs."""
    robots = [one for one in recordings if "robot" in one.tables and one.clock.kind == "epoch"]
    if log.clock.kind == "epoch" and "people" in log.tables and "robot" not in log.tables and robots:
        yield _note((log.first_s, log.last_s), robots, [(one.first_s, one.last_s) for one in robots], 0.0)


def _note(
    mine: Span,
    robots: Sequence[LogCard],
    spans: Sequence[Span],
    offset_s: float,
    cause: Cause | None = None,
    **told: str | float,
) -> Note:
    cause = cause or cause_of(mine, spans)
    away_s = [mine[0] - (0.0 if cause is None else cause.late_s) - span[0] for span in spans]
    near = min(range(len(spans)), key=lambda number: abs(away_s[number]))
    late_s = away_s[near] if cause is None else cause.late_s
    told |= {} if cause is None else {"cause": cause.words, "offset_s": offset_s - late_s}
    outside = 1.0 - share(mine, spans[near])
    return note("clock-apart", robot=robots[near].shown, outside=outside, late=_duration(late_s), **told)


def _in_future(log: RecordingCard, file: Path | None) -> list[Note]:
    """Return a note if a log's dates are later than its file."""
    if log.clock.kind != "epoch" or file is None or not file.exists():
        return []
    late_s = log.last_s - file.stat().st_mtime
    return [note("clock-future", late=_duration(late_s))] if late_s > DAY_S else []


def _length(span: Span) -> float:
    return span[1] - span[0]


def _lasts(time_s: float) -> str:
    return f"{compact(time_s)} s"


def _duration(time_s: float) -> str:
    """Return a time in the two largest units, with "later" or "earlier"."""
    left = abs(time_s)
    parts: list[str] = []
    for unit, size_s in (("years", 365.25 * DAY_S), ("d", DAY_S), ("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        count = int(left // size_s) if unit != "s" else round(left)
        left -= count * size_s
        parts += [f"{count} {unit}"] if count or parts else []
    return f"{' '.join(parts[:2]) or '0 s'} {'later' if time_s > 0 else 'earlier'}"
