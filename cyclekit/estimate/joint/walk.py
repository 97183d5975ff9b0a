"""Simulation of cycles of both agents step by step: an agent departs once its own work and its waits are over.

The robot advances as in `estimate.cycle.walk`, at the scaling of the safety function for the operator's position. The
operator and sources of parts are not slowed: their departure is computed as soon as the events they wait for are known.
Event times are exact within a step: an agent that waited uses the rest of the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from cyclekit.estimate.cycle.walk import FINE_STEP_S, SUPPORT_EVERY_S, TIME_STEP_S
from cyclekit.estimate.joint.draws import NEVER
from cyclekit.estimate.robot.safety import Dynamics, Follower, SafetyModel, at_once, is_fast, scaling_in_step

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.estimate.joint.draws import CycleDraws
    from cyclekit.estimate.robot.safety import Logged
    from cyclekit.schema import Bools, Floats, Ints, Vector

OWN, PLANNED = -1, -2
"""Causes of departure other than an event: own work, or the earliest start in the plan."""
MOVES, WORKS, WAITS, ENDED = range(4)


class LegTimes:
    """Times of arrival, end of own work and departure for each leg of one agent: shape (rows, legs) each, s.

    Attributes:
        decided: Column of the event that decided departure, or OWN or PLANNED.
        lost_s: Safety loss of the leg.
        trips: Whether the operator made a trip before departure.
    """

    def __init__(self, draws: CycleDraws) -> None:
        """Create times of inf: nothing has occurred yet."""
        shape = draws.own_s.shape
        self.arrives_s, self.works_s, self.passes_s = (np.full(shape, np.inf) for _ in range(3))
        self.decided = np.full(shape, OWN)
        self.lost_s = np.zeros(shape)
        self.trips = np.zeros(shape, dtype=np.bool_)

    @property
    def waits_s(self) -> Floats:
        """Wait at the end of each leg, shape (rows, legs), s."""
        passed = np.isfinite(self.passes_s)
        return np.where(passed, self.passes_s, 0.0) - np.where(passed, self.works_s, 0.0)


def departures(draws: CycleDraws, events_s: Floats, rows: Ints, legs: Ints, works_s: Vector) -> tuple[Vector, Ints]:
    """Return when these rows may depart from these legs, s (inf: not known yet), and the cause that decides it."""
    agenda = draws.which[rows]
    columns = draws.needs[agenda, legs]
    lag_s = draws.lag_s[rows, legs]
    due = np.where(lag_s == NEVER, NEVER, events_s[rows[:, None], columns]) + lag_s
    latest = due.argmax(axis=1)
    each = np.arange(len(rows))
    planned = draws.not_before_s[agenda, legs]
    own = np.maximum(works_s, planned)
    needed = due[each, latest]
    decided = np.where(needed > own, columns[each, latest], np.where(planned > works_s, PLANNED, OWN))
    return np.maximum(own, needed), decided


class UnslowedAgent:
    """An agent that is never slowed: the operator, or a source of parts."""

    def __init__(self, draws: CycleDraws, events_s: Floats) -> None:
        """Start all rows."""
        self.draws, self.times, self._events_s = draws, LegTimes(draws), events_s
        self.leg = np.zeros(len(draws.which), dtype=np.int64)
        self.ended = np.zeros(len(draws.which), dtype=np.bool_)
        self._arrive(np.arange(len(draws.which)), np.zeros(len(draws.which)))

    def go_on(self, rows: Ints) -> Ints:
        """Compute all departures of these rows that are known now; return the rows that departed or ended."""
        rows = moved = rows[~self.ended[rows]]
        first = self.leg[rows].copy()
        while len(rows):
            legs = self.leg[rows]
            open_s, decided = departures(self.draws, self._events_s, rows, legs, self.times.works_s[rows, legs])
            known = np.isfinite(open_s)
            rows, legs, open_s = rows[known], legs[known], open_s[known]
            if self.draws.trips:
                open_s = self._after_trips(rows, legs, open_s)
            if self.draws.if_waits.any():
                open_s = self._straight(rows, legs, open_s)
            self.times.passes_s[rows, legs], self.times.decided[rows, legs] = open_s, decided[known]
            agenda = self.draws.which[rows]
            self._events_s[rows[:, None], self.draws.passes[agenda, legs]] = open_s[:, None]
            last = legs >= self.draws.last[agenda]
            self.ended[rows[last]] = True
            rows, open_s = rows[~last], open_s[~last]
            self.leg[rows] += 1
            self._arrive(rows, open_s)
        return moved[(self.leg[moved] > first) | self.ended[moved]]

    def _straight(self, rows: Ints, legs: Ints, open_s: Vector) -> Vector:
        """Return when these rows depart from these legs, s.

        Where the operator goes only if he has to wait, one who need not as he leaves the leg before goes straight on.
        """
        draws = self.draws
        some = np.flatnonzero(draws.if_waits[draws.which[rows], legs])
        row, leg = rows[some], legs[some]
        ready_s = self.times.passes_s[row, leg - 1]
        goes = departures(draws, self._events_s, row, leg, ready_s)[0] <= ready_s
        some, row, leg, ready_s = some[goes], row[goes], leg[goes], ready_s[goes]
        open_s[some] = ready_s
        self.times.arrives_s[row, leg] = self.times.works_s[row, leg] = ready_s
        draws.walk[row, leg + 1], draws.walk_s[row, leg + 1] = (
            draws.straight[row, leg + 1],
            draws.straight_s[row, leg + 1],
        )
        return open_s

    def _after_trips(self, rows: Ints, legs: Ints, open_s: Vector) -> Vector:
        """Return when these rows may depart from these legs after the trips that they make, s."""
        draws, works_s = self.draws, self.times.works_s[rows, legs]
        agenda = draws.which[rows]
        events_s = np.where(
            draws.lag_s[rows, legs] == NEVER, NEVER, self._events_s[rows[:, None], draws.needs[agenda, legs]]
        )
        late_s = (events_s + draws.soonest_s[agenda, legs]).max(axis=1) - works_s
        goes = np.where(late_s > 0.0, draws.trips_waiting[rows, legs], draws.trips_free[rows, legs])
        self.times.trips[rows, legs] = goes
        kind, level = draws.trip_kind[agenda, legs], draws.trip_level[rows, legs]
        for number, times in enumerate(draws.trips.values()):
            mine = np.flatnonzero(goes & (kind == number))
            open_s[mine] = np.maximum(open_s[mine], works_s[mine] + times.took_s(late_s[mine], level[mine]))
        return open_s

    def on_trip(self, t_s: float, rows: Ints, legs: Ints) -> Bools:
        """Return which of these rows, not yet departed from these legs, are on a trip or back from one, shape (N,)."""
        departs = np.isfinite(self.times.passes_s[rows, legs])  # known; otherwise he waits
        goes = np.where(departs, self.times.trips[rows, legs], self.draws.trips_waiting[rows, legs])
        return np.asarray(goes & (t_s >= self.times.works_s[rows, legs]))

    def _arrive(self, rows: Ints, departs_s: Vector) -> None:
        legs = self.leg[rows]
        arrives = departs_s + self.draws.walk_s[rows, legs]
        self.times.arrives_s[rows, legs] = arrives
        self.times.works_s[rows, legs] = arrives + self.draws.own_s[rows, legs]
        columns = self.draws.arrives[self.draws.which[rows], legs]
        self._events_s[rows[:, None], columns] = arrives[:, None]


class RobotLine:
    """The robot in N cycles: its leg, its progress on it, and what it waits for."""

    def __init__(self, draws: CycleDraws, events_s: Floats, step_s: float) -> None:
        """Place all rows at their start."""
        self.draws, self.times, self._events_s, self._step_s = draws, LegTimes(draws), events_s, step_s
        legs, count = draws.own_s.shape[1], len(draws.which)
        paths = [leg.path_m for agenda in draws.agendas for leg in agenda.legs]
        self._xyz_m = np.concatenate(paths)
        self._rows, self._first = np.ones((2, len(draws.agendas), legs), dtype=np.int64)
        self._way_s = np.zeros((len(draws.agendas), legs))
        begin = 0
        for a, agenda in enumerate(draws.agendas):
            for n, leg in enumerate(agenda.legs):
                self._rows[a, n], self._first[a, n], self._way_s[a, n] = len(leg.path_m), begin, leg.way_s
                begin += len(leg.path_m)
        self.row = np.arange(count)
        self.part = np.zeros(count, dtype=np.int64)
        self.leg = np.zeros(count, dtype=np.int64)
        self._at, self._clock = np.zeros(count), np.zeros(count)
        self._end = self._way_s[draws.which, 0]

    @property
    def may_move(self) -> Bools:
        """Which rows may move at some time of the next step."""
        soon = (self.part == WORKS) & (self._end - self._at < self._step_s)
        return np.asarray((self.part == MOVES) | soon | (self.part == WAITS))

    def keep(self, going: Bools) -> None:
        """Drop all other rows."""
        for name in ("row", "part", "leg", "_at", "_clock", "_end"):
            setattr(self, name, getattr(self, name)[going])

    def gone(self, ahead_s: Vector) -> Vector:
        """Return which part of its way each row will have gone then, shape (N,)."""
        part = np.minimum(self._at + ahead_s, self._end) / np.maximum(self._end, 1e-9)
        return np.where(self.part == MOVES, part, 1.0)

    def where(self, ahead_s: Vector) -> Floats:
        """Return the TCP (N, 3) of the rows after their motions have advanced by `ahead_s` (N,)."""
        agenda, gone = self.draws.which[self.row], self.gone(ahead_s)
        last = self._rows[agenda, self.leg] - 1
        return np.asarray(self._xyz_m[self._first[agenda, self.leg] + (gone * last + 0.5).astype(np.int64)])

    def advance(self, scaling: Vector, until_s: float) -> tuple[Vector, Ints]:
        """Advance to a time; return the safety loss of each row in it (N,), s, and the rows that began a new part."""
        lost, some = np.zeros(len(scaling)), np.flatnonzero(self.part != ENDED)
        touched: list[Ints] = []
        while len(some):
            row, leg, part, clock = self.row[some], self.leg[some], self.part[some], self._clock[some]
            moves, waits = part == MOVES, part == WAITS
            rate = np.where(moves, scaling[some], 1.0)
            to_go = self._end[some] - self._at[some]
            takes = np.where(to_go <= 1e-9, 0.0, to_go / np.maximum(rate, 1e-12))
            decided = np.full(len(some), OWN)
            if waits.any():
                open_s, decided[waits] = departures(self.draws, self._events_s, row[waits], leg[waits], clock[waits])
                takes[waits] = open_s - clock[waits]
            left = until_s - clock
            done = takes <= left
            spent = np.where(waits & ~done, 0.0, np.minimum(takes, left))
            self._clock[some] = clock = np.where(done & waits, clock + takes, clock + spent)
            self._at[some] += np.where(waits, 0.0, rate * spent)
            loss = np.where(moves, (1.0 - rate) * spent, 0.0)
            self.times.lost_s[row, leg] += loss
            lost[some] += loss
            some, decided = some[done], decided[done]
            if not len(some):
                break
            self._next(some, decided)
            touched.append(self.row[some])
            some = some[self.part[some] != ENDED]
        if len(touched) > 1:
            return lost, np.unique(np.concatenate(touched))
        return lost, touched[0] if touched else some[:0]

    def _next(self, some: Ints, decided: Ints) -> None:
        """Start the next part of rows that have ended a way, own work or a wait."""
        row, leg, part, clock = self.row[some], self.leg[some], self.part[some], self._clock[some]
        agenda = self.draws.which[row]
        for when, found in ((MOVES, self.times.arrives_s), (WORKS, self.times.works_s), (WAITS, self.times.passes_s)):
            mine = part == when
            found[row[mine], leg[mine]] = clock[mine]
        for when, columns in ((MOVES, self.draws.arrives), (WAITS, self.draws.passes)):
            mine = part == when
            self._events_s[row[mine, None], columns[agenda[mine], leg[mine]]] = clock[mine, None]
        goes = part == WAITS
        self.times.decided[row[goes], leg[goes]] = decided[goes]
        ends = goes & (leg >= self.draws.last[agenda])
        self._at[some] = 0.0
        self.part[some] = np.where(ends, ENDED, (part + 1) % ENDED)
        self.leg[some] = leg = np.where(goes & ~ends, leg + 1, leg)
        self._end[some] = np.where(part == MOVES, self.draws.own_s[row, leg], self._way_s[agenda, leg])


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


@dataclass(frozen=True)
class JointCycles:
    """N cycles of both agents.

    Attributes:
        robot, operator: Times of the legs of each agent.
        activity_s: Safety loss by the operator's place, shape (N, activities + 1); the last = unknown.
        activities: Names of the places.
        known, looked: Number of support evaluations in logged positions, and of all, shape (N,).
        stuck: Rows that end in a deadlock, shape (N,).
        events_s: Time of each event, shape (N, columns).
    """

    robot: LegTimes
    operator: LegTimes
    activity_s: Floats
    activities: tuple[str, ...]
    known: Vector
    looked: Vector
    stuck: Bools
    events_s: Floats


def simulate_both(
    model: SafetyModel,
    robot: CycleDraws,
    operator: CycleDraws,
    sources: Sequence[CycleDraws],
    events_s: Floats,
    people_of: Callable[[UnslowedAgent], Presence],
    *,
    until_s: float,
    support: Logged | None = None,
    dynamics: Dynamics,
) -> JointCycles:
    """Simulate N cycles to their ends.

    Args:
        model: The safety function.
        robot: Draws for the robot, N rows.
        operator: Draws for the operator.
        sources: Draws for sources of parts, N rows each.
        events_s: Event times from `EventColumns.times`; filled in place.
        people_of: Returns where people are, from what the operator does.
        until_s: Cycles that have not ended by then are abandoned: their remaining times are inf.
        support: Test for logged positions; None: `looked` stays 0.
        dynamics: Response of s to the safety function.
    """
    line = RobotLine(robot, events_s, FINE_STEP_S)
    others = [UnslowedAgent(draws, events_s) for draws in (operator, *sources)]
    people, count = people_of(others[0]), len(robot.which)
    follower = None if at_once(model, dynamics) else Follower(model, dynamics, FINE_STEP_S)
    asks_after = 1 if is_fast(model) else round(TIME_STEP_S / FINE_STEP_S)
    looks_after = round(SUPPORT_EVERY_S / FINE_STEP_S)
    activity_s = np.zeros((count, len(people.activities) + 1))
    known, looked, stuck = np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.bool_)
    scaling, human = np.ones(count), np.zeros((count, 3))
    doing = np.zeros(count, dtype=np.int64)
    advance_unslowed(others, np.arange(count))
    for number in range(int(until_s / FINE_STEP_S)):
        if number % asks_after == 0:
            ahead_s = scaling * asks_after * FINE_STEP_S / 2
            tcp = line.where(ahead_s)
            human, doing = people.at((number + asks_after / 2) * FINE_STEP_S, line, line.gone(ahead_s))
            scaling = scaling_in_step(model, follower, line, tcp, human)
            if support is not None and number % looks_after == 0:
                known[line.row] += support.near_logged(tcp, human)
                looked[line.row] += 1
        elif follower is not None:
            scaling = follower.go_on()
        lost, touched = line.advance(scaling, (number + 1) * FINE_STEP_S)
        activity_s[line.row, doing] += lost
        if len(touched):
            advance_unslowed(others, touched)
        stuck[line.row] = (line.part == WAITS) & ~np.isfinite(_due(line))
        ended = (line.part == ENDED) | stuck[line.row]
        if ended.any():
            going = ~ended
            scaling, doing = scaling[going], doing[going]
            line.keep(going)
            if follower is not None:
                follower.keep(going)
            if not len(line.row):
                break
    return JointCycles(line.times, others[0].times, activity_s, people.activities, known, looked, stuck, events_s)


def advance_unslowed(others: Sequence[UnslowedAgent], rows: Ints) -> None:
    """Advance the agents that are never slowed as far as known, until no event of one lets another depart."""
    while len(rows):
        moved = [other.go_on(rows) for other in others]
        rows = np.unique(np.concatenate(moved)) if len(others) > 1 else rows[:0]


def _due(line: RobotLine) -> Vector:
    """Return when each row may depart; 0 for rows that do not wait."""
    due, waits = np.zeros(len(line.row)), np.flatnonzero(line.part == WAITS)
    if len(waits):
        due[waits] = departures(line.draws, line._events_s, line.row[waits], line.leg[waits], np.zeros(len(waits)))[0]
    return due
