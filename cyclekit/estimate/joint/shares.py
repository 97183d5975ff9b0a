"""Where the time of joint cycles goes: the split of the robot's tasks, and when each task of both starts and ends."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.joint.plans import legs_of_tasks
from cyclekit.estimate.joint.roll import begins_s
from cyclekit.estimate.joint.walk import OWN, PLANNED
from cyclekit.estimate.result import PlannedShare, TaskShare

if TYPE_CHECKING:
    from cyclekit.estimate.joint.legs import Agenda
    from cyclekit.estimate.joint.roll import OneAgent, RolledBoth
    from cyclekit.schema import Ints


def task_shares(rolled: RolledBoth) -> list[TaskShare]:
    """Return the split of each of the robot's tasks, mean seconds; the wait before a task is its own."""
    agenda, times = rolled.robot.agenda, rolled.robot.times
    waits, works = times.waits_s.mean(axis=0), (times.works_s - times.arrives_s).mean(axis=0)
    lost = times.lost_s.mean(axis=0)
    found = []
    for name, legs in zip(agenda.tasks, legs_of_tasks(agenda), strict=True):
        nominal = sum(agenda.legs[leg].way_s for leg in legs)
        parts = [float(part[legs].sum()) for part in (lost, works, waits)]
        found.append(TaskShare(name, nominal + sum(parts), nominal, *parts))
    return found


def planned_shares(rolled: RolledBoth) -> list[PlannedShare]:
    """Return when each task starts and ends and what its start waited for; a task that waits midway has two rows.

    Where the operator does this in one cycle and that in another, his tasks have no mean times and are left out.
    """
    agents = [rolled.robot, *(rolled.operators if len(rolled.operators) == 1 else ())]
    whose = _whose(rolled)
    return [share for agent in agents for share in _of_agent(agent, rolled, whose)]


def _whose(rolled: RolledBoth) -> dict[int, str]:
    """Return which task sets each event, `operator: bench`, by its column."""
    agendas = [rolled.plan.robot, *rolled.plan.operators]
    names = {event: _named(agenda, task) for agenda in agendas for event, task in agenda.events}
    signals = {n: f"signal: {event[1]}" for n, event in enumerate(rolled.events) if event[0] == "signal"}
    return {n: names[event] for n, event in enumerate(rolled.events) if event in names} | signals


def _named(agenda: Agenda, task: int) -> str:
    return f"{agenda.agent}: {agenda.tasks[task]}" if task >= 0 else f"{agenda.agent}: start"


def _of_agent(agent: OneAgent, rolled: RolledBoth, whose: dict[int, str]) -> list[PlannedShare]:
    agenda, times, found = agent.agenda, agent.times, list[PlannedShare]()
    before = 0
    begin_s = begins_s(len(rolled.duration_s), (rolled.robot, *rolled.operators))[agent.rows]
    for name, legs in zip(agenda.tasks, legs_of_tasks(agenda), strict=True):
        for leg in legs:
            if agenda.legs[leg].hold:
                continue
            gates = list(range(before, leg))  # from the last own work to going on: its own gate, and a hold
            start, works = times.passes_s[:, leg - 1], times.works_s[:, before]
            works = np.maximum(works, begin_s)
            decided = _decided(times.decided[:, gates], whose)
            end = times.passes_s[:, leg] if leg == len(agenda.legs) - 1 else times.works_s[:, leg]
            first, last = (float((at - begin_s).mean()) for at in (start, end))
            wait = float(np.maximum(start - works, 0.0).mean())
            found.append(PlannedShare(agenda.agent, agenda.agent, name, first, last, wait, decided))
            before = leg
    return found


def _decided(columns: Ints, whose: dict[int, str]) -> dict[str, float]:
    """Return in which part of the cycles what decided going on; of several gates in a row, the last that held."""
    names = {OWN: "own task before", PLANNED: "planned start"} | whose
    last = np.full(len(columns), OWN)
    for gate in range(columns.shape[1]):
        last = np.where(columns[:, gate] != OWN, columns[:, gate], last)
    counts: Counter[str] = Counter()
    for key, count in zip(*np.unique(last, return_counts=True), strict=True):
        counts[names[int(key)]] += int(count)
    return {name: count / len(columns) for name, count in counts.items()}
