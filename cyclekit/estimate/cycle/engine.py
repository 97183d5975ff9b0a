"""The one simulation of the robot in many cycles at once: it moves, works, waits, and is slowed near people.

The robot advances along its nominal time, in motion at the scaling s(x_r, x_h), at work at 1; nothing is assumed about
the form of s. Where it has to wait, it departs once the events it waits for have occurred. The step is divided where a
part of a leg ends in it, so times are exact within a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from cyclekit.estimate.robot.safety import Dynamics, Follower, SafetyModel, at_once, is_fast, scaling_in_step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.robot.safety import Logged
    from cyclekit.schema import Bools, Floats, Ints, Vector

TIME_STEP_S, FINE_STEP_S = 0.2, 0.1
"""Time step of the simulation, s, and the fine one, used if s follows the safety function with delay, ramps or
hysteresis, if agents wait for each other, or if single cycles count more than their mean. The safety function is
evaluated at mid-step positions, once per TIME_STEP_S; once per step if single cycles count or it is a rule, which is
fast."""
SUPPORT_EVERY_S = 0.4
"""Time between evaluations of the support, s."""
AT_ONCE = Dynamics()
OWN = -1
"""Cause of a departure that waited for nothing: own work."""
MOVES, WORKS, WAITS, ENDED = range(4)


class LegTimes:
    """Times of arrival, end of own work and departure for each leg of one agent: shape (rows, legs) each, s.

    Attributes:
        decided: Number of the event that decided departure, or of another cause, as OWN.
        lost_s: Safety loss of the leg.
        trips: Whether the operator made a trip before departure.
    """

    def __init__(self, rows: int, legs: int) -> None:
        """Create times of inf: nothing has occurred yet."""
        self.arrives_s, self.works_s, self.passes_s = (np.full((rows, legs), np.inf) for _ in range(3))
        self.decided = np.full((rows, legs), OWN)
        self.lost_s = np.zeros((rows, legs))
        self.trips = np.zeros((rows, legs), dtype=np.bool_)

    @property
    def waits_s(self) -> Floats:
        """Wait at the end of each leg, shape (rows, legs), s."""
        passed = np.isfinite(self.passes_s)
        return np.where(passed, self.passes_s, 0.0) - np.where(passed, self.works_s, 0.0)


class Waits(Protocol):
    """What the robot waits for in N cycles, and what others do once they know what it did."""

    @property
    def gated(self) -> Bools:
        """At the end of which legs it may have to wait, shape (orders, legs)."""

    def departures(self, rows: Ints, legs: Ints, since_s: Vector, /) -> tuple[Vector, Ints]:
        """Return when these rows may depart from these legs, s (inf: not known yet), and the cause that decides it."""

    def arrived(self, rows: Ints, legs: Ints, at_s: Vector, /) -> None:
        """Hear that these rows have come to the end of these legs."""

    def departed(self, rows: Ints, legs: Ints, at_s: Vector, /) -> None:
        """Hear that these rows have departed from these legs."""

    def settle(self, rows: Ints, /) -> None:
        """Advance all others in these rows as far as is known."""


class Presence(Protocol):
    """Where the people of N cycles are.

    Attributes:
        activities: Names of what they may be at.
    """

    activities: tuple[str, ...]

    def at(self, t_s: float, line: RobotLine, gone: Vector, /) -> tuple[Floats, Ints]:
        """Return positions (N, 3), m, or states (N, D), of the rows under way, and at what people are (N,).

        Args:
            t_s: Time since the start of the cycle.
            line: The robot in all rows.
            gone: Which part of its way each row has gone, shape (N,).
        """


class RobotLine:
    """The robot in N cycles: its leg, its progress on it, and what it waits for.

    `times` has a row for every cycle; all other arrays have one per cycle that has not ended. `waits` is what it waits
    for; None: nothing.
    """

    def __init__(
        self,
        orders: Sequence[Sequence[tuple[Floats, float]]],
        which: Ints,
        own_s: Floats,
        step_s: float,
        waits: Waits | None = None,
    ) -> None:
        """Place all rows at their start.

        Args:
            orders: Per order its legs: the positions along the way, shape (K, 3), m, and its duration at scaling 1, s.
            which: Order of each row, shape (N,).
            own_s: Time of own work at the end of each leg, shape (N, legs), s.
            step_s: Time step, s.
            waits: What it waits for; None: nothing.
        """
        legs = max(map(len, orders))
        self._rows, self._first = np.ones((2, len(orders), legs), dtype=np.int64)
        self._way_s = np.zeros((len(orders), legs))
        begins: dict[int, int] = {}  # a way of several legs is stored once
        paths, begin = [], 0
        for number, order in enumerate(orders):
            for leg, (path_m, way_s) in enumerate(order):
                if id(path_m) not in begins:
                    begins[id(path_m)] = begin
                    paths.append(path_m)
                    begin += len(path_m)
                self._rows[number, leg], self._first[number, leg] = len(path_m), begins[id(path_m)]
                self._way_s[number, leg] = way_s
        self._xyz_m = np.concatenate(paths)
        self._which, self._own_s, self._step_s, self.waits = which, own_s, step_s, waits
        self._last = np.array([len(order) - 1 for order in orders])
        self._gated = waits.gated if waits is not None else np.zeros((len(orders), legs), dtype=np.bool_)
        self.times = LegTimes(len(which), legs)
        self.row = np.arange(len(which))
        self.part, self.leg = np.zeros((2, len(which)), dtype=np.int64)
        self._at, self._clock = np.zeros((2, len(which)))
        self._end = self._way_s[which, 0]

    @property
    def may_move(self) -> Bools:
        """Which rows may move at some time of the next step."""
        soon = (self.part == WORKS) & (self._end - self._at < self._step_s)
        return np.asarray((self.part == MOVES) | soon | (self.part == WAITS))

    @cached_property
    def ends(self) -> Ints:
        """Number of the last leg of each cycle, shape (cycles,)."""
        return np.asarray(self._last[self._which])

    def keep(self, going: Bools) -> None:
        """Drop all other rows."""
        for name in ("row", "part", "leg", "_at", "_clock", "_end"):
            setattr(self, name, getattr(self, name)[going])

    def gone(self, ahead_s: Vector) -> Vector:
        """Return which part of its way each row will have gone then, shape (N,)."""
        part = np.minimum(self._at + ahead_s, self._end) / np.maximum(self._end, 1e-9)
        return np.where(self.part == MOVES, part, 1.0)

    def where(self, gone: Vector) -> Floats:
        """Return the TCP (N, 3) of the rows at these parts of their ways."""
        order = self._which[self.row]
        last = self._rows[order, self.leg] - 1
        return self._xyz_m.take(self._first[order, self.leg] + (gone * last + 0.5).astype(np.int64), axis=0)

    @property
    def stuck(self) -> Bools:
        """Which rows wait for what never comes."""
        stuck = np.zeros(len(self.row), dtype=np.bool_)
        if self.waits is not None and len(waits := np.flatnonzero(self.part == WAITS)):
            due_s, _ = self.waits.departures(self.row[waits], self.leg[waits], np.zeros(len(waits)))
            stuck[waits] = ~np.isfinite(due_s)
        return stuck

    def advance(self, scaling: Vector, until_s: float) -> tuple[Vector, Ints]:
        """Advance to a time; return the safety loss of each row in it (N,), s, and the rows that began a new part."""
        lost = np.zeros(len(scaling))
        touched: list[Ints] = []
        some: slice | Ints = slice(None)  # first all rows, then those with time left
        while True:
            part, clock, at = self.part[some], self._clock[some], self._at[some]
            moves, to_go = part == MOVES, self._end[some] - at
            rate = np.where(moves, scaling[some], 1.0)
            takes = np.where(to_go <= 1e-9, 0.0, to_go / np.maximum(rate, 1e-12))
            decided, left = np.full(len(part), OWN), until_s - clock
            stays = np.zeros(len(part), dtype=np.bool_)
            if self.waits is not None and (stays := part == WAITS).any():
                row, leg = self.row[some][stays], self.leg[some][stays]
                open_s, decided[stays] = self.waits.departures(row, leg, clock[stays])
                takes[stays] = open_s - clock[stays]
            done = np.asarray(takes <= left)
            spent = np.where(stays & ~done, 0.0, np.minimum(takes, left))
            self._clock[some] = clock + spent
            self._at[some] = np.where(stays, 0.0, at + rate * spent)
            loss = np.where(moves, (1.0 - rate) * spent, 0.0)
            self.times.lost_s[self.row[some], self.leg[some]] += loss
            lost[some] += loss
            ended = np.flatnonzero(done) if isinstance(some, slice) else some[done]
            if not len(ended):
                break
            self._next(ended, decided[done])
            touched.append(self.row[ended])
            some = left_over = ended[self.part[ended] != ENDED]
            if not len(left_over):
                break
        return lost, np.unique(np.concatenate(touched)) if len(touched) > 1 else [*touched, self.row[:0]][0]

    def _next(self, some: Ints, decided: Ints) -> None:
        """Start the next part of rows that have ended a way, own work or a wait."""
        row, leg, part, clock = self.row[some], self.leg[some], self.part[some], self._clock[some]
        order = self._which[row]
        arrives, works = part == MOVES, part == WORKS
        goes = (part == WAITS) | (works & ~self._gated[order, leg])
        self.times.arrives_s[row[arrives], leg[arrives]] = clock[arrives]
        self.times.works_s[row[works], leg[works]] = clock[works]
        self.times.passes_s[row[goes], leg[goes]] = clock[goes]
        self.times.decided[row[goes], leg[goes]] = decided[goes]
        if self.waits is not None:
            self.waits.arrived(row[arrives], leg[arrives], clock[arrives])
            self.waits.departed(row[goes], leg[goes], clock[goes])
        ends = goes & (leg >= self._last[order])
        leg = np.where(goes & ~ends, leg + 1, leg)
        self.leg[some], self._at[some] = leg, 0.0
        self.part[some] = np.where(ends, ENDED, np.where(goes, MOVES, part + 1))
        self._end[some] = np.where(arrives, self._own_s[row, leg], self._way_s[order, leg])


@dataclass(frozen=True)
class SimulatedCycles:
    """N simulated cycles of the robot.

    Attributes:
        robot: Times of its legs.
        duration_s: When it departs from its last leg, shape (N,); inf if it does not within the simulated time.
        activity_s: Safety loss by what people are at, shape (N, activities + 1); the last = unknown.
        known, looked: Number of support evaluations in logged positions, and of all, shape (N,).
        own_loss_s: Safety loss before `known_until_s`, shape (N,).
        stuck: Rows that end in a deadlock, shape (N,).
    """

    robot: LegTimes
    duration_s: Vector
    activity_s: Floats
    known: Vector
    looked: Vector
    own_loss_s: Vector
    stuck: Bools


def simulate_robot(
    model: SafetyModel,
    line: RobotLine,
    people: Presence,
    *,
    steps: int,
    step_s: float,
    dynamics: Dynamics = AT_ONCE,
    support: Logged | None = None,
    often: bool = False,
    start: Vector | None = None,
    known_until_s: Vector | None = None,
) -> SimulatedCycles:
    """Simulate N cycles to their ends.

    Args:
        model: The safety function.
        line: The robot in all cycles, at its start.
        people: Where people are.
        steps: Number of steps; cycles that have not ended by then are abandoned.
        step_s: Time step, s.
        dynamics: Response of s to the safety function.
        support: Test for logged positions; None leaves `known` and `looked` at 0.
        often: Evaluate the safety function in every step, however slow it is.
        start: s at the start of each cycle, shape (N,); None: as commanded.
        known_until_s: Until when the people of each cycle are those of one log, shape (N,), s; None: always.
    """
    waits = line.waits
    follower = None if at_once(model, dynamics) else Follower(model, dynamics, step_s, start)
    asks_after = 1 if often or is_fast(model) else round(TIME_STEP_S / step_s)
    looks_after = round(SUPPORT_EVERY_S / step_s)
    count, kinds = len(line.row), len(people.activities) + 1
    activity_s, stuck = np.zeros(count * kinds), np.zeros(count, dtype=np.bool_)
    known, looked, own_loss_s = np.zeros((3, count))
    scaling, doing = np.ones(count), np.zeros(count, dtype=np.int64)
    if waits is not None:
        waits.settle(line.row)
    for number in range(steps):
        if number % asks_after == 0:
            t_s = (number + asks_after / 2) * step_s
            gone = line.gone(scaling * asks_after * step_s / 2)
            tcp = line.where(gone)
            human, doing = people.at(t_s, line, gone)
            scaling = scaling_in_step(model, follower, line, tcp, human)
            if support is not None and number % looks_after == 0:
                known[line.row] += support.near_logged(tcp, human)
                looked[line.row] += 1
        elif follower is not None:
            scaling = follower.go_on()
        lost, touched = line.advance(scaling, (number + 1) * step_s)
        activity_s[line.row * kinds + doing] += lost
        own_loss_s[line.row] += lost if known_until_s is None else lost * (t_s < known_until_s[line.row])
        ended = line.part == ENDED
        if waits is not None:
            if len(touched):
                waits.settle(touched)
            stuck[line.row] = is_stuck = line.stuck
            ended |= is_stuck
        if ended.any():
            scaling, doing = scaling[~ended], doing[~ended]
            line.keep(~ended)
            if follower is not None:
                follower.keep(~ended)
            if not len(line.row):
                break
    duration_s = line.times.passes_s[np.arange(count), line.ends]
    return SimulatedCycles(line.times, duration_s, activity_s.reshape(count, kinds), known, looked, own_loss_s, stuck)
