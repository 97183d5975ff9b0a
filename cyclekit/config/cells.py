"""Content of a cell file as frozen dataclasses, with the defaults of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from msgspec import Meta

Role = Literal["robot", "people", "events", "tasks"]
Mover = Literal["people", "program", "hand"]
Begin = Literal["auto", "file", "gap", "home", "register", "digital-output", "signal"]
AlignClocks = Literal["logs"]
"""How clocks are aligned: `logs` = by what the logs themselves show, also in doubt and against what is stated."""
FARTHEST_M = 1e7
"""Farthest coordinate, m: the pole in the coordinates of a survey (the metre was made for that)."""
Number = Annotated[float, Meta(ge=-FARTHEST_M, le=FARTHEST_M)]
"""A coordinate, m, or an angle, deg; excludes NaN and infinity."""
Positive = Annotated[float, Meta(gt=0.0, le=FARTHEST_M)]
Offset = Annotated[float, Meta(ge=-1e11, le=1e11)]
"""Difference of two clocks, s: three thousand years, as some count from 1601."""
Rate = Annotated[float, Meta(ge=1e-3, le=1e6)]
"""Rate of a log, 1/s."""
SampleRate = Annotated[float, Meta(ge=0.1, le=1000.0)]
"""Rate of the samples, 1/s; the networks of the paper have 10."""
Levels = Annotated[tuple[Annotated[float, Meta(ge=0.0, le=1.0)], ...], Meta(examples=[[0.0, 0.5, 1.0]])]
Point = Annotated[tuple[Number, Number, Number], Meta(examples=[[0.0, 0.0, 0.0]])]
Matrix = tuple[Point, Point, Point]
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
CLOCK_KEYS = ("clock_offset_s", "sync", "sync_events", "sees", "same_clock_as")
"""Keys of a source that relate its clock to the robot's."""


@dataclass(frozen=True)
class Frame:
    """Pose of a log's frame in the robot base frame: p_base = rotation @ p + xyz_m, after rotation of up to z.

    Attributes:
        xyz_m: Origin of the log's frame, base frame, m.
        rotation: Row-major rotation matrix; from `yaw_deg` (about base z) if the file gives that.
    """

    xyz_m: Point = (0.0, 0.0, 0.0)
    rotation: Matrix = IDENTITY


@dataclass(frozen=True)
class Sync:
    """Two signals that change at the same times.

    Attributes:
        robot: Signal in the robot log: "digital-output 3", "register", or a signal of its events ("signal=value" for
            changes to that value only).
        other: Likewise in the log to align.
    """

    robot: str
    other: str


@dataclass(frozen=True)
class Activity:
    """What an agent does, told by a state that a log of signals holds: `[[sources.activities]]` of the cell file.

    Attributes:
        column: Signal of the states, such as the step of a sequence chain; or several bits, each a state of its own
            name. `*` and `?` match any text.
        agent: Name of the agent.
        idle: States that are no activity, such as the step in which it waits for the start.
        cycle: What begins a cycle: a signal that comes on or changes, or one that takes a value (`Step=10`); an idle
            state begins it when it is left. None: nothing in the log.
    """

    column: tuple[str, ...]
    agent: str = "robot"
    idle: tuple[str, ...] = ()
    cycle: str | None = None


