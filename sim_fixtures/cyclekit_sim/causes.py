"""Causes of lost time other than a person: slider, reduced mode, limits, waits, pauses, protective stops.

Each cause is a cap of the speed scaling or a standstill, known for each cycle. Lost time is attributed in the order
nominal motion, slider, limits, input, person, protective stop: each cause gets what it adds to those before it. So a
protective stop costs nothing while a person stops the robot anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array
from cyclekit_sim.program import DWELL, MOVE, WAIT, Ints, Program

Bools = NDArray[np.bool_]
CAUSES = ("person", "slider", "input", "limits", "wait", "pause", "stop")
REDUCED_BIT, PART_BIT = 2, 3
_HOUR_S = 3600.0
_REACTION_S = 0.2  # s, of the controller to the input of the reduced mode


@dataclass(frozen=True)
class MixedCauses:
    """Causes of lost time other than the person; None or 0 disables one.

    Attributes:
        slider: Speed slider in some executions, in (0, 1).
        slider_share: Share of these executions.
        slider_every: A hand sets the slider anew, from `slider` to 1, before every so many executions; 0: see above.
        slider_turns_per_hour: Likewise, at random times of a run; it begins at 1.
        slider_goals: The program sets the slider on its way to these places and at them, in every execution.
        reduced: Cap of the scaling while digital input 2 is on, in (0, 1).
        reduced_per_hour, reduced_s: Frequency and duration range of the reduced mode.
        limit: Cap of the scaling on one stretch of every move away from the conveyor, in (0, 1).
        limit_from, limit_to: Limits of that stretch, as shares of the move's nominal time.
        wait_share, wait_s: Share of parts with a wait at the conveyor, and its duration range.
        part_signal: Digital input 3 is on while a part is at the conveyor.
        pauses_per_hour, pause_s: Frequency and duration range of program pauses.
        stops_per_hour, stop_s: Frequency and duration range of protective stops: speed 0 while the program plays.
    """

    slider: float | None = 0.6
    slider_share: float = 0.2
    slider_every: int = 0
    slider_turns_per_hour: float = 0.0
    slider_goals: tuple[str, ...] = ()
    reduced: float | None = 0.35
    reduced_per_hour: float = 12.0
    reduced_s: tuple[float, float] = (15.0, 45.0)
    limit: float | None = 0.55
    limit_from: float = 0.4
    limit_to: float = 0.7
    wait_share: float = 0.15
    wait_s: tuple[float, float] = (1.0, 6.0)
    part_signal: bool = True
    pauses_per_hour: float = 15.0
    pause_s: tuple[float, float] = (3.0, 12.0)
    stops_per_hour: float = 20.0
    stop_s: tuple[float, float] = (2.0, 6.0)


@dataclass(frozen=True)
class Caps:
    """Caps of K cycles of one run, shape (K,) each; the slider; protective stops and pauses of the program."""

    person: Array
    reduced: Array
    limit: Array
    slider: Array
    stopped: Bools
    paused: Bools


class Slowing:
    """The other causes of B parallel runs."""

    def __init__(
        self, programs: Sequence[Program], causes: MixedCauses, streams: Sequence[np.random.Generator], until_s: float
    ) -> None:
        width = max(len(program.kind) for program in programs) + 1
        self._slider, self._limit = np.ones((len(programs), width)), np.ones((len(programs), width))
        self._length = np.ones((len(programs), width))
        self._causes, self._row = causes, np.arange(len(programs))
        self._spans: list[tuple[Array, Array, Array]] = []
        self._turns: list[tuple[Array, Array]] = []
        for b, (program, rng) in enumerate(zip(programs, streams, strict=True)):
            count = len(program.kind)
            self._length[b, :count] = np.maximum(program.length_s, 1e-9)
            by_hand = bool(causes.slider_every or causes.slider_turns_per_hour)
            if causes.slider_every:
                self._slider[b, :count] = [
                    _set_by_hand(causes, max(e, 0) // causes.slider_every) for e in program.execution
                ]
            self._turns.append(_turns(rng, causes, until_s))
            if causes.slider is not None and causes.slider_goals:
                self._slider[b, :count][np.isin(program.goals, causes.slider_goals)] = causes.slider
            elif causes.slider is not None and not by_hand:
                low = {e.index for e in program.executions if rng.random() < causes.slider_share}
                self._slider[b, :count][np.isin(program.execution, list(low))] = causes.slider
            if causes.limit is not None:
                self._limit[b, :count][_leaves_conveyor(program)] = causes.limit
            self._spans.append(
                (
                    _spans(rng, causes.reduced_per_hour if causes.reduced else 0.0, causes.reduced_s, until_s),
                    _spans(rng, causes.stops_per_hour, causes.stop_s, until_s),
                    _spans(rng, causes.pauses_per_hour, causes.pause_s, until_s),
                )
            )

    def during(self, times: Array) -> tuple[Array, Bools, Bools, Array]:
        """Return cap of the reduced mode, protective stop, pause and slider at times (T,), shape (T, B) each."""
        found = [(*self._at(b, times), self._turned(b, times)) for b in range(len(self._spans))]
        reduced, stopped, paused, slider = (np.stack(column, axis=1) for column in zip(*found, strict=True))
        return reduced, stopped, paused, slider

    def _turned(self, b: int, times: Array) -> Array:
        at, value = self._turns[b]
        return np.asarray(value[np.searchsorted(at, times, side="right")])

    def _at(self, b: int, times: Array) -> tuple[Array, Bools, Bools]:
        reduced, stops, pauses = self._spans[b]
        cap = np.where(_inside(times - _REACTION_S, reduced), self._causes.reduced or 1.0, 1.0)
        return cap, _inside(times, stops), _inside(times, pauses)

    def segment_caps(self, segment: Ints, nominal_s: Array, b: Ints | int | None = None) -> tuple[Array, Array]:
        """Return slider and cap of the limits for the running segments."""
        which = self._row if b is None else b
        share = nominal_s / self._length[which, segment]
        inside = (share >= self._causes.limit_from) & (share < self._causes.limit_to)
        return self._slider[which, segment], np.where(inside, self._limit[which, segment], 1.0)

    def caps(self, b: int, times: Array, person: Array, segment: Ints, nominal_s: Array) -> Caps:
        """Return the caps of run `b` at each of its cycles."""
        slider, limit = self.segment_caps(segment, nominal_s, b)
        reduced, stopped, paused = self._at(b, times)
        return Caps(person, reduced, limit, slider * self._turned(b, times), stopped, paused)

    def switched_on(self, b: int, times: Array) -> Bools:
        """Return a mask of the times at which the input of the reduced mode of run `b` is on."""
        return _inside(times, self._spans[b][0])


def scaling_of(caps: Caps) -> Array:
    """Return the scaling executed by the controller, without slider and pause."""
    return np.where(caps.stopped, 0.0, np.minimum(np.minimum(caps.person, caps.reduced), caps.limit))


def lost_parts(caps: Caps, kind: Ints) -> dict[str, Array]:
    """Return the share of each cycle lost to each cause, shape (K,) each.

    Args:
        caps: The caps.
        kind: Kind of program segment, shape (K,).
    """
    s, c1 = scaling_of(caps), caps.limit
    c2 = np.minimum(c1, caps.reduced)
    free = np.where(caps.stopped & (caps.person > 0.0), 0.0, 1.0)
    moving = ((kind == MOVE) & ~caps.paused).astype(np.float64)
    return {
        "person": moving * (free - s / c2),
        "slider": moving * s * (1.0 - caps.slider),
        "input": moving * (s / c2 - s / c1),
        "limits": moving * (s / c1 - s),
        "wait": ((kind == WAIT) & ~caps.paused).astype(np.float64),
        "pause": caps.paused.astype(np.float64),
        "stop": moving * (1.0 - free),
    }


def part_there(program: Program, segment: Ints) -> Bools:
    """Return a mask of cycles with a part at the conveyor: from the end of the wait until it is picked."""
    return np.asarray((program.kind == DWELL) & (np.array(program.goals) == "conveyor"))[segment]


def _leaves_conveyor(program: Program) -> Bools:
    goals = np.array(("", *program.goals[:-1]))
    return np.asarray((program.kind == MOVE) & (goals == "conveyor"))


def _set_by_hand(causes: MixedCauses, number: int) -> float:
    """Return the `number`-th position of a slider that a hand sets, in steps of 5 %."""
    low = causes.slider or 0.05
    return float(np.round(20.0 * np.random.default_rng([77, number]).uniform(low, 1.0)) / 20.0)


def _turns(rng: np.random.Generator, causes: MixedCauses, until_s: float) -> tuple[Array, Array]:
    """Return the times (N,) at which a hand turns the slider, and its positions before and after them (N + 1,)."""
    if not causes.slider_turns_per_hour:
        return np.empty(0), np.ones(1)
    at, found = np.empty(0), 0.0
    while (found := found + rng.exponential(_HOUR_S / causes.slider_turns_per_hour)) < until_s:
        at = np.append(at, found)
    return at, np.append(1.0, [_set_by_hand(causes, int(n)) for n in rng.integers(1 << 30, size=len(at))])


def _spans(rng: np.random.Generator, per_hour: float, lasts_s: tuple[float, float], until_s: float) -> Array:
    """Return start and end of random events with this frequency, shape (N, 2), s."""
    if per_hour <= 0:
        return np.empty((0, 2))
    found, at = [], 0.0
    while (at := at + rng.exponential(_HOUR_S / per_hour)) < until_s:
        found.append((at, at + rng.uniform(*lasts_s)))
        at = found[-1][1]
    return np.array(found).reshape(-1, 2)


def _inside(times: Array, spans: Array) -> Bools:
    number = np.searchsorted(spans[:, 0], times, side="right") - 1
    return np.asarray((number >= 0) & (times < np.append(spans[:, 1], -np.inf)[number]))
