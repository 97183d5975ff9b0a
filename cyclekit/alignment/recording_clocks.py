"""Choose and fit the clock of each recording of a session.

The robot log's clock is that of the session. Another log is aligned as its source in the cell file requests (an offset,
events, the motion of a body on the flange, another source's clock, a start date), else by epoch time, else by the
stamps of device and host in the log, else by a common start. A request that cannot be met is an error, never replaced
by a weaker method. The fits are in `clocks`.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from fnmatch import fnmatchcase
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl

from cyclekit.alignment.clocks import (
    ASSUMED,
    ClockFit,
    ClockStart,
    fit_clock,
    fit_events,
    fit_motion,
    fit_pairs,
    follow,
)
from cyclekit.config.cells import CLOCK_KEYS
from cyclekit.dataset.cards import LogCard, Note, RecordingCard, note
from cyclekit.dataset.signals import event_times
from cyclekit.errors import ConfigError, UnknownName

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cyclekit.config import Source
    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.schema import Points, Vector
    from cyclekit.storage.parquet import StoredTable


FINE_S = 0.01
"""Period of the robot rows used to align clocks, s: half the period of the grid for speeds."""
_TCP = ("tcp_x_m", "tcp_y_m", "tcp_z_m")
START_GOOD_TO_S = 1.0
LATE_S = 0.1
"""Median delay of stamps above which a note is added, s."""
RESTART_S = 1.0
"""Minimum backward step of a device's clock for a restart, s."""


class _Tables(NamedTuple):
    """Access to the tables of the recordings."""

    read: Read
    stored: Stored


def place_in_time(
    session: LogGroup,
    sources: Mapping[str, Source | None],
    read: Read,
    stored: Stored,
) -> tuple[RecordingCard, ...]:
    """Return the recordings of a session with their clocks: method, offset, rate and quality.

    Args:
        session: The session; the clock of its first log is the session's.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns) for reading by row ranges.

    Raises:
        ConfigError: The logs do not allow the method that the cell file requests.
    """
    master, tables = session.logs[0], _Tables(read, stored)
    borrowers: dict[str, LogCard] = {}
    fits: dict[str, ClockFit] = {}
    for log in session.logs:
        source = sources[log.id]
        if log is not master and source is not None and source.same_clock_as is not None:
            borrowers[log.id] = log
            continue
        try:
            fits[log.id] = _fit(log, master, source, sources[master.id], tables)
        except ConfigError as error:
            raise ConfigError(f"{log.shown}: {error.seen}", nearest=error.nearest, cure=error.cure) from error
    _check_start(session, sources[master.id], fits)
    fits |= _with_common_starts([log for log in session.logs if log.id in fits], fits, sources)
    for log in borrowers.values():
        lender = _lender(log, session, sources, borrowers)
        borrowed = replace(fits[lender.id], same_as=lender.id)
        fits[log.id] = replace(borrowed, method="same-log") if lender is master else borrowed
    return tuple(_placed(log, session.name, fits[log.id]) for log in session.logs)


def can_follow(log: LogCard, robot: LogCard, sources: Mapping[str, Source | None], read: Read, stored: Stored) -> bool:
    """Return whether the logs themselves relate a log's clock to a robot's: by events, motion or stamps.

    An offset, pairs of times or a start in the cell file do not say to which part of a robot's log they belong.

    Args:
        log: A log of people or events.
        robot: The robot's log.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns) for reading by row ranges.
    """
    source = sources[log.id]
    if source is not None and (source.sync_events or source.clock_offset_s is not None or source.start is not None):
        return False
    try:
        fit = _fit(log, robot, source, sources[robot.id], _Tables(read, stored))
    except ConfigError:
        return False
    return fit.method in ("event-pairs", "motion", "lower-envelope")


def is_stated(source: Source | None) -> bool:
    """Return whether the cell file says how a log's clock relates to the robot's."""
    return source is not None and (
        source.start is not None or any(getattr(source, key) not in (None, ()) for key in CLOCK_KEYS)
    )


def _placed(log: LogCard, session: str, fit: ClockFit) -> RecordingCard:
    """Return a log with its clock in the session."""
    read = {name: getattr(log, name) for name in LogCard.__struct_fields__ if name != "clock"}
    return RecordingCard(**read, session=session, clock=fit.card(log.clock.kind))


