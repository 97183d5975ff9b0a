"""The interface between adapters and cyclekit: the protocols that an adapter implements, and the Recording it returns.

An adapter turns one log into tables in SI units, in the log's own clock and frame, with facts about the log
(kind of clock, vertical axis, rows set aside). It never guesses: a quantity that was not logged is absent.
`ingest` brings several logs to one clock and one frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Protocol, runtime_checkable

from msgspec import Meta

from cyclekit.storage.safe_path import safe_path
from cyclekit.storage.scratch import Scratch as Scratch  # for adapters that need a copy of a log

if TYPE_CHECKING:
    from pathlib import Path

    import polars as pl

Role = Literal["robot", "people", "events", "tasks"]
ClockKind = Literal["epoch", "uptime", "relative"]
RowKind = Literal["line", "row", "message", "frame"]
_PEOPLE = {"human", "operator", "person", "worker", "technician", "werker", "bediener", "mensch", "mitarbeiter"}
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
inside = safe_path  # for adapters of folders: a path from a name in the data
NO_VALUE = "no value in any column that is read, except its time"
"""Reason for which a row is set aside without loss: it holds nothing."""
CUT_LINE = "the last line has no line end: it was cut while being written"
"""Reason, or its end, for which the last line of a text is set aside: that alone is no lost tail."""
TABLES = ("robot", "people", "events", "task_list", "safety", "skeletons", "stamps")
"""Fields of `Recording` that hold tables; ingest stores each under its name."""


@dataclass(frozen=True)
class ReadOptions:
    """Settings of one source in the cell file; the defaults suit a self-describing log.

    Attributes:
        role: Use of the log, where it could serve as several.
        map: Column mapping and units of a generic CSV, and topic names of a bag (`[sources.map]` in cell.toml).
        body: Name of the rigid body, marker or topic that is the person, where a log has several.
        flange: Name of a body on the robot's flange, read beside `body`: it aligns the clocks, and is no person.
        rate_hz: Sampling rate of a log without timestamps, Hz; it has to be given and is never guessed.
        skeletons: Also fill `Recording.skeletons`, where the log has them. Personal data: only on request.
        frame_given: The cell file gives the pose of this log's frame, so positions stay in that frame, even where the
            log itself holds the transform to the robot's base.
        columns: Canonical columns that are needed, in addition to `t_s`; empty = all. An adapter may skip the others
            to save time.
    """

    role: Role | None = None
    map: Mapping[str, object] = field(default_factory=dict)
    body: str | None = None
    flange: str | None = None
    rate_hz: float | None = None
    skeletons: bool = False
    frame_given: bool = False
    columns: tuple[str, ...] = ()


class TimeUnit(NamedTuple):
    """A unit in which a log may count its time.

    Attributes:
        name: Its name in the cell file.
        seconds: One count, s; 0 for a count of rows.
        zero_s: Zero of the count, s since 1970; None if the log sets it.
    """

    name: str
    seconds: Annotated[float, Meta(ge=0.0, le=1e19)]
    zero_s: Annotated[float, Meta(ge=-1e19, le=1e19)] | None = None


@dataclass(frozen=True)
class Recording:
    """Content of one log, in SI units, in its own clock and frame.

    Attributes:
        robot: Table ROBOT of `cyclekit.schema`, or None.
        people: Table PEOPLE, or None. An empty table means "recorded, and no person present".
        events: Table EVENTS, or None.
        task_list: Table TASK_LIST, or None.
        safety: Table SAFETY, or None.
        skeletons: Table SKELETONS, or None; only if `ReadOptions.skeletons` is set.
        stamps: Table STAMPS with device time and host time of each message, or None if the log does not hold both.
        clock: `epoch` (s since 1970), `uptime` (since a controller or PC started) or `relative` (since the
            recording began). All tables of one log share it.
        time_units: Units that its times may have, while it does not tell; the first is the one used. Of several
            `ingest` proves one by the log's other logs, or refuses; one that is stated, or the default, it compares
            with them. Empty: the log shows its unit.
        up: Vertical axis of the people's frame: trackers differ ("y" for Motive).
        joint_names: Names of the joints of `q0_rad`, `q1_rad`, ..., in that order.
        rows_are: Unit of `source_row`: a `line` of a text file (from 1, as in editors), a `row` of a binary
            table (or, from 1, of a spreadsheet), a `message` of its topic, a `frame` of a take (from 0).
        rows_read: Number of data rows or messages read, used or not.
        set_aside: Rows not used: columns `source_row` (Int64), `reason` (String).
        warnings: What the user must know before trusting the log, one sentence each.
        impossible: Those of the warnings that mean that a whole column cannot be as it was read, such as metres that
            are millimetres; `ingest` then refuses the log unless the user accepts it.
        facts: Other information that the log holds about itself (rate, units, tracked point), to display.
    """

    robot: pl.DataFrame | None = None
    people: pl.DataFrame | None = None
    events: pl.DataFrame | None = None
    task_list: pl.DataFrame | None = None
    safety: pl.DataFrame | None = None
    skeletons: pl.DataFrame | None = None
    stamps: pl.DataFrame | None = None
    clock: ClockKind = "relative"
    time_units: tuple[TimeUnit, ...] = ()
    up: Literal["y", "z"] = "z"
    joint_names: tuple[str, ...] = ()
    rows_are: RowKind = "row"
    rows_read: int = 0
    set_aside: pl.DataFrame | None = None
    warnings: tuple[str, ...] = ()
    impossible: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)

    def tables(self) -> dict[str, pl.DataFrame]:
        """Return the tables that are not None, by name."""
        named = {name: getattr(self, name) for name in TABLES}
        return {name: table for name, table in named.items() if table is not None}

    @property
    def time_open(self) -> bool:
        """Whether the unit of its times is not known."""
        return len(self.time_units) > 1

    @property
    def said(self) -> tuple[str, ...]:
        """The warnings, with one about a unit of time that is open."""
        first, *others = [unit.name for unit in self.time_units] or [""]
        may = f"the unit of its times is not stated: read as {first}, they may also be {' or '.join(others)}"
        cure = f'give time_unit = "{first}" (or another of these) in [sources.map] of the cell file'
        return (*self.warnings, f"{may}; {cure}") if others else self.warnings


@dataclass(frozen=True)
class Proposal:
    """One key that an adapter proposes for a source of the cell file.

    Attributes:
        key: Key of the source, or of its map.
        value: Value that TOML can represent; an empty text if only the user can know it.
        why: Evidence for the value, in a few words.
        sure: True if no other value is possible; otherwise the user decides.
    """

    key: str
    value: object
    why: str = ""
    sure: bool = True


@dataclass(frozen=True)
class Draft:
    """Proposed settings for a log that no adapter recognises; with all its sure keys, the log must be readable.

    Attributes:
        source: Keys of the source: `role`, `rate_hz`.
        map: Keys of its map.
        notes: What the user should know, one sentence each.
    """

    source: tuple[Proposal, ...] = ()
    map: tuple[Proposal, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def unsure(self) -> int:
        """Number of keys that the user has to decide."""
        return sum(not proposal.sure for proposal in (*self.source, *self.map))


class Adapter(Protocol):
    """A log format: two methods, registered by one line in the entry-point group `cyclekit.adapters`.

    The first line of the adapter's module docstring is its description in `cyclekit adapters`.
    """

    def recognises(self, path: Path) -> bool:
        """Return whether `path`, a file or a folder, has this format, judged by its content.

        Reads the first few KiB and never judges by the name alone. Must be fast and must not raise, because it is
        called
        for every file.
        """
        ...

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read the whole log.

        Raises:
            cyclekit.errors.LogError: The log cannot be used; the message names file, cause and cure.
            cyclekit.errors.ConfigError: This adapter cannot apply a value in `options`.
        """
        ...


