"""Simulation of cycles of both agents: an agent departs once its own work and its waits are over.

The robot is that of `estimate.cycle.engine`. The operator and sources of parts are not slowed: their departure is
computed as soon as the events they wait for are known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.cycle.engine import FINE_STEP_S, OWN, LegTimes, RobotLine, SimulatedCycles, simulate_robot
from cyclekit.estimate.joint.draws import NEVER

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.estimate.cycle.engine import Presence
    from cyclekit.estimate.joint.draws import CycleDraws
    from cyclekit.estimate.robot.safety import Dynamics, Logged, SafetyModel
    from cyclekit.schema import Bools, Floats, Ints, Vector

PLANNED = -2
"""Cause of departure: the earliest start in the plan."""


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
        self.draws, self.times, self._events_s = draws, LegTimes(*draws.own_s.shape), events_s
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


def advance_unslowed(others: Sequence[UnslowedAgent], rows: Ints) -> None:
    """Advance the agents that are never slowed as far as known, until no event of one lets another depart."""
    while len(rows):
        moved = [other.go_on(rows) for other in others]
        rows = np.unique(np.concatenate(moved)) if len(others) > 1 else rows[:0]


class RobotWaits:
    """What the robot waits for in N cycles: events of the others, who go on once they know what it did."""

    def __init__(self, draws: CycleDraws, events_s: Floats, others: Sequence[UnslowedAgent]) -> None:
        """Take the robot's draws, the event times, and all agents that are never slowed."""
        self._draws, self._events_s, self._others = draws, events_s, others
        self.gated = (draws.needs != draws.unneeded).any(axis=2) | (draws.not_before_s > 0.0)

    def departures(self, rows: Ints, legs: Ints, since_s: Vector, /) -> tuple[Vector, Ints]:
        """Return when these rows may depart from these legs, s, and the cause that decides it."""
        return departures(self._draws, self._events_s, rows, legs, since_s)

    def arrived(self, rows: Ints, legs: Ints, at_s: Vector, /) -> None:
        """Set the events of an arrival."""
        self._events_s[rows[:, None], self._draws.arrives[self._draws.which[rows], legs]] = at_s[:, None]

    def departed(self, rows: Ints, legs: Ints, at_s: Vector, /) -> None:
        """Set the events of a departure."""
        self._events_s[rows[:, None], self._draws.passes[self._draws.which[rows], legs]] = at_s[:, None]

    def settle(self, rows: Ints, /) -> None:
        """Advance all others in these rows as far as is known."""
        advance_unslowed(self._others, rows)


@dataclass(frozen=True)
class JointCycles(SimulatedCycles):
    """N cycles of both agents.

    Attributes:
        operator: Times of the operator's legs.
        activities: Names of the operator's places.
        events_s: Time of each event, shape (N, columns).
    """

    operator: LegTimes
    activities: tuple[str, ...]
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
    others = [UnslowedAgent(draws, events_s) for draws in (operator, *sources)]
    people = people_of(others[0])
    orders = [[(leg.path_m, leg.way_s) for leg in agenda.legs] for agenda in robot.agendas]
    line = RobotLine(orders, robot.which, robot.own_s, FINE_STEP_S, RobotWaits(robot, events_s, others))
    simulated = simulate_robot(
        model,
        line,
        people,
        steps=int(until_s / FINE_STEP_S),
        step_s=FINE_STEP_S,
        dynamics=dynamics,
        support=support,
    )
    return JointCycles(**vars(simulated), operator=others[0].times, activities=people.activities, events_s=events_s)
