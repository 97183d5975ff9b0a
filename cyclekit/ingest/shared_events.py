"""One log of events beside several robot logs of one folder: the scanner that several robots, or shifts, share.

Each robot log becomes a session of its own, and each of them needs the events in its own time. So the log becomes a
recording of each. Which logs may be shared is decided here; how sessions are made is the business of `sessions`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msgspec import structs

from cyclekit import schema
from cyclekit.storage.parquet import TableWriter

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.config import Source
    from cyclekit.dataset.cards import LogCard
    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.dataset.signals import Read


def may_be_shared(log: LogCard, sources: Mapping[str, Source | None]) -> bool:
    """Tell whether a log may lie beside several robot logs: of events alone, and its clock is known beside each.

    So it is where it counts since 1970, or where the cell file says how it lies beside a robot's log.
    """
    if set(log.tables) != {"events"}:
        return False
    source = sources.get(log.id)
    told = source is not None and (source.sync or source.sync_events or source.clock_offset_s is not None)
    return bool(told) or log.clock.kind == "epoch"


@dataclass(frozen=True)
class Shared:
    """Sessions in which each recording is in one alone.

    Attributes:
        groups: The sessions.
        copies: Cards of the recordings that were added, by id the id of the log that each is one of.
    """

    groups: list[LogGroup]
    copies: Mapping[str, str]


def apart(groups: Sequence[LogGroup], read: Read, staging: Path) -> Shared:
    """Return sessions that share no log: each but the first gets a recording of its own of one that they share.

    Args:
        groups: Sessions; a log of events may be in several.
        read: Returns a native table of a recording (id, table), None if it has none.
        staging: Folder of the dataset in the making.

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
                _write(read, log, staging / "recordings" / name)
                taken.add(name)
                copies[name] = log.id
                log = structs.replace(log, id=name, key="", rows_set_aside=(), warnings=())
            seen.add(log.id)
            logs.append(log)
        made.append(replace(group, logs=tuple(logs)))
    return Shared(made, copies)


def _write(read: Read, log: LogCard, folder: Path) -> None:
    events = read(log.id, "events")
    with TableWriter(folder / "events.parquet", schema.OF_LOGS["events"]) as table:
        if events is not None:
            table.write(events)
