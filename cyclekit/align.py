"""Which clock each recording of a session gets: what the cell file asks for, found in the logs themselves.

The robot log's clock is the session's. Another log is placed by what its source says (an offset, events, the motion of
a body on the flange, another source's clock, a start by the calendar), else by epoch time, else by the stamps of both
clocks that a log may hold (its device's and its host's), else by a common start. What was asked for and cannot be done
is refused, never replaced by something weaker. How a line is fitted to events, motion or stamps is the business of
`clock`.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit.clock import (
    MAX_DRIFT,
    ClockFit,
    LogClock,
    coarse_fit,
    fit_clock,
    fit_events,
    fit_motion,
    fit_pairs,
    lower_envelope,
)
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.frames import to_base

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.config import Source, Sync
    from cyclekit.session import Session

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]
    Read = Callable[[str, str], pl.DataFrame | None]

CLOCK = "clock: "
"""How a warning of a recording begins that was found here, and not when its log was read."""
OUTPUT = "digital-output "
_ON = {"1", "1.0", "true", "on", "high"}
_OFF = {"0", "0.0", "false", "off", "low"}
START_GOOD_TO_S = 1.0
LATE_S = 0.1
"""Stamps that typically lie further above the line under their delays are worth a word."""
RESTART_S = 1.0
"""A device's clock that steps back by more than this began anew."""


def place_in_time(
    session: Session, sources: Mapping[str, Source | None], read: Read, *, coarse_step_s: float | None = None
) -> None:
    """Give each recording of a session its clock: `entry["clock"]` with method, offset, rate and how good it is.

    Args:
        session: Its first entry is the clock's master.
        sources: What the cell file says about each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        coarse_step_s: Where nothing says how a clock relates, align on the operator being near while the robot slows,
            in whole steps of this length; None = do not.

    Raises:
        ConfigError: What the cell file asks for cannot be followed with these logs.
    """
    master = session.entries[0]
    borrowers = []
    for entry in session.entries:
        source = sources[entry["id"]]
        if entry is not master and source is not None and source.same_clock_as is not None:
            borrowers.append(entry)
            continue
        try:
            fit = _fit(entry, master, source, sources[master["id"]], read, coarse_step_s)
        except ConfigError as error:
            seen = f"{entry['sources'][0]['path']}: {error.seen}"
            raise ConfigError(seen, nearest=error.nearest, cure=error.cure) from error
        _note(entry, fit)
    for entry in borrowers:
        _note(entry, _borrowed(entry, session, sources, borrowers))


def _note(entry: dict[str, Any], fit: ClockFit) -> None:
    entry["clock"] = {"kind": entry["clock"]["kind"], **fit.to_json()}
    entry["warnings"] = [text for text in entry["warnings"] if not text.startswith(CLOCK)]
    if fit.warning:
        entry["warnings"].append(CLOCK + fit.warning)


def _fit(
    entry: dict[str, Any],
    master: dict[str, Any],
    source: Source | None,
    master_source: Source | None,
    read: Read,
    coarse_step_s: float | None,
) -> ClockFit:
    log = LogClock(entry["clock"]["kind"], entry["first_s"])
    main = LogClock(master["clock"]["kind"], master["first_s"])
    if entry is master:
        return replace(fit_clock(log, main, source, same_log=True), method="own")
    found = None
    if source is not None and source.sync_events:
        found = fit_pairs(*np.array(source.sync_events).T)
    elif source is not None and source.sync is not None:
        found = _by_events(entry["id"], master["id"], source.sync, read)
    elif source is not None and source.sees is not None:
        found = _by_motion(entry["id"], master["id"], source, read)
    if found is not None:
        return found.since(main.first_s)
    if source is not None and source.start is not None and source.clock_offset_s is None:
        return _by_start(log, main, source.start, master_source)
    plain = fit_clock(log, main, source)
    if plain.method != "assumed-common-start":
        return plain
    if (stamped := _by_stamps(entry, master, read)) is not None:
        return stamped.since(main.first_s)
    if any(_restarts(_stamps_of(one, read)) for one in (entry, master)):
        said = "a device's clock was restarted while recording, so its stamps place no clock: split the log there; "
        plain = replace(plain, warning=said + str(plain.warning))
    if coarse_step_s is None or "people" not in entry["tables"]:
        return plain
    return _coarse(entry, master, source, read, coarse_step_s) or plain


