"""Trips of the operator while he waits, and own work that depends on where he goes next."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.learning.coupling.conditions.departures import Condition, Departures, Gate
from cyclekit.learning.coupling.conditions.given_signals import since_given
from cyclekit.learning.coupling.events.trips import part_trips, trip_places
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses
from cyclekit.learning.coupling.words import habit_lines

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard, GateCard
    from cyclekit.dataset.cards.coupling import Agent

WALK_S, FETCH_S = 1.0, 4.5
WORK_S = {"fixture_1": (1.0, 1.8), "fixture_2": (5.0, 6.0)}


def _execution(
    rng: np.random.Generator,
    name: str,
    *,
    share: float = 0.0,
    free: float = 0.0,
    planned: bool = False,
    by_fixture: bool = False,
) -> ExecutionVisits:
    """Return one in which the operator, at his bench, waits until the robot has left a fixture, then works there.

    Args:
        rng: Random numbers.
        name: Its name.
        share: Share of his waits in which he fetches material and comes back.
        free: The same of the passages without a wait.
        planned: Whether he goes to the shelf once in each execution, by plan.
        by_fixture: Whether his work at the bench depends on the fixture.
    """
    robot, operator = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("rest", 0.0, 0.5)]
    for number, fixture in enumerate(rng.permutation(["fixture_1", "fixture_2", "fixture_1"]).tolist()):
        came = robot[-1].left_s + rng.uniform(2.0, 12.0)
        robot.append(PlaceVisit(fixture, came, came + 2.0))
        if planned and number == 1:
            operator.append(PlaceVisit("shelf", operator[-1].left_s + WALK_S, operator[-1].left_s + WALK_S + 1.0))
        begin = operator[-1].left_s + WALK_S
        ready = begin + rng.uniform(*(WORK_S[fixture] if by_fixture else (1.0, 1.8)))
        left = came + 2.0 + rng.uniform(0.3, 0.7)
        if rng.random() < (share if left > ready + 0.5 else free):
            operator += [PlaceVisit("bench", begin, ready), PlaceVisit("shelf", ready + 1.5, ready + 3.0)]
            begin = ready = ready + FETCH_S + rng.uniform(-0.5, 0.5)
        operator.append(PlaceVisit("bench", begin, max(ready, left)))
        operator.append(
            PlaceVisit(fixture, max(ready, left) + WALK_S, max(ready, left) + WALK_S + rng.uniform(3.0, 4.0))
        )
    operator.append(PlaceVisit("rest", operator[-1].left_s + WALK_S, np.nan))
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def _executions(seed: int, count: int = 40, **habits: float | bool) -> list[ExecutionVisits]:
    rng = np.random.default_rng(seed)
    return [_execution(rng, str(number), **habits) for number in range(count)]  # type: ignore[arg-type]


def _gates(card: CouplingCard) -> dict[str, GateCard]:
    return {gate.place: gate for gate in card.gates if (gate.agent, gate.at) == ("operator", "approach")}


@pytest.mark.parametrize("share", [0.5, pytest.param(1.0, marks=pytest.mark.slow)])
def test_trips_are_made_in_a_share_of_the_waits(share: float) -> None:
    card = learn_courses(_executions(1, share=share))
    gates = _gates(card)
    assert set(gates) == {"fixture_1", "fixture_2"}
    for gate in gates.values():
        assert [(one.agent, one.place, one.needed) for one in gate.conditions] == [("robot", gate.place, 1.0)]
        assert gate.trip is not None
        assert gate.trip.places == ("shelf",)
        assert gate.trip.waiting == pytest.approx(share, abs=0.13)
        assert gate.trip.free < 0.05
        assert np.median(gate.trip.took_s) == pytest.approx(FETCH_S, abs=0.2)
    (bench,) = (gate for gate in card.gates if (gate.agent, gate.at, gate.place) == ("operator", "leave", "bench"))
    assert max(bench.own_s) < 2.5  # a trip is no own work
    assert any("trips to shelf" in line for line in habit_lines(card))


def test_trips_at_any_time_are_also_made_without_a_wait() -> None:
    trips = [gate.trip for gate in _gates(learn_courses(_executions(2, share=0.4, free=0.4))).values()]
    shares = [(trip.waiting, trip.free) for trip in trips if trip is not None]
    assert np.mean(shares, axis=0) == pytest.approx([0.4, 0.4], abs=0.12)


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_who_goes_there_in_each_execution_makes_no_trips(seed: int) -> None:
    courses = _executions(seed, 60, planned=True)
    assert trip_places(courses) == ()
    assert all(gate.trip is None for gate in learn_courses(courses).gates)


def test_a_visit_goes_on_over_a_trip() -> None:
    visits = [PlaceVisit("bench", 0.0, 2.0), PlaceVisit("shelf", 4.0, 5.0)]
    walks_s = {("bench", "fixture"): 1.5}
    home = [*visits, PlaceVisit("bench", 7.0, 9.0), PlaceVisit("fixture", 10.5, 14.0)]
    parted = part_trips(home, ["shelf"], walks_s)
    assert [(visit.place, visit.left_s, visit.away_s) for visit in parted.visits] == [
        ("bench", 9.0, 5.0),
        ("fixture", 14.0, 0.0),
    ]
    straight = part_trips([*visits, PlaceVisit("fixture", 8.0, 12.0)], ["shelf"], walks_s)
    assert (straight.visits[0].left_s, straight.trips[0].back_s) == (6.5, 6.5)  # as if he had come from his bench
    unseen = part_trips([visits[0], PlaceVisit("fixture", 8.0, 12.0)], ["shelf"], walks_s)
    assert (unseen.visits[0].left_s, unseen.trips[0].left_s) == (6.5, 2.0)  # so long a walk was a trip
    assert part_trips(home, ["shelf"], walks_s, {("approach", "other")}).visits == home


@pytest.mark.parametrize("seed", [5, pytest.param(6, marks=pytest.mark.slow)])
def test_own_work_differs_by_the_next_place(seed: int) -> None:
    card = learn_courses(_executions(seed, 60, by_fixture=True))
    (bench,) = (gate for gate in card.gates if (gate.agent, gate.at, gate.place) == ("operator", "leave", "bench"))
    usual_s = {one.place: float(np.median(one.own_s)) for one in bench.own_by if one.side == "next"}
    assert usual_s == {"fixture_1": pytest.approx(1.4, abs=0.2), "fixture_2": pytest.approx(5.5, abs=0.3)}
    gates = _gates(card)
    assert {place for place, gate in gates.items() if gate.conditions} == {"fixture_1", "fixture_2"}
    assert bench.conditions == ()
    assert any("own work" in line for line in habit_lines(card))


@pytest.mark.parametrize("seed", [7, pytest.param(8, marks=pytest.mark.slow)])
def test_own_work_that_does_not_differ_has_one_distribution(seed: int) -> None:
    assert all(not gate.own_by for gate in learn_courses(_executions(seed, 60)).gates)


def test_a_signal_of_a_place_whose_visits_are_all_trips_keeps_its_own_time() -> None:
    gate, rows = Gate("robot", "leave", "fixture_1"), np.arange(2)
    condition = Condition(Event("operator", "shelf", "leaves", "button"), 0)
    came, since = np.array([5.0, 7.0]), np.array([0.4, 0.6])
    found = Departures(gate, rows, rows, 0 * rows, came, came, came, {(gate, condition): since})
    visits = {"robot": [PlaceVisit("fixture_1", 1.0, 5.0)], "operator": [PlaceVisit("bench", 0.0, 9.0)]}
    courses = [ExecutionVisits(name, visits, events_of(visits)) for name in "ab"]  # type: ignore[arg-type]
    assert (since_given(courses, found, condition, {}) == since).all()
