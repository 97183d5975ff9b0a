"""What each agent does in a plan, leg by leg: a way, own work at its end, and what must have happened to go on.

A leg of the robot is a nominal motion, one of the operator a walk. Where a gate comes before the own task begins, or
midway, a leg without way or without work stands for it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import UnknownName

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cyclekit.config.sequences import PlannedTask
    from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard
    from cyclekit.estimate.nominal import NominalTask
    from cyclekit.schema import Floats, Vector

Event = tuple[str, str, str, int]
"""Whose, where (or which task), `arrives`, `leaves`, `set`, `cleared` or `done`, and the how manieth from 0."""
NONE = np.zeros(1)


@dataclass(frozen=True, eq=False)
class Need:
    """An event that must have come.

    Attributes:
        event: Which.
        lag_s: Quantiles of the time from it to going on, s.
        needed: How often it is needed.
        together: Needs of one number are needed together in passages of one number; 0 = each by itself.
        passage: Number of the passage.
    """

    event: Event
    lag_s: Vector = field(default_factory=lambda: NONE)
    needed: float = 1.0
    together: int = 0
    passage: int = 0


@dataclass(frozen=True, eq=False)
class AgendaLeg:
    """A way, own work at its end, and what must have happened to go on.

    Attributes:
        task: Number of the task of this agent; -1 = what comes before the first.
        place: Where it ends.
        path_m: Positions along the way of the robot, shape (K, 3); of the operator empty.
        way_s: Duration of the way of the robot at scaling 1.
        start: Place where the operator's walk begins, empty at the start of an execution; None = there is no walk.
        own_s: Quantiles of the own work at its end, s.
        name: By which own work and lags are drawn: the same in every plan.
        needs: What must have happened to go on.
        not_before_s: Earliest time to go on, from the start of the cycle.
        arrives, passes: Events that it sets at the end of the way, and on going on.
        hold: It stands for a wait before the task begins.
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


@dataclass(frozen=True, eq=False)
class Agenda:
    """All legs of one agent in a plan; the first is where it stands before.

    Attributes:
        agent: `robot` or `operator`.
        legs: In order.
        tasks: What each task is called.
    """

    agent: str
    legs: tuple[AgendaLeg, ...]
    tasks: tuple[str, ...]

    @property
    def events(self) -> list[tuple[Event, int]]:
        """The events that it sets, each with the number of its task."""
        return [(event, leg.task) for leg in self.legs for event in (*leg.arrives, *leg.passes)]


class Gates:
    """The gates of a cell by agent and place."""

    def __init__(self, coupling: CouplingCard | None) -> None:
        """Take them from what was learned; None = there are none."""
        self._gates = {(gate.agent, gate.at, gate.place): gate for gate in (coupling.gates if coupling else ())}

    def at(self, agent: str, at: str, place: str) -> GateCard | None:
        """Return a gate, if there is one."""
        return self._gates.get((agent, at, place))  # type: ignore[arg-type]

    def needs(self, agent: str, at: str, place: str, turn: int) -> tuple[Need, ...]:
        """Return what the passage number `turn` of a gate needs."""
        gate = self.at(agent, at, place)
        return tuple(
            Need(
                (one.agent, one.place, event_kind(one), number),
                np.array(one.lag_s),
                one.needed,
                one.together,
                turn // one.turns.every,
            )
            for one in (gate.conditions if gate else ())
            if (number := one.turns.event(turn, one.back)) is not None
        )

    def waits(self, agent: str) -> bool:
        """Return whether an agent ever waits: a stay of it is then more than its work."""
        return any(gate.conditions for gate in self._gates.values() if gate.agent == agent)

    def own_s(self, agent: str, place: str) -> Vector | None:
        """Return the quantiles of an agent's own work at a place, where they were learned."""
        gate = self.at(agent, "leave", place)
        return np.array(gate.own_s) if gate is not None and max(gate.own_s) > 0.0 else None


def event_kind(condition: ConditionCard) -> str:
    """Return what must have come; who gives a signal at a place has done there, though he may have to stay."""
    given = condition.signal is not None and condition.event == "leaves"
    return "set" if given else condition.event


def told_needs(tasks: Sequence[PlannedTask], where: str) -> dict[int, tuple[Need, ...]]:
    """Return what each task of a plan is told to come after, by its number in the plan.

    Raises:
        UnknownName: A task that it shall come after is not in the plan.
    """
    turns: Counter[tuple[str, str]] = Counter()
    count = Counter((task.agent, task.name) for task in tasks)
    found = {}
    for number, task in enumerate(tasks):
        nth = turns[task.agent, task.name]
        turns[task.agent, task.name] += 1
        needs = []
        for told in task.after:
            able = [key for key in count if key[1] == told and key != (task.agent, task.name)]
            if not able:
                raise UnknownName(f"{where}: {task.shown}", "task", told, {each.name for each in tasks})
            needs += [Need((key[0], told, "done", min(nth, count[key] - 1))) for key in able]
        found[number] = tuple(needs)
    return found


