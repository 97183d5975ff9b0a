"""A robot that seldom waits, an operator who begins cycles in the middle of his work, trips at both ends of a cycle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.coupling.events.trips import part_trips, trip_places
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses
from cyclekit.learning.coupling.words import habit_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import CouplingCard, GateCard
    from cyclekit.dataset.cards.coupling import Agent

WALK_S = 1.5


def _execution(
    rng: np.random.Generator, name: str, away_s: Sequence[float], left_s: tuple[float, float] = (0.0, 4.0)
) -> ExecutionVisits:
    """Return one in which the robot brings parts to a fixture, and the operator works on each and leaves.

    Args:
        rng: Random numbers.
        name: Its name.
        away_s: Time of the robot's other work before each visit to the fixture, s.
        left_s: Rest of the operator's work at his bench when the execution begins, at least and at most, s.
    """
    robot, operator = [PlaceVisit("home", 0.0, 0.0)], list[PlaceVisit]()
    begin, ready, free = 0.0, rng.uniform(*left_s), 0.0
    for other_s in away_s:
        came = robot[-1].left_s + other_s
        robot.append(PlaceVisit("crate", came, max(came + 1.2, free)))
        robot.append(PlaceVisit("fixture", robot[-1].left_s + 4.0, robot[-1].left_s + 5.6))
        left = max(ready, robot[-1].left_s + rng.uniform(0.5, 0.7))
        operator.append(PlaceVisit("bench", begin, left))
        operator.append(PlaceVisit("fixture", left + WALK_S, left + WALK_S + rng.normal(6.0, 0.8)))
        free = operator[-1].left_s + rng.uniform(0.4, 0.6)
        begin = operator[-1].left_s + WALK_S
        ready = begin + rng.normal(8.0, 1.0)
    operator.append(PlaceVisit("bench", begin, np.nan))
    robot.append(PlaceVisit("home", robot[-1].left_s + 4.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def _gate(card: CouplingCard, agent: str, at: str, place: str) -> GateCard:
    (found,) = [gate for gate in card.gates if (gate.agent, gate.at, gate.place) == (agent, at, place)]
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_few_long_waits_that_all_end_with_an_event_are_enough(seed: int) -> None:
    """Of 14 second visits to the fixture, the robot waits before three, as in a log of 40 executions of mixed work."""
    rng = np.random.default_rng(seed)
    twice = [(rng.uniform(2.0, 9.0), away_s) for away_s in (3.0, 5.0, 4.0, *rng.uniform(20.0, 30.0, 11))]
    orders = [*twice, *((away_s,) for away_s in rng.uniform(2.0, 9.0, 26))]
    card = learn_courses([_execution(rng, str(number), order) for number, order in enumerate(orders)])
    (waits,) = _gate(card, "robot", "approach", "fixture").conditions
    assert (waits.agent, waits.event, waits.place, waits.back) == ("operator", "leaves", "fixture", 1)
    assert waits.lag_s[len(waits.lag_s) // 2] == pytest.approx(0.5, abs=0.12)


def test_own_work_that_lasts_longer_does_not_hide_what_an_operator_waits_for() -> None:
    """After his first visit, the work at his bench is mostly longer than the robot takes to bring the next part."""
    rng = np.random.default_rng(3)
    orders = [rng.uniform(2.0, 6.0, 1 + number % 3) for number in range(40)]
    card = learn_courses([_execution(rng, str(number), order) for number, order in enumerate(orders)])
    (needs,) = _gate(card, "operator", "approach", "fixture").conditions
    assert (needs.agent, needs.event, needs.place, needs.needed) == ("robot", "leaves", "fixture", 1.0)


def test_who_begins_a_cycle_in_the_middle_of_his_work_has_the_rest_of_it_left() -> None:
    rng = np.random.default_rng(4)
    orders = [rng.uniform(2.0, 6.0, 1 + number % 3) for number in range(60)]
    card = learn_courses([_execution(rng, str(number), order, (4.0, 14.0)) for number, order in enumerate(orders)])
    bench = _gate(card, "operator", "leave", "bench")
    assert np.median(bench.own_s) == pytest.approx(8.0, abs=0.8)
    (rest,) = [one for one in bench.own_by if not one.place]
    assert rest.side == "before"
    assert max(rest.own_s) > 12.0  # after nine seconds or so the robot is away: sooner is not seen
    assert any("if a cycle begins in the middle of it" in line for line in habit_lines(card))


def test_who_comes_to_his_first_place_after_the_start_has_all_of_his_work_left() -> None:
    rng = np.random.default_rng(4)
    orders = [rng.uniform(2.0, 6.0, 1 + number % 3) for number in range(60)]
    courses = [_execution(rng, str(number), order, (4.0, 14.0)) for number, order in enumerate(orders)]
    for course in courses:
        course.visits["robot"][0] = PlaceVisit("home", -5.0, 0.0)  # type: ignore[index]  # a list
    assert all(one.place for one in _gate(learn_courses(courses), "operator", "leave", "bench").own_by)


def test_every_departure_of_two_hundred_executions_counts() -> None:
    """His first visit to the bench takes 2 s, his second 4 s: every other departure would be all of one kind."""
    courses = []
    for number in range(205):
        operator = [PlaceVisit("bench", 1.0, 3.0), PlaceVisit("bench", 4.0, 8.0), PlaceVisit("rest", 9.0, np.nan)]
        robot = [PlaceVisit("home", 0.0, 0.0), PlaceVisit("crate", 3.0, 4.0), PlaceVisit("home", 9.0, np.nan)]
        visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
        courses.append(ExecutionVisits(str(number), visits, events_of(visits)))
    bench = _gate(learn_courses(courses), "operator", "leave", "bench")
    assert np.mean(bench.own_s) == pytest.approx(3.0, abs=0.1)


def test_trips_at_both_ends_of_an_execution_are_no_tasks() -> None:
    at = {"bench": 1.0, "shelf": 1.0, "fixture": 3.0}
    for order in (("shelf", "bench", "fixture", "bench"), ("bench", "fixture", "bench", "shelf")):
        visits = [PlaceVisit(place, 5.0 * n, 5.0 * n + at[place]) for n, place in enumerate(order)]
        parted = part_trips(visits, {"shelf"}, {})
        assert [visit.place for visit in parted.visits] == ["bench", "fixture", "bench"]
        assert parted.trips == {}
    home = [PlaceVisit(place, 5.0 * n, 5.0 * n + 1.0) for n, place in enumerate(("bench", "shelf", "bench"))]
    (visit,) = part_trips(home, {"shelf"}, {}).visits
    assert (visit.arrived_s, visit.left_s, visit.away_s) == (0.0, 11.0, 9.0)


def test_a_place_of_trips_is_found_where_many_of_them_meet_the_ends_of_executions() -> None:
    rng, found = np.random.default_rng(5), []
    for number in range(40):
        plain = _execution(rng, str(number), [3.0])
        visits = list(plain.visits["operator"])
        if number % 4 == 1:
            visits = [PlaceVisit("shelf", 0.0, 0.1), *visits]
        if number % 4 == 2:
            visits = [*visits, PlaceVisit("shelf", visits[-1].arrived_s + 9.0, np.nan)]
        mine: dict[Agent, list[PlaceVisit]] = {"robot": list(plain.visits["robot"]), "operator": visits}
        found.append(ExecutionVisits(str(number), mine, events_of(mine)))
    assert trip_places(found) == ("shelf",)
