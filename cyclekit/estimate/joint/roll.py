"""Rollout of many cycles of several plans at once: agendas, draws and the simulation of both agents."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from cyclekit.errors import EstimateError
from cyclekit.estimate.cycle.engine import LegTimes
from cyclekit.estimate.cycle.spread import logged_support
from cyclekit.estimate.joint.draws import CycleDraws, EventColumns
from cyclekit.estimate.joint.in_turn import in_turn_agendas
from cyclekit.estimate.joint.legs import Agenda, AgendaLeg, Gates, Need, needs_of
from cyclekit.estimate.joint.people import LoggedMotions, LoggedPeople, OperatorPositions
from cyclekit.estimate.joint.unended import deadlock
from cyclekit.estimate.joint.visits import Segments
from cyclekit.estimate.joint.walk import JointCycles, simulate_both
from cyclekit.estimate.robot.safety import Dynamics, OnStates, SafetyModel, holds_everywhere
from cyclekit.estimate.robot.signal_states import on_states_of
from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from cyclekit.dataset.cards import CouplingCard, SourceCard
    from cyclekit.dataset.cards.coupling import CommonPaceCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.cycle.engine import Presence
    from cyclekit.estimate.joint.legs import Event
    from cyclekit.estimate.joint.walk import UnslowedAgent
    from cyclekit.estimate.robot.safety import Logged
    from cyclekit.learning.coupling.events.visits import PlaceVisit
    from cyclekit.schema import Ints, Vector

ROWS = 8192
"""Number of cycles simulated at once."""
REST_S, TIMES = 60.0, 4.0
"""A cycle is abandoned after TIMES the undisturbed work of both agents plus REST_S, s."""
OF_LOGS = "; or give these waits in [[waits]] of the cell file: those learned from the logs are wrong for this order."
TOLD = "or correct [[waits]] in the cell file, and ingest and train again"
LEFT_OUT = 0.01
"""Maximum share of cycles that are left out, as they end in a deadlock or do not end. A real cell has neither: with
more, the wait conditions are wrong for the plan, and the mean of the others would be of lucky cycles. A tolerance for
rare draws: in 11 new orders of a cell with four fixtures no cycle was left out, so half and twice of it change nothing.
"""


@dataclass(frozen=True)
class Plan:
    """The agendas of both agents for the cycles of one question.

    Attributes:
        name: Name of the plan in messages.
        robot: Agenda of the robot.
        operators: Agendas of the operator, used by the cycles in turn.
        both: Whether the cycle ends when both agents are done; else when the robot is.
        composed: Whether the operator's orders are composed of parts of logged ones.
    """

    name: str
    robot: Agenda
    operators: tuple[Agenda, ...]
    both: bool
    composed: bool = False


@dataclass(frozen=True)
class OneAgent:
    """One agent with one agenda in the cycles `rows` of a question; times of shape (rows, legs)."""

    agenda: Agenda
    rows: Ints
    times: LegTimes


@dataclass(frozen=True)
class RolledBoth:
    """The cycles of one plan.

    Attributes:
        plan: The plan.
        duration_s: Duration of each cycle, shape (cycles,); inf if it does not end.
        robot: The robot in all cycles.
        operators: The operator, by agenda.
        events: The events by column.
        activity_s: Mean safety loss by the operator's place.
        support: Share of the time in logged positions.
        left_out: Share of the cycles left out: a deadlock, or abandoned.
        shared: Normal scores of what the operator's durations share in each cycle, shape (cycles,).
    """

    plan: Plan
    duration_s: Vector
    robot: OneAgent
    operators: tuple[OneAgent, ...]
    events: Sequence[Event]
    activity_s: dict[str, float]
    support: float
    left_out: float
    shared: Vector

    @cached_property
    def begins_s(self) -> Vector:
        """When the first task of any agent starts, shape (cycles,), s."""
        return _begins_s(len(self.duration_s), (self.robot, *self.operators))


class JointCell:
    """Inputs of joint rollouts: safety function, wait conditions, the operator's logged tracks."""

    def __init__(
        self,
        model: SafetyModel,
        dataset: Dataset,
        coupling: CouplingCard | None,
        *,
        dynamics: Dynamics | None = None,
        as_logged: CouplingCard | None = None,
    ) -> None:
        """Read the operator's visits.

        Args:
            model: Safety function.
            dataset: The logs.
            coupling: Who waits for whom.
            dynamics: Response of s to the safety function; None: as logged.
            as_logged: Who waited for whom in the logs, if that was changed: it tells what of a stay was work, and which
                work of the operator belongs to which work of the robot.

        Raises:
            EstimateError: There is no operator in the logs, or he never stays at a place; and it is not known that the
                robot alone waits.
        """
        self.model, self.dataset, self.coupling = on_states_of(model, dataset), dataset, coupling
        logs = dataset.card.coupling or coupling
        self.paces = logs.pace.factors() if logs is not None and logs.pace is not None else {}
        self.as_logged = as_logged or coupling
        self.gates, self.segments = Gates(coupling, self.as_logged), Segments(dataset, coupling, self.paces)
        self.dynamics = dynamics or Dynamics.of(dataset.card.dynamics, model)
        self.pace = self.work_pace = 1.0  # factors on the durations of the operator's walks and trips, and of his work
        if not self.segments.orders and not self.unseen:
            seen = f"{dataset.path}: no complete execution has an operator who stays at one of his places"
            raise EstimateError(seen, cure="Ingest the tracker's log too; name [human_places.*] in the cell file.")

    def at_pace(self, work: float, walk: float) -> JointCell:
        """Return the cell with an operator whose work and walks take so many times as long."""
        other = copy(self)
        for name in ("work_s", "first_stays_s"):
            vars(other).pop(name, None)
        other.work_pace, other.pace = work * self.work_pace, walk * self.pace
        if self.coupling is not None:
            other.coupling = replace(self.coupling, gates=tuple(gate.at_pace(work) for gate in self.coupling.gates))
            other.gates = Gates(other.coupling, self.as_logged)
        return other

    @property
    def unseen(self) -> bool:
        """Whether no log shows what the operator does: signals alone tell what the robot waits for."""
        gates = self.coupling.gates if self.coupling is not None else ()
        return bool(gates) and not self.segments.orders and all(gate.agent == "robot" for gate in gates)

    @cached_property
    def logged(self) -> Mapping[str, tuple[PlaceVisit, ...]]:
        """What the operator did in each logged execution that it rests on, by its name; nothing where he is unseen."""
        if not self.unseen:
            return self.segments.orders
        return {one.execution: () for one in self.dataset.card.executions if one.whole and not one.reference}

    @cached_property
    def motions(self) -> LoggedMotions:
        """Where unseen people were, or in which state, along logged motions."""
        return LoggedMotions(self.dataset, self.model)

    @property
    def common(self) -> CommonPaceCard | None:
        """What durations of one execution shared in the logs."""
        return self.coupling.common if self.coupling is not None else None

    @property
    def executions(self) -> int:
        """Number of logged executions that the rollout is based on."""
        return len(self.logged)

    @cached_property
    def work_s(self) -> dict[str, Vector]:
        """Logged durations of the operator's stays at each of his places."""
        found = {place: self.segments.work_s(place) for place in self.dataset.human_places}
        return {place: self.work_pace * works for place, works in found.items() if len(works)}

    @cached_property
    def first_stays_s(self) -> dict[str, Vector]:
        """Logged durations of the operator's stays at the start of an execution, by place."""
        found = {place: self.segments.first_stays_s(place) for place in self.dataset.human_places}
        return {place: self.work_pace * stays for place, stays in found.items() if len(stays)}

    @cached_property
    def support(self) -> Logged | None:
        """Logged positions; None if the safety function is valid everywhere."""
        if isinstance(self.model, OnStates):
            return self.model
        return None if holds_everywhere(self.model) else logged_support(self.dataset)

    def roll(
        self, plans: Sequence[Plan], *, cycles: int, seed: int = 0, until_s: float
    ) -> Iterator[RolledBoth | EstimateError]:
        """Yield the cycles of plans, in order; for a plan that ends in a deadlock, an error with the cause.

        Args:
            plans: The plans.
            cycles: Number of cycles per plan.
            seed: Seed of the draws; every plan has the same draws.
            until_s: A cycle that takes longer is abandoned.
        """
        at_once = max(1, ROWS // cycles)
        for first in range(0, len(plans), at_once):
            yield from self._some(plans[first : first + at_once], cycles, seed, until_s)

    def _some(
        self, plans: Sequence[Plan], cycles: int, seed: int, until_s: float
    ) -> Iterator[RolledBoth | EstimateError]:
        robots = [plan.robot for plan in plans]
        operators = list(dict.fromkeys(agenda for plan in plans for agenda in plan.operators))
        number = {agenda: n for n, agenda in enumerate(operators)}
        which = np.repeat(np.arange(len(plans)), cycles)
        turn = np.tile(np.arange(cycles), len(plans))
        does = np.array([number[plan.operators[k % len(plan.operators)]] for plan in plans for k in range(cycles)])
        sources = self.sources(robots)
        turns, mine = in_turn_agendas(self.coupling, robots)
        columns = EventColumns([*robots, *operators, *sources, *turns])
        every = np.arange(len(which))
        served = np.array([mine[n][k % len(mine[n])] for n, k in zip(which, turn, strict=True)]) if turns else every
        done = [(agenda, np.flatnonzero(which == n)) for n, agenda in enumerate(robots)]
        done += [(agenda, np.flatnonzero(does == n)) for n, agenda in enumerate(operators)]
        done += [(agenda, np.flatnonzero(served == n)) for n, agenda in enumerate(turns)]
        events_s = columns.times([*done, *((source, every) for source in sources)], len(which))
        robot, operator = (
            CycleDraws(agendas, mine, turn, cycles, columns, seed, self.common)
            for agendas, mine in ((robots, which), (operators, does))
        )
        people_of: Callable[[UnslowedAgent], Presence]
        if self.unseen:
            people = LoggedPeople(self.motions, robot)
            people_of = lambda _: people  # noqa: E731
        else:
            operator.draw_segments(self.segments, self.pace)
            step_s = 1.0 / self.dataset.rate_hz
            people_of = partial(OperatorPositions, segments=self.segments, step_s=step_s, pace=self.pace)
        parts = [CycleDraws([source], np.zeros_like(which), turn, cycles, columns, seed) for source in sources]
        parts += [CycleDraws(turns, served, turn, cycles, columns, seed)] if turns else []
        simulated = simulate_both(
            self.model,
            robot,
            operator,
            parts,
            events_s,
            people_of,
            until_s=until_s,
            support=self.support,
            dynamics=self.dynamics,
        )
        for n, plan in enumerate(plans):
            rows = np.flatnonzero(which == n)
            yield _of_one(plan, simulated, rows, columns, number, does, operator.shared, told=self._told)

    @property
    def _told(self) -> bool:
        """Whether a wait is from the cell file."""
        return any(gate.told for gate in self.coupling.gates) if self.coupling is not None else False

    def sources(self, robots: Sequence[Agenda]) -> list[Agenda]:
        """Return how signals come, but those that one operator gives in turn."""
        card = self.coupling
        if card is None:
            return []
        in_turn = card.in_turn.signals if card.in_turn else ()
        return [self.source(source, robots) for source in card.sources if source.signal not in in_turn]

    def source(self, source: SourceCard, robots: Sequence[Agenda]) -> Agenda:
        """Return how a signal comes: one after the other, as long as there is room, or after what the robot does."""
        taken = [event for agenda in robots for event, _ in agenda.events if event[1:3] == (source.taken_by, "leaves")]
        wanted = [need.event for agenda in robots for leg in agenda.legs for need in leg.needs]
        mine = [event for event in wanted if event[:3] == ("signal", source.signal, source.brings)]
        count = 1 + max((event[3] for event in (mine if source.after else taken)), default=-1)
        legs, begin_s = [], -np.inf if source.comes_on else 0.0
        for part in range(count):
            if source.after:
                needs = needs_of(source.after, part)
            else:
                room = part - source.buffer
                needs = (Need(("robot", source.taken_by, "leaves", room)),) if room >= 0 else ()
            own = np.array(source.gap_s if part else source.first_s)
            passes = (("signal", source.signal, source.brings, part),)
            legs.append(
                AgendaLeg(
                    part,
                    "",
                    np.empty((0, 3)),
                    own_s=own,
                    name=source.signal,
                    needs=needs,
                    not_before_s=begin_s,
                    passes=passes,
                )
            )
        return Agenda("signal", tuple(legs) or (AgendaLeg(-1, "", np.empty((0, 3))),), (source.signal,) * count)


def _of_one(
    plan: Plan,
    simulated: JointCycles,
    rows: Ints,
    columns: EventColumns,
    number: dict[Agenda, int],
    does: Ints,
    shared: Vector,
    *,
    told: bool,
) -> RolledBoth | EstimateError:
    stuck = rows[simulated.stuck[rows]]
    if len(stuck) > LEFT_OUT * len(rows):
        operator = plan.operators[(stuck[0] - rows[0]) % len(plan.operators)]
        part = f" in {percent(len(stuck) / len(rows), 1)} of the cycles" if len(stuck) < len(rows) else ""
        return EstimateError(
            f"{plan.name}: deadlock{part}: {deadlock(plan.robot, operator, simulated, stuck[0], columns)}",
            cure="Change the order of one agent, or 'after'" + (f"; {TOLD}." if told else OF_LOGS if part else "."),
        )
    asked, rows = len(rows), rows[~simulated.stuck[rows]]
    robot, mine, duration = _agents_of(plan, simulated, rows, number, does)
    ended = np.isfinite(duration)
    if 1.0 - LEFT_OUT <= ended.mean() < 1.0:
        rows = rows[ended]
        robot, mine, duration = _agents_of(plan, simulated, rows, number, does)
    lost = simulated.activity_s[rows].mean(axis=0).tolist()
    looked = float(simulated.looked[rows].sum())
    return RolledBoth(
        plan,
        duration,
        robot,
        tuple(mine),
        columns.events,
        dict(zip((*simulated.activities, "unknown"), lost, strict=True)),
        float(simulated.known[rows].sum()) / looked if looked else float("nan"),
        1.0 - len(rows) / asked,
        shared[rows],
    )


def _agents_of(
    plan: Plan, simulated: JointCycles, rows: Ints, number: dict[Agenda, int], does: Ints
) -> tuple[OneAgent, list[OneAgent], Vector]:
    """Return the robot and the operator (by agenda) in some cycles, and the durations of these, s."""
    robot = OneAgent(plan.robot, np.arange(len(rows)), _cut(simulated.robot, rows, len(plan.robot.legs)))
    mine = []
    for agenda in dict.fromkeys(plan.operators):
        some = np.flatnonzero(does[rows] == number[agenda])
        mine.append(OneAgent(agenda, some, _cut(simulated.operator, rows[some], len(agenda.legs))))
    duration = robot.times.passes_s[:, -1].copy()
    if plan.both:
        for each in mine:
            duration[each.rows] = np.maximum(duration[each.rows], each.times.passes_s[:, -1])
        duration -= _begins_s(len(rows), (robot, *mine))
    return robot, mine, duration


def longest_s(plan: Plan) -> float:
    """Return the time after which a cycle of a plan is abandoned, s."""
    latest = max(leg.not_before_s for agenda in (plan.robot, *plan.operators) for leg in agenda.legs)
    return REST_S + TIMES * (plan.robot.alone_s + max(agenda.alone_s for agenda in plan.operators)) + latest


def _begins_s(cycles: int, agents: Sequence[OneAgent]) -> Vector:
    """Return when the first task of any agent starts, shape (cycles,), s."""
    begins = np.full(cycles, np.inf)
    for agent in agents:
        first = next((n for n, leg in enumerate(agent.agenda.legs) if leg.task >= 0 and not leg.hold), 0)
        if first:
            begins[agent.rows] = np.minimum(begins[agent.rows], agent.times.passes_s[:, first - 1])
    return np.where(np.isfinite(begins), begins, 0.0)


def _cut(times: LegTimes, rows: Ints, legs: int) -> LegTimes:
    found = LegTimes.__new__(LegTimes)
    for name, values in vars(times).items():
        setattr(found, name, values[rows, :legs])
    return found
