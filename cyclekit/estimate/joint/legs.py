"""The legs of each agent in a plan: a way, own work at its end, and the events needed before departure.

A leg of the robot is a nominal motion, one of the operator a walk. A gate before a task or midway becomes a leg without
a way or without work.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.config.sequences import NOT_ITSELF
from cyclekit.dataset.cards import CouplingCard
from cyclekit.errors import EstimateError, UnknownName

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from cyclekit.config.sequences import PlannedTask
    from cyclekit.dataset.cards import ConditionCard, GateCard, TripCard
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.schema import Floats, Vector

Event = tuple[str, str, str, int]
"""Agent, place or task, kind (`arrives`, `leaves`, `set`, `cleared` or `done`), and occurrence number from 0."""
NONE = np.zeros(1)


@dataclass(frozen=True, eq=False)
class Need:
    """An event that must have occurred.

    Attributes:
        event: The event.
        lag_s: Quantiles of the lag from the event to departure, s.
        needed: Probability that it is needed.
        together: Group: needs of one group are needed in the same passages; 0 = independent.
        passage: Number of the passage.
        common: Correlation of the lag with what the operator's works share in a cycle.
    """

    event: Event
    lag_s: Vector = field(default_factory=lambda: NONE)
    needed: float = 1.0
    together: int = 0
    passage: int = 0
    common: float = 0.0


@dataclass(frozen=True, eq=False)
class AgendaLeg:
    """A way, own work at its end, and the events needed before departure.

    Attributes:
        task: Number of the agent's task; -1 = before the first task.
        place: Place at its end.
        path_m: Robot positions along the way, shape (K, 3); empty for the operator.
        way_s: Duration of the robot's way at scaling 1.
        start: Place where the operator's walk begins, empty at the start of an execution; None = no walk.
        own_s: Quantiles of the time of own work at its end, s.
        name: Key of the draws of own work and lags: the same in every plan.
        needs: Events needed before departure.
        not_before_s: Earliest departure, from the start of the cycle; -inf = a part may have come before it.
        arrives, passes: Events set at the end of the way, and at departure.
        hold: Whether it is a wait before the task begins.
        trip: Trips that the operator makes before departure, mostly while he waits.
        if_waits: Whether he goes there only if he has to wait; otherwise straight to the place of the next leg.
    """

    task: int
    place: str
    path_m: Floats
    way_s: float = 0.0
    start: str | None = None
    own_s: Vector = field(default_factory=lambda: NONE)
    name: str = ""
    needs: tuple[Need, ...] = ()
    not_before_s: float = 0.0
    arrives: tuple[Event, ...] = ()
    passes: tuple[Event, ...] = ()
    hold: bool = False
    trip: TripCard | None = None
    if_waits: bool = False


@dataclass(frozen=True, eq=False)
class Agenda:
    """All legs of one agent in a plan; the first is the initial position.

    Attributes:
        agent: `robot` or `operator`.
        legs: The legs, in order.
        tasks: Names of the tasks.
    """

    agent: str
    legs: tuple[AgendaLeg, ...]
    tasks: tuple[str, ...]

    @property
    def events(self) -> list[tuple[Event, int]]:
        """The events that it sets, each with the number of its task."""
        return [(event, leg.task) for leg in self.legs for event in (*leg.arrives, *leg.passes)]

    @cached_property
    def alone_s(self) -> float:
        """How long it takes at most if nothing disturbs the agent, s: 5 s for each walk."""
        return sum(max(float(np.max(leg.own_s)), 0.0) + leg.way_s + 5.0 for leg in self.legs)


class Gates:
    """The gates of a cell by agent and place: points where an agent may have to wait."""

    def __init__(self, coupling: CouplingCard | None, as_logged: CouplingCard | None = None) -> None:
        """Store the gates, and those of the logs if they were changed since; None = no gates."""
        self._gates = {(gate.agent, gate.at, gate.place): gate for gate in (coupling.gates if coupling else ())}
        self._logged = (as_logged or coupling or CouplingCard()).gates

    def at(self, agent: str, at: str, place: str) -> GateCard | None:
        """Return a gate, or None."""
        return self._gates.get((agent, at, place))  # type: ignore[arg-type]

    def needs(self, agent: str, at: str, place: str, turn: int) -> tuple[Need, ...]:
        """Return the needs of passage number `turn` of a gate."""
        gate = self.at(agent, at, place)
        return needs_of(gate.conditions if gate else (), turn)

    def waits(self, agent: str) -> bool:
        """Return whether an agent ever waited in the logs; if so, its stays there are longer than its work."""
        return any(gate.conditions for gate in self._logged if gate.agent == agent)

    def own_s(self, agent: str, place: str) -> Vector | None:
        """Return the quantiles of an agent's own work at a place, if learned."""
        gate = self.at(agent, "leave", place)
        return np.array(gate.own_s) if gate is not None and max(gate.own_s) > 0.0 else None

    def own_by_s(self, place: str, before: str | None, after: str | None) -> Vector | None:
        """Return the quantiles of the operator's own work at a place by the places around it, if it differs by them."""
        gate = self.at("operator", "leave", place)
        around = {("before", before), ("next", after)}
        return (
            next((np.array(one.own_s) for one in gate.own_by if (one.side, one.place) in around), None)
            if gate
            else None
        )