@runtime_checkable
class StreamingAdapter(Adapter, Protocol):
    """A format whose logs may exceed memory: one more method, which ingest uses instead of `read`."""

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        """Yield the log in consecutive parts; `concat_parts` of the parts equals the result of `read`.

        All parts share clock, axes, joint names and the set of tables. Warnings and facts that are known only at the
        end
        are in the last part.

        Raises:
            cyclekit.errors.LogError, cyclekit.errors.ConfigError: As `read`, also during iteration.
        """
        ...


@runtime_checkable
class DraftingAdapter(Adapter, Protocol):
    """A format that the cell file has to describe: one more method proposes the keys, for `inspect --write-cell`."""

    def draft(self, path: Path) -> Draft | None:
        """Propose settings for a file that no adapter recognises, from its first few KiB; None if it does not apply.

        Raises:
            cyclekit.errors.LogError: The file cannot be read.
        """
        ...


def is_person(agent: str) -> bool:
    """Return whether an agent's name contains a word for a person, such as human, operator, person or worker."""
    words = (word.lower() for word in _WORDS.findall(agent))
    return any(word in _PEOPLE or word.removesuffix("s") in _PEOPLE for word in words)


def concat_parts(parts: Iterable[Recording]) -> Recording:
    """Concatenate the parts of a log; each warning appears once, and the facts are those of the last part."""
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
        impossible=tuple(dict.fromkeys(text for part in every for text in part.impossible)),
    )