def _borrowed(
    entry: dict[str, Any],
    session: Session,
    sources: Mapping[str, Source | None],
    borrowers: Sequence[dict[str, Any]],
) -> ClockFit:
    """The clock of another recording of the session, which the cell file names by its path; that one may borrow too."""
    lender, passed = entry, [entry["id"]]
    while lender in borrowers:
        source = sources[lender["id"]]
        path = str(source.same_clock_as if source else "")
        where = f"{lender['sources'][0]['path']}: same_clock_as"
        others = [other for other in session.entries if other is not lender]
        named = [other for other in others if _means(path, other, sources[other["id"]])]
        if not named:
            known = [other["sources"][0]["path"] for other in others]
            raise UnknownName(where, "log of this session", path, known)
        if named[0]["id"] in passed:
            raise ConfigError(f"{where}: {path!r} borrows its clock from this one", cure="Say how one of them runs.")
        lender = named[0]
        passed.append(lender["id"])
    kept = {key: value for key, value in lender["clock"].items() if key != "kind"}
    warned = next((text for text in lender["warnings"] if text.startswith(CLOCK)), None)
    fit = ClockFit(**{**kept, "same_as": lender["id"]}, warning=warned and warned.removeprefix(CLOCK))
    return replace(fit, method="same-log") if lender is session.entries[0] else fit


def _means(path: str, entry: Mapping[str, Any], source: Source | None) -> bool:
    shown = entry["sources"][0]["path"]
    return shown == path or fnmatchcase(shown, path) or (source is not None and source.path == path)


def _by_events(log: str, robot: str, sync: Sync, read: Read) -> ClockFit:
    return fit_events(_event_times(log, sync.other, read), _event_times(robot, sync.robot, read))


def _event_times(recording: str, signal: str, read: Read) -> Vector:
    """Return when a signal of a recording changes, its own clock: outputs and on/off signals when they rise."""
    robot = read(recording, "robot") if signal.startswith(OUTPUT) or signal == "register" else None
    if robot is not None and signal == "register":
        return _changes(robot["t_s"], robot["register"].cast(pl.String))
    if robot is not None:
        bit = signal.removeprefix(OUTPUT)
        if not bit.isdigit() or int(bit) > 62:
            raise ConfigError(f"sync: {signal!r} is no output", cure=f'Write "{OUTPUT}0" to "{OUTPUT}62".')
        bits = robot["digital_out_bits"]
        on = pl.Series(((bits.fill_null(0).to_numpy() >> int(bit)) & 1).astype(np.int64)).cast(pl.String)
        return _changes(robot["t_s"], pl.select(pl.when(bits.is_not_null()).then(on)).to_series())
    events = read(recording, "events")
    name, _, value = signal.partition("=")
    if events is None:
        cure = "Put sync at the log that holds the events, and same_clock_as at this one."
        raise ConfigError(f"sync: {signal!r} is an event, and {recording} holds none", cure=cure)
    if name not in (known := events["signal"].unique().to_list()):
        raise UnknownName("sync", "signal", name, [*known, f"{OUTPUT}0", "register"])
    mine = events.filter(pl.col("signal") == name).sort("t_s")
    return _changes(mine["t_s"], mine["value"], wanted=value or None, sampled=False)


def _changes(t: pl.Series, values: pl.Series, *, wanted: str | None = None, sampled: bool = True) -> Vector:
    """Return when the values change; an on/off signal counts when it rises, `wanted` picks the changes to one value.

    In a sampled log the change lies between two rows: in the middle, or at the later one where rows are missing.
    """
    known = values.is_not_null()
    t, values = t.filter(known), values.filter(known)
    if len(values) == 0:
        return np.empty(0)
    before = values.shift(1)
    changed = values != before if sampled else (values != before).fill_null(value=True)
    switches = set(values.str.to_lowercase().unique().to_list()) <= _ON | _OFF
    if wanted is not None:
        changed &= values == wanted
    elif switches:
        changed &= values.str.to_lowercase().is_in(list(_ON))
    rows = np.flatnonzero(changed.fill_null(value=False).to_numpy())
    at = t.to_numpy()
    if not sampled:
        return np.asarray(at[rows])
    step = at[rows] - at[rows - 1]
    return np.asarray(np.where(step <= 0.1, at[rows] - step / 2, at[rows]))


def _by_motion(log: str, robot: str, source: Source, read: Read) -> ClockFit:
    people, motion = read(log, "people"), read(robot, "robot")
    if people is None or motion is None:
        raise ConfigError('sees = "tcp" needs a log of positions, and a robot log', cure="Remove it.")
    people = flange(people, source).sort("t_s")
    motion = motion.sort("t_s")
    tcp = motion.select("tcp_x_m", "tcp_y_m", "tcp_z_m").to_numpy()
    seen = people.select("x_m", "y_m", "z_m").to_numpy()
    return fit_motion(people["t_s"].to_numpy(), seen, motion["t_s"].to_numpy(), tcp)


