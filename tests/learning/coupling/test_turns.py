"""A bin that the operator fills for several visits of the robot: every n-th visit waits for him."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses
from cyclekit.learning.coupling.words import wait_rows

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent


def _filled(rng: np.random.Generator, name: str, parts: int) -> ExecutionVisits:
    """Return one in which the operator fills the bin twice, each time for so many visits of the robot.

    Between these the operator works elsewhere for some time; the robot puts a part on a tray, or first goes to a rack.
    """
    operator, filled = [PlaceVisit("desk", 0.0, rng.uniform(0.5, 15.0))], []
    for place in ("desk", "shelf"):
        came = operator[-1].left_s + 2.0
        filled.append(came + rng.uniform(2.5, 3.5))
        operator.append(PlaceVisit("bin", came, filled[-1]))
        operator.append(PlaceVisit(place, filled[-1] + 2.0, filled[-1] + 2.0 + rng.uniform(3.0, 25.0)))
    robot = [PlaceVisit("home", 0.0, 0.0)]
    for number in range(2 * parts):
        if rng.random() < 0.4:
            came = robot[-1].left_s + 2.0
            robot.append(PlaceVisit("rack", came, came + 0.7))
        came = robot[-1].left_s + 2.0
        robot.append(PlaceVisit("bin", came, max(came, filled[number // parts]) + rng.uniform(0.85, 0.95)))
        robot.append(PlaceVisit("tray", robot[-1].left_s + 1.5, robot[-1].left_s + 2.1))
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


@pytest.mark.parametrize("parts", [3, pytest.param(2, marks=pytest.mark.slow), pytest.param(4, marks=pytest.mark.slow)])
def test_every_nth_visit_to_a_bin_waits_until_it_is_filled(parts: int) -> None:
    rng = np.random.default_rng(parts)
    card = learn_courses([_filled(rng, str(number), parts) for number in range(60)])
    (gate,) = (gate for gate in card.gates if gate.conditions)
    (one,) = gate.conditions
    assert (gate.agent, one.agent, one.place, one.event, one.needed) == ("robot", "operator", "bin", "leaves", 1.0)
    assert [one.turns.event(visit, one.back) for visit in range(parts + 1)] == [0, *[None] * (parts - 1), 1]
    assert np.median(one.lag_s) == pytest.approx(0.9, abs=0.05)
    nth = {2: "2nd", 3: "3rd", 4: "4th"}[parts]
    assert any(row.until.endswith(f"every {nth} time") for row in wait_rows(card))
