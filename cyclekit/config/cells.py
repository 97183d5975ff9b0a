"""What a cell file says, as frozen dataclasses; the defaults here are those of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from msgspec import Meta

Role = Literal["robot", "people", "events", "tasks"]
Begin = Literal["auto", "file", "gap", "home", "register", "digital-output", "signal"]
Number = Annotated[float, Meta(ge=-1e15, le=1e15)]
"""No number of a cell is larger; NaN and infinity are not either."""
Positive = Annotated[float, Meta(gt=0.0, le=1e15)]
Rate = Annotated[float, Meta(gt=0.0, le=1e6)]
"""A sampling rate, 1/s."""
Levels = Annotated[tuple[Annotated[float, Meta(ge=0.0, le=1.0)], ...], Meta(examples=[[0.0, 0.5, 1.0]])]
Point = Annotated[tuple[Number, Number, Number], Meta(examples=[[0.0, 0.0, 0.0]])]
Matrix = tuple[Point, Point, Point]
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
CLOCK_KEYS = ("clock_offset_s", "sync", "sync_events", "sees", "same_clock_as")
"""Keys of a source that each say how its clock relates to the robot's."""


@dataclass(frozen=True)
class Frame:
    """Where a log's frame stands in the robot base frame: p_base = rotation @ p + xyz_m, after turning up to z.

    Attributes:
        xyz_m: Origin of the log's frame, base frame, metres.
        rotation: Row-major rotation matrix; from `yaw_deg` (about base z) where the file gives that.
    """

    xyz_m: Point = (0.0, 0.0, 0.0)
    rotation: Matrix = IDENTITY


@dataclass(frozen=True)
class Sync:
    """Two signals that change at the same instants.

    Attributes:
        robot: In the robot's log: "digital-output 3", "register", or a signal of its events ("signal=value" takes
            only the changes to that value).
        other: Likewise in the log to be placed.
    """

    robot: str
    other: str


@dataclass(frozen=True)
class Source:
    """One kind of log in the folder.

    Attributes:
        path: File, folder or glob, relative to the folder of logs.
        adapter: Adapter to use; None = found by content.
        role: robot, people, events or tasks; None = all that the log holds.
        clock_offset_s: Added to this log's time to get the robot log's time; None = not known.
        clock_rate: Seconds of the robot log per second of this log.
        sync: Signals that change at the same instants in this log and the robot's; the clock is fitted to them.
        sync_events: Instead, the times of such events: (this log's, the robot log's), seconds.
        sees: "tcp" = a body of this log rides on the robot's flange; the clock is fitted to its motion.
        sees_as: That body's name; None = all that the log holds is that body, and no person.
        same_clock_as: Path of another source whose clock this log shares.
        start: When this log began by the calendar, ISO 8601 with time zone; seconds at best, the last resort.
        frame: Where the log's frame stands; None = not known (taken as the base frame, with a warning).
        body: Which rigid body, marker or topic is the operator.
        silence: What it means that this tracker writes nothing: `absent` (it sees nobody) or `unknown` (it may be off);
            None = found in the logs.
        rate_hz: Rate of a log that has no clock.
        map: Columns, units or topics, as the adapter understands them.
    """

    path: str
    adapter: str | None = None
    role: Role | None = None
    clock_offset_s: Number | None = None
    clock_rate: Positive = 1.0
    sync: Sync | None = None
    sync_events: Annotated[tuple[tuple[Number, Number], ...], Meta(examples=[[[1.5, 101.5]]])] = ()
    sees: Literal["tcp"] | None = None
    sees_as: str | None = None
    same_clock_as: str | None = None
    start: str | None = None
    frame: Frame | None = None
    body: str | None = None
    silence: Literal["absent", "unknown"] | None = None
    rate_hz: Rate | None = None
    map: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class NamedPlace:
    """A place that the integrator named: positions within `radius_m` of `xyz_m` (base frame) are there.

    Attributes:
        label: How results show it to people; None: by its name.
    """

    xyz_m: Point
    radius_m: Positive = 0.05
    label: Annotated[str | None, Meta(examples=["Left table, slot 2"])] = None


