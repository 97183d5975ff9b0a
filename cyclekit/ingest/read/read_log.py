"""One log to its tables on disk and its card.

The adapter reads, in parts if it can. Implausible values are removed (`validate`). The parts are written as they
arrive, so a log may exceed memory.
"""

from __future__ import annotations

import secrets
import shutil
from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.alignment.recording_clocks import RESTART_S
from cyclekit.alignment.spans import DATED_S
from cyclekit.dataset.cards import READ, FrameCard, LogCard, SetAside, note
from cyclekit.dataset.cards.recording import LogClock
from cyclekit.dataset.rates import Rates
from cyclekit.errors import LogError
from cyclekit.ingest.discover import Log, options_of
from cyclekit.ingest.free_text import Words
from cyclekit.ingest.pseudonymise import Nameless, shown_as
from cyclekit.ingest.read.tool_point import with_tool_point
from cyclekit.ingest.registry import adapter_named
from cyclekit.ingest.validate.validate import examined_parts
from cyclekit.storage.parquet import TableWriter
from cyclekit.text.numbers import compact

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from cyclekit.adapter import Recording
    from cyclekit.config import Source
    from cyclekit.dataset.cards import SourceFile
    from cyclekit.dataset.cards.recording import Table
    from cyclekit.ingest.read.log_checksums import Digests

_PLACES = ("tcp_x_m", "x_m")
_ENDS = ("t_s", "end_s")
QUARANTINE = "quarantine"
MAKING = ".making-"
"""Prefix of the temporary folder in which a recording is written."""
MAX_RESTARTS = 1000
"""Maximum number of restarts noted: a clock that steps back more often is a faulty one."""
UNPROTECTED = "none: a flipped bit is found only where it makes a value impossible"
"""Fact `checksum` of a recording whose adapter reports none."""
SHORT_BYTES, SHORT_ROWS = 1 << 20, 1024
"""A log of less than SHORT_BYTES and at most SHORT_ROWS rows may be held, to be written together with others."""


@dataclass(frozen=True)
class ReadSettings:
    """What to store of each log.

    Attributes:
        pseudonymise: Replace names.
        words: Which words of free text remain then.
        skeletons: Store all joints of all persons, if a tracker has them.
        checksums: Compute the BLAKE3 of each file.
    """

    pseudonymise: bool = False
    words: Words = field(default_factory=Words)
    skeletons: bool = False
    checksums: bool = True


@dataclass(frozen=True)
class ReadLog:
    """Card of a log, and its tables if they are held in memory; then none of them is on disk."""

    card: LogCard
    tables: dict[str, pl.DataFrame] = field(default_factory=dict)


def read_or_error(
    log: Log, digests: Digests, *, staging: Path, settings: ReadSettings, hold: bool = False
) -> ReadLog | LogError:
    """Read a log into `staging/recordings/<id>`, or return the error; then nothing of it remains there.

    The folder gets its name when it is complete, so reading a log twice does no harm. `hold`: the tables of a short
    recording are returned instead of written.
    """
    place = staging / "recordings" / log.id
    folder = place.with_name(f"{MAKING}{secrets.token_hex(6)}")
    try:
        kept = _read_log(log, digests, folder, settings, hold=hold)
        if not kept.tables:
            _put(folder, place)
    except LogError as error:
        problem = copy(error)  # without references to frames, tables and the original error
    except (OSError, MemoryError) as error:
        if _is_ours(error, folder):
            raise
        reason = getattr(error, "strerror", None) or str(error) or "too large for the memory"
        problem = LogError(log.path, f"cannot be read ({reason})", cure="Check the file.")
    else:
        return kept
    shutil.rmtree(folder, ignore_errors=True)
    return problem


def _put(folder: Path, place: Path) -> None:
    try:
        folder.rename(place)
    except OSError as error:
        if not place.is_dir():
            raise OSError(error.errno, error.strerror, str(place)) from error
        shutil.rmtree(folder)  # read before by a worker that was lost afterwards: the bytes are the same


def _is_ours(error: BaseException, folder: Path) -> bool:
    """Return whether our own file could not be written, as opposed to a log that could not be read."""
    name = getattr(error, "filename", None)
    return name is not None and str(folder.parent.parent) in str(name)