class _Builder:
    """Legs of one agent, put one behind the other."""

    def __init__(self, agent: str, start: str, at_m: Floats, gates: Gates) -> None:
        self.agent, self._gates = agent, gates
        self.legs = [AgendaLeg(-1, start, at_m)]
        self._visits: Counter[str] = Counter({start: 1} if start else {})
        self._done: Counter[str] = Counter()

    def go(
        self,
        task: int,
        name: str,
        leg: AgendaLeg,
        told: tuple[Need, ...],
        not_before_s: float,
        split: Callable[[AgendaLeg, tuple[Need, ...], float], list[AgendaLeg]] | None = None,
    ) -> None:
        """Add a task: wait for its start if need be, go, wait midway if need be, do the own work at its end."""
        here, place = self.legs[-1].place, leg.place
        turn = self._visits[place]
        gate = self._gates.at(self.agent, "approach", place)
        approach = self._gates.needs(self.agent, "approach", place, turn)
        phase = gate.phase if gate is not None else 0.0
        midway = approach if split is not None and phase > 0.0 else ()
        needs = (*told, *(() if midway else approach))
        if needs or not_before_s > 0.0:
            hold = AgendaLeg(task, here, self.legs[-1].path_m[-1:], needs=needs, not_before_s=not_before_s)
            self.legs.append(replace(hold, name=f"hold {place}", hold=True))
        if here:
            self._passes((self.agent, here, "leaves", self._visits[here] - 1))
            self._passes((self.agent, here, "cleared", self._visits[here] - 1))
        leave = self._gates.needs(self.agent, "leave", place, turn)
        done = (self.agent, name, "done", self._done[name]), (self.agent, place, "set", turn)
        last = replace(leg, task=task, needs=leave, arrives=((self.agent, place, "arrives", turn),), passes=done)
        self.legs += split(last, midway, phase) if split is not None and midway else [last]
        self._visits[place] += 1
        self._done[name] += 1

    def agenda(self, tasks: Sequence[str]) -> Agenda:
        """Return all legs; the last place is left at the end."""
        here = self.legs[-1].place
        self._passes((self.agent, here, "leaves", self._visits[here] - 1))
        return Agenda(self.agent, tuple(self.legs), tuple(tasks))

    def _passes(self, event: Event) -> None:
        self.legs[-1] = replace(self.legs[-1], passes=(*self.legs[-1].passes, event))


def robot_agenda(
    tasks: Sequence[NominalTask],
    gates: Gates,
    *,
    names: Sequence[str] | None = None,
    told: Mapping[int, tuple[Need, ...]] | None = None,
    not_before_s: Sequence[float] | None = None,
) -> Agenda:
    """Return the legs of a robot that does chained tasks.

    Args:
        tasks: In order.
        gates: Of the cell.
        names: What a plan calls them; None: `start->goal`.
        told: What each of them shall come after, by number.
        not_before_s: Earliest start of each.
    """
    start = tasks[0].task.partition("->")[0]
    builder = _Builder("robot", start, tasks[0].xyz_m[:1], gates)
    for number, task in enumerate(tasks):
        place = task.task.partition("->")[2]
        own = gates.own_s("robot", place)
        leg = AgendaLeg(number, place, task.xyz_m, task.nominal_s, own_s=task.stands_s if own is None else own)
        name = names[number] if names else task.task
        leg = replace(leg, name=task.task)
        earliest = not_before_s[number] if not_before_s else 0.0
        builder.go(number, name, leg, (told or {}).get(number, ()), earliest, _split)
    return builder.agenda([task.task for task in tasks])


def _split(leg: AgendaLeg, needs: tuple[Need, ...], phase: float) -> list[AgendaLeg]:
    """Return a leg of the robot with a wait midway, at this part of its nominal motion."""
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
    told: Mapping[int, tuple[Need, ...]] | None = None,
    not_before_s: Sequence[float] | None = None,
) -> Agenda:
    """Return the legs of an operator who goes to places one after the other, from where he is at the start.

    Args:
        places: In order.
        gates: Of the cell.
        work_s: Quantiles of his stays at each place: his work, if he never waits; at others he has none.
        first_stays_s: Of his stays at the start of an execution, for a place where he is at no other time.
        told: What each of them shall come after, by number.
        not_before_s: Earliest start of each.
    """
    builder = _Builder("operator", "", np.empty((0, 3)), gates)
    for number, place in enumerate(places):
        own = gates.own_s("operator", place) if gates.waits("operator") else None
        own = work_s.get(place, NONE) if own is None or place not in work_s else own
        own = first_stays_s.get(place, own) if number == 0 and place not in work_s else own
        leg = AgendaLeg(number, place, np.empty((0, 3)), start=builder.legs[-1].place, own_s=own, name=place)
        earliest = not_before_s[number] if not_before_s else 0.0
        builder.go(number, place, leg, (told or {}).get(number, ()), earliest)
    return builder.agenda(places)
