"""Cards of logs: provenance, clock, frame, and the rows kept and set aside."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from cyclekit.adapter import TimeUnit
from cyclekit.dataset.cards.notes import Note, texts
from cyclekit.dataset.cards.quantities import Card, Count, Digest, Duration, Measure, Name, Point, Rotation, Seconds

Table = Literal["robot", "people", "events", "task_list", "safety", "skeletons", "stamps"]
"""Tables that a log may have."""
ClockMethod = Literal[
    "own",
    "same-log",
    "cell-file",
    "event-pairs",
    "motion",
    "lower-envelope",
    "epoch",
    "start-text",
    "logs",
    "assumed-common-start",
]
"""Method by which a log's clock was aligned with that of its session."""


class SourceFile(Card, frozen=True, kw_only=True):
    """A file of a log.

    Attributes:
        path: Path relative to the ingested folder, with `/` as separator.
        blake3: Checksum; None if none was requested, or an earlier version stored `sha256`.
        sha256: Checksum from an earlier version.
        size: Size in bytes.
    """

    path: str
    blake3: Digest | None = None
    sha256: Digest | None = None
    size: Count = 0

    @property
    def checksum(self) -> str | None:
        """Checksum of its content, by either function; None if there is none."""
        return self.blake3 or self.sha256


class LogClock(Card, frozen=True, kw_only=True):
    """The clock of a log itself: seconds since 1970, since a device was started, or since the recording began."""

    kind: Literal["epoch", "uptime", "relative"]


class ClockTest(Card, frozen=True, kw_only=True):
    """What the logs themselves say about a clock: where people are, or states of signals, explain what the robot does.

    Attributes:
        lag_s: Time to be added to the log's at the best lag, relative to the clock as it was stated or assumed.
        explained: Share of the variance of the level that is explained there.
        next_best: The same at the best other peak.
        here: The same with the clock as it was; None if the logs hardly met.
        certain: Whether the best lag beats every other peak by a test.
    """

    lag_s: Seconds
    explained: Measure
    next_best: Measure
    here: Measure | None = None
    certain: bool


class ClockCard(LogClock, frozen=True, kw_only=True):
    """Alignment of a log's clock with its session: t_session = rate * t_log + offset_s.

    Attributes:
        residual_s: Typical residual of the fit; None if no data was left to check it.
        events: Number of event pairs, or of windows of motion, used in the fit.
        events_rejected: Number of events without a partner, or in conflict with the others.
        correlation: Peak of the correlation, -1 to 1.
        second_best: Height of the second peak over that of the first; near 1 the fit is ambiguous.
        second_best_s: Distance of the second peak from the first.
        same_as: Id of the recording whose clock this log shares.
        test: What the logs themselves say about it; None if they say nothing.
        warnings: Limits of the alignment that a user must know.
    """

    method: ClockMethod
    offset_s: Seconds
    rate: Annotated[float, Meta(gt=0.0, le=1e15)] = 1.0
    residual_s: Duration | None = None
    events: Count | None = None
    events_rejected: Count | None = None
    correlation: Measure | None = None
    second_best: Measure | None = None
    second_best_s: Seconds | None = None
    same_as: str | None = None
    test: ClockTest | None = None
    warnings: tuple[Note, ...] = ()


class FrameCard(Card, frozen=True, kw_only=True):
    """Pose of a log's frame in the robot base frame: p_base = rotation @ p + xyz_m, after turning up to z.

    Attributes:
        method: `robot base`: positions are already in it; `assumed base frame`: the pose is unknown.
        up: Axis of the log that points up; None for logs without people.
        xyz_m, rotation: Pose from the cell file; None with the other methods.
    """

    method: Literal["robot base", "assumed base frame", "cell-file"]
    up: Literal["y", "z"] | None = None
    xyz_m: Point | None = None
    rotation: Rotation | None = None

    def __post_init__(self) -> None:
        """Refuse a frame from the cell file without its pose.

        Raises:
            ValueError: The pose is missing.
        """
        if self.method == "cell-file" and (self.xyz_m is None or self.rotation is None):
            msg = 'method "cell-file" needs xyz_m and rotation'
            raise ValueError(msg)


class SetAside(Card, frozen=True, kw_only=True):
    """Rows set aside for one reason."""

    reason: str
    count: Count


class OperatorCard(Card, frozen=True, kw_only=True):
    """How well a log sees the operator: numbers of samples.

    Attributes:
        not_believed: Positions dropped as implausible: faster than a person moves.
        seen: Samples with an operator seen.
        occluded: Samples with the operator hidden for longer than is bridged.
        absent: Samples without an operator.
        outside: Samples outside of the time of the log.
        several: Samples with people at different places at once, in all logs of its session.
        warnings: Limits that a user must know.
    """

    not_believed: Count = 0
    seen: Count = 0
    occluded: Count = 0
    absent: Count = 0
    outside: Count = 0
    several: Count = 0
    warnings: tuple[Note, ...] = ()


class LogCard(Card, frozen=True, kw_only=True):
    """A log as it was read, before it becomes part of a session.

    Attributes:
        id: Name of the recording and its folder.
        tables: Its tables.
        sources: Its files; one, or all files of a folder that is one log.
        adapter, adapter_package, adapter_version: The adapter that read it.
        clock: Its clock.
        frame: Pose of its frame.
        positions: Whether it holds positions of the robot or of people; None = an earlier version did not store it.
        up: Axis that points up in the frame of its people.
        joint_names: Names of the joints q0, q1, ...
        rows: Number of rows kept, by table.
        rows_are: Unit of `source_row`.
        rows_read: Number of rows of the log.
        rows_set_aside: Rows set aside, by reason.
        restart_rows: Rows of the robot table at which the log's clock begins anew, more than a second back.
        first_s, last_s: Time of the first and last row, clock of the log.
        duration_s: last_s - first_s.
        rate_hz: Rows per second; None if all rows have one time.
        warnings: Limits of the log that a user must know.
        facts: Other findings of the adapter, as texts.
        time_units: Units that its times may have, while they are not proven, or the stated one: see
            `adapter.Recording`.
        key: Changes with the log, its adapter or its options; empty if the dataset is pseudonymised.
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
    restart_rows: tuple[Count, ...] = ()
    first_s: Seconds
    last_s: Seconds
    duration_s: Duration
    rate_hz: Annotated[float, Meta(gt=0.0, le=1e12)] | None
    warnings: tuple[Note, ...]
    facts: dict[str, str]
    time_units: tuple[TimeUnit, ...] = ()
    key: str

    @property
    def shown(self) -> str:
        """Path of its first file, which names the log in messages."""
        return self.sources[0].path


class RecordingCard(LogCard, frozen=True, kw_only=True):
    """A log in the dataset.

    Attributes:
        session: Name of its session.
        clock: Alignment of its clock with the session.
        operator: How well it sees the operator; None for logs without people.
        listed: Warnings about tasks of a task list, relative to those in the robot's log.
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
        """All warnings about the log, one sentence each."""
        clock = [f"clock: {'; '.join(texts(self.clock.warnings))}"] if self.clock.warnings else []
        operator = [f"operator: {text}" for text in texts(self.operator.warnings if self.operator else ())]
        return [*texts(self.warnings), *clock, *operator, *(f"task list: {text}" for text in texts(self.listed))]
