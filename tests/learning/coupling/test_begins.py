"""Work that the operator begins with an event: lag and own work are one draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent, GateCard

REACTS_S = 0.8


def _executions(seed: int, *, work_first: bool) -> list[ExecutionVisits]:
    """Return executions in which the operator comes to the fixture before or after the robot has brought a part.

    He works for about 6 s once it is there; or, with `work_first`, prepares for 6 s, and goes when it has come.
    """
    rng, courses = np.random.default_rng(seed), []
    for number in range(60):
        brought_s, came_s, work_s = rng.uniform(4.0, 20.0), rng.uniform(8.0, 12.0), float(rng.normal(6.0, 0.8))
        react_s = float(rng.normal(REACTS_S, 0.05))
        begins_s = max(came_s, brought_s + react_s)
        left_s = max(came_s + work_s, brought_s + react_s) if work_first else begins_s + work_s
        operator = [PlaceVisit("bench", 0.0, came_s - 2.0), PlaceVisit("fixture", came_s, left_s)]
        operator.append(PlaceVisit(("bench", "printer", "shelf")[number % 3], left_s + 2.0, np.nan))
        robot = [PlaceVisit("home", 0.0, 1.0), PlaceVisit("fixture", brought_s, brought_s + rng.uniform(0.5, 4.0))]
        robot.append(PlaceVisit("home", robot[-1].left_s + rng.uniform(2.0, 9.0), np.nan))
        visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
        courses.append(ExecutionVisits(str(number), visits, events_of(visits)))
    return courses


def _gate(courses: list[ExecutionVisits]) -> GateCard:
    gates = learn_courses(courses).gates
    return next(gate for gate in gates if (gate.agent, gate.at, gate.place) == ("operator", "leave", "fixture"))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_lag_with_his_whole_work_is_one_draw_with_it(seed: int) -> None:
    gate = _gate(_executions(seed, work_first=False))
    (one,) = gate.conditions
    assert one.with_work
    lag_s, own_s = np.array(one.lag_s), np.array(gate.own_s)
    assert np.quantile(own_s, (0.1, 0.5, 0.9)) == pytest.approx([5.0, 6.0, 7.0], abs=0.4)
    assert lag_s - own_s == pytest.approx(np.full(len(own_s), lag_s[0] - own_s[0]), abs=0.01)
    assert float(lag_s[0] - own_s[0]) == pytest.approx(REACTS_S, abs=0.4)


def test_a_lag_without_his_work_is_a_draw_of_its_own() -> None:
    gate = _gate(_executions(3, work_first=True))
    (one,) = gate.conditions
    assert not one.with_work
    assert np.median(one.lag_s) == pytest.approx(REACTS_S, abs=0.2)
