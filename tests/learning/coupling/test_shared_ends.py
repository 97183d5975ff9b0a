"""Several tasks of the operator in one stay are told apart by the robot, which goes on as each of them ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.coupling.events.shared_ends import with_shared_ends
from cyclekit.learning.coupling.events.trips import Trip, are_trips
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent


def _shown(rng: np.random.Generator, name: str, *, waits: bool = True) -> ExecutionVisits:
    """Return one in which the robot shows three parts, each until he has looked at it; in between he may go to pack.

    Not `waits`: the robot goes on after its own work.
    """
    robot, operator, at = [PlaceVisit("home", 0.0, 0.0)], list[PlaceVisit](), 1.0
    for job in rng.permutation(["view", "view", "view", "packing", "packing"]).tolist():
        stays = bool(operator) and operator[-1].place == job == "view"
        if not stays:
            begins = operator[-1].left_s + 1.5 if operator else at
            operator.append(PlaceVisit(job, begins, begins + rng.uniform(3.0, 8.0)))
        if job == "view":
            shown = robot[-1].left_s + rng.uniform(4.0, 14.0)
            at = max(at if stays else operator[-1].arrived_s, shown) + rng.uniform(2.0, 4.0)
            left_s = at + rng.uniform(0.1, 0.2) if waits else shown + rng.uniform(1.9, 2.1)
            robot.append(PlaceVisit("show", shown, left_s))
            robot.append(PlaceVisit("tray", left_s + 1.5, left_s + rng.uniform(2.0, 2.2)))
            operator[-1] = operator[-1]._replace(left_s=at + rng.uniform(0.4, 0.6))
    operator.append(PlaceVisit("door", operator[-1].left_s + 2.0, np.nan))
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def test_the_robot_parts_the_stay_in_which_it_shows_several_parts() -> None:
    rng = np.random.default_rng(1)
    courses = with_shared_ends([_shown(rng, str(n)) for n in range(40)])
    assert {sum(visit.place == "view" for visit in one.visits["operator"]) for one in courses} == {3}
    card = learn_courses(courses)
    found = {(gate.agent, one.agent, one.event, one.place, one.back) for gate in card.gates for one in gate.conditions}
    assert found == {("robot", "operator", "leaves", "view", 0), ("operator", "robot", "arrives", "show", 0)}


@pytest.mark.parametrize("waits", [True, False])
def test_stays_with_one_departure_each_or_beside_a_robot_that_does_not_wait_are_as_logged(waits: bool) -> None:
    rng = np.random.default_rng(2)
    courses = [_shown(rng, str(n), waits=waits) for n in range(40)]
    if waits:
        alone = [one for one in courses if len(one.events[Event("operator", "view", "leaves")]) == 3]
        assert len(alone) > 5
        assert with_shared_ends(alone) == alone
    else:
        assert with_shared_ends(courses) == courses


def test_what_he_does_most_of_the_time_is_no_trip() -> None:
    rng = np.random.default_rng(3)
    courses = [_shown(rng, str(n)) for n in range(12)]
    for share, trips in ((0.2, True), (0.8, False)):
        some = [{0: Trip("packing", 2.0, 2.0 + share * one.visits["operator"][-1].arrived_s)} for one in courses]
        assert are_trips(courses, some) is trips
    assert not are_trips(courses[:9], [{0: Trip("packing", 2.0, 5.0)}] * 9)
