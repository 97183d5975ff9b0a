"""Who waits for whom is found from visits, and nobody is said to wait where nobody does."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.config import Wait
from cyclekit.dataset.cards.coupling import Agent
from cyclekit.errors import UnknownName
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses
from cyclekit.learning.coupling.waits import with_waits_named

ROBOT, OPERATOR = ("feeder", "fixture", "tray", "rack"), ("bench", "fixture", "shelf")


def _alone(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return an execution of two agents that do not see each other."""
    visits: dict[Agent, list[PlaceVisit]] = {
        "robot": _walk(rng, [str(place) for place in rng.choice(ROBOT, 12)], (0.5, 0.6), 2.0),
        "operator": _walk(rng, [str(place) for place in rng.choice(OPERATOR, 9)], (1.0, 4.0), 2.5),
    }
    return ExecutionVisits(name, visits, events_of(visits))


def _walk(rng: np.random.Generator, places: list[str], dwell_s: tuple[float, float], way_s: float) -> list[PlaceVisit]:
    at, found = 0.0, []
    for place in places:
        left = at + rng.uniform(*dwell_s)
        found.append(PlaceVisit(place, at, left))
        at = left + way_s * rng.uniform(0.8, 1.3)
    return found


def _coupled(rng: np.random.Generator, name: str, share: float = 1.0) -> ExecutionVisits:
    """Return one in which the robot brings parts to a fixture; the operator mounts each and lets the robot in again.

    Only with a `share` of the parts they wait for each other.
    """
    robot, operator, pressed = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("bench", 0.0, np.nan)], [-np.inf]
    free_s = 0.0
    for _ in range(3):
        at = robot[-1].left_s + rng.uniform(3.0, 14.0)
        waits = share == 1.0 or rng.random() < share
        reached, went_on = at, max(at, pressed[-1] + rng.uniform(0.1, 0.2)) if waits else at
        robot.append(PlaceVisit("fixture", went_on + 1.0, went_on + 2.2, reached, went_on))
        ready = free_s + rng.uniform(1.0, 12.0)
        left = max(ready, robot[-1].left_s + rng.uniform(0.3, 0.8)) if waits else ready
        operator[-1] = operator[-1]._replace(left_s=left)
        pressed.append(left + 2.0 + rng.uniform(5.0, 7.0))
        gone = pressed[-1] + rng.uniform(0.1, 0.4)
        free_s = gone + 2.0
        operator += [PlaceVisit("fixture", left + 2.0, gone), PlaceVisit("bench", free_s, np.nan)]
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    release = {Event("operator", "fixture", "leaves", "release set"): np.array(pressed[1:])}
    return ExecutionVisits(name, visits, events_of(visits) | release)