def needs_of(conditions: Iterable[ConditionCard], turn: int) -> tuple[Need, ...]:
    """Return what the passage number `turn` needs of these conditions."""
    return tuple(
        Need(
            (one.agent, one.place, event_kind(one), number),
            np.array(one.lag_s),
            one.needed,
            one.together,
            turn // one.turns.every,
            one.common,
        )
        for one in conditions
        if (number := one.turns.event(turn, one.back)) is not None
    )


def event_kind(condition: ConditionCard) -> str:
    """Return the kind of event; a signal set at a place means done there, even if its agent has to stay."""
    given = condition.signal is not None and condition.event == "leaves"
    return "set" if given else condition.event


def precedence_needs(tasks: Sequence[PlannedTask], where: str) -> dict[int, tuple[Need, ...]]:
    """Return the tasks that each task of a plan must follow (`after`), as needs by number in the plan.

    Raises:
        UnknownName: A task in `after` is not in the plan.
        EstimateError: It is the task itself.
    """
    turns: Counter[tuple[str, str]] = Counter()
    count = Counter((task.agent, task.name) for task in tasks)
    found = {}
    for number, task in enumerate(tasks):
        nth = turns[task.agent, task.name]
        turns[task.agent, task.name] += 1
        needs = []
        for earlier in task.after:
            able = [key for key in count if key[1] == earlier and key != (task.agent, task.name)]
            if not able and earlier == task.name:
                raise EstimateError(f"{where}: {task.shown}: after names the task itself", cure=NOT_ITSELF)
            if not able:
                raise UnknownName(f"{where}: {task.shown}", "task", earlier, {each.name for each in tasks})
            needs += [Need((key[0], earlier, "done", min(nth, count[key] - 1))) for key in able]
        found[number] = tuple(needs)
    return found


class _Builder:
    """Builds the legs of one agent, one after the other."""

    def __init__(self, agent: str, start: str, at_m: Floats, gates: Gates, planned: Collection[str] = ()) -> None:
        self.agent, self._gates, self._planned = agent, gates, planned
        self.legs = [AgendaLeg(-1, start, at_m)]
        self._visits: Counter[str] = Counter({start: 1} if start else {})
        self._done: Counter[str] = Counter()

    def go(
        self,
        task: int,
        name: str,
        leg: AgendaLeg,
        precedence: tuple[Need, ...],
        not_before_s: float,
        split: Callable[[AgendaLeg, tuple[Need, ...], float], list[AgendaLeg]] | None = None,
    ) -> None:
        """Add a task: wait before its start if needed, way, wait midway if needed, own work at its end."""
        here, place = self.legs[-1].place, leg.place
        turn = self._visits[place]
        gate = self._gates.at(self.agent, "approach", place)
        approach = self._gates.needs(self.agent, "approach", place, turn)
        phase = gate.phase if gate is not None else 0.0
        midway = approach if split is not None and phase > 0.0 else ()
        needs = (*precedence, *(() if midway else approach))
        spot = gate.waits_at(here) if gate is not None and approach else None
        stays = spot is None and not (self.agent == "operator" and here == place)  # else he leaves before he waits
        if not stays:
            self._left(here)
        if spot is not None:
            leg = replace(leg, start=spot)
            hold = AgendaLeg(task, spot, leg.path_m, start=here, needs=needs, not_before_s=not_before_s)
            self.legs.append(replace(hold, name=f"hold {place}", hold=True, if_waits=True))
        elif needs or not_before_s > 0.0:
            if gate is not None and gate.trip is not None:  # no second trip before it leaves here
                self.legs[-1] = replace(self.legs[-1], trip=None)
            hold = AgendaLeg(task, here, self.legs[-1].path_m[-1:], needs=needs, not_before_s=not_before_s)
            self.legs.append(replace(hold, name=f"hold {place}", hold=True, trip=self._trip(gate)))
        if stays:
            self._left(here)
        leave = self._gates.needs(self.agent, "leave", place, turn)
        done = (self.agent, name, "done", self._done[name]), (self.agent, place, "set", turn)
        trip = self._trip(self._gates.at(self.agent, "leave", place))
        arrives = ((self.agent, place, "arrives", turn),)
        last = replace(leg, task=task, needs=leave, arrives=arrives, passes=done, trip=trip)
        self.legs += split(last, midway, phase) if split is not None and midway else [last]
        self._visits[place] += 1
        self._done[name] += 1

    def agenda(self, tasks: Sequence[str]) -> Agenda:
        """Return the agenda of all legs; the agent leaves the last place at the end."""
        here = self.legs[-1].place
        self._passes((self.agent, here, "leaves", self._visits[here] - 1))
        return Agenda(self.agent, tuple(self.legs), tuple(tasks))

    def _left(self, here: str) -> None:
        """Set the events of leaving a place at the end of the last leg."""
        if here:
            self._passes((self.agent, here, "leaves", self._visits[here] - 1))
            self._passes((self.agent, here, "cleared", self._visits[here] - 1))

    def _trip(self, gate: GateCard | None) -> TripCard | None:
        """Return the trips from a gate; none to places that the plan goes to anyway."""
        trip = gate.trip if gate is not None else None
        return None if trip is None or set(trip.places) & set(self._planned) else trip

    def _passes(self, event: Event) -> None:
        self.legs[-1] = replace(self.legs[-1], passes=(*self.legs[-1].passes, event))