def flange(people: pl.DataFrame, source: Source) -> pl.DataFrame:
    """Return the rows of the body that rides on the robot's flange.

    Raises:
        UnknownName: The log has no body of that name.
        ConfigError: It holds several, and none is named.
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


def _by_stamps(entry: dict[str, Any], master: dict[str, Any], read: Read) -> ClockFit | None:
    """Return the line from one log's clock to the other's over the epoch time of their hosts; None without one."""
    mine, theirs = _to_epoch(entry, read), _to_epoch(master, read)
    if mine is None or theirs is None:
        return None
    known = [fit for fit in (mine, theirs) if fit.method == "lower-envelope"]
    late_s = max(fit.residual_s or 0.0 for fit in known)
    warning = None
    if late_s > LATE_S:
        warning = f"its stamps typically lie {late_s:.2g} s above the line that places its clock: delays, or a poor fit"
    return ClockFit(
        "lower-envelope",
        (mine.offset_s - theirs.offset_s) / theirs.rate,
        mine.rate / theirs.rate,
        warning,
        residual_s=late_s,
        events=min(fit.events or 0 for fit in known),
    )


def _to_epoch(entry: dict[str, Any], read: Read) -> ClockFit | None:
    """Return the line from a log's clock to epoch time; None if nothing tells it."""
    if entry["clock"]["kind"] == "epoch":
        return ClockFit("epoch", 0.0)
    stamps = _stamps_of(entry, read)
    if stamps is None or stamps.height < 2 or _restarts(stamps):
        return None
    return lower_envelope(stamps["t_s"].to_numpy(), stamps["host_s"].to_numpy(), max_drift=MAX_DRIFT)


def _stamps_of(entry: dict[str, Any], read: Read) -> pl.DataFrame | None:
    return read(entry["id"], "stamps") if "stamps" in entry["tables"] else None


def _restarts(stamps: pl.DataFrame | None) -> bool:
    """Tell whether the device's clock began anew: then each part of the log has a line of its own."""
    return stamps is not None and bool((np.diff(stamps["t_s"].to_numpy()) < -RESTART_S).any())


def _by_start(log: LogClock, main: LogClock, start: str, robot: Source | None) -> ClockFit:
    if robot is not None and robot.start is not None:
        began_s = datetime.fromisoformat(robot.start).timestamp()
    elif main.kind == "epoch":
        began_s = main.first_s
    else:
        cure = "Add start = … to the robot's source as well, or use sync."
        raise ConfigError("start is given, and the robot log tells no time of day", cure=cure)
    apart = datetime.fromisoformat(start).timestamp() - began_s
    warning = "placed by the time of day at which it began: good to a second or so, so no delay can be read from it"
    return ClockFit("start-text", apart - log.first_s, warning=warning, residual_s=START_GOOD_TO_S)


def _coarse(
    entry: dict[str, Any], master: dict[str, Any], source: Source | None, read: Read, step_s: float
) -> ClockFit | None:
    people, robot = read(entry["id"], "people"), read(master["id"], "robot")
    if people is None or robot is None or people.height == 0 or robot.height == 0:
        return None
    count = int((entry["last_s"] - entry["first_s"]) / step_s) + 1
    at = entry["first_s"] + np.arange(count) * step_s
    tracks = []
    for (_,), rows in people.sort("t_s").group_by(["person"], maintain_order=True):
        xyz = to_base(rows.select("x_m", "y_m", "z_m").to_numpy(), source.frame if source else None, up=entry["up"])
        tracks.append(_nearest_rows(rows["t_s"].to_numpy(), xyz, at, step_s))
    grid = master["first_s"] + np.arange(int((master["last_s"] - master["first_s"]) / step_s) + 1) * step_s
    robot = robot.sort("t_s")
    values = robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m", "scaling").to_numpy()
    sampled = _nearest_rows(robot["t_s"].to_numpy(), values, grid, step_s)
    found = coarse_fit(tracks, sampled[:, :3], sampled[:, 3], step_s=step_s)
    return replace(found, offset_s=found.offset_s - entry["first_s"]) if found else None


def _nearest_rows(t_s: Vector, values: Points, at: Vector, step_s: float) -> Points:
    """Return the last row before each time, NaN where it is older than a sample and a quarter second."""
    row = np.clip(np.searchsorted(t_s, at + 1e-9, side="right") - 1, 0, len(t_s) - 1)
    out = np.array(values[row], float)
    out[np.abs(at - t_s[row]) > step_s + 0.25] = np.nan
    return out