def _handed_over(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return one in which the robot always holds a part for seconds until the operator has taken it."""
    robot, operator, at, gone = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("bench", 0.0, 3.0)], 0.0, 0.0
    for _ in range(3):
        robot.append(PlaceVisit("bin", at + 2.0, at + 2.6))
        came = max(at + 4.6, gone + 8.0) + rng.uniform(1.5, 9.0)
        gone = came + rng.uniform(1.0, 2.0)
        robot.append(PlaceVisit("handover", at + 4.6, gone + rng.uniform(0.1, 0.5)))
        operator += [PlaceVisit("handover", came, gone), PlaceVisit("bench", gone + 2.0, gone + 6.0)]
        at = robot[-1].left_s
    robot.append(PlaceVisit("home", at + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def _taken(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return one in which the operator takes each part in a second or two; at half of them he is there before."""
    robot, operator, at, gone = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("bench", 0.0, 3.0)], 0.0, 0.0
    for _ in range(3):
        there = at + 4.6
        came = gone + 2.0 + rng.uniform(2.5, 4.5) + (0.0 if rng.random() < 0.5 else rng.uniform(3.0, 14.0))
        taken = max(came, there + rng.uniform(0.3, 0.8)) + rng.uniform(1.0, 2.0)
        gone = taken + rng.uniform(0.1, 0.4)
        robot.append(PlaceVisit("bin", at + 2.0, at + 2.6))
        robot.append(PlaceVisit("handover", there, taken + rng.uniform(0.1, 0.2) + 0.4))
        operator += [PlaceVisit("handover", came, gone), PlaceVisit("bench", gone + 2.0, gone + 4.0)]
        at = robot[-1].left_s + rng.uniform(0.0, 6.0)
    robot.append(PlaceVisit("home", at + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def test_short_waits_of_a_robot_that_always_waits_are_no_own_work() -> None:
    """Some waits are as long as each other by chance: then his departure seemed to follow the robot's work."""
    rng = np.random.default_rng(4)
    found = learn_courses([_taken(rng, str(number)) for number in range(40)])
    (gate,) = (gate for gate in found.gates if (gate.agent, gate.place) == ("robot", "handover"))
    (condition,) = gate.conditions
    assert (condition.agent, condition.place, condition.event, condition.back) == ("operator", "handover", "leaves", 0)
    assert (condition.decided, gate.passages) == (120, 120)


def _half_handed_over(rng: np.random.Generator, name: str, together: bool) -> ExecutionVisits:
    """Return one in which both wait for each other at half of the parts, at the same ones if they do so `together`."""
    robot, operator, at, free_s = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("bench", 0.0, 1.0)], 3.0, 1.0
    for _ in range(3):
        robot_waits, operator_waits = rng.random(2) < 0.5
        operator_waits = robot_waits if together else operator_waits
        arrives, came = at + 4.6, free_s + rng.uniform(2.0, 6.0)
        begins = max(came, arrives + rng.uniform(0.3, 0.8)) if operator_waits else came
        gone = begins + rng.uniform(1.0, 2.0)
        left = max(arrives + 0.4, gone + rng.uniform(0.1, 0.2)) if robot_waits else arrives + 0.4
        robot += [PlaceVisit("bin", at + 2.0, at + 2.6), PlaceVisit("handover", arrives, left)]
        free_s = gone + 2.0 + rng.uniform(1.0, 4.0)
        operator += [PlaceVisit("handover", came, gone), PlaceVisit("bench", gone + 2.0, free_s)]
        at = left + rng.uniform(0.0, 9.0)
    robot.append(PlaceVisit("home", at + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def _taken_again(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return one in which the robot brings each part, waits short of the fixture, and takes it when it is mounted."""
    robot, operator, at, free_s = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("bench", 0.0, np.nan)], 0.0, 0.0
    for _ in range(3):
        came = at + rng.uniform(3.0, 9.0)
        robot.append(PlaceVisit("fixture", came, came + 1.0))
        left = max(free_s + rng.uniform(1.0, 9.0), came + 1.0 + rng.uniform(0.3, 0.8))
        operator[-1] = operator[-1]._replace(left_s=left)
        gone = left + 1.5 + rng.uniform(4.0, 6.0)
        went_on = gone + rng.uniform(0.1, 0.2)
        robot.append(PlaceVisit("fixture", went_on + 0.8, went_on + 1.6, came + 2.0, went_on))
        at, free_s = went_on + 1.6, gone + 2.0
        operator += [PlaceVisit("fixture", left + 1.5, gone), PlaceVisit("bench", free_s, np.nan)]
    visits: dict[Agent, list[PlaceVisit]] = {
        "robot": [*robot, PlaceVisit("home", at + 2.0, np.nan)],
        "operator": operator,
    }
    return ExecutionVisits(name, visits, events_of(visits))


def test_a_robot_that_takes_again_what_it_brought_waits_at_every_second_visit() -> None:
    rng = np.random.default_rng(8)
    card = learn_courses([_taken_again(rng, str(number)) for number in range(30)])
    found = {(gate.agent, gate.place): gate.conditions for gate in card.gates if gate.conditions}
    assert set(found) == {("robot", "fixture"), ("operator", "fixture")}
    (robot,), (operator,) = found["robot", "fixture"], found["operator", "fixture"]
    assert (robot.agent, robot.place, robot.event) == ("operator", "fixture", "leaves")
    assert [robot.turns.event(passage, robot.back) for passage in range(6)] == [None, 0, None, 1, None, 2]
    assert (operator.agent, operator.place, operator.event) == ("robot", "fixture", "leaves")
    assert [operator.turns.event(passage, operator.back) for passage in range(3)] == [0, 2, 4]


@pytest.mark.parametrize("seed", [11, pytest.param(13, marks=pytest.mark.slow)])
def test_where_only_half_of_the_passages_wait_it_is_said_how_many(seed: int) -> None:
    rng = np.random.default_rng(seed)
    card = learn_courses([_coupled(rng, str(number), 0.5) for number in range(60)])
    found = {(gate.agent, gate.at, gate.place): gate.conditions for gate in card.gates if gate.conditions}
    assert set(found) == {("robot", "approach", "fixture"), ("operator", "approach", "fixture")}
    for (condition,), lag_s in zip(found.values(), (-0.1, 0.55), strict=True):
        assert condition.needed == pytest.approx(0.5, abs=0.15)
        assert condition.held < 0.98
        assert np.median(condition.lag_s) == pytest.approx(lag_s, abs=0.1)


@pytest.mark.parametrize("together", [True, False])
def test_whether_both_wait_in_the_same_passages_is_seen(together: bool) -> None:
    rng = np.random.default_rng(16)
    card = learn_courses([_half_handed_over(rng, str(number), together) for number in range(60)])
    found = {gate.agent: gate.conditions for gate in card.gates if gate.conditions}
    (robot,), (operator,) = found["robot"], found["operator"]
    assert robot.together == operator.together == int(together)
    assert (robot.needed == operator.needed) is together
    if together:  # what is seen of either agent counts for both
        assert robot.needed == pytest.approx(0.5, abs=0.06)


def test_who_leaves_just_after_the_robot_that_waited_for_him_does_not_wait_for_it() -> None:
    rng = np.random.default_rng(9)
    courses = []
    for number in range(30):
        visits = {agent: list(some) for agent, some in _handed_over(rng, str(number)).visits.items()}
        robot = [visit.left_s for visit in visits["robot"] if visit.place == "handover"]
        gone = [visit for visit in visits["operator"] if visit.place == "handover"]
        for visit, left_s in zip(gone, robot, strict=True):
            visits["operator"][visits["operator"].index(visit)] = visit._replace(left_s=left_s + rng.uniform(0.0, 0.3))
        courses.append(ExecutionVisits(str(number), visits, events_of(visits)))
    card = learn_courses(courses)
    found = {(gate.agent, one.agent, one.event, one.place) for gate in card.gates for one in gate.conditions}
    assert ("robot", "operator", "leaves", "handover") in found
    assert ("operator", "robot", "leaves", "handover") not in found


def _with_trips(rng: np.random.Generator, course: ExecutionVisits) -> ExecutionVisits:
    """Return the execution with trips to the shelf during some stays at the bench, and a robot that leaves late."""
    operator = []
    for visit in course.visits["operator"]:
        begin = visit.arrived_s
        if visit.place == "bench" and visit.left_s - begin > 6.0 and rng.random() < 0.6:
            gone, back = begin + rng.uniform(0.5, 1.0), begin + rng.uniform(5.0, 6.0)
            operator += [PlaceVisit("bench", begin, gone), PlaceVisit("shelf", gone + 1.5, back - 1.5)]
            begin = back
        operator.append(visit._replace(arrived_s=begin))
    late = (one._replace(left_s=one.left_s + 2.8) if one.place == "fixture" else one for one in course.visits["robot"])
    visits: dict[Agent, list[PlaceVisit]] = {"robot": list(late), "operator": operator}
    return ExecutionVisits(course.name, visits, events_of(visits))


@pytest.mark.parametrize("seed", [3, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (4, 5))])
def test_who_makes_trips_while_he_waits_still_waits_for_the_robot_in_all_passages(seed: int) -> None:
    rng = np.random.default_rng(seed)
    card = learn_courses([_with_trips(rng, _coupled(rng, str(number))) for number in range(40)])
    (gate,) = (gate for gate in card.gates if gate.agent == "operator" and gate.conditions)
    assert (gate.at, gate.place) in [("approach", "fixture"), ("leave", "bench")]  # from his bench he goes nowhere else
    assert [(one.agent, one.place, one.needed) for one in gate.conditions] == [("robot", "fixture", 1.0)]


def test_who_goes_just_before_the_robot_does_not_wait_for_it() -> None:
    """Of every second part the robot waits until the operator has it, and goes just after him."""
    rng = np.random.default_rng(12)
    courses = []
    for number in range(60):
        at, robot, operator = 0.0, [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("bench", 0.0, 1.0)]
        for _ in range(3):
            arrives, waits = at + 4.6, rng.random() < 0.5
            came = arrives + rng.uniform(-1.0, 6.0)
            gone = came + rng.uniform(1.0, 2.0)
            left = gone + rng.uniform(0.1, 0.2) if waits else arrives + 0.4
            robot += [PlaceVisit("bin", at + 2.0, at + 2.6), PlaceVisit("handover", arrives, left)]
            operator += [PlaceVisit("handover", came, gone), PlaceVisit("bench", gone + 2.0, gone + 3.0)]
            at = max(left, gone + 3.0)
        visits: dict[Agent, list[PlaceVisit]] = {
            "robot": [*robot, PlaceVisit("home", at + 2.0, np.nan)],
            "operator": operator,
        }
        courses.append(ExecutionVisits(str(number), visits, events_of(visits)))
    card = learn_courses(courses)
    found = {(gate.agent, one.agent, one.event, one.place) for gate in card.gates for one in gate.conditions}
    assert ("operator", "robot", "leaves", "handover") not in found


def test_own_work_where_the_robot_always_waits_is_that_of_its_other_places() -> None:
    rng = np.random.default_rng(7)
    card = learn_courses([_handed_over(rng, str(number)) for number in range(40)])
    (gate,) = (gate for gate in card.gates if (gate.agent, gate.place) == ("robot", "handover"))
    assert gate.own_s == pytest.approx((0.6,))
    assert [(one.place, one.event, one.decided) for one in gate.conditions] == [("handover", "leaves", 120)]


@pytest.mark.parametrize("signals", [True, False], ids=["release button", "positions only"])
def test_both_conditions_are_found_and_no_other(signals: bool) -> None:
    rng = np.random.default_rng(5)
    courses = [_coupled(rng, str(number)) for number in range(40)]
    if not signals:
        courses = [ExecutionVisits(one.name, one.visits, events_of(one.visits)) for one in courses]
    card = learn_courses(courses)
    found = {(gate.agent, gate.at, gate.place): gate for gate in card.gates if gate.conditions}
    assert set(found) == {("robot", "approach", "fixture"), ("operator", "approach", "fixture")}
    assert card.coupled
    (robot,), (operator,) = (gate.conditions for gate in found.values())
    assert (robot.agent, robot.place, robot.event, robot.back) == ("operator", "fixture", "leaves", 1)
    assert robot.signal == ("release set" if signals else None)
    assert np.median(robot.lag_s) == pytest.approx(-0.1, abs=0.1)  # from his leaving, which is after the button
    assert (operator.agent, operator.place, operator.event, operator.back) == ("robot", "fixture", "leaves", 0)
    assert np.median(operator.lag_s) == pytest.approx(0.55, abs=0.1)
    assert min(robot.held, operator.held) > 0.98
    assert min(robot.decided, operator.decided) >= 20


def test_the_cell_file_wins_over_what_the_logs_show() -> None:
    rng = np.random.default_rng(6)
    courses = [_coupled(rng, str(number)) for number in range(20)]
    told = (
        Wait("robot", before="fixture", never=True),
        Wait("operator", before="fixture", until="robot arrives fixture"),
    )
    card = learn_courses(courses, told)
    (gate,) = (gate for gate in card.gates if gate.conditions)
    assert (gate.agent, gate.at, gate.place, gate.told) == ("operator", "approach", "fixture", True)
    (condition,) = gate.conditions
    assert (condition.agent, condition.place, condition.event, condition.back) == ("robot", "fixture", "arrives", 0)
    assert np.median(condition.lag_s) == pytest.approx(1.75, abs=0.2)


@pytest.mark.parametrize(
    ("wait", "kind"),
    [
        (Wait("robot", before="fixtur", until="operator leaves fixture"), "place"),
        (Wait("robot", before="fixture", until="operator leaves banch"), "event"),
    ],
)
def test_a_told_wait_names_what_the_logs_show(wait: Wait, kind: str) -> None:
    courses = [_coupled(np.random.default_rng(number), str(number)) for number in range(5)]
    with pytest.raises(UnknownName, match=kind):
        learn_courses(courses, (wait,))


def test_parts_that_come_are_learned_from_their_sensor() -> None:
    rng = np.random.default_rng(7)
    card = learn_courses([_fed(rng, str(number)) for number in range(50)])
    (gate,) = (gate for gate in card.gates if gate.conditions)
    assert (gate.agent, gate.at, gate.place) == ("robot", "leave", "conveyor")
    (condition,), (source,) = gate.conditions, card.sources
    assert (condition.agent, condition.place, condition.event) == ("signal", "part", "set")
    assert (source.signal, source.taken_by, source.buffer) == ("part", "conveyor", 2)
    assert np.mean(source.gap_s) == pytest.approx(10.0, rel=0.1)


def _fed(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return an execution whose robot takes parts; they come 6 s apart or more, at most two of them wait."""
    robot, came, at = [PlaceVisit("home", 0.0, 0.0)], [-10.0], 2.0
    came[0] += 6.0 + rng.exponential(4.0) + 10.0
    for part in range(6):
        if part:
            room = robot[part - 1].left_s if part >= 2 else 0.0
            came.append(max(came[-1] + 6.0 + rng.exponential(4.0), room))
        left = max(at + 0.6, came[part] + rng.uniform(0.7, 0.8))
        robot.append(PlaceVisit("conveyor", at, left))
        at = left + rng.choice([4.0, 14.0])
    visits: dict[Agent, list[PlaceVisit]] = {"robot": [*robot, PlaceVisit("home", at, np.nan)]}
    visits["operator"] = _walk(rng, ["bench"] * 6, (1.0, 4.0), 2.5)
    return ExecutionVisits(name, visits, events_of(visits) | {Event("signal", "part", "set"): np.array(came)})


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 8))])
def test_agents_that_do_not_see_each_other_wait_for_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    card = learn_courses([_alone(rng, str(number)) for number in range(40)])
    assert not card.coupled
    assert {gate.agent for gate in card.gates} == {"robot", "operator"}  # they have gates of their own work


def _told(course: ExecutionVisits, index: int, visit: PlaceVisit) -> dict[str, object]:
    """Return what the table of tasks has of a task that ends with a visit of the robot."""
    times = {"arrival_s": visit.arrived_s, "end_s": visit.left_s}
    return {"execution": course.name, "index": index, "agent": "robot", **times}


def test_a_wait_at_a_place_is_all_of_the_standstill_but_the_own_work() -> None:
    rng = np.random.default_rng(7)
    courses = [_handed_over(rng, str(number)) for number in range(20)]
    rows = [
        {
            **_told(course, index, after),
            "dwell_s": after.left_s - after.arrived_s,
        }
        for course in courses
        for index, after in enumerate(course.visits["robot"][1:])
    ]
    tasks = schema.conform(pl.DataFrame(rows).with_columns(wait_s=0.0), schema.TASKS)
    found = with_waits_named(tasks, courses, learn_courses(courses)).filter(pl.col("waited_for").is_not_null())
    assert found.height == 60
    assert found["waited_for"].unique().to_list() == ["operator leaves handover"]
    assert found["dwell_s"].to_numpy() == pytest.approx(np.full(60, 0.6))
    assert (found["wait_s"] > 1.0).all()
