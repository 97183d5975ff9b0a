"""Split of joint cycles: the times of the robot's tasks, and start and end of each task of both agents."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.estimate.cycle.engine import OWN
from cyclekit.estimate.joint.plans import legs_of_tasks
from cyclekit.estimate.joint.walk import PLANNED
from cyclekit.estimate.result import ELSEWHERE, OWN_TASK, PARTS, PlannedShare, TaskShare

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from cyclekit.estimate.joint.legs import Agenda
    from cyclekit.estimate.joint.roll import OneAgent, RolledBoth
    from cyclekit.schema import Floats, Ints, Vector


def task_shares(rolled: RolledBoth) -> list[TaskShare]:
    """Return the split of each of the robot's tasks, mean seconds; the wait before a task counts as its own."""
    agenda, times = rolled.robot.agenda, rolled.robot.times
    waits, works = times.waits_s.mean(axis=0), (times.works_s - times.arrives_s).mean(axis=0)
    lost = times.lost_s.mean(axis=0)
    found = []
    for name, legs in zip(agenda.tasks, legs_of_tasks(agenda), strict=True):
        nominal = sum(agenda.legs[leg].way_s for leg in legs)
        parts = [float(part[legs].sum()) for part in (lost, works, waits)]
        found.append(TaskShare(name, nominal + sum(parts), nominal, *parts))
    return found


def planned_shares(
    rolled: RolledBoth, factor: float = 1.0, band: Callable[[Vector], tuple[float, ...]] = lambda _ends_s: ()
) -> list[PlannedShare]:
    """Return start, end and cause of the start of each task; one in which the robot waits on its way has two rows.

    If the operator's agenda differs between cycles, his tasks have no mean times and are left out. Where the cycle ends
    with the robot, his tasks are cut there, and those that begin later in most cycles are left out.

    Args:
        rolled: The cycles.
        factor: Factor on every duration that corrects the bias on logged executions.
        band: Function from the ends of a task (cycles,), s, to their interval in single cycles.
    """
    agents = [rolled.robot, *(rolled.operators if len(rolled.operators) == 1 else ())]
    whose, found = _whose(rolled), list[PlannedShare]()
    for agent in agents:
        for span in _joined(_told(agent, rolled)):
            first, last, wait = (factor * float(at.mean()) for at in (span.start_s, span.end_s, span.wait_s))
            name, decided = agent.agenda.agent, _decided(span.decided, whose)
            low, high, *_ = (*band(factor * span.end_s), None, None)
            found.append(PlannedShare(name, name, span.task, first, last, wait, decided, low, high, span.rest))
    return found


def operator_shares(rolled: RolledBoth, cycle_s: float) -> dict[str, tuple[float, ...]]:
    """Return the share of the cycles with the operator at each task, in PARTS equal parts of a cycle."""
    middle_s = (np.arange(PARTS) + 0.5) / PARTS * cycle_s
    found: dict[str, Floats] = {}
    for agent in rolled.operators:
        for span in _spans(agent, rolled):
            there = (span.start_s[:, None] <= middle_s) & (middle_s < span.end_s[:, None])
            found[span.task] = found.get(span.task, np.zeros(PARTS)) + there.sum(axis=0)
    rest = len(rolled.duration_s) - np.sum(list(found.values()), axis=0)
    found[ELSEWHERE] = np.maximum(rest, 0.0)
    parts = ((name, times / len(rolled.duration_s)) for name, times in found.items())
    return {name: tuple(np.round(part, 4).tolist()) for name, part in parts if part.any()}


def _whose(rolled: RolledBoth) -> dict[int, str]:
    """Return the task that sets each event, such as `operator: bench`, by column."""
    agendas = [rolled.plan.robot, *rolled.plan.operators]
    names = {event: _named(agenda, task) for agenda in agendas for event, task in agenda.events}
    signals = {n: f"signal: {event[1]}" for n, event in enumerate(rolled.events) if event[0] == "signal"}
    return {n: names[event] for n, event in enumerate(rolled.events) if event in names} | signals


def _named(agenda: Agenda, task: int) -> str:
    return f"{agenda.agent}: {agenda.tasks[task]}" if task >= 0 else f"{agenda.agent}: start"


MIN_WAIT_S = 0.05
"""Minimum mean wait on the way of a task that divides it, s."""


class _Span(NamedTuple):
    """One task of one agent: times from the start of each cycle (rows,), s, and what decided departure at its gates.

    `rest`: it is the rest of the task before it, after a wait on the way.
    """

    task: str
    start_s: Vector
    end_s: Vector
    wait_s: Vector
    decided: Ints
    rest: bool = False


def _spans(agent: OneAgent, rolled: RolledBoth) -> Iterator[_Span]:
    agenda, times, before = agent.agenda, agent.times, 0
    begin_s = rolled.begins_s[agent.rows]
    for name, legs in zip(agenda.tasks, legs_of_tasks(agenda), strict=True):
        rest = False
        for leg in legs:
            if agenda.legs[leg].hold:
                continue
            gates = list(range(before, leg))  # from the last own work to departure: the gate of that place, and a hold
            start, works = times.passes_s[:, leg - 1], np.maximum(times.works_s[:, before], begin_s)
            end = times.passes_s[:, leg] if leg == len(agenda.legs) - 1 else times.works_s[:, leg]
            wait = np.maximum(start - works, 0.0)
            yield _Span(name, start - begin_s, end - begin_s, wait, times.decided[:, gates], rest)
            before, rest = leg, True


def _told(agent: OneAgent, rolled: RolledBoth) -> Iterator[_Span]:
    """Yield the tasks of an agent within the cycles."""
    for span in _spans(agent, rolled):
        ends_here = agent is rolled.robot or rolled.plan.both
        found = span if ends_here else _in_cycle(span, rolled.duration_s[agent.rows])
        if found is not None:
            yield found


def _joined(spans: Iterator[_Span]) -> Iterator[_Span]:
    """Yield tasks, each in one piece unless the agent waits on its way."""
    last: _Span | None = None
    for span in spans:
        if last is not None and span.rest and span.wait_s.mean() < MIN_WAIT_S:
            last = last._replace(end_s=span.end_s)
            continue
        if last is not None:
            yield last
        last = span
    if last is not None:
        yield last


def _in_cycle(span: _Span, cycle_s: Vector) -> _Span | None:
    """Return a task cut at the ends of the cycles, shape (rows,), s; None if it begins later in most of them."""
    if (span.start_s < cycle_s).mean() < 0.5:
        return None
    start_s, end_s = np.minimum(span.start_s, cycle_s), np.minimum(span.end_s, cycle_s)
    wait_s = np.maximum(start_s - (span.start_s - span.wait_s), 0.0)
    return span._replace(start_s=start_s, end_s=end_s, wait_s=wait_s)


def _decided(columns: Ints, whose: dict[int, str]) -> dict[str, float]:
    """Return the share of the cycles in which each cause decided departure; of several gates, the last that held."""
    names = {OWN: OWN_TASK, PLANNED: "planned start"} | whose
    last = np.full(len(columns), OWN)
    for gate in range(columns.shape[1]):
        last = np.where(columns[:, gate] != OWN, columns[:, gate], last)
    counts: Counter[str] = Counter()
    for key, count in zip(*np.unique(last, return_counts=True), strict=True):
        counts[names[int(key)]] += int(count)
    return {name: count / len(columns) for name, count in counts.items()}
