"""A change of the cell, as read from a file.

[[change]]
name = "thresholds of the new scanner"
levels = [0.0, 0.25, 0.5, 0.75, 1.0]       # ascending
thresholds_m = [0.6, 0.8, 1.2, 1.6]        # one fewer; at or below a threshold the slower level holds

[[change]]
name = "zones"
levels = [0.0, 0.5, 1.0]
zones = [{ x_m = [-1.0, 1.0], y_m = [-1.0, 1.0], level = 0.0 }]   # rectangles on the floor, base frame

[[change]]
name = "thresholds and a zone"                                    # the slower of both holds
levels = [0.0, 0.5, 1.0]
thresholds_m = [0.8, 1.5]
zones = [{ x_m = [1.0, 2.5], y_m = [-1.0, 1.0], level = 0.5 }]

[[change]]
name = "single numbers of the rule in the model"                  # all others and the hysteresis are unchanged
limits = [{ level = 0.5, threshold_m = 1.3 }, { level = 0.0, x_m = [0.9, 2.0] }]

[[change]]
name = "another level, and a mat that counts in a part of the path only"      # with signals of people
signals = [{ signal = "warning field", level = 0.7 }, { signal = "mat", x_m = [0.0, 1.0], y_m = [-0.3, 0.3] }]

[[change]]
name = "robot half a metre back, fewer visits"
base = { xyz_m = [-0.5, 0.0, 0.0], yaw_deg = 0.0 }   # new position of the base, in the present base frame
places = { conveyor = [0.7, 0.0, 0.1] }              # moved places of the robot, in the frame of its base
frequency = 0.5                                      # visits per hour, relative to the logged ones

[[change]]
name = "quicker recovery"        # response of s to the safety function; omitted values stay as logged
ramp_up_per_s = 2.0              # inf: at once
hysteresis_m = 0.0               # also ramp_down_per_s, latency_s

[[change]]
name = "a practised operator, parts in advance"   # if robot and operator wait for each other
faster = { operator = 1.2 }                       # 1.2 times as fast; in task lists also robot or the agent's name
buffer = { part = 3 }                             # parts in advance, of a source or of a task of task lists
more_places = { fixture = 1 }                     # additional places that an agent waits for to be free
without_waits = ["robot before fixture"]          # waits that are removed
no_wait = [["weld", "mount"]]                     # in task lists: weld no longer waits for mount; "part": for parts
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cyclekit.config.cells import Levels, Number, Point
from cyclekit.config.toml_file import read_toml, require_list, to_dataclass
from cyclekit.dataset.cards.quantities import LONGEST_DELAY_S, SLOWEST_RAMP
from cyclekit.errors import ConfigError
from cyclekit.text.numbers import given

if TYPE_CHECKING:
    from pathlib import Path

_DYNAMICS = ("latency_s", "ramp_down_per_s", "ramp_up_per_s", "hysteresis_m")
FASTEST = 100
"""Maximum of factors in `faster` and `frequency`, whose minimum is 1 / FASTEST, and of counts in `buffer` and
`more_places`."""
LARGEST_M = 1000.0
"""Maximum of thresholds and hysteresis, m: beyond any hall, a limit of what can be."""
_EXAMPLE = """Add one:
  [[change]]
  name = "fewer visits"
  frequency = 0.5"""
_CURE = "docs/commands.md shows every key of a change."


def _refuse_edges(what: str, x_m: tuple[float, float] | None, y_m: tuple[float, float] | None) -> None:
    for name, edges in (("x_m", x_m), ("y_m", y_m)):
        if edges is not None and not edges[0] < edges[1]:
            msg = f"{what}: {name} {edges}: the first must be less than the second"
            raise ValueError(msg)


@dataclass(frozen=True)
class Zone:
    """A rectangle on the floor, base frame, m, including its border; an operator in it allows at most `level`."""

    x_m: tuple[Number, Number]
    y_m: tuple[Number, Number]
    level: float

    def __post_init__(self) -> None:
        """Refuse a rectangle without extent.

        Raises:
            ValueError: It has no extent.
        """
        _refuse_edges("zone", self.x_m, self.y_m)


@dataclass(frozen=True)
class LimitChange:
    """New numbers of one limit of the model's rule, m: where the robot slows down to `level`.

    Numbers that are None are unchanged, and so is the hysteresis of the limit. Edges of a rotated rectangle are along
    its own axes; an edge that was never crossed stays unknown: -inf or inf.
    """

    level: float
    threshold_m: Number | None = None
    x_m: tuple[float, float] | None = None
    y_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse an empty change, an invalid level, a negative threshold, or a rectangle without extent.

        Raises:
            ValueError: It is one of these.
        """
        if not 0 <= self.level <= 1:
            msg = f"limit of level {given(self.level)}: a level must be between 0 and 1"
            raise ValueError(msg)
        if self.threshold_m is None and self.x_m is None and self.y_m is None:
            msg = f"limit of level {given(self.level)}: give threshold_m, x_m or y_m"
            raise ValueError(msg)
        if self.threshold_m is not None and self.threshold_m < 0:
            msg = f"limit of level {given(self.level)}: threshold_m {self.threshold_m} must be 0 or more"
            raise ValueError(msg)
        _refuse_edges(f"limit of level {given(self.level)}", self.x_m, self.y_m)