def _read_log(log: Log, digests: Digests, folder: Path, settings: ReadSettings, *, hold: bool) -> ReadLog:
    sources, options = digests.sources(log), options_of(log.source, skeletons=settings.skeletons)
    written: dict[str, _Table] = {}
    aside, counts, rows_read, first_aside = None, dict[str, int](), 0, None
    last: Recording | None = None
    keep = log.source.sees_as if log.source else None
    nameless = Nameless(keep=keep, words=settings.words) if settings.pseudonymise else None
    try:
        read = adapter_named(log.adapter).parts(log.path, options, log.activities)
        for part in examined_parts(with_tool_point(read, log.robot)):
            part = _on_stated_clock(part, log)
            last = nameless.part(part) if nameless else part
            rows_read += last.rows_read
            for name, frame in last.tables().items():
                if name not in written:
                    written[name] = _Table(folder, name, frame)
                written[name].write(frame)
            aside_now = last.set_aside
            if aside_now is not None and aside_now.height:
                aside = aside or TableWriter(folder / f"{QUARANTINE}.parquet", schema.QUARANTINE)
                first_aside = first_aside or aside_now.row(0)
                aside.write(_quarantined(aside_now, last.rows_are, log, shown_as(log) if nameless else log.shown))
                for reason, count in aside_now.group_by("reason", maintain_order=True).len().iter_rows():
                    counts[reason] = counts.get(reason, 0) + count
        _check(log, written, rows_read, first_aside, last)
        if nameless:
            nameless.check(log.path)
        alone = any(table.restart_rows for table in written.values()) or (last is not None and last.time_open)
        held = _held(written) if hold and aside is None and log.size < SHORT_BYTES and not alone else {}
        for writer in [] if held else [*(table.writer for table in written.values()), *([aside] if aside else [])]:
            writer.close()
    except BaseException:
        for writer in [*(table.writer for table in written.values()), *([aside] if aside else [])]:
            writer.abandon()
        raise
    if last is None:
        raise LogError(log.path, "holds nothing", cure="Record again, or remove the file.")
    return ReadLog(_card(log, last, written, sources, rows_read, counts), held)


def _on_stated_clock(part: Recording, log: Log) -> Recording:
    """Return a part of a robot's log with the times that the cell file states, which count since 1970 as the others'.

    Raises:
        LogError: They are no dates.
    """
    source = log.source
    if source is None or source.role != "robot" or source.clock_offset_s is None:
        return part
    true_s = pl.col("t_s") * source.clock_rate + source.clock_offset_s
    tables = {name: frame.with_columns(true_s) for name, frame in part.tables().items() if "t_s" in frame.columns}
    first_s = min((float(frame["t_s"][0]) for frame in tables.values() if frame.height), default=DATED_S)
    if first_s < DATED_S:
        cause = f"clock_offset_s is given to a robot's log, whose times would begin {compact(first_s)} s after 1970"
        cure = "Give what makes them dates, or give clock_offset_s to the logs beside it instead."
        raise LogError(log.path, cause, cure=cure)
    return replace(part, clock="epoch", **tables)  # type: ignore[arg-type]  # the names are those of the fields


def _held(written: Mapping[str, _Table]) -> dict[str, pl.DataFrame]:
    """Return the tables of a short recording, none of which is on disk yet; empty for a long one."""
    if sum(table.writer.rows for table in written.values()) > SHORT_ROWS:
        return {}
    held = {name: frame for name, table in written.items() if (frame := table.writer.held()) is not None}
    return held if len(held) == len(written) else {}


