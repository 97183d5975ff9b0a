"""One log of people or events for several robot logs: a scanner or tracker shared by robots or shifts.

Each robot log becomes a separate session and needs the shared log during its own time. So the log becomes one recording
in each of them. This module decides which logs may be shared; `dataset.sessions` makes the sessions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from msgspec import structs

from cyclekit import schema
from cyclekit.storage.parquet import TableWriter

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.config import Source
    from cyclekit.dataset.cards import LogCard
    from cyclekit.dataset.cards.recording import Table
    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.dataset.signals import Read

_SHARED: set[Table] = {"events", "people", "skeletons"}
_MARGIN_S = 60.0
"""Margin, s, of a copy before and after the robot's log: bridges gaps in tracks, and clock errors."""


def may_be_shared(log: LogCard, sources: Mapping[str, Source | None]) -> bool:
    """Return whether a log may belong to several robot logs, because its clock is known relative to each.

    True for time since 1970; for events also if the cell file gives their time relative to a robot log.
    """
    if not set(log.tables) <= _SHARED:
        return False
    source = sources.get(log.id)
    given = source is not None and (source.sync or source.sync_events or source.clock_offset_s is not None)
    if set(log.tables) == {"events"}:
        return bool(given) or log.clock.kind == "epoch"
    near = source is None or abs(source.clock_offset_s or 0.0) < _MARGIN_S
    return log.clock.kind == "epoch" and near


@dataclass(frozen=True)
class Shared:
    """Sessions without shared recordings.

    Attributes:
        groups: The sessions.
        copies: Id of each added recording -> id of its log.
    """

    groups: list[LogGroup]
    copies: Mapping[str, str]


def split_shared(groups: Sequence[LogGroup], read: Read, staging: Path) -> Shared:
    """Return sessions that share no log: all but the first get their own recording of a shared log.

    Args:
        groups: Sessions; a log of people or events may be in several.
        read: Function from (id, table) to a native table of a recording, or None.
        staging: Folder of the dataset being built.

    Raises:
        OSError: A recording cannot be written.
    """
    taken = {log.id for group in groups for log in group.logs}
    seen, copies = set[str](), dict[str, str]()
    made: list[LogGroup] = []
    for group in groups:
        logs = []
        for log in group.logs:
            if log.id in seen:
                name = next(name for k in range(2, len(taken) + 3) if (name := f"{log.id}-{k}") not in taken)
                taken.add(name)
                copies[name] = log.id
                log = _copied(read, log, name, group.logs[0], staging / "recordings" / name)
            seen.add(log.id)
            logs.append(log)
        made.append(replace(group, logs=tuple(logs)))
    return Shared(made, copies)


def _copied(read: Read, log: LogCard, name: str, robot: LogCard, folder: Path) -> LogCard:
    """Write the part of a log within a robot log's time; return its card.

    For a clock that does not count since 1970 that part is unknown yet, so all rows are written.
    """
    epoch = log.clock.kind == "epoch" and robot.clock.kind == "epoch"
    span_s = (robot.first_s - _MARGIN_S, robot.last_s + _MARGIN_S) if epoch else (-np.inf, np.inf)
    rows: dict[Table, int] = {}
    first_s, last_s = np.inf, -np.inf
    for table in log.tables:
        frame = read(log.id, table)
        with TableWriter(folder / f"{table}.parquet", schema.OF_LOGS[table]) as out:
            if frame is not None and (frame := frame.filter(pl.col("t_s").is_between(*span_s))).height:
                out.write(frame)
                rows[table] = frame.height
                times = frame["t_s"].to_numpy()
                first_s, last_s = min(first_s, times.min()), max(last_s, times.max())
    if first_s > last_s:
        first_s, last_s = log.first_s, log.last_s
    return structs.replace(
        log,
        id=name,
        key="",
        rows={table: rows.get(table, 0) for table in log.tables},
        first_s=float(first_s),
        last_s=float(last_s),
        duration_s=float(last_s - first_s),
        rows_set_aside=(),
        warnings=(),
    )
