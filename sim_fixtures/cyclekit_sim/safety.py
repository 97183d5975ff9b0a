"""The safety function: where robot and person are -> the step of the speed scaling, and how s follows it in time.

Three kinds: a staircase over their distance, zones on the floor that look at the person alone, and the slower of both.
Each answers with a step number; latency, hysteresis and ramps are added by `SpeedScaling`. Moving the robot is the
business of `engine`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array
from cyclekit_sim.options import SimulationOptions

Ints = NDArray[np.int64]


class SafetyFunction(Protocol):
    """Anything that turns positions into a step."""

    @property
    def levels(self) -> tuple[float, ...]:
        """Speed scalings, ascending; a step is an index into them."""

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> Ints:
        """Return the step (B,) for TCPs (B, 3) and persons (B, 3), boundaries moved outwards by `margin_m`."""


@dataclass(frozen=True)
class DistanceStaircase:
    """s = levels[i] for a distance in (thresholds_m[i-1], thresholds_m[i]]; a threshold is of the slower step."""

    levels: tuple[float, ...]
    thresholds_m: tuple[float, ...]

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> Ints:
        """Return the step by distance."""
        squares = (tcp_m - person_m) ** 2
        gamma = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])
        return np.asarray(np.searchsorted(np.array(self.thresholds_m) + margin_m, gamma, side="left"))


@dataclass(frozen=True)
class FloorZone:
    """A rectangle on the floor, base frame, metres; a person in it (border included) allows at most `step`."""

    name: str
    x_m: tuple[float, float]
    y_m: tuple[float, float]
    step: int


@dataclass(frozen=True)
class FloorZones:
    """s is that of the slowest zone the person stands in; where the robot is plays no part."""

    levels: tuple[float, ...]
    zones: tuple[FloorZone, ...]

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> Ints:
        """Return the step by the zones under the person's feet."""
        del tcp_m
        result = np.full(len(person_m), len(self.levels) - 1)
        x, y = person_m[:, 0], person_m[:, 1]
        for zone in self.zones:
            inside = (x >= zone.x_m[0] - margin_m) & (x <= zone.x_m[1] + margin_m)
            inside &= (y >= zone.y_m[0] - margin_m) & (y <= zone.y_m[1] + margin_m)
            result[inside] = np.minimum(result[inside], zone.step)
        return result


@dataclass(frozen=True)
class SlowestOf:
    """s is the slowest that any of several safety functions with the same levels allows."""

    levels: tuple[float, ...]
    parts: tuple[DistanceStaircase | FloorZones, ...]

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> Ints:
        """Return the lowest step of all parts."""
        return np.asarray(np.min([part.step(tcp_m, person_m, margin_m) for part in self.parts], axis=0))


class SpeedScaling:
    """s of B cells over time: the safety function with its hysteresis, latency and ramps, one call per cycle."""

    def __init__(self, function: SafetyFunction, options: SimulationOptions) -> None:
        self._function = function
        self._levels = np.array(function.levels)
        self._margin_m = options.hysteresis_m
        self._cycle_s = options.cycle_s
        self._delay = round(options.latency_s / options.cycle_s)
        self._fall = options.ramp_down_per_s
        self._rise = options.ramp_up_per_s
        self._seen: deque[Ints] = deque()
        self._step: Ints | None = None
        self._s: Array | None = None

    def advance(self, tcp_m: Array, person_m: Array) -> Array:
        """Return s (B,) of the cycle that begins now, with TCPs (B, 3) and persons (B, 3), m, as they are now."""
        step = self._function.step(tcp_m, person_m, 0.0)
        if self._margin_m > 0 and self._step is not None:
            step = np.clip(self._step, self._function.step(tcp_m, person_m, self._margin_m), step)
        self._step = step
        self._seen.append(step)
        wanted = self._levels[self._seen.popleft() if len(self._seen) > self._delay else self._seen[0]]
        if self._s is not None and (self._fall is not None or self._rise is not None):
            lowest = -np.inf if self._fall is None else self._s - self._fall * self._cycle_s
            highest = np.inf if self._rise is None else self._s + self._rise * self._cycle_s
            wanted = np.clip(wanted, lowest, highest)
        self._s = wanted
        return wanted