@dataclass(frozen=True)
class SignalChange:
    """New settings of a signal of people: another level, or an effect only while the TCP is in a rectangle, m.

    Settings that are None are unchanged.
    """

    signal: str
    level: float | None = None
    x_m: tuple[Number, Number] | None = None
    y_m: tuple[Number, Number] | None = None

    def __post_init__(self) -> None:
        """Refuse an empty change, an invalid level, or a rectangle without extent.

        Raises:
            ValueError: It is one of these.
        """
        if self.level is None and self.x_m is None and self.y_m is None:
            msg = f"signal {self.signal!r}: give level, x_m or y_m"
            raise ValueError(msg)
        if self.level is not None and not 0 <= self.level <= 1:
            msg = f"signal {self.signal!r}: level {self.level} must be between 0 and 1"
            raise ValueError(msg)
        _refuse_edges(f"signal {self.signal!r}", self.x_m, self.y_m)


@dataclass(frozen=True)
class Change:
    """One change of the cell; values that are None or empty are unchanged.

    Attributes:
        name: Name of the change in the answer.
        levels: Levels of another safety function, ascending.
        thresholds_m: Its thresholds on ||x_r - x_h||, one fewer than levels.
        zones: Its zones on the floor; with thresholds as well, the slower of both holds.
        limits: Single thresholds and edges of the rule in the model, instead of `levels`.
        signals: New settings of single signals of people, if the model's input is signals.
        base_m, base_yaw_deg: New position of the robot's base, in the present base frame.
        places: Moved places of the robot: name -> TCP, m, in the frame of the robot's base.
        frequency: The operator's visits per hour, relative to the logged ones.
        more_places: Number of additional places, by name of a place that an agent waits for to be free.
        without_waits: Waits that are removed, named as in `inspect`: `robot before fixture`.
        dynamics: Changed response of s to the safety function, by name in `Dynamics`: s, 1/s or m.
        faster: Factor on the speed of an agent, by agent; only the operator in cells with positions.
        no_wait: Pairs of tasks of task lists: the first no longer waits for the second; `part` = for parts that
            come by themselves.
        buffer: Number of parts in advance, by signal of their source; in task lists by the task that waits for them.
    """

    name: str
    levels: tuple[float, ...] = ()
    thresholds_m: tuple[float, ...] = ()
    zones: tuple[Zone, ...] = ()
    limits: tuple[LimitChange, ...] = ()
    signals: tuple[SignalChange, ...] = ()
    base_m: Point | None = None
    base_yaw_deg: float = 0.0
    places: Mapping[str, Point] = field(default_factory=dict)
    frequency: float | None = None
    dynamics: Mapping[str, float] = field(default_factory=dict)
    more_places: Mapping[str, int] = field(default_factory=dict)
    without_waits: tuple[str, ...] = ()
    faster: Mapping[str, float] = field(default_factory=dict)
    no_wait: tuple[tuple[str, str], ...] = ()
    buffer: Mapping[str, int] = field(default_factory=dict)

    @property
    def operator_pace(self) -> float:
        """Factor on the operator's speed of work and walking."""
        return self.faster.get("operator", 1.0)

    @property
    def waits_change(self) -> bool:
        """Whether it changes wait conditions, or the durations of waits."""
        return bool(self.faster or self.no_wait or self.buffer or self.more_places or self.without_waits)

    @property
    def of_tasks(self) -> bool:
        """Whether it changes only tasks and waits of task lists, without positions."""
        return bool(self.faster or self.no_wait or self.buffer) and not self._of_positions

    @property
    def _of_positions(self) -> bool:
        found = self.levels, self.limits, self.signals, self.base_m, self.places, self.frequency, self.dynamics
        return any(map(bool, (*found, self.more_places, self.without_waits)))

    def __post_init__(self) -> None:
        """Refuse an invalid safety function or an empty change.

        Raises:
            ConfigError: Levels, thresholds or zones do not fit together, or nothing is changed.
        """
        if self.levels:
            rising = all(a < b for a, b in zip(self.levels, self.levels[1:], strict=False))
            if not rising or not 0 <= self.levels[0] <= self.levels[-1] <= 1:
                self._refuse(f"levels {list(self.levels)}", "Give levels between 0 and 1, ascending.")
            if not self.thresholds_m and not self.zones:
                self._refuse("levels without thresholds_m or zones", _CURE)
            if self.thresholds_m and len(self.thresholds_m) != len(self.levels) - 1:
                self._refuse(
                    f"{len(self.levels)} levels and {len(self.thresholds_m)} thresholds", "Give one threshold fewer."
                )
            if [*self.thresholds_m] != sorted(self.thresholds_m) or any(
                not 0 <= m <= LARGEST_M for m in self.thresholds_m
            ):
                self._refuse(f"thresholds_m {list(self.thresholds_m)}", "Give them ascending, in metres.")
            if strange := [zone.level for zone in self.zones if zone.level not in self.levels]:
                self._refuse(f"a zone has level {strange[0]}, which is not among levels", _CURE)
            if self.limits:
                self._refuse("both levels and limits", "Write the whole function, or change the rule.")
        elif self.thresholds_m or self.zones:
            self._refuse("thresholds_m or zones without levels", _CURE)
        if self.frequency is not None and not 1 / FASTEST <= self.frequency <= FASTEST:
            cure = "0.5 means half as many visits per hour as were logged; give 0.01 to 100."
            self._refuse(f"frequency {self.frequency}", cure)
        self._refuse_dynamics()
        if slow := [value for value in self.faster.values() if not 1 / FASTEST <= value <= FASTEST]:
            self._refuse(f"faster {given(slow[0])}", "1.2 means 1.2 times as fast; give 0.01 to 100.")
        for name, count in (*self.more_places.items(), *self.buffer.items()):
            if not 0 < count <= FASTEST:
                self._refuse(f"{name}: {count}", "Give a whole number, 1 or more.")
        if not self.waits_change and not self._of_positions:
            self._refuse("nothing is changed", _CURE)

    def _refuse_dynamics(self) -> None:
        for name, value in self.dynamics.items():
            most = {"latency_s": LONGEST_DELAY_S, "hysteresis_m": LARGEST_M}.get(name, math.inf)
            least = SLOWEST_RAMP if name.startswith("ramp_") else 0.0
            if not least <= value <= most:
                cure = "inf means without a ramp." if name.startswith("ramp_") else ""
                self._refuse(f"{name} {value}", f"Give {given(least)} to {given(most)}. {cure}".rstrip())

    def _refuse(self, seen: str, cure: str) -> None:
        raise ConfigError(f"change {self.name!r}: {seen}", cure=cure)


