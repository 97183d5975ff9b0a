"""The operator as a track: positions at any time, and the start of each task.

A simulated operator walks from station to station on a curve through a random midpoint and dwells there; a recorded one
replays a tracker log to and fro. Neither reacts to the robot. `scenes` defines the stations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cyclekit_sim.arm import Array

_KNOT_S = 0.02
_ROOM = 4096
_WALK_ACCELERATION_M_S2 = 1.5
_SWAY_S = 0.5


@dataclass(frozen=True)
class Press:
    """Start of a task of the operator: time (s since the track's start), station, and exact goal (3,), m."""

    t_s: float
    goal: str
    goal_m: tuple[float, float, float]


@dataclass(frozen=True)
class Leg:
    """Part of a track: knot times from 0 (K,), s, and positions (K, 3), m; with the press that starts it."""

    t_s: Array
    xyz_m: Array
    press: Press | None = None


class Track(Protocol):
    """A person in the cell."""

    def at(self, t_s: Array) -> Array:
        """Return positions (M, 3), base frame, m, at times (M,), s since the track's start; NaN: absent."""

    def presses(self, until_s: float) -> list[Press]:
        """Return the tasks started up to `until_s`, in order."""


class Nobody:
    """The reference run: an empty cell."""

    def at(self, t_s: Array) -> Array:
        """Return NaN everywhere."""
        return np.full((len(t_s), 3), np.nan)

    def presses(self, until_s: float) -> list[Press]:
        """Return no task."""
        del until_s
        return []


class WalkedTrack:
    """Consecutive legs, generated as needed; after the last leg the person stands still.

    `skip_s` skips the beginning: time 0 of the track is at that time of the legs.
    """

    def __init__(self, legs: Iterator[Leg], *, skip_s: float = 0.0) -> None:
        self._legs, self._skip_s = legs, skip_s
        self._presses: list[Press] = []
        self._end_s = 0.0
        self._over = False
        self._points = 0
        self._t_s = np.empty(_ROOM)
        self._xyz_m = np.empty((_ROOM, 3))

    def at(self, t_s: Array) -> Array:
        """Return positions (M, 3) at times (M,); before 0 the first, after the last leg the last."""
        t_s = t_s + self._skip_s
        self._grow(float(np.max(t_s, initial=0.0)))
        known_s, known_m = self._t_s[: self._points], self._xyz_m[: self._points]
        return np.stack([np.interp(t_s, known_s, known_m[:, axis]) for axis in range(3)], axis=1)

    def presses(self, until_s: float) -> list[Press]:
        """Return the tasks started up to `until_s`, in order."""
        self._grow(until_s + self._skip_s)
        begun = [Press(press.t_s - self._skip_s, press.goal, press.goal_m) for press in self._presses]
        return [press for press in begun if 0.0 <= press.t_s <= until_s]

    def _grow(self, until_s: float) -> None:
        while not self._over and self._end_s <= until_s:
            leg = next(self._legs, None)
            if leg is None:
                self._over = True
                break
            if leg.press is not None:
                self._presses.append(Press(self._end_s + leg.press.t_s, leg.press.goal, leg.press.goal_m))
            self._put(self._end_s + leg.t_s, leg.xyz_m)
            self._end_s += float(leg.t_s[-1])

    def _put(self, t_s: Array, xyz_m: Array) -> None:
        end = self._points + len(t_s)
        if end > len(self._t_s):  # doubled, so that the cost per leg does not grow with the session
            room = max(2 * len(self._t_s), end)
            self._t_s = np.concatenate([self._t_s, np.empty(room - len(self._t_s))])
            self._xyz_m = np.concatenate([self._xyz_m, np.empty((room - len(self._xyz_m), 3))])
        self._t_s[self._points : end], self._xyz_m[self._points : end] = t_s, xyz_m
        self._points = end


class RecordedTrack:
    """A recording (K,), (K, 3) replayed to and fro without end, starting at `phase_s`; in the base frame."""

    def __init__(self, t_s: Array, xyz_m: Array, phase_s: float) -> None:
        self._t_s, self._xyz_m, self._phase_s = t_s - t_s[0], xyz_m, phase_s

    def at(self, t_s: Array) -> Array:
        """Return positions (M, 3) at times (M,)."""
        length = self._t_s[-1]
        folded = np.mod(np.maximum(t_s, 0.0) + self._phase_s, 2 * length)
        folded = np.minimum(folded, 2 * length - folded)
        return np.stack([np.interp(folded, self._t_s, self._xyz_m[:, axis]) for axis in range(3)], axis=1)

    def presses(self, until_s: float) -> list[Press]:
        """Return no task: a recording has no button presses."""
        del until_s
        return []


def walk(start_m: Array, middle_m: Array, goal_m: Array, speed_m_s: float) -> Leg:
    """Return the walk from `start_m` to `goal_m` (3,) on the parabola through `middle_m`, easing in and out."""
    u = np.linspace(0.0, 1.0, 65)[:, None]
    handle = 2 * middle_m - 0.5 * (start_m + goal_m)
    curve = (1 - u) ** 2 * start_m + 2 * u * (1 - u) * handle + u**2 * goal_m
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    length = float(along[-1])
    top = min(speed_m_s, np.sqrt(length * _WALK_ACCELERATION_M_S2))
    rise_s = top / _WALK_ACCELERATION_M_S2
    total_s = length / top + rise_s
    t = np.linspace(0.0, total_s, max(2, int(np.ceil(total_s / _KNOT_S)) + 1))
    done = _trapezoid(t, top, rise_s, total_s)
    return Leg(t, np.stack([np.interp(done, along, curve[:, axis]) for axis in range(3)], axis=1))


def stand(at_m: Array, length_s: float) -> Leg:
    """Return a dwell of `length_s` at `at_m` (3,)."""
    return Leg(np.array([0.0, length_s]), np.stack([at_m, at_m]))


def sway(at_m: Array, length_s: float, sd_m: float, rng: np.random.Generator) -> Leg:
    """Return a dwell of `length_s` at work about `at_m` (3,): another position each _SWAY_S, begun and ended there."""
    t = np.linspace(0.0, length_s, max(2, round(length_s / _SWAY_S) + 1))
    xyz_m = np.tile(at_m, (len(t), 1))
    xyz_m[1:-1, :2] += rng.normal(0.0, sd_m, (len(t) - 2, 2))
    return Leg(t, xyz_m)


def away(length_s: float) -> Leg:
    """Return a leg of `length_s` without a person in the cell."""
    return Leg(np.array([0.0, length_s]), np.full((2, 3), np.nan))


def _trapezoid(t: Array, top: float, rise_s: float, total_s: float) -> Array:
    """Return the distance covered (K,) at times (K,), for a speed that rises to `top`, holds and falls at one rate."""
    rising = 0.5 * top / rise_s * np.minimum(t, rise_s) ** 2
    cruising = top * np.clip(t - rise_s, 0.0, total_s - 2 * rise_s)
    falling_s = np.clip(t - (total_s - rise_s), 0.0, rise_s)
    return np.asarray(rising + cruising + top * falling_s - 0.5 * top / rise_s * falling_s**2)
