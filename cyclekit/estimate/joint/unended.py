"""What keeps a plan of both agents from ending, or is left out of it, in words."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.estimate.joint.draws import EventColumns
    from cyclekit.estimate.joint.legs import Agenda, AgendaLeg, Event
    from cyclekit.estimate.joint.walk import JointCycles


def deadlock(robot: Agenda, operator: Agenda, simulated: JointCycles, row: int, columns: EventColumns) -> str:
    """Return a description of the deadlock of a cycle: which agent waits where for which event."""
    waits = []
    for agenda, times in ((robot, simulated.robot), (operator, simulated.operator)):
        ended = np.isfinite(times.passes_s[row, : len(agenda.legs)])
        if not ended.all():
            leg = agenda.legs[int(ended.argmin())]
            missing = [
                need.event for need in leg.needs if np.isinf(simulated.events_s[row, columns.needed(need.event)])
            ]
            where = _where(leg)
            waits.append(f"{agenda.agent} waits {where} until {' and '.join(_shown(event) for event in missing)}")
    return "; ".join(waits)


def waits_without_source(agendas: Iterable[Agenda], coupling: CouplingCard | None) -> list[str]:
    """Return what the agendas of a plan leave out, one sentence each: waits for a signal that no agent sets."""
    sources = coupling.sources if coupling else ()
    brought = {(source.signal, source.brings) for source in sources}
    found: dict[str, None] = {}
    for agenda in agendas:
        for leg in agenda.legs:
            where = _where(leg)
            for who, signal, state, _ in (need.event for need in leg.needs):
                if who == "signal" and (signal, state) not in brought:
                    found[
                        f"waits of the {agenda.agent} {where} for '{signal} {state}' are left out: neither agent gives "
                        "that signal, and when it comes was not learned"
                    ] = None
    return list(found)


def waits_without_task(robot: Agenda, operator: Agenda) -> list[str]:
    """Return the waits for tasks that the plan of the other agent lacks, one sentence each: they are left out."""
    given = {event for agenda in (robot, operator) for event, _ in agenda.events}
    found = Counter[str]()
    for agenda in (robot, operator):
        for leg in agenda.legs:
            for who, place, what, turn in (need.event for need in leg.needs):
                if who in ("robot", "operator") and (who, place, what, turn) not in given:
                    found[f"wait of the {agenda.agent} {_where(leg)} until {_shown((who, place, what, 0))}"] += 1
    times = {1: "once", 2: "twice"}
    return [
        f"{wait}: left out {times.get(n, f'{n} times')}, the plan has no such task then" for wait, n in found.items()
    ]


def lacks_visit(robot: Agenda, operator: Agenda) -> bool:
    """Return whether the robot waits for a visit of the operator that his agenda lacks."""
    given = {event for event, _ in operator.events}
    needed = {need.event for leg in robot.legs for need in leg.needs if need.event[0] == "operator"}
    return not needed <= given


def _where(leg: AgendaLeg) -> str:
    """Return where an agent waits: before a place, or at one."""
    kind, _, place = leg.name.partition(" ")
    return f"before {place}" if kind in ("hold", "approach") and place else f"at {leg.place}"


def _shown(event: Event) -> str:
    """Return an event in words: `operator leaves fixture (time 2)`."""
    who, where, what, turn = event
    verb = {"set": "has done the work at", "done": "has done", "cleared": "leaves"}.get(what, what)
    said = f"a part comes ({where})" if who == "signal" else f"{who} {verb} {where}"
    return said if not turn else f"{said} (time {turn + 1})"
