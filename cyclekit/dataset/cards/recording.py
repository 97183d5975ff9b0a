"""What a dataset says of one log: where it came from, how its clock and frame lie, what was kept and set aside."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from cyclekit.dataset.cards.notes import Note, texts
from cyclekit.dataset.cards.quantities import Card, Count, Digest, Duration, Name, Point, Rotation, Seconds

Table = Literal["robot", "people", "events", "task_list", "safety", "skeletons", "stamps"]
"""Tables that a log may give."""
ClockMethod = Literal[
    "own",
    "same-log",
    "cell-file",
    "event-pairs",
    "motion",
    "lower-envelope",
    "epoch",
    "start-text",
    "coarse",
    "assumed-common-start",
]
"""How it was found how a clock relates to the clock of its session."""


class SourceFile(Card, frozen=True, kw_only=True):
    """A file of a log.

    Attributes:
        path: Relative to the folder that was ingested, `/` between its parts.
        blake3: None where no checksums were asked for, or an earlier version kept `sha256`.
        sha256: Of an earlier version.
        size: Bytes.
    """

    path: str
    blake3: Digest | None = None
    sha256: Digest | None = None
    size: Count = 0

    @property
    def checksum(self) -> str | None:
        """Of its bytes, by whichever function; None where none was made."""
        return self.blake3 or self.sha256


class LogClock(Card, frozen=True, kw_only=True):
    """The clock of a log by itself: seconds since 1970, since a device was started, or since the recording began."""

    kind: Literal["epoch", "uptime", "relative"]


class ClockCard(LogClock, frozen=True, kw_only=True):
    """How the clock of a log lies in the time of its session: t_session = rate * t_log + offset_s.

    Attributes:
        residual_s: What the fit leaves unexplained, typically; None where nothing was left to check it by.
        events: Pairs of events, or windows of motion, that the fit rests on.
        events_rejected: Events that found no partner or contradicted the others.
        correlation: Peak of the correlation, -1 to 1.
        second_best: Height of the second peak over that of the first; near 1 the fit is ambiguous.
        second_best_s: How far the second peak lies from the first.
        same_as: Id of the recording whose clock this log shares.
        warnings: What a person must know before trusting it.
    """

    method: ClockMethod
    offset_s: Seconds
    rate: Annotated[float, Meta(gt=0.0, le=1e15)] = 1.0
    residual_s: Duration | None = None
    events: Count | None = None
    events_rejected: Count | None = None
    correlation: float | None = None
    second_best: float | None = None
    second_best_s: Seconds | None = None
    same_as: str | None = None
    warnings: tuple[Note, ...] = ()


class FrameCard(Card, frozen=True, kw_only=True):
    """How the frame of a log lies in the robot base frame: p_base = rotation @ p + xyz_m, after turning up to z.

    Attributes:
        method: `robot base`: positions are in it already; `assumed base frame`: nothing says where the frame lies.
        up: Axis of the log that points up; None for logs without people.
        xyz_m, rotation: As the cell file says; None with the other methods.
    """

    method: Literal["robot base", "assumed base frame", "cell-file"]
    up: Literal["y", "z"] | None = None
    xyz_m: Point | None = None
    rotation: Rotation | None = None

    def __post_init__(self) -> None:
        """Refuse a frame without its place.

        Raises:
            ValueError: The cell file gave the frame, and it is not there.
        """
        if self.method == "cell-file" and (self.xyz_m is None or self.rotation is None):
            msg = 'method "cell-file" needs xyz_m and rotation'
            raise ValueError(msg)


class SetAside(Card, frozen=True, kw_only=True):
    """Rows that were set aside for one reason."""

    reason: str
    count: Count


class OperatorCard(Card, frozen=True, kw_only=True):
    """How well a log sees the operator: samples by what was seen.

    Attributes:
        not_believed: Positions that were dropped as implausible: faster than a person moves.
        seen: Samples at which somebody was seen.
        occluded: ... hidden for longer than is bridged.
        absent: ... no operator was there.
        outside: ... the log was not running.
        warnings: What a person must know before trusting it.
    """

    not_believed: Count = 0
    seen: Count = 0
    occluded: Count = 0
    absent: Count = 0
    outside: Count = 0
    warnings: tuple[Note, ...] = ()


class LogCard(Card, frozen=True, kw_only=True):
    """A log as it was read, before it was put into a session.

    Attributes:
        id: Names the recording and its folder.
        tables: Which tables it has.
        sources: Its files; one, or all of a folder that is one log.
        adapter, adapter_package, adapter_version: Who read it.
        positions: It holds places of the robot or of people; None = an earlier version did not say.
        up: Axis that points up in the frame of its people.
        joint_names: Of the joints q0, q1, ...
        rows: Rows kept, by table.
        rows_are: What `source_row` counts.
        rows_read: Rows of the log.
        rows_set_aside: Rows that were not kept, by reason.
        first_s, last_s: Time of the first and last row, clock of the log.
        duration_s: last_s - first_s.
        rate_hz: Rows a second; None where the log has a single time.
        warnings: What a person must know before trusting what was read.
        facts: What else the adapter found out, as texts.
        key: Changes when the log, its adapter or its options do; empty where the dataset is pseudonymised.
    """

    id: Name
    tables: Annotated[tuple[Table, ...], Meta(min_length=1)]
    sources: Annotated[tuple[SourceFile, ...], Meta(min_length=1)]
    adapter: str
    adapter_package: str
    adapter_version: str
    clock: LogClock
    frame: FrameCard
    positions: bool | None = None
    up: Literal["y", "z"]
    joint_names: tuple[str, ...]
    rows: dict[Table, Count]
    rows_are: Literal["line", "row", "message", "frame"]
    rows_read: Count
    rows_set_aside: tuple[SetAside, ...]
    first_s: Seconds
    last_s: Seconds
    duration_s: Duration
    rate_hz: Annotated[float, Meta(gt=0.0)] | None
    warnings: tuple[Note, ...]
    facts: dict[str, str]
    key: str

    @property
    def shown(self) -> str:
        """The path of its first file, by which messages name it."""
        return self.sources[0].path


class RecordingCard(LogCard, frozen=True, kw_only=True):
    """A log in the dataset.

    Attributes:
        session: Name of the session it belongs to.
        clock: How it lies in the time of the session.
        operator: How well it sees the operator; None for logs without people.
        listed: What a person must know of the tasks of a task list beside those of the robot.
    """

    session: Name
    clock: ClockCard
    operator: OperatorCard | None = None
    listed: tuple[Note, ...] = ()

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time of the recording, session time."""
        first_s, last_s = (at_s * self.clock.rate + self.clock.offset_s for at_s in (self.first_s, self.last_s))
        return first_s, last_s

    @property
    def said(self) -> list[str]:
        """All that a person must know of it, one sentence each."""
        clock = [f"clock: {'; '.join(texts(self.clock.warnings))}"] if self.clock.warnings else []
        operator = [f"operator: {text}" for text in texts(self.operator.warnings if self.operator else ())]
        return [*texts(self.warnings), *clock, *operator, *(f"task list: {text}" for text in texts(self.listed))]