def load_changes(path: Path | str) -> list[Change]:
    """Read a file of changes.

    Raises:
        ConfigError: The file cannot be read, holds no change, or a change is invalid.
    """
    raw = read_toml(path)
    if not require_list(str(path), raw, "change") and not set(raw) - {"change"}:
        raise ConfigError(f"{path}: no [[change]] in it", cure=_EXAMPLE)
    return [_change(entry, number) for number, entry in enumerate(to_dataclass(str(path), raw, _File).change)]


@dataclass(frozen=True)
class _Base:
    """New position of the base, as in the file."""

    xyz_m: Point = (0.0, 0.0, 0.0)
    yaw_deg: Number = 0.0


@dataclass(frozen=True)
class _Entry:
    """A change, as in the file."""

    name: str | None = None
    levels: Levels = ()
    thresholds_m: tuple[Number, ...] = ()
    zones: tuple[Zone, ...] = ()
    limits: tuple[LimitChange, ...] = ()
    signals: tuple[SignalChange, ...] = ()
    base: _Base | None = None
    places: Mapping[str, Point] = field(default_factory=dict)
    frequency: float | None = None
    latency_s: float | None = None
    ramp_down_per_s: float | None = None
    ramp_up_per_s: float | None = None
    hysteresis_m: float | None = None
    more_places: Mapping[str, int] = field(default_factory=dict)
    without_waits: tuple[str, ...] = ()
    faster: Mapping[str, float] = field(default_factory=dict)
    no_wait: tuple[tuple[str, str], ...] = ()
    buffer: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _File:
    """All keys of a file of changes."""

    change: tuple[_Entry, ...] = ()


def _change(entry: _Entry, number: int) -> Change:
    return Change(
        name=entry.name or f"change {number + 1}",
        levels=entry.levels,
        thresholds_m=entry.thresholds_m,
        zones=entry.zones,
        limits=entry.limits,
        signals=entry.signals,
        base_m=entry.base.xyz_m if entry.base else None,
        base_yaw_deg=entry.base.yaw_deg if entry.base else 0.0,
        places=entry.places,
        frequency=entry.frequency,
        more_places=entry.more_places,
        without_waits=entry.without_waits,
        dynamics={key: value for key in _DYNAMICS if (value := getattr(entry, key)) is not None},
        faster=entry.faster,
        no_wait=entry.no_wait,
        buffer=entry.buffer,
    )
