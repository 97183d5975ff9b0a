"""Many cycles of several plans at once: agendas, draws and the walk of both agents put together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import EstimateError
from cyclekit.estimate.joint.drawn import Drawn, EventColumns
from cyclekit.estimate.joint.legs import Agenda, AgendaLeg, Gates, Need
from cyclekit.estimate.joint.visits import Segments
from cyclekit.estimate.joint.walk import JointCycles, LegTimes, walk_both
from cyclekit.estimate.safety import Dynamics, SafetyModel, holds_everywhere
from cyclekit.estimate.spread import logged_support

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.dataset.cards import CouplingCard, SourceCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.joint.legs import Event
    from cyclekit.estimate.support import Support
    from cyclekit.schema import Ints, Vector

ROWS = 8192
"""Cycles walked at once."""
REST_S, TIMES = 60.0, 4.0
"""A cycle is given up after so many times the undisturbed work of both, and this."""
ENDLESS_PART = 0.05
"""Up to this part of the cycles that are given up are left out; of more, the plan has no answer."""


@dataclass(frozen=True)
class Plan:
    """What both agents do in the cycles of one question.

    Attributes:
        name: How a message names it.
        robot: What the robot does.
        operators: What the operator does: one of these in each cycle, in turn.
        both: The cycle lasts until both are done; else until the robot is.
    """

    name: str
    robot: Agenda
    operators: tuple[Agenda, ...]
    both: bool


@dataclass(frozen=True)
class OneAgent:
    """One agent in those cycles `rows` of one question in which it does an agenda; times of shape (rows, legs)."""

    agenda: Agenda
    rows: Ints
    times: LegTimes


@dataclass(frozen=True)
class RolledBoth:
    """The cycles of one plan.

    Attributes:
        plan: The plan.
        duration_s: Of each cycle, shape (cycles,); inf where it does not end.
        robot: The robot in all cycles.
        operators: The operator, by what he did.
        events: The events by column.
        activity_s: Mean safety loss by what the operator was at.
        support: Part of the time in logged positions.
        left_out: Part of the cycles that do not end: nobody can go on, or they were given up.
    """

    plan: Plan
    duration_s: Vector
    robot: OneAgent
    operators: tuple[OneAgent, ...]
    events: Sequence[Event]
    activity_s: dict[str, float]
    support: float
    left_out: float = 0.0


class JointCell:
    """What rollouts of both agents rest on: safety function, who waits for whom, the operator's logged tracks."""

    def __init__(
        self, model: SafetyModel, dataset: Dataset, coupling: CouplingCard | None, *, dynamics: Dynamics | None = None
    ) -> None:
        """Read what the operator did.

        Raises:
            EstimateError: There is no operator in the logs, or he never stays at a place.
        """
        self.model, self.dataset, self.coupling = model, dataset, coupling
        self.gates, self.segments = Gates(coupling), Segments(dataset)
        self.dynamics = dynamics or Dynamics.of(dataset.card.dynamics, model)
        self.pace = 1.0  # what the operator does takes so many times as long as logged
        if not self.segments.orders:
            seen = f"{dataset.path}: no complete execution has an operator who stays at one of his places"
            raise EstimateError(seen, cure="Ingest the tracker's log too; name [human_places.*] in the cell file.")

    @property
    def executions(self) -> int:
        """How many logged executions it rests on."""
        return len(self.segments.orders)

    @cached_property
    def work_s(self) -> dict[str, Vector]:
        """How long the operator stays at each of his places, as logged."""
        found = {place: self.segments.work_s(place) for place in self.dataset.human_places}
        return {place: self.pace * works for place, works in found.items() if len(works)}

    @cached_property
    def first_stays_s(self) -> dict[str, Vector]:
        """How long the operator stays where he is at the start of an execution."""
        found = {place: self.segments.first_stays_s(place) for place in self.dataset.human_places}
        return {place: self.pace * stays for place, stays in found.items() if len(stays)}

    @cached_property
    def support(self) -> Support | None:
        """Where logged positions lie."""
        return None if holds_everywhere(self.model) else logged_support(self.dataset)

    def roll(
        self, plans: Sequence[Plan], *, cycles: int, seed: int = 0, until_s: float
    ) -> Iterator[RolledBoth | EstimateError]:
        """Yield the cycles of plans, in order; in place of those in which nobody can go on, an error that tells why.

        Args:
            plans: What is done in them.
            cycles: Of each.
            seed: Of what is drawn; every plan draws the same.
            until_s: A cycle that takes longer has no end.
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
        sources = [self.source(source, robots) for source in (self.coupling.sources if self.coupling else ())]
        columns = EventColumns([*robots, *operators, *sources])
        every = np.arange(len(which))
        done = [(agenda, np.flatnonzero(which == n)) for n, agenda in enumerate(robots)]
        done += [(agenda, np.flatnonzero(does == n)) for n, agenda in enumerate(operators)]
        events_s = columns.times([*done, *((source, every) for source in sources)], len(which))
        robot, operator = (
            Drawn(agendas, mine, turn, cycles, columns, seed) for agendas, mine in ((robots, which), (operators, does))
        )
        operator.draw_segments(self.segments, self.pace)
        parts = [Drawn([source], np.zeros_like(which), turn, cycles, columns, seed) for source in sources]
        walked = walk_both(
            self.model,
            robot,
            operator,
            parts,
            events_s,
            self.segments,
            step_s=1.0 / self.dataset.rate_hz,
            until_s=until_s,
            support=self.support,
            dynamics=self.dynamics,
            pace=self.pace,
        )
        for n, plan in enumerate(plans):
            yield _of_one(plan, walked, np.flatnonzero(which == n), columns, number, does)

    def source(self, source: SourceCard, robots: Sequence[Agenda]) -> Agenda:
        """Return how parts come: one after the other, as long as there is room."""
        taken = [event for agenda in robots for event, _ in agenda.events if event[1:3] == (source.taken_by, "leaves")]
        count = 1 + max((event[3] for event in taken), default=-1)
        legs = []
        for part in range(count):
            needs = (Need(("robot", source.taken_by, "leaves", part - source.buffer)),) if part >= source.buffer else ()
            own = np.array(source.gap_s if part else source.first_s)
            passes = (("signal", source.signal, "arrives" if source.inferred else "set", part),)
            legs.append(
                AgendaLeg(part, "", np.empty((0, 3)), own_s=own, name=source.signal, needs=needs, passes=passes)
            )
        return Agenda("signal", tuple(legs) or (AgendaLeg(-1, "", np.empty((0, 3))),), (source.signal,) * count)


def _of_one(
    plan: Plan, walked: JointCycles, rows: Ints, columns: EventColumns, number: dict[Agenda, int], does: Ints
) -> RolledBoth | EstimateError:
    if walked.stuck[rows].all():
        return EstimateError(
            f"{plan.name}: {_stuck(plan, walked, rows[0], columns)}",
            cure="Change the order of one of them, or what is told by 'after'.",
        )
    asked, rows = len(rows), rows[~walked.stuck[rows]]
    robot, mine, duration = _agents_of(plan, walked, rows, number, does)
    ended = np.isfinite(duration)
    if 1.0 - ENDLESS_PART <= ended.mean() < 1.0:
        rows = rows[ended]
        robot, mine, duration = _agents_of(plan, walked, rows, number, does)
    lost = walked.activity_s[rows].mean(axis=0).tolist()
    looked = float(walked.looked[rows].sum())
    return RolledBoth(
        plan,
        duration,
        robot,
        tuple(mine),
        columns.events,
        dict(zip((*walked.activities, "unknown"), lost, strict=True)),
        float(walked.known[rows].sum()) / looked if looked else float("nan"),
        1.0 - len(rows) / asked,
    )


def _agents_of(
    plan: Plan, walked: JointCycles, rows: Ints, number: dict[Agenda, int], does: Ints
) -> tuple[OneAgent, list[OneAgent], Vector]:
    """Return the robot and the operator, by what he did, in some cycles, and how long these take, s."""
    robot = OneAgent(plan.robot, np.arange(len(rows)), _cut(walked.robot, rows, len(plan.robot.legs)))
    mine = []
    for agenda in dict.fromkeys(plan.operators):
        some = np.flatnonzero(does[rows] == number[agenda])
        mine.append(OneAgent(agenda, some, _cut(walked.operator, rows[some], len(agenda.legs))))
    duration = robot.times.passes_s[:, -1].copy()
    if plan.both:
        for each in mine:
            duration[each.rows] = np.maximum(duration[each.rows], each.times.passes_s[:, -1])
        duration -= begins_s(len(rows), (robot, *mine))
    return robot, mine, duration


def longest_s(plan: Plan) -> float:
    """Return after which time a cycle of a plan is given up, s."""
    agendas = (plan.robot, *plan.operators)
    work = sum(max(float(np.max(leg.own_s)), 0.0) + leg.way_s + 5.0 for agenda in agendas[:2] for leg in agenda.legs)
    latest = max(leg.not_before_s for agenda in agendas for leg in agenda.legs)
    return REST_S + TIMES * work + latest


def begins_s(cycles: int, agents: Sequence[OneAgent]) -> Vector:
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


def _stuck(plan: Plan, walked: JointCycles, row: int, columns: EventColumns) -> str:
    """Return who waits where for what, in a cycle in which nobody can go on."""
    told = []
    for agenda, times in ((plan.robot, walked.robot), (plan.operators[row % len(plan.operators)], walked.operator)):
        ended = np.isfinite(times.passes_s[row, : len(agenda.legs)])
        if not ended.all():
            leg = agenda.legs[int(ended.argmin())]
            missing = [need.event for need in leg.needs if np.isinf(walked.events_s[row, columns.needed(need.event)])]
            where = f"before {leg.name.removeprefix('hold ')}" if leg.hold else f"at {leg.place}"
            told.append(f"{agenda.agent} waits {where} until {' and '.join(shown(event) for event in missing)}")
    return "deadlock: " + "; ".join(told)


def unbrought(plan: Plan, coupling: CouplingCard | None) -> list[str]:
    """Return what a plan leaves out, one sentence each: waits for a signal that nobody in it gives."""
    sources = coupling.sources if coupling else ()
    brought = {(source.signal, "arrives" if source.inferred else "set") for source in sources}
    found: dict[str, None] = {}
    for agenda in (plan.robot, *plan.operators):
        for leg in agenda.legs:
            where = f"before {leg.name.removeprefix('hold ')}" if leg.hold else f"at {leg.place}"
            for who, signal, state, _ in (need.event for need in leg.needs):
                if who == "signal" and (signal, state) not in brought:
                    found[
                        f"waits of the {agenda.agent} {where} for '{signal} {state}' are left out: neither agent gives "
                        "that signal, and when it comes was not learned"
                    ] = None
    return list(found)


def shown(event: Event) -> str:
    """Return an event in words: `operator leaves fixture (2nd time)`."""
    who, where, what, turn = event
    verb = {"set": "has done the work at", "done": "has done", "cleared": "leaves"}.get(what, what)
    said = f"a part comes ({where})" if who == "signal" else f"{who} {verb} {where}"
    return said if not turn else f"{said} (time {turn + 1})"