@dataclass(frozen=True)
class Furniture:
    """A table or any other thing in the cell: a box, drawn in replays and reports and used for nothing else.

    Attributes:
        xyz_m: Middle of its top, base frame.
        size_m: Length, width and height; length is along x before it is turned.
        yaw_deg: How it is turned about the vertical.
    """

    xyz_m: Point
    size_m: Annotated[tuple[Positive, Positive, Positive], Meta(examples=[[0.9, 0.4, 0.7]])]
    yaw_deg: Number = 0.0


@dataclass(frozen=True)
class Wait:
    """Who waits where until what has happened; it wins over what the logs show.

    Attributes:
        agent: Who waits.
        before: Place that it may not go on to; else `leaving`: place that it may not leave.
        until: "operator leaves fixture", "robot arrives handover", "release set" or "release cleared" of a signal.
        back: The k-th passage needs the (k - back)-th such event of the execution; None = found in the logs.
        never: It does not wait for that, or for nothing at all without `until`.
    """

    agent: Literal["robot", "operator"]
    before: str | None = None
    leaving: str | None = None
    until: str | None = None
    back: Annotated[int, Meta(ge=0, le=100)] | None = None
    never: bool = False

    def place(self, at: str) -> str | None:
        """Return the place that it may not `approach`, or may not `leave`; None where it says nothing of that."""
        return self.before if at == "approach" else self.leaving

    @property
    def event(self) -> tuple[str, str, str] | None:
        """Whose event it waits for (`signal` = of a signal), where (or the signal), and which; None = any."""
        if self.until is None:
            return None
        first, _, rest = self.until.partition(" ")
        kind, _, place = rest.partition(" ")
        if first in ("robot", "operator") and kind in ("arrives", "leaves") and place:
            return first, place, kind
        signal, _, kind = self.until.rpartition(" ")
        return ("signal", signal, kind) if signal and kind in ("set", "cleared") else ("", "", "")


@dataclass(frozen=True)
class Executions:
    """How executions of the process begin.

    Attributes:
        begin: `auto` splits at gaps and, where the log stays continuous, at departures from home.
        gap_s: A silence of the robot log longer than this separates executions.
        home: Place that an execution starts from; None = where the recording starts, if it returns there.
        bit: Digital output whose rising edge begins an execution (begin = "digital-output").
        signal: What begins one (begin = "signal"): an event of any log, "signal" or "signal=value"; "register=100" for
            a program line.
    """

    begin: Begin = "auto"
    gap_s: Positive = 2.0
    home: str | None = None
    bit: Annotated[int, Meta(ge=0, le=62)] = 0
    signal: str | None = None


@dataclass(frozen=True)
class OperatorSignal:
    """A signal that tells of people where no tracker does: the field of a scanner, a light curtain, a door.

    Attributes:
        name: What it is called.
        signal: "digital-input 3", or the name of an event in any log.
        occupied: Its value while somebody is there, as text.
    """

    name: str
    signal: str
    occupied: str = "1"


@dataclass(frozen=True)
class Robot:
    """The arm of a log that holds joint angles and no TCP.

    Attributes:
        model: A known arm, see `arm.MODELS`.
        dh: Instead, of each joint from the base on: d, a (m), alpha, theta (deg), standard Denavit-Hartenberg.
        tool_m: The TCP from the flange, in the flange's frame, metres.
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
        all_places_named: The robot stops for its process at the named places only; nothing else becomes a place.
        levels: Levels of the safety system's speed scaling, ascending, fractions; empty = found in the logs.
        robot: The arm, where the TCP is not logged and shall be computed from the joint angles.
        operator_signals: Signals that tell of people; empty: without a tracker they are found in the logs.
        waits: Who waits where for what, beside what the logs show.
        bridge_s: A gap in the operator's track up to this long is bridged linearly; longer ones stay unknown.
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
    rate_hz: Rate = 10.0
    bridge_s: Number = 0.3
    levels: Levels = ()
    robot: Robot | None = None
    operator_signals: tuple[OperatorSignal, ...] = ()
