"""The safety function: positions of robot and person to a step of the speed scaling, and its response over time.

Safety functions of the scenes: a staircase over their distance, zones on the floor for the person alone, and the slower
of both; `rules` has user-defined ones. `SpeedScaling` adds latency, hysteresis, hold time and ramps. `engine` moves the
robot.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array
from cyclekit_sim.options import SimulationOptions

Ints = NDArray[np.int64]


ABSENT_M = 1e5
"""Distance, m, beyond which a person counts as absent."""


class SafetyInputs(NamedTuple):
    """Inputs of a safety function for B cells, base frame.

    Attributes:
        tcp_m, person_m: TCPs and persons, shape (B, 3), m.
        links_m: Returns the joints from base to TCP, shape (B, J, 3), m.
    """

    tcp_m: Array
    person_m: Array
    links_m: Callable[[], Array]


class SafetyFunction(Protocol):
    """A function from positions to a scaling."""

    def allowed(self, at: SafetyInputs, margin_m: float) -> Array:
        """Return the scaling (B,) that it allows, with boundaries moved outwards by `margin_m`."""


class _Steps:
    """Common part of safety functions with levels."""

    levels: tuple[float, ...]

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> Ints:
        """Return the step (B,), an index into levels, for TCPs and persons (B, 3), with boundaries moved outwards."""
        raise NotImplementedError

    def allowed(self, at: SafetyInputs, margin_m: float) -> Array:
        """Return the level of the step."""
        return self._levels[self.step(at.tcp_m, at.person_m, margin_m)]

    @cached_property
    def _levels(self) -> Array:
        return np.array(self.levels)


@dataclass(frozen=True)
class DistanceStaircase(_Steps):
    """s = levels[i] for a distance in (thresholds_m[i-1], thresholds_m[i]]; a threshold belongs to the slower step."""

    levels: tuple[float, ...]
    thresholds_m: tuple[float, ...]

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> Ints:
        """Return the step for the distance."""
        squares = (tcp_m - person_m) ** 2
        gamma = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])
        return np.asarray((self._thresholds_m + margin_m).searchsorted(gamma, side="left"))

    @cached_property
    def _thresholds_m(self) -> Array:
        return np.array(self.thresholds_m)


@dataclass(frozen=True)
class FloorZone:
    """A rectangle on the floor, base frame, m; a person in it (border included) allows at most `step`."""

    name: str
    x_m: tuple[float, float]
    y_m: tuple[float, float]
    step: int


@dataclass(frozen=True)
class FloorZones(_Steps):
    """s is that of the slowest zone with the person in it, independent of the robot's position."""

    levels: tuple[float, ...]
    zones: tuple[FloorZone, ...]

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> Ints:
        """Return the step of the zones at the person's position."""
        del tcp_m
        result = np.full(len(person_m), len(self.levels) - 1)
        x, y = person_m[:, 0], person_m[:, 1]
        for zone in self.zones:
            inside = (x >= zone.x_m[0] - margin_m) & (x <= zone.x_m[1] + margin_m)
            inside &= (y >= zone.y_m[0] - margin_m) & (y <= zone.y_m[1] + margin_m)
            result[inside] = np.minimum(result[inside], zone.step)
        return result


@dataclass(frozen=True)
class SlowestOf(_Steps):
    """s is the lowest that any of several safety functions with the same levels allows."""

    levels: tuple[float, ...]
    parts: tuple[DistanceStaircase | FloorZones, ...]

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> Ints:
        """Return the lowest step of all parts."""
        return np.asarray(np.min([part.step(tcp_m, person_m, margin_m) for part in self.parts], axis=0))


class SpeedScaling:
    """s of B cells over time: the safety function with hysteresis, latency, hold time and ramps, one call per cycle."""

    def __init__(self, function: SafetyFunction, options: SimulationOptions) -> None:
        self._function = function
        self._margin_m = options.hysteresis_m
        self._cycle_s = options.cycle_s
        self._delay = round(options.latency_s / options.cycle_s)
        self._fall = options.ramp_down_per_s
        self._rise = options.ramp_up_per_s
        self._seen: deque[Array] = deque()
        self._held: deque[Array] = deque(maxlen=1 + round(options.hold_s / options.cycle_s))
        self._allowed: Array | None = None
        self._s: Array | None = None

    def advance(self, at: SafetyInputs) -> Array:
        """Return s (B,) of the cycle that starts now, for the current positions of TCPs and persons."""
        allowed = self._function.allowed(at, 0.0)
        if self._margin_m > 0 and self._allowed is not None:
            allowed = np.clip(self._allowed, self._function.allowed(at, self._margin_m), allowed)
        self._allowed = allowed
        self._seen.append(allowed)
        wanted = self._seen.popleft() if len(self._seen) > self._delay else self._seen[0]
        if self._held.maxlen != 1:
            self._held.append(wanted)
            wanted = np.min(self._held, axis=0)
        if self._s is not None and (self._fall is not None or self._rise is not None):
            lowest = -np.inf if self._fall is None else self._s - self._fall * self._cycle_s
            highest = np.inf if self._rise is None else self._s + self._rise * self._cycle_s
            wanted = np.clip(wanted, lowest, highest)
        self._s = wanted
        return wanted
