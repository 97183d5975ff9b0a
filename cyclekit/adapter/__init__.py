"""All that an adapter may know of cyclekit: the protocol it meets and the Recording it returns.

An adapter turns one log into tables of SI values in the log's OWN clock and frame, and states the facts of the log
(what clock, which axis is up, what was set aside). It never guesses: a quantity that was not logged stays absent.
Putting logs together in one clock and one frame is ingest's business.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

from cyclekit.storage.inside import inside as inside  # for adapters of folders: a name out of data as a path
from cyclekit.storage.scratch import Scratch as Scratch  # for adapters that need a copy of a log

if TYPE_CHECKING:
    from pathlib import Path

    import polars as pl

Role = Literal["robot", "people", "events", "tasks"]
ClockKind = Literal["epoch", "uptime", "relative"]
RowKind = Literal["line", "row", "message", "frame"]
TABLES = ("robot", "people", "events", "task_list", "safety", "skeletons", "stamps")
"""The fields of a `Recording` that are tables; each is kept by ingest under its name."""


@dataclass(frozen=True)
class ReadOptions:
    """What the cell file says about one source; every field has a default that works for a self-describing log.

    Attributes:
        role: What the log is used for, where it could be several things.
        map: Column mapping and units of a generic CSV, and topic names of a bag (`[sources.map]` in cell.toml).
        body: Name of the rigid body, marker or topic that is the person, where a log has several.
        rate_hz: Rate of a log without any clock; must be given, is never invented.
        skeletons: Fill `Recording.skeletons` too, where the log has them. Personal data: only on request.
        frame_given: The cell file says where this log's frame stands, so positions stay in it, even where the log
            itself knows the way to the robot's base.
        columns: Canonical columns that somebody will look at, beside `t_s`; empty = all. An adapter may leave the
            others out where that saves time.
    """

    role: Role | None = None
    map: Mapping[str, object] = field(default_factory=dict)
    body: str | None = None
    rate_hz: float | None = None
    skeletons: bool = False
    frame_given: bool = False
    columns: tuple[str, ...] = ()


@dataclass(frozen=True)
class Recording:
    """What one log says, in SI units, in its own clock and frame.

    Attributes:
        robot: Table ROBOT of `cyclekit.schema`, or None.
        people: Table PEOPLE, or None. An empty table means "recorded, and nobody was there".
        events: Table EVENTS, or None.
        task_list: Table TASK_LIST, or None.
        safety: Table SAFETY, or None.
        skeletons: Table SKELETONS, or None; only where `ReadOptions.skeletons` asks for it.
        stamps: Table STAMPS, or None: where the log holds a device's time and its host's, what each said.
        clock: `epoch` (s since 1970), `uptime` (since a controller or PC started) or `relative` (since the
            recording began). Times of one log share it, also across its tables.
        up: Axis that points up in the people's frame: trackers differ ("y" for Motive).
        joint_names: Names of the joints behind `q0_rad`, `q1_rad`, ... in that order.
        rows_are: What `source_row` counts: a `line` of a text file (from 1, as editors do), a `row` of a binary
            table (or, from 1, of a spreadsheet), a `message` of its topic, a `frame` of a take (from 0).
        rows_read: Data rows or messages looked at.
        set_aside: Rows not used: columns `source_row` (Int64), `reason` (String).
        warnings: What a person must know before trusting the log, one sentence each.
        facts: Anything else the log states about itself (rate, units, point tracked), for people to read.
    """

    robot: pl.DataFrame | None = None
    people: pl.DataFrame | None = None
    events: pl.DataFrame | None = None
    task_list: pl.DataFrame | None = None
    safety: pl.DataFrame | None = None
    skeletons: pl.DataFrame | None = None
    stamps: pl.DataFrame | None = None
    clock: ClockKind = "relative"
    up: Literal["y", "z"] = "z"
    joint_names: tuple[str, ...] = ()
    rows_are: RowKind = "row"
    rows_read: int = 0
    set_aside: pl.DataFrame | None = None
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)

    def tables(self) -> dict[str, pl.DataFrame]:
        """Return the tables that there are, by name."""
        named = {name: getattr(self, name) for name in TABLES}
        return {name: table for name, table in named.items() if table is not None}


@dataclass(frozen=True)
class Proposal:
    """One key that an adapter proposes for a source of the cell file.

    Attributes:
        key: Of the source, or of its map.
        value: What TOML can hold.
        why: What speaks for it, in a few words.
        sure: Nothing else is possible; what is not sure is for a person to decide.
    """

    key: str
    value: object
    why: str = ""
    sure: bool = True


@dataclass(frozen=True)
class Draft:
    """What an adapter proposes to read a log by that it does not recognise; all that is sure must read it as it is.

    Attributes:
        source: Keys of the source: `role`, `rate_hz`.
        map: Keys of its map.
        notes: What a person should know, one sentence each.
    """

    source: tuple[Proposal, ...] = ()
    map: tuple[Proposal, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def unsure(self) -> int:
        """How many keys a person has to decide."""
        return sum(not proposal.sure for proposal in (*self.source, *self.map))


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


@runtime_checkable
class StreamingAdapter(Adapter, Protocol):
    """A format whose logs may be larger than memory: one method more, which ingest then uses instead of `read`."""

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        """Yield the log in consecutive parts; `whole` of them is what `read` returns.

        Clock, axes, joint names and the set of tables are those of every part. What is only known at the end is in the
        last part's warnings and facts.

        Raises:
            cyclekit.errors.LogError, cyclekit.errors.ConfigError: As `read`; while the parts are taken, too.
        """
        ...


@runtime_checkable
class DraftingAdapter(Adapter, Protocol):
    """A format that a cell file must describe: one method more, which proposes how, for `inspect --write-cell`."""

    def draft(self, path: Path) -> Draft | None:
        """Propose how a file is to be read that no adapter recognises, from its first few KiB; None = not by me.

        Raises:
            cyclekit.errors.LogError: The file cannot be read.
        """
        ...


def whole(parts: Iterable[Recording]) -> Recording:
    """Put the parts of a log together: tables and rows set aside end to end, warnings each once, the last facts."""
    import polars as pl

    every = list(parts)
    if len(every) == 1:
        return every[0]
    last = every[-1]
    together = {name: pl.concat([part.tables()[name] for part in every]) for name in last.tables()}
    aside = [part.set_aside for part in every if part.set_aside is not None]
    return replace(
        last,
        **together,  # type: ignore[arg-type]  # the names are those of the fields
        rows_read=sum(part.rows_read for part in every),
        set_aside=pl.concat(aside) if aside else None,
        warnings=tuple(dict.fromkeys(text for part in every for text in part.warnings)),
    )