@dataclass(frozen=True)
class Source:
    """One kind of log in the folder.

    Attributes:
        path: File, folder or glob, relative to the folder of logs.
        adapter: Adapter to use; None = found by content.
        role: robot, people, events or tasks; None = all tables of the log.
        clock_offset_s: Added to this log's time to get the robot log's time, s, or a date (role robot); None = unknown.
        clock_rate: Seconds of the robot log per second of this log.
        sync: Signals that change at the same times in this log and the robot log; the clock is fitted to them.
        sync_events: Alternative to `sync`: times of such events (in this log, in the robot log), s.
        sees: "tcp" = a body of this log is mounted on the robot's flange; the clock is fitted to its motion.
        sees_as: Name of that body; None = it is the only body of the log, and the log has no person.
        same_clock_as: Path of another source whose clock this log shares.
        start: Date and time at which this log began, ISO 8601 with time zone; accurate to seconds at best.
        frame: Pose of the log's frame; None = unknown (taken as the base frame, with a warning).
        body: Rigid body, marker or topic of the operator.
        silence: Meaning of a tracker without rows: `absent` (no person) or `unknown` (it may be off); None = found in
            the logs.
        rate_hz: Rate of a log without clock.
        map: Columns, units or topics for the adapter.
        activities: States of its signals that are tasks of an agent.
    """

    path: str
    adapter: str | None = None
    role: Role | None = None
    clock_offset_s: Offset | None = None
    clock_rate: Annotated[float, Meta(ge=0.1, le=10.0)] = 1.0
    sync: Sync | None = None
    sync_events: Annotated[tuple[tuple[Offset, Offset], ...], Meta(examples=[[[1.5, 101.5]]])] = ()
    sees: Literal["tcp"] | None = None
    sees_as: str | None = None
    same_clock_as: str | None = None
    start: str | None = None
    frame: Frame | None = None
    body: str | None = None
    silence: Literal["absent", "unknown"] | None = None
    rate_hz: Rate | None = None
    map: Mapping[str, object] = field(default_factory=dict)
    activities: tuple[Activity, ...] = ()


@dataclass(frozen=True)
class NamedPlace:
    """A named place: all positions within `radius_m` of `xyz_m` (base frame).

    Attributes:
        label: Name shown in results; None: the name in the file.
    """

    xyz_m: Point
    radius_m: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.05
    label: Annotated[str | None, Meta(examples=["Left table, slot 2"])] = None


@dataclass(frozen=True)
class Furniture:
    """A table or other object in the cell, as a box; only drawn in replays and reports.

    Attributes:
        xyz_m: Centre of its top, base frame, m.
        size_m: Length, width and height, m; the length is along x before rotation.
        yaw_deg: Rotation about the vertical, deg.
    """

    xyz_m: Point
    size_m: Annotated[tuple[Positive, Positive, Positive], Meta(examples=[[0.9, 0.4, 0.7]])]
    yaw_deg: Number = 0.0


@dataclass(frozen=True)
class Wait:
    """A wait condition, which overrides those found in the logs.

    Attributes:
        agent: The agent that waits.
        before: Place that the agent must not approach until the event; or `leaving`: place that it must not leave; or
            `spot`: place of the operator where he does not wait (with `never`); or `task`: task of a task list.
        until: The event: "operator leaves fixture", "robot arrives handover", "release set" or "release cleared" of a
            signal; with `task` the task that it waits for.
        back: The k-th passage needs the (k - back)-th such event of the execution; None = found in the logs.
        never: The agent does not wait for that event, or, without `until`, for any event.
    """

    agent: Literal["robot", "operator"]
    before: str | None = None
    leaving: str | None = None
    spot: str | None = None
    task: str | None = None
    until: str | None = None
    back: Annotated[int, Meta(ge=0, le=100)] | None = None
    never: bool = False

    def place(self, at: str) -> str | None:
        """Return the place that the agent must not `approach`, or must not `leave`; None if there is no such place."""
        return self.before if at == "approach" else self.leaving

    @property
    def event(self) -> tuple[str, str, str] | None:
        """The event as (agent or `signal`, place or name of the signal, kind); None = any."""
        if self.until is None or self.task is not None:
            return None
        first, _, rest = self.until.partition(" ")
        kind, _, place = rest.partition(" ")
        if first in ("robot", "operator") and kind in ("arrives", "leaves") and place:
            return first, place, kind
        signal, _, kind = self.until.rpartition(" ")
        return ("signal", signal, kind) if signal and kind in ("set", "cleared") else ("", "", "")