def robot_agenda(
    tasks: Sequence[NominalTask],
    gates: Gates,
    *,
    names: Sequence[str] | None = None,
    precedence: Mapping[int, tuple[Need, ...]] | None = None,
    not_before_s: Sequence[float] | None = None,
) -> Agenda:
    """Return the legs of a robot with consecutive tasks.

    Args:
        tasks: The tasks, in order.
        gates: Gates of the cell.
        names: Names of the tasks in the plan; None: `start->goal`.
        precedence: Tasks that each must follow (`after`), by number.
        not_before_s: Earliest start of each task.
    """
    start = tasks[0].task.partition("->")[0]
    builder = _Builder("robot", start, tasks[0].xyz_m[:1], gates)
    for number, task in enumerate(tasks):
        place = task.task.partition("->")[2]
        own = gates.own_s("robot", place)
        leg = AgendaLeg(number, place, task.xyz_m, task.nominal_s, own_s=task.standstill_s if own is None else own)
        name = names[number] if names else task.task
        leg = replace(leg, name=task.task)
        earliest = not_before_s[number] if not_before_s else 0.0
        builder.go(number, name, leg, (precedence or {}).get(number, ()), earliest, _split)
    return builder.agenda([task.task for task in tasks])


def _split(leg: AgendaLeg, needs: tuple[Need, ...], phase: float) -> list[AgendaLeg]:
    """Split a leg of the robot at fraction `phase` of its nominal motion, with a wait there."""
    row = min(max(1, round(phase * (len(leg.path_m) - 1))), len(leg.path_m) - 1)
    before, name = leg.path_m[: row + 1], f"approach {leg.place}"
    first = AgendaLeg(leg.task, leg.place, before, phase * leg.way_s, name=name, needs=needs)
    return [first, replace(leg, path_m=leg.path_m[row:], way_s=(1.0 - phase) * leg.way_s)]


def operator_agenda(
    places: Sequence[str],
    gates: Gates,
    work_s: Mapping[str, Vector],
    first_stays_s: Mapping[str, Vector],
    *,
    precedence: Mapping[int, tuple[Need, ...]] | None = None,
    not_before_s: Sequence[float] | None = None,
    begun: bool = True,
) -> Agenda:
    """Return the legs of an operator who visits places one after the other.

    Args:
        places: The places, in order.
        gates: Gates of the cell.
        work_s: Quantiles of stays at each place, which are work if he never waits.
        first_stays_s: Quantiles of stays at the start of an execution; where he is at no other time he has no work.
        precedence: Tasks that each must follow (`after`), by number.
        not_before_s: Earliest start of each task.
        begun: Whether he has begun his work at the first place before the cycle begins, as in the logs.
    """
    builder = _Builder("operator", "", np.empty((0, 3)), gates, places)
    for number, place in enumerate(places):
        worked = place in work_s or place not in first_stays_s  # the end of each of few stays may be unlogged
        own = gates.own_s("operator", place) if gates.waits("operator") and worked else None
        own = work_s.get(place, NONE) if own is None else own
        before = places[number - 1] if number else "" if begun else None
        around = before, places[number + 1] if number + 1 < len(places) else None
        by_place = gates.own_by_s(place, *around) if worked else None
        own = own if by_place is None else by_place
        own = first_stays_s.get(place, own) if number == 0 and place not in work_s else own
        leg = AgendaLeg(number, place, np.empty((0, 3)), start=builder.legs[-1].place, own_s=own, name=place)
        earliest = not_before_s[number] if not_before_s else 0.0
        builder.go(number, place, leg, (precedence or {}).get(number, ()), earliest)
    return builder.agenda(places)
