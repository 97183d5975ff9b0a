"""What is waited for at places of one kind is learned from all of them, where each shows too little alone."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.config import Wait
from cyclekit.dataset.cards.coupling import Agent, ConditionCard, CouplingCard
from cyclekit.learning.coupling.conditions.alike import number_of
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses

FIXTURES = (1, 2, 3, 4)
PARTS = 4


def _mounted(rng: np.random.Generator, name: str, free: tuple[int, ...] = ()) -> ExecutionVisits:
    """Return an execution in which a robot brings parts to any of four fixtures and the operator mounts them in order.

    He waits at his bench until the robot has left the fixture, it waits short of a fixture until he has left that one.
    At fixtures that are `free` nobody waits.
    """
    robot, operator = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("bench", 0.0, np.nan)]
    gone = dict.fromkeys(FIXTURES, -np.inf)
    at, free_s = 0.0, 0.0
    for number in rng.choice(FIXTURES, PARTS).tolist():
        reached = at + rng.uniform(3.0, 9.0)
        went_on = reached if number in free else max(reached, gone[number] + rng.uniform(0.1, 0.2))
        stood = went_on > reached
        robot.append(PlaceVisit(f"fixture_{number}", went_on + 1.0, went_on + 2.2, reached, went_on))
        if not stood and number == FIXTURES[-1]:
            robot[-1] = robot[-1]._replace(reached_s=np.nan, went_on_s=np.nan)
        at = robot[-1].left_s
        ready = free_s + rng.uniform(0.5, 6.0)
        left = ready if number in free else max(ready, at + rng.uniform(0.3, 0.8))
        operator[-1] = operator[-1]._replace(left_s=left)
        gone[number] = left + 2.0 + rng.uniform(4.0, 6.0)
        free_s = gone[number] + 2.0
        operator += [PlaceVisit(f"fixture_{number}", left + 2.0, gone[number]), PlaceVisit("bench", free_s, np.nan)]
    robot.append(PlaceVisit("home", at + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def _learned(seed: int, executions: int, free: tuple[int, ...] = (), *given: Wait) -> CouplingCard:
    rng = np.random.default_rng(seed)
    return learn_courses([_mounted(rng, str(number), free) for number in range(executions)], given)


def _found(card: CouplingCard) -> dict[tuple[str, str], ConditionCard]:
    return {(gate.agent, gate.place): one for gate in card.gates for one in gate.conditions}


def _needs(agent: str, numbers: tuple[int, ...] = FIXTURES) -> set[tuple[str, str]]:
    return {(agent, f"fixture_{number}") for number in numbers}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_few_executions_show_what_is_waited_for_at_each_of_four_fixtures(seed: int) -> None:
    found = _found(_learned(seed, 12))
    assert set(found) == _needs("robot") | _needs("operator")
    assert min(one.decided for one in found.values()) < 5  # too few by themselves
    for (agent, place), one in found.items():
        other, back, lag_s = ("operator", 1, 0.15) if agent == "robot" else ("robot", 0, 0.55)
        assert (one.agent, one.place, one.event, one.back) == (other, place, "leaves", back)
        assert np.median(one.lag_s) == pytest.approx(lag_s, abs=0.1)
        assert one.alike == sum(each.decided for (who, _), each in found.items() if who == agent)
    assert len({one.lag_s for (agent, _), one in found.items() if agent == "operator"}) == 1


ROBOT = dict(zip([f"fixture_{number}" for number in FIXTURES], ("left jig", "press", "vice", "rear"), strict=True))
OPERATOR = dict(zip(ROBOT, ("at left", "by the press", "bench end", "behind"), strict=True))


def _renamed(course: ExecutionVisits) -> ExecutionVisits:
    names: dict[Agent, dict[str, str]] = {"robot": ROBOT, "operator": OPERATOR}
    visits: dict[Agent, list[PlaceVisit]] = {
        agent: [one._replace(place=names[agent].get(one.place, one.place)) for one in some]
        for agent, some in course.visits.items()
    }
    return ExecutionVisits(course.name, visits, events_of(visits))


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_places_at_which_the_operator_waits_in_the_same_way_are_of_one_kind(seed: int) -> None:
    rng = np.random.default_rng(seed)
    courses = [_renamed(_mounted(rng, str(number))) for number in range(24)]
    found = _found(learn_courses(courses))
    for name, place in ROBOT.items():
        one = found["robot", place]
        assert (one.agent, one.place, one.event, one.back) == ("operator", OPERATOR[name], "leaves", 1)
        assert one.decided < one.alike == sum(each.decided for (who, _), each in found.items() if who == "robot")
    assert len(found) == 8


@pytest.mark.parametrize("seed", range(3))
def test_nobody_waits_at_places_of_any_name_where_nothing_is_coupled(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert not learn_courses([_renamed(_mounted(rng, str(number), FIXTURES)) for number in range(30)]).coupled


def test_numbers_of_places_that_nobody_named_tell_no_kind() -> None:
    rng = np.random.default_rng(1)
    courses = []
    for number in range(12):
        visits: dict[Agent, list[PlaceVisit]] = {
            agent: [one._replace(place=one.place.replace("fixture", called)) for one in some]
            for (agent, some), called in zip(_mounted(rng, "").visits.items(), ("place", "spot"), strict=True)
        }
        courses.append(ExecutionVisits(str(number), visits, events_of(visits)))
    assert not any(one.alike for gate in learn_courses(courses).gates for one in gate.conditions)


def test_a_fixture_where_nobody_waits_is_left_out() -> None:
    found = _found(_learned(4, 40, free=(2,)))
    assert set(found) == _needs("robot", (1, 3, 4)) | _needs("operator", (1, 3, 4))


@pytest.mark.parametrize("seed", range(4))
def test_nobody_waits_at_places_of_one_kind_where_nothing_is_coupled(seed: int) -> None:
    assert not _learned(seed, 30, free=FIXTURES).coupled


def test_the_cell_file_frees_one_place_of_a_kind() -> None:
    told = Wait("operator", before="fixture_3", never=True)
    found = _found(_learned(1, 12, (), told))
    assert set(found) == _needs("robot") | _needs("operator", (1, 2, 4))


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("fixture_2", ("fixture_#", "2")),
        ("station 12 left", ("station # left", "12")),
        ("press B", ("press #", "B")),
        ("release 3 set", ("release # set", "3")),
        ("bench", None),
    ],
)
def test_names_of_one_kind_differ_in_a_number_or_a_last_letter(name: str, parts: tuple[str, str] | None) -> None:
    assert number_of(name) == parts