class _Table:
    """A table being written, and the range and rate of its times."""

    def __init__(self, folder: Path, name: str, first: pl.DataFrame) -> None:
        self._columns = schema.OF_LOGS[name]
        joints = sorted(filter(schema.is_joint, first.columns), key=schema.joint_order) if name == "robot" else []
        self.writer = TableWriter(folder / f"{name}.parquet", self._columns, more=joints)
        self.first_s, self.last_s = float("inf"), -float("inf")
        self.rates = None if name in schema.UNRATED else Rates()
        self.restart_rows = list[int]()
        self._robot, self._latest_s = name == "robot", np.nan
        self.placed = False

    def write(self, frame: pl.DataFrame) -> None:
        before = self.writer.rows
        self.writer.write(schema.conform(frame, self._columns))
        if not frame.height:
            return
        times = frame["t_s"].to_numpy()
        if self._robot:
            back = np.flatnonzero(np.diff(times, prepend=self._latest_s) < -RESTART_S)
            self.restart_rows += (before + back)[: MAX_RESTARTS - len(self.restart_rows)].tolist()
            self._latest_s = float(times[-1])
        last_s = max(
            float(np.nanmax(frame[name].to_numpy(), initial=-np.inf)) for name in _ENDS if name in frame.columns
        )
        self.first_s, self.last_s = min(self.first_s, float(times.min())), max(self.last_s, last_s)
        self.placed = self.placed or any(frame[name].count() for name in _PLACES if name in frame.columns)
        if self.rates is not None:
            self.rates.add(frame)


def _check(
    log: Log, written: dict[str, _Table], rows_read: int, aside: tuple[object, ...] | None, last: Recording | None
) -> None:
    """Refuse a log that holds nothing to use; `aside` is the place and reason of the first row set aside."""
    if not written.keys() & set(schema.MAIN):
        raise LogError(
            log.path, "holds neither robot, people, events, tasks nor an override", cure="Check what was recorded."
        )
    if not any(written[name].writer.rows for name in schema.MAIN if name in written):
        if not rows_read:
            raise LogError(log.path, "holds a header and no data", cure="Record again, or remove the file.")
        aside = aside or (None, "it holds no value that is read")
        where = "" if aside[0] is None or last is None else f" ({last.rows_are} {aside[0]})"
        cause = f"none of its {rows_read} rows can be used; the first{where}: {aside[1]}"
        raise LogError(log.path, cause, cure="Check what its columns are, and their units (docs/adapters.md).")


def _quarantined(rows: pl.DataFrame, rows_are: str, log: Log, shown: str) -> pl.DataFrame:
    named = {"recording": log.id, "file": shown, "row_is": rows_are}
    rows = rows.with_columns(pl.lit(value).alias(name) for name, value in named.items())
    return schema.conform(rows, schema.QUARANTINE)


def _card(
    log: Log,
    last: Recording,
    written: dict[str, _Table],
    sources: tuple[SourceFile, ...],
    rows_read: int,
    set_aside: dict[str, int],
) -> LogCard:
    main = next(written[name] for name in schema.MAIN if name in written and written[name].writer.rows)
    duration_s = main.last_s - main.first_s
    rate = main.rates.found() if main.rates is not None else None
    tables = cast("dict[Table, _Table]", written)  # names as in `schema`
    return LogCard(
        id=log.id,
        tables=tuple(tables),
        sources=sources,
        adapter=log.adapter,
        adapter_package=log.package,
        adapter_version=log.version,
        clock=LogClock(kind=last.clock),
        frame=_frame_card(log.source, last),
        positions=any(table.placed for name, table in tables.items() if name in ("robot", "people")),
        up=last.up,
        joint_names=tuple(last.joint_names),
        rows={name: table.writer.rows for name, table in tables.items()},
        rows_are=last.rows_are,
        rows_read=rows_read,
        restart_rows=tuple(written["robot"].restart_rows) if "robot" in written else (),
        rows_set_aside=tuple(SetAside(reason=reason, count=count) for reason, count in set_aside.items()),
        first_s=main.first_s,
        last_s=main.last_s,
        duration_s=duration_s,
        rate_hz=round(rate.mean_hz, 3) if rate is not None else None,
        warnings=tuple(
            note("impossible", text=text) if text in last.impossible else note(READ, text=text)
            for text in last.warnings
        ),
        facts={"checksum": UNPROTECTED, **last.facts},
        time_units=last.time_units,
        key=log.key,
    )


def _frame_card(source: Source | None, recording: Recording) -> FrameCard:
    if recording.people is None:
        return FrameCard(method="robot base")
    if source is None or source.frame is None:
        return FrameCard(method="assumed base frame", up=recording.up)
    frame = source.frame
    return FrameCard(method="cell-file", up=recording.up, xyz_m=frame.xyz_m, rotation=frame.rotation)
