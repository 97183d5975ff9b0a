"""A rack between robot and operator with room for several parts: who brings waits when it is full."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.config import Wait
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses
from cyclekit.learning.coupling.words import wait_rows

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.cards.coupling import Agent

PARTS = 7


def _away_s(rng: np.random.Generator, work_s: tuple[float, float], other_s: float) -> list[float]:
    """Return how long an agent is away between two visits to the rack, once with another task, s."""
    other = rng.integers(1, PARTS)
    return [3.0 + rng.uniform(*work_s) + (other_s if number == other else 0.0) for number in range(PARTS)]


def _shared(rng: np.random.Generator, name: str, room: int, *, robot_brings: bool = True) -> ExecutionVisits:
    """Return one in which an agent brings parts to a rack and the other takes them away, each part by a visit.

    Who takes waits at the rack until a part is there; who brings waits there while it is full.

    Args:
        rng: Random numbers.
        name: Its name.
        room: Number of parts that fit in the rack.
        robot_brings: Whether the robot brings, and the operator takes; else the other way round.
    """
    own_s = {"robot": rng.uniform(0.55, 0.65, PARTS), "operator": rng.uniform(1.1, 1.9, PARTS)}
    names: tuple[Agent, Agent] = ("robot", "operator") if robot_brings else ("operator", "robot")
    away = {names[0]: _away_s(rng, (0.5, 2.5), 9.0), names[1]: _away_s(rng, (4.0, 9.0), 6.0)}
    visits: dict[Agent, list[PlaceVisit]] = {agent: [PlaceVisit("home", 0.0, 0.0)] for agent in names}
    brought: list[float] = []
    taken: list[float] = []
    for number in range(PARTS):
        for agent, mine, other, back in ((names[0], brought, taken, room), (names[1], taken, brought, 0)):
            came = visits[agent][-1].left_s + 0.5 * away[agent][number]
            free = other[number - back] if number >= back else 0.0
            mine.append(max(came, free) + own_s[agent][number])
            visits[agent].append(PlaceVisit("rack", came, mine[-1]))
            work = visits[agent][-1].left_s + 0.3 * away[agent][number]
            visits[agent].append(PlaceVisit("bench", work, work + 0.2 * away[agent][number]))
    return ExecutionVisits(name, visits, events_of(visits))


def _card(seed: int, room: int, *, robot_brings: bool = True) -> CouplingCard:
    rng = np.random.default_rng(seed)
    return learn_courses([_shared(rng, str(number), room, robot_brings=robot_brings) for number in range(40)])


ROOMS = [(2, True), (3, True), pytest.param(1, True, marks=pytest.mark.slow), (2, False)]


@pytest.mark.parametrize(("room", "robot_brings"), ROOMS)
def test_who_brings_parts_waits_while_the_rack_is_full(room: int, robot_brings: bool) -> None:
    card = _card(room, room, robot_brings=robot_brings)
    brings, takes = ("robot", "operator") if robot_brings else ("operator", "robot")
    (gate,) = (gate for gate in card.gates if gate.conditions)
    (one,) = gate.conditions
    assert (gate.agent, one.agent, one.place, one.event) == (brings, takes, "rack", "leaves")
    assert (one.back, one.needed) == (room, 1.0)
    assert np.median(one.lag_s) == pytest.approx(0.6 if robot_brings else 1.5, abs=0.1)
    earlier = "1 visit earlier" if room == 1 else f"{room} visits earlier"
    assert any(earlier in row.until for row in wait_rows(card))


def test_the_cell_file_need_not_tell_how_many_parts_fit() -> None:
    rng = np.random.default_rng(4)
    courses = [_shared(rng, str(number), 2) for number in range(20)]
    told = Wait(agent="robot", leaving="rack", until="operator leaves rack")
    (gate,) = (gate for gate in learn_courses(courses, [told]).gates if gate.conditions)
    assert [one.back for one in gate.conditions] == [2]
