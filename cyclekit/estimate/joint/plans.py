"""Sequences as agendas of both agents: a plan of both, or the robot's places with logged operator orders."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.errors import EstimateError, UnknownName
from cyclekit.estimate.joint.composed import composed_orders, continued, coupled_places, pairs_of
from cyclekit.estimate.joint.legs import Agenda, operator_agenda, precedence_needs, robot_agenda
from cyclekit.estimate.joint.roll import Plan
from cyclekit.estimate.robot.program import lay_out

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.estimate.joint.legs import Need
    from cyclekit.estimate.joint.roll import JointCell
    from cyclekit.estimate.joint.stop_overs import StopOver
    from cyclekit.estimate.robot.nominal import NominalTask

AGENTS = ("robot", "operator")


@dataclass(frozen=True)
class _Mine:
    """One agent's tasks of a plan: names, needs from `after` by number, and earliest starts."""

    names: tuple[str, ...]
    precedence: dict[int, tuple[Need, ...]]
    not_before_s: tuple[float, ...]


class Planner:
    """Makes the plans of sequences in one cell."""

    def __init__(self, cell: JointCell, nominal: Mapping[str, NominalTask]) -> None:
        """Set the cell and its nominal tasks; agendas of the operator are built once per order."""
        self._cell, self.nominal = cell, nominal
        self._orders: dict[tuple[str, ...], Agenda] = {}
        self.waited_for = {robot for robot, _ in coupled_places(cell.as_logged)}
        self._went = {one.execution: one.places for one in cell.dataset.card.executions if one.execution in cell.logged}
        logged = [(went, tuple(visit.place for visit in cell.logged[name])) for name, went in self._went.items()]
        self._operator = dict(zip(self._went, continued(logged, cell.as_logged), strict=True))

    def plan(self, sequence: TaskSequence) -> Plan:
        """Return the plan of both agents.

        Raises:
            UnknownName: A place, a task or an agent does not exist.
            EstimateError: A task was never logged, or no logged operator order fits the robot's places.
        """
        if sequence.plan:
            return self._of_both(sequence)
        program = lay_out(sequence, self.nominal, self._cell.dataset)
        robot = robot_agenda(program.tasks, self._cell.gates)
        if sequence.operator is not None:
            return Plan(sequence.shown, robot, (self.operator(sequence.operator, sequence.shown),), both=False)
        fitting, composed = self._fitting(sequence)
        operators = tuple(self.operator(order, sequence.shown) for order in fitting)
        return Plan(sequence.shown, robot, operators, both=False, composed=composed)

    def through(self, sequence: TaskSequence) -> tuple[TaskSequence, list[StopOver]] | None:
        """Return a sequence with the stop-overs of the operator that it leaves out, and these; None if there are none.

        Its places stay as they are.
        """
        mine = [n for n, task in enumerate(sequence.plan) if task.agent == "operator"]
        order = [sequence.plan[n].name for n in mine] if sequence.plan else list(sequence.operator or ())
        missing = self._cell.segments.stop_overs.left_out(order)
        if not missing:
            return None
        plan = list(sequence.plan)
        for number, one in reversed(missing):
            order.insert(number, one.place)
            if plan:
                plan.insert(mine[number], PlannedTask("operator", one.place))
        operator = sequence.operator and tuple(order)
        return replace(sequence, operator=operator, plan=tuple(plan)), [one for _, one in missing]

    def operator(self, order: Sequence[str], where: str) -> Agenda:
        """Return the agenda of an operator who visits these places.

        Raises:
            UnknownName: A place does not exist.
        """
        order = tuple(order)
        if order and self._cell.unseen:
            seen = f"{where}: no log shows the operator, so his tasks are unknown: {order[0]}"
            raise EstimateError(seen, cure="Leave his tasks out, or ingest the tracker's log too.")
        if order not in self._orders:
            self._check(order, where)
            self._orders[order] = operator_agenda(order, self._cell.gates, self._cell.work_s, self._cell.first_stays_s)
        return self._orders[order]

    def _check(self, order: Sequence[str], where: str) -> None:
        for place in order:
            if place not in self._cell.dataset.human_places:
                raise UnknownName(where, "place of the operator", place, self._cell.dataset.human_places)

    def _fitting(self, sequence: TaskSequence) -> tuple[list[tuple[str, ...]], bool]:
        """Return the operator's orders in logged executions of the same work, else with the same coupled visits.

        A coupled visit is one at a place where an agent waits for the other. If no log has so many of them, the orders
        are composed from parts of logged orders, which is also returned.

        Raises:
            EstimateError: There are none.
        """
        if self._cell.unseen:
            return [()], False
        same = Counter(sequence.places[1:])
        found = [name for name, went in self._went.items() if Counter(went[1:]) == same]
        if not found:
            mine = self._counted(sequence.places)
            found = [name for name, went in self._went.items() if self._counted(went) == mine]
        if not found and (orders := self._composed(sequence.places)):
            return orders, True
        if not found:
            visits = ", ".join(f"{place} {n} times" for place, n in sorted(self._counted(sequence.places).items()))
            seen = f"{sequence.shown}: in no logged execution did the robot visit {visits or 'these places'}"
            raise EstimateError(
                f"{seen}, so the operator's tasks during this work are unknown",
                cure='Name his places, operator = ["...", "..."], or plan for both: [[sequence.task]].',
            )
        return [self._operator[name] for name in found], False

    def _composed(self, places: Sequence[str]) -> list[tuple[str, ...]]:
        return composed_orders(places, self.logged_orders, pairs_of(self._cell.as_logged))

    def composed(self, sequence: TaskSequence) -> list[tuple[str, ...]]:
        """Return the composed orders of the operator that a sequence uses; none if it uses logged ones."""
        plain = sequence.operator is None and not sequence.plan and not self._cell.unseen
        orders, composed = self._fitting(sequence) if plain else ([], False)
        return orders if composed else []

    @property
    def logged_orders(self) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
        """Places of robot and operator in each execution whose operator order a sequence may use."""
        return [(went, self._operator[name]) for name, went in self._went.items()]

    def _counted(self, places: Sequence[str]) -> Counter[str]:
        return Counter(place for place in places[1:] if place in self.waited_for)

    def _of_both(self, sequence: TaskSequence) -> Plan:
        where, precedence = sequence.shown, precedence_needs(sequence.plan, sequence.shown)
        mine = {agent: _of_agent(agent, sequence.plan, precedence) for agent in AGENTS}
        if other := {task.agent for task in sequence.plan} - set(AGENTS):
            raise UnknownName(where, "agent", min(other), AGENTS)
        robot, operator = mine["robot"], mine["operator"]
        if not robot.names:
            cure = 'Add one: agent = "robot", name = "start->goal".'
            raise EstimateError(f"{where}: no task of the robot", cure=cure)
        self.operator(operator.names, where)
        places = self.chained(robot.names, where)
        program = lay_out(TaskSequence(sequence.name, places, file=sequence.file), self.nominal, self._cell.dataset)
        return Plan(
            where,
            robot_agenda(
                program.tasks,
                self._cell.gates,
                names=robot.names,
                precedence=robot.precedence,
                not_before_s=robot.not_before_s,
            ),
            (
                operator_agenda(
                    operator.names,
                    self._cell.gates,
                    self._cell.work_s,
                    self._cell.first_stays_s,
                    precedence=operator.precedence,
                    not_before_s=operator.not_before_s,
                    begun=False,
                ),
            ),
            both=True,
        )

    def chained(self, names: Sequence[str], where: str) -> tuple[str, ...]:
        """Return the places of consecutive tasks, each given as `start->goal` or as the goal alone.

        Raises:
            EstimateError: A task does not start where the one before it ends.
        """
        start, arrow, _ = names[0].partition("->")
        places = [start] if arrow else [Counter(went[0] for went in self._went.values()).most_common(1)[0][0]]
        for name in names:
            start, arrow, goal = name.partition("->")
            if arrow and start != places[-1]:
                seen = f"{where}: robot task {name!r} does not start where the task before it ends, at {places[-1]!r}"
                raise EstimateError(seen, cure="A robot cannot jump: insert the task between them.")
            places.append(goal if arrow else name)
        return tuple(places)


def _of_agent(agent: str, tasks: Sequence[PlannedTask], precedence: Mapping[int, tuple[Need, ...]]) -> _Mine:
    some = [(number, task) for number, task in enumerate(tasks) if task.agent == agent]
    return _Mine(
        tuple(task.name for _, task in some),
        {mine: precedence[number] for mine, (number, _) in enumerate(some)},
        tuple(task.not_before_s or 0.0 for _, task in some),
    )


def legs_of_tasks(agenda: Agenda) -> list[list[int]]:
    """Return the leg numbers of each task."""
    found: list[list[int]] = [[] for _ in agenda.tasks]
    for number, leg in enumerate(agenda.legs):
        if leg.task >= 0:
            found[leg.task].append(number)
    return found
