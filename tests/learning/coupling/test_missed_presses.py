"""A robot that always waits for the operator's button, of which some presses are in no log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.coupling.events.givers import with_givers
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent

BUTTON = Event("signal", "button", "set")
MISSED = 0.04
"""Share of the presses that are in no log."""


def _execution(rng: np.random.Generator, name: str, ahead: float) -> ExecutionVisits:
    """Return one in which the robot shows three parts, each until the operator has pressed the button.

    Args:
        rng: Random numbers.
        name: Its name.
        ahead: Share of the presses that come before the robot: it then shows the part for 2 s.
    """
    robot, operator, presses = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("desk", 0.0, 2.0)], list[float]()
    for _ in range(3):
        came_s = robot[-1].left_s + 2.0
        robot.append(PlaceVisit("rack", came_s, came_s + float(rng.normal(0.7, 0.02))))
        came_s = robot[-1].left_s + 4.0
        press_s = came_s + (rng.uniform(-3.0, -0.5) if rng.random() < ahead else rng.uniform(1.5, 9.0))
        left_s = max(came_s + 2.0 if ahead else came_s, press_s + float(rng.normal(0.3, 0.02)))
        robot.append(PlaceVisit("show", came_s, left_s))
        begin_s = press_s - rng.uniform(0.8, 4.0)
        operator[-1] = operator[-1]._replace(left_s=begin_s - rng.uniform(0.8, 3.0))
        gone_s = press_s + rng.uniform(0.1, 1.5)
        operator += [PlaceVisit("button", begin_s, gone_s), PlaceVisit("desk", gone_s + 1.0, np.nan)]
        presses += [press_s] if rng.random() > MISSED else []
    robot.append(PlaceVisit("home", robot[-1].left_s + 3.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits) | {BUTTON: np.array(presses)})


@pytest.mark.parametrize(("ahead", "own_s"), [(0.0, 0.7), (0.09, 2.0)])
def test_waits_whose_press_was_not_logged_are_no_own_work(ahead: float, own_s: float) -> None:
    """Where the robot always waits, its own work is as at other places; where it seldom does not, it is seen."""
    rng = np.random.default_rng(5)
    card = learn_courses(with_givers([_execution(rng, str(number), ahead) for number in range(60)], ()))
    (gate,) = (one for one in card.gates if one.agent == "robot" and one.conditions)
    assert (gate.at, gate.place) == ("leave", "show")
    assert np.median(gate.own_s) == pytest.approx(own_s, abs=0.1)