def _fit(
    entry: LogCard,
    master: LogCard,
    source: Source | None,
    master_source: Source | None,
    tables: _Tables,
) -> ClockFit:
    log = ClockStart(entry.clock.kind, entry.first_s)
    main = ClockStart(master.clock.kind, master.first_s)
    if entry is master:
        _check_robot(entry, source)
        return replace(fit_clock(log, main, source, same_log=True), method="own")
    found = None
    if source is not None and source.sync_events:
        found = fit_pairs(*np.array(source.sync_events).T)
    elif source is not None and source.sync is not None:
        sync = source.sync
        found = fit_events(event_times(entry, sync.other, *tables), event_times(master, sync.robot, *tables))
        found = _warned("clock-of-robot-restarted", found) if _robot_restarts(master, tables) else found
    elif source is not None and source.sees is not None:
        found = _by_motion(entry, master, source, tables)
    if found is not None:
        return found.since(main.first_s)
    if source is not None and source.start is not None and source.clock_offset_s is None:
        return _by_start(log, main, source.start, master_source)
    plain = fit_clock(log, main, source)
    if plain.method != ASSUMED:
        return plain
    if log.kind == "epoch" and master_source is not None and master_source.start is not None:
        return _started(-_instant(master_source.start))
    if (stamped := _by_stamps(entry, master, tables.read)) is not None:
        return stamped.since(main.first_s)
    if any(_restarts(_stamps_of(one, tables.read)) for one in (entry, master)):
        plain = _warned("clock-restarted", plain)
    elif any(_is_lost(one, tables.read) for one in (entry, master)):
        plain = _warned("clock-stamps-apart", plain)
    return plain


def _check_robot(entry: LogCard, source: Source | None) -> None:
    """Refuse keys of a robot's own log that say how its clock relates to the robot's, which would be ignored.

    Raises:
        ConfigError: There is one; clock_offset_s is used where the role says that it is the robot's.
    """
    if source is None or "robot" not in entry.tables or entry.shown != source.path:
        return
    said = [key for key in CLOCK_KEYS if getattr(source, key) not in (None, ())]
    if said and (source.role, said) != ("robot", ["clock_offset_s"]):
        cure = 'Give it to the other log; or clock_offset_s and role = "robot", to set the dates of this robot right.'
        raise ConfigError(f"{said[0]} is given to the robot's log, whose clock is that of the session", cure=cure)


def _warned(code: str, fit: ClockFit) -> ClockFit:
    return replace(fit, warnings=(note(code), *fit.warnings))


def _lender(
    log: LogCard, session: LogGroup, sources: Mapping[str, Source | None], borrowers: Collection[str]
) -> LogCard:
    """Return the log of the session whose clock a log shares by the cell file; chains are followed."""
    lender, passed = log, [log.id]
    while lender.id in borrowers:
        source = sources[lender.id]
        path = str(source.same_clock_as if source else "")
        where = f"{lender.shown}: same_clock_as"
        others = [other for other in session.logs if other is not lender]
        named = [other for other in others if _means(path, other, sources[other.id])]
        if not named:
            raise UnknownName(where, "log of this session", path, [other.shown for other in others])
        if named[0].id in passed:
            raise ConfigError(f"{where}: {path!r} takes its clock from this one", cure="Set the clock of one of them.")
        lender = named[0]
        passed.append(lender.id)
    return lender


def _means(path: str, log: LogCard, source: Source | None) -> bool:
    return log.shown == path or fnmatchcase(log.shown, path) or (source is not None and source.path == path)


def _by_motion(log: LogCard, robot: LogCard, source: Source, tables: _Tables) -> ClockFit:
    people = tables.read(log.id, "people")
    if people is None or "robot" not in robot.tables:
        raise ConfigError('sees = "tcp" needs a log of positions, and a robot log', cure="Remove it.")
    people = flange(people, source).sort("t_s")
    seen = people.select("x_m", "y_m", "z_m").to_numpy()
    return fit_motion(people["t_s"].to_numpy(), seen, *_thinned(tables.stored(robot.id, ["t_s", *_TCP])))


def _thinned(table: StoredTable) -> tuple[Vector, Points]:
    """Return times (N,) and the other columns (N, K) of rows about FINE_S apart, in order of time.

    A clock fit needs fewer rows than a controller logs, and hours of all rows would not fit into memory.
    """
    parts = []
    for begin, end in table.groups:
        columns = table.read(begin, end)
        steps = np.diff(columns["t_s"])
        usual_s = float(np.median(steps[steps > 0])) if (steps > 0).any() else FINE_S
        some = slice(None, None, max(1, round(FINE_S / usual_s)))
        parts.append(np.stack([columns[name][some] for name in table.columns]))
    rows = np.concatenate(parts, axis=1) if parts else np.empty((len(table.columns), 0))
    rows = rows[:, np.argsort(rows[0], kind="stable")]
    return rows[0], rows[1:].T


def flange(people: pl.DataFrame, source: Source) -> pl.DataFrame:
    """Return the rows of the body on the robot's flange.

    Raises:
        UnknownName: The log has no body of that name.
        ConfigError: The log has several bodies, and none is named.
    """
    names = people["person"].unique().to_list()
    if source.sees_as is not None:
        if source.sees_as not in names:
            raise UnknownName("sees_as", "body", source.sees_as, names)
        return people.filter(pl.col("person") == source.sees_as)
    if len(names) != 1:
        several = ", ".join(sorted(names)[:6])
        raise ConfigError(f'sees = "tcp", and the log holds {len(names)} bodies ({several})', cure="Add sees_as.")
    return people


