"""All that an adapter may know of cyclekit: the protocol it meets and the Recording it returns.

An adapter turns one log into tables of SI values in the log's OWN clock and frame, and states the facts of the log
(what clock, which axis is up, what was set aside). It never guesses: a quantity that was not logged stays absent.
Putting logs together in one clock and one frame is ingest's business.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Protocol

if TYPE_CHECKING:
    from pathlib import Path

    import polars as pl

Role = Literal["robot", "people", "events"]
ClockKind = Literal["epoch", "uptime", "relative"]


@dataclass(frozen=True)
class ReadOptions:
    """What the cell file says about one source; every field has a default that works for a self-describing log.

    Attributes:
        role: What the log is used for, where it could be several things.
        map: Column mapping and units of a generic CSV, and topic names of a bag (`[sources.map]` in cell.toml).
        body: Name of the rigid body, marker or topic that is the person, where a log has several.
        rate_hz: Rate of a log without any clock; must be given, is never invented.
    """

    role: Role | None = None
    map: Mapping[str, object] = field(default_factory=dict)
    body: str | None = None
    rate_hz: float | None = None


@dataclass(frozen=True)
class Recording:
    """What one log says, in SI units, in its own clock and frame.

    Attributes:
        robot: Table ROBOT of `cyclekit.schema`, or None.
        people: Table PEOPLE, or None. An empty table means "recorded, and nobody was there".
        events: Table EVENTS, or None.
        clock: `epoch` (s since 1970), `uptime` (since a controller or PC started) or `relative` (since the
            recording began). Times of one log share it, also across its three tables.
        up: Axis that points up in the people's frame: trackers differ ("y" for Motive).
        joint_names: Names of the joints behind `q0_rad`, `q1_rad`, ... in that order.
        rows_read: Data rows or messages looked at.
        set_aside: Rows not used: columns `source_row` (Int64), `reason` (String).
        warnings: What a person must know before trusting the log, one sentence each.
        facts: Anything else the log states about itself (rate, units, point tracked), for people to read.
    """

    robot: pl.DataFrame | None = None
    people: pl.DataFrame | None = None
    events: pl.DataFrame | None = None
    clock: ClockKind = "relative"
    up: Literal["y", "z"] = "z"
    joint_names: tuple[str, ...] = ()
    rows_read: int = 0
    set_aside: pl.DataFrame | None = None
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)


class Adapter(Protocol):
    """A format. Two methods; registered by one line in the entry-point group `cyclekit.adapters`.

    The first line of the adapter's module docstring is its description in `cyclekit adapters`.
    """

    def recognises(self, path: Path) -> bool:
        """Tell from the content (first few KiB, never the name alone) whether `path`, a file or a folder, is mine.

        Must not raise and must answer fast: it is asked of every file.
        """
        ...

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read the whole log.

        Raises:
            cyclekit.errors.LogError: The log cannot be used; the message names file, cause and cure.
            cyclekit.errors.ConfigError: `options` says something that this adapter cannot follow.
        """
        ...
