"""What the cell file said when the logs were ingested, as the card of the dataset keeps it."""

from __future__ import annotations

from typing import Any, Literal

from msgspec import field

from cyclekit.dataset.cards.quantities import Card, Hertz, Metres, Point, Rotation, Scaling, Seconds

Begin = Literal["auto", "file", "gap", "home", "register", "digital-output", "signal"]
"""How executions begin."""


class FrameSettings(Card, frozen=True, kw_only=True):
    """Where the frame of a log stands in the robot base frame.

    Attributes:
        xyz_m: Its origin.
        rotation: p_base = rotation @ p + xyz_m.
    """

    xyz_m: Point
    rotation: Rotation


class SyncSettings(Card, frozen=True, kw_only=True):
    """Two signals that change at the same times: in the robot's log and in the other one."""

    robot: str
    other: str


class SourceSettings(Card, frozen=True, kw_only=True):
    """One kind of log of the cell; see `cyclekit.config.Source`.

    Attributes:
        clock_rate: Seconds of the robot log per second of this log.
        sync_events: Times of the same events: (this log's, the robot log's).
        start: ISO 8601 with time zone.
        rate_hz: Of a log that has no clock.
        map: Columns, units or topics, as the adapter understands them.
    """

    path: str
    adapter: str | None = None
    role: Literal["robot", "people", "events", "tasks"] | None = None
    clock_offset_s: Seconds | None = None
    clock_rate: float = 1.0
    sync: SyncSettings | None = None
    sync_events: tuple[tuple[Seconds, Seconds], ...] = ()
    sees: Literal["tcp"] | None = None
    sees_as: str | None = None
    same_clock_as: str | None = None
    start: str | None = None
    frame: FrameSettings | None = None
    body: str | None = None
    silence: Literal["absent", "unknown"] | None = None
    rate_hz: float | None = None
    map: dict[str, Any] = field(default_factory=dict)


class NamedPlaceSettings(Card, frozen=True, kw_only=True):
    """A place that the cell file names."""

    xyz_m: Point
    radius_m: Metres = 0.05


class FurnitureSettings(Card, frozen=True, kw_only=True):
    """A box that stands in the cell.

    Attributes:
        xyz_m: Middle of its top.
        size_m: Length, width and height.
        yaw_deg: How it is turned about the vertical.
    """

    xyz_m: Point
    size_m: Point
    yaw_deg: float = 0.0


class ExecutionSettings(Card, frozen=True, kw_only=True):
    """How executions begin."""

    begin: Begin = "auto"
    gap_s: Seconds = 2.0
    home: str | None = None
    bit: int = 0
    signal: str | None = None


class RobotSettings(Card, frozen=True, kw_only=True):
    """The arm of a log of joint angles; see `cyclekit.config.Robot`.

    Attributes:
        dh: Of each joint: d, a, m; alpha, theta, deg.
    """

    model: str | None = None
    dh: tuple[tuple[float, float, float, float], ...] = ()
    tool_m: Point = (0.0, 0.0, 0.0)


class CellSettings(Card, frozen=True, kw_only=True):
    """A cell file; see `cyclekit.config.Cell`."""

    name: str = "cell"
    sources: tuple[SourceSettings, ...] = ()
    ignore: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()
    places: dict[str, NamedPlaceSettings] = field(default_factory=dict)
    all_places_named: bool = False
    human_places: dict[str, NamedPlaceSettings] = field(default_factory=dict)
    furniture: dict[str, FurnitureSettings] = field(default_factory=dict)
    executions: ExecutionSettings = ExecutionSettings()
    robot: RobotSettings | None = None
    rate_hz: Hertz = 10.0
    bridge_s: Seconds = 0.3
    levels: tuple[Scaling, ...] = ()
