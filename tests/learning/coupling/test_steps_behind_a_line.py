"""An operator who loads a fixture and steps back behind a line, before the robot may come with its part."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard, GateCard
    from cyclekit.dataset.cards.coupling import Agent

FROM_LINE_S, FROM_DESK_S, FROM_PRINTER_S = 1.0, 1.6, 5.2
"""Walks to the fixture from behind the line, from the desk and from the printer, s."""
TO_LINE_S = {"desk": 1.2, "printer": 5.0, "fixture": 0.8}
WORK_S = {"desk": (7.0, 3.0), "printer": (4.0, 2.0)}
ORDERS = (("JAJBJ", "DLLPL"), ("AJJBJ", "LDLPL"), ("JBJJA", "PLLDL"), ("BJAJJ", "LPLDL"))
"""Tasks of the robot (J: at the fixture) and of the operator (L: loads it; D, P: at desk and printer)."""


def _executions(seed: int, count: int = 60) -> list[ExecutionVisits]:
    rng = np.random.default_rng(seed)
    return [_execution(rng, str(number), *ORDERS[rng.integers(len(ORDERS))]) for number in range(count)]


def _execution(rng: np.random.Generator, name: str, robots: str, his: str) -> ExecutionVisits:
    """Return one in which the robot waits at its rack for the operator, and he until it has left the fixture.

    He waits behind the line. The printer is so far away that he turns off on the way there each time.
    """
    robot, operator = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("desk", 0.0, rng.uniform(0.5, 3.0))]
    rest, free_s = iter(robots), -np.inf
    for task in his:
        here, ready_s = operator[-1].place, operator[-1].left_s
        if task != "L":
            place = "desk" if task == "D" else "printer"
            came_s = ready_s + (3.0 if place != here else 0.0)
            operator.append(PlaceVisit(place, came_s, came_s + max(1.5, rng.normal(*WORK_S[place]))))
            continue
        if here == "printer" and free_s > ready_s + 4.5:
            ready_s = free_s - rng.uniform(1.0, 4.5)
            operator[-1] = operator[-1]._replace(left_s=ready_s)
        if free_s <= ready_s and here != "fixture":
            came_s = ready_s + (FROM_DESK_S if here == "desk" else FROM_PRINTER_S)
        else:
            aside_s, goes_s = ready_s + TO_LINE_S[here], free_s + rng.uniform(0.15, 0.5)
            if goes_s > aside_s + 0.5:
                operator.append(PlaceVisit("line", aside_s, goes_s))
            came_s = max(goes_s, min(aside_s, goes_s + 3.0)) + FROM_LINE_S
        operator.append(PlaceVisit("fixture", came_s, came_s + max(1.5, rng.normal(4.0, 0.8))))
        loaded_s = operator[-1].left_s + rng.uniform(0.4, 0.6)
        for other in rest:
            came_s = robot[-1].left_s + 2.0
            if other == "J":
                gone_s = max(came_s + 0.8, loaded_s)
                free_s = gone_s + 2.7 + float(rng.normal(3.5, 0.03))
                robot += [PlaceVisit("rack", came_s, gone_s), PlaceVisit("mount", gone_s + 2.7, free_s)]
                break
            robot.append(PlaceVisit(f"bin {other}", came_s, came_s + 0.7))
            robot.append(PlaceVisit("tray", came_s + 3.0, came_s + 3.0 + float(rng.normal(1.0, 0.03))))
    robot.append(PlaceVisit("home", robot[-1].left_s + 3.0, np.nan))
    operator.append(PlaceVisit("desk", operator[-1].left_s + 3.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def _waiting(card: CouplingCard, agent: Agent) -> GateCard:
    (found,) = [gate for gate in card.gates if gate.agent == agent and gate.conditions]
    return found


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_both_wait_for_each_other_and_no_parts_are_invented(seed: int) -> None:
    """He waits behind the line, also where he turned off on the way there as the robot left the fixture."""
    card = learn_courses(_executions(seed))
    assert card.sources == ()
    gate = _waiting(card, "operator")
    (robots,), (his,) = _waiting(card, "robot").conditions, gate.conditions
    assert (robots.agent, robots.event, robots.place, robots.back) == ("operator", "leaves", "fixture", 0)
    assert (his.agent, his.event, his.place, his.back, his.needed) == ("robot", "leaves", "mount", 1, 1.0)
    assert (gate.at, gate.place, gate.wait_at) == ("approach", "fixture", "line")
    assert "printer" in gate.wait_from