def _by_stamps(entry: LogCard, master: LogCard, read: Read) -> ClockFit | None:
    """Return the line from one log's clock to the other's through the epoch time of their hosts; None without one."""
    mine, theirs = _to_epoch(entry, read), _to_epoch(master, read)
    if mine is None or theirs is None:
        return None
    known = [fit for fit in (mine, theirs) if fit.method == "lower-envelope"]
    late_s = max(fit.residual_s or 0.0 for fit in known)
    said: list[Note] = [one for fit in known for one in fit.warnings]
    if late_s > LATE_S:
        said.append(note("clock-stamps-late", late_s=late_s))
    return ClockFit(
        "lower-envelope",
        (mine.offset_s - theirs.offset_s) / theirs.rate,
        mine.rate / theirs.rate,
        tuple(said),
        residual_s=late_s,
        events=min(fit.events or 0 for fit in known),
    )


def _to_epoch(entry: LogCard, read: Read) -> ClockFit | None:
    """Return the line from a log's clock to epoch time; None if unknown."""
    if entry.clock.kind == "epoch":
        return ClockFit("epoch", 0.0)
    stamps = _stamps_of(entry, read)
    if stamps is None or stamps.height < 2 or _restarts(stamps):
        return None
    return follow(stamps["t_s"].to_numpy(), stamps["host_s"].to_numpy())


def _stamps_of(entry: LogCard, read: Read) -> pl.DataFrame | None:
    return read(entry.id, "stamps") if "stamps" in entry.tables else None


def _is_lost(entry: LogCard, read: Read) -> bool:
    """Return whether a log has stamps to which no line fits."""
    stamps = _stamps_of(entry, read)
    return entry.clock.kind != "epoch" and stamps is not None and stamps.height > 1 and _to_epoch(entry, read) is None


def _robot_restarts(master: LogCard, tables: _Tables) -> bool:
    """Return whether the robot's clock restarted while it was recorded."""
    if "robot" not in master.tables:
        return False
    table, last_s = tables.stored(master.id, ["t_s"]), np.nan
    for begin, end in table.groups:
        times = table.column("t_s", begin, end)
        if (np.diff(times, prepend=last_s) < -RESTART_S).any():
            return True
        last_s = float(times[-1])
    return False


def _restarts(stamps: pl.DataFrame | None) -> bool:
    """Return whether the device's clock restarted: each part of the log would need a separate line."""
    return stamps is not None and bool((np.diff(stamps["t_s"].to_numpy()) < -RESTART_S).any())


def _by_start(log: ClockStart, main: ClockStart, start: str, robot: Source | None) -> ClockFit:
    if robot is not None and robot.start is not None:
        began_s = _instant(robot.start)
    elif main.kind == "epoch":
        began_s = main.first_s
    else:
        cure = "Add start = … to the robot's source as well, or use sync."
        raise ConfigError("start is given, but the robot log holds no time of day", cure=cure)
    return _started(_instant(start) - began_s - log.first_s)


def _started(offset_s: float) -> ClockFit:
    return ClockFit("start-text", offset_s, warnings=(note("clock-by-start"),), residual_s=START_GOOD_TO_S)


def _instant(start: str) -> float:
    """Return a date and time as seconds since 1970."""
    return datetime.fromisoformat(start).timestamp()


def _check_start(session: LogGroup, robot: Source | None, fits: Mapping[str, ClockFit]) -> None:
    """Refuse a start of the robot's log that relates it to no other log of the session.

    Raises:
        ConfigError: Its times are dates already, or no other log has a start or dates.
    """
    if robot is None or robot.start is None or len(session.logs) == 1:
        return
    if session.logs[0].clock.kind == "epoch":
        seen, cure = "start is given, but its times count since 1970", "Remove start, or correct clock in its map."
    elif all(fit.method != "start-text" for fit in fits.values()):
        seen = "start is given, but no other log of the session has a start, or times since 1970 without another clock"
        cure = "Add start = … to the other source as well, or remove it here."
    else:
        return
    raise ConfigError(f"{session.logs[0].shown}: {seen}", cure=cure)


def _with_common_starts(
    logs: Sequence[LogCard], fits: Mapping[str, ClockFit], sources: Mapping[str, Source | None]
) -> dict[str, ClockFit]:
    """Return the clocks of logs that are assumed to start with the robot: of files of one clock, the first one does.

    Files of one source are of one clock if they count since 1970, or if their times run on from file to file.
    """
    made: dict[str, ClockFit] = {}
    assumed = [log for log in logs if fits[log.id].method == ASSUMED]
    for kind in dict.fromkeys(of_one_kind(log, sources) for log in assumed):
        mine = sorted((log for log in assumed if of_one_kind(log, sources) == kind), key=lambda log: log.first_s)
        if all(log.clock.kind == "epoch" or before.last_s <= log.first_s for before, log in pairwise(mine)):
            made |= {log.id: replace(fits[log.id], offset_s=-mine[0].first_s) for log in mine}
    return made


def of_one_kind(log: LogCard, sources: Mapping[str, Source | None]) -> tuple[str, ...]:
    """Return what the files of one device have in common: their source in the cell file, else adapter and tables."""
    source = sources[log.id]
    return (source.path,) if source is not None else ("", log.adapter, *log.tables)