@dataclass(frozen=True)
class Executions:
    """Rule for the start of executions of the process.

    Attributes:
        begin: The rule; `auto` splits at gaps and, where the log has none, at departures from home.
        gap_s: Minimum gap in the robot log between executions, s.
        home: Place from which an execution starts; None = where the recording starts, if the robot returns there.
        bit: Digital output whose rising edge starts an execution (begin = "digital-output").
        signal: Signal that starts an execution (begin = "signal"): an event of any log, "signal" or "signal=value";
            "register=100" for a program line.
    """

    begin: Begin = "auto"
    gap_s: Annotated[float, Meta(gt=0.0, le=86400.0)] = 2.0
    home: str | None = None
    bit: Annotated[int, Meta(ge=0, le=62)] = 0
    signal: str | None = None


@dataclass(frozen=True)
class OperatorSignal:
    """A signal that shows people without a tracker: field of a scanner, light curtain, door.

    Attributes:
        name: Name in results.
        signal: "digital-input 3", or the name of an event in any log.
        occupied: Its value while a person is present, as text.
        reset: Signal of the button that ends the stop once nobody is present; None: the stop ends with the presence.
        reset_at: Value, as text, to which `reset` changes at the reset.
    """

    name: str
    signal: str
    occupied: str = "1"
    reset: str | None = None
    reset_at: str = "1"


@dataclass(frozen=True)
class Robot:
    """The arm of a log with joint angles but without TCP.

    Attributes:
        model: A known arm, see `arms.MODELS`.
        dh: Alternative to `model`: d, a (m), alpha, theta (deg) of each joint from the base, standard
            Denavit-Hartenberg.
        tool_m: Position of the TCP in the flange frame, m.
    """

    model: str | None = None
    dh: Annotated[tuple[tuple[Number, Number, Number, Number], ...], Meta(examples=[[[0.34, 0, -90, 0]]])] = ()
    tool_m: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Cell:
    """A cell: its sources, places and conventions.

    Attributes:
        ignore: Globs of files that are not logs.
        reference: Globs of robot logs recorded without a person in the cell.
        rate_hz: Rate of the samples.
        all_places_named: Whether the named places are the only ones; then no others are searched for.
        levels: Levels of the safety system's speed scaling, ascending, fractions; empty = found in the logs.
        set_override: Who moves the override that is set (speed slider): a program with "people", the "program" by the
            robot's position, or a "hand"; None = found in the logs.
        robot: The arm, to compute the TCP from joint angles if it is not logged.
        operator_signals: Signals that show people; empty: without a tracker, they are found in the logs.
        waits: Wait conditions, in addition to those found in the logs.
        known_words: Words of tasks and signals that name nobody, kept in a pseudonymised dataset.
        bridge_s: Maximum gap in the operator's track that is interpolated linearly, s; longer ones stay unknown.
        accept_bad_logs: Whether to go on without the only log of its kind if it cannot be read, and with values that
            cannot be.
        goal_signals: Signals whose values name the place to which the operator goes next, as they are logged.
        align_clocks: How clocks are aligned; None = by the logs only where nothing else does, and without doubt.
    """

    name: str = "cell"
    sources: tuple[Source, ...] = ()
    ignore: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()
    places: Mapping[str, NamedPlace] = field(default_factory=dict)
    all_places_named: bool = False
    human_places: Mapping[str, NamedPlace] = field(default_factory=dict)
    furniture: Mapping[str, Furniture] = field(default_factory=dict)
    executions: Executions = field(default_factory=Executions)
    waits: tuple[Wait, ...] = ()
    rate_hz: SampleRate = 10.0
    bridge_s: Annotated[float, Meta(ge=0.0, le=3600.0)] = 0.3
    levels: Levels = ()
    set_override: Mover | None = None
    robot: Robot | None = None
    operator_signals: tuple[OperatorSignal, ...] = ()
    known_words: tuple[str, ...] = ()
    goal_signals: tuple[str, ...] = ()
    align_clocks: AlignClocks | None = None
    accept_bad_logs: bool = False
