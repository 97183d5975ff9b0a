"""Parts without a sensor are found by the robot's standstills alone; standstills that merely vary are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.dataset.cards.coupling import Agent
from cyclekit.learning.coupling.events.part_visits import PartVisits, Times
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import MAX_EXECUTIONS, learn_courses, learn_executions
from cyclekit.learning.coupling.parts.part_chains import succession
from cyclekit.learning.coupling.parts.part_gaps import _fast, part_gaps
from cyclekit.learning.coupling.parts.unseen_parts import part_arrivals
from cyclekit.learning.coupling.waits import with_waits_named

GAP_S = 6.0, 4.0  # at least, and what comes on top on average


def _fed(rng: np.random.Generator, name: str, buffer: int | None) -> ExecutionVisits:
    """Return an execution whose robot takes parts from a belt and sorts others meanwhile.

    They come GAP_S apart, at most `buffer` of them wait; None: a part is always there, and its process varies as much.
    """
    at, robot, came = 0.0, [PlaceVisit("home", 0.0, 0.0)], [0.0]
    for part in range(6):
        at = _sorted(robot, rng, at, int(rng.choice([1, 1, 10])))
        came.append(came[-1] + GAP_S[0] + rng.exponential(GAP_S[1]))
        if buffer is not None and part >= buffer:
            came[-1] = max(came[-1], [each.left_s for each in robot if each.place == "belt"][part - buffer])
        waits_s = max(came[-1] - at, 0.0) if buffer is not None else max(rng.normal(0.0, 4.0), 0.0)
        robot.append(PlaceVisit("belt", at, at + waits_s + rng.uniform(0.6, 0.61)))
        at = robot[-1].left_s + 2.0
    robot.append(PlaceVisit("home", at, np.nan))
    operator, at = [], 0.0
    for _ in range(6):
        operator.append(PlaceVisit("bench", at, at + rng.uniform(1.0, 4.0)))
        operator.append(
            PlaceVisit("shelf", operator[-1].left_s + 2.0, operator[-1].left_s + 2.0 + rng.uniform(1.0, 4.0))
        )
        at = operator[-1].left_s + 2.0
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits))


def _sorted(robot: list[PlaceVisit], rng: np.random.Generator, at: float, count: int) -> float:
    for _ in range(count):
        robot.append(PlaceVisit(f"tray {rng.integers(3)}", at, at + 0.5))
        at += 2.5
    return at


@pytest.mark.parametrize("buffer", [2, pytest.param(1, marks=pytest.mark.slow)])
def test_parts_are_learned_from_standstills_alone(buffer: int) -> None:
    rng = np.random.default_rng(3)
    card = learn_courses([_fed(rng, str(number), buffer) for number in range(60)])
    (gate,) = (gate for gate in card.gates if gate.conditions)
    (condition,), (source,) = gate.conditions, card.sources
    assert (gate.agent, gate.at, gate.place) == ("robot", "leave", "belt")
    assert (condition.agent, condition.place, condition.event) == ("signal", "part at belt", "arrives")
    assert (source.signal, source.taken_by, source.inferred) == ("part at belt", "belt", True)
    assert np.mean(source.gap_s) == pytest.approx(sum(GAP_S), rel=0.15)
    assert np.mean(source.first_s) == pytest.approx(sum(GAP_S), rel=0.15)
    assert np.median(gate.own_s) == pytest.approx(0.605, abs=0.01)
    assert source.buffer == buffer


def test_few_executions_show_parts() -> None:
    rng = np.random.default_rng(3)
    card = learn_courses([_fed(rng, str(number), 2) for number in range(9)])
    assert [source.signal for source in card.sources] == ["part at belt"]


def _running_on(
    rng: np.random.Generator, count: int, parts: int, buffer: int, gap_s: float = 12.0
) -> list[ExecutionVisits]:
    """Return executions one after the other at a belt that never stops; each takes so many parts from it."""
    at, came, taken, found = 0.0, 0.0, list[float](), list[ExecutionVisits]()
    for number in range(count):
        robot, begin = [PlaceVisit("home", at, at)], at
        for _ in range(parts):
            at = _sorted(robot, rng, at + 2.0, int(rng.choice([1, 1, 6])))
            came += gap_s - 4.0 + rng.exponential(4.0)
            came = max(came, taken[-buffer] if len(taken) >= buffer else 0.0)
            taken.append(max(at, came) + rng.uniform(0.6, 0.61))
            robot.append(PlaceVisit("belt", at, taken[-1]))
            at = taken[-1] + 2.0
        robot.append(PlaceVisit("home", at, np.nan))
        operator = [PlaceVisit("bench", begin, begin + rng.uniform(1.0, 4.0)), PlaceVisit("shelf", begin + 6.0, np.nan)]
        visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
        found.append(ExecutionVisits(str(number), visits, events_of(visits), "shift", number=number))
        at += rng.uniform(1.0, 3.0)
    return found


@pytest.mark.parametrize(
    ("parts", "buffer", "gap_s"), [pytest.param(3, 1, 12.0, marks=pytest.mark.slow), (3, 2, 12.0), (1, 1, 16.0)]
)
def test_a_belt_that_runs_on_between_executions_is_found(parts: int, buffer: int, gap_s: float) -> None:
    courses = _running_on(np.random.default_rng(5), 180 // parts, parts, buffer, gap_s)
    (source,) = learn_courses(courses).sources
    assert (source.signal, source.buffer, source.comes_on) == ("part at belt", buffer, True)
    assert np.mean(source.gap_s) == pytest.approx(gap_s, rel=0.1)
    came_before = np.mean(np.array(source.first_s) < 0.0)
    firsts = [next(visit for visit in course.visits["robot"] if visit.place == "belt") for course in courses]
    assert 0.05 < came_before < np.mean([visit.left_s - visit.arrived_s < 0.7 for visit in firsts])


def test_a_belt_that_runs_on_is_found_in_more_executions_than_are_learned_from() -> None:
    """Executions that follow each other tell when parts came, so some of these are among those learned from."""
    courses = _running_on(np.random.default_rng(5), MAX_EXECUTIONS + 20, 1, 1, 16.0)
    card = learn_executions(courses, schema.empty(schema.TASKS))
    assert card is not None
    assert [(source.signal, source.buffer, source.comes_on) for source in card.sources] == [("part at belt", 1, True)]


def test_executions_that_are_not_known_to_follow_each_other_tell_nothing_of_it() -> None:
    courses = [replace(each, session=each.name) for each in _running_on(np.random.default_rng(5), 90, 1, 1, 16.0)]
    assert learn_courses(courses).sources == ()


def test_gaps_too_short_to_be_seen_may_be_any_that_are_shorter() -> None:
    """In a burst the robot waits for the first part only: no gap within it is seen."""
    seen = Times(np.array([10.0, 12.0]), np.array([0.2, 0.3]))
    drawn_s = seen.drawn((20000,), np.random.default_rng(0))
    assert [np.mean(drawn_s == at) for at in (10.0, 12.0)] == pytest.approx([0.2, 0.3], abs=0.01)
    assert np.quantile(drawn_s[drawn_s < 10.0], [0.1, 0.5, 0.9]) == pytest.approx([1.0, 5.0, 9.0], abs=0.2)


def test_parts_that_come_in_bursts_are_found() -> None:
    """The robot waits for the first part of a burst only; what it sees after such waits tells little of the others."""
    rng = np.random.default_rng(3)
    trip_s = rng.choice([2.0, 5.0, 10.0, 15.0, 20.0], (80, 3)) + rng.uniform(0.0, 0.5, (80, 3))
    gap_s = np.where(rng.random((80, 3)) < 0.6, rng.uniform(1.0, 3.0, (80, 3)), rng.uniform(15.0, 26.0, (80, 3)))
    part_s = np.cumsum(gap_s, axis=1)
    came_s, left_s, at_s = np.empty((80, 3)), np.empty((80, 3)), np.zeros(80)
    for number in range(3):
        came_s[:, number] = at_s + trip_s[:, number]
        left_s[:, number] = at_s = np.maximum(came_s[:, number], part_s[:, number]) + 0.6
    apart = succession(["shift"] * 80, range(80), range(0, 8000, 100), range(50, 8050, 100))
    found = part_arrivals(PartVisits(came_s, left_s, 0.6), apart)
    assert found is not None
    assert np.mean(found.gap_s) == pytest.approx(0.6 * 2.0 + 0.4 * 20.5, rel=0.25)
    assert min(found.first_s) >= 0.0


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_dwell_that_merely_varies_is_no_wait_for_parts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    card = learn_courses([_fed(rng, str(number), None) for number in range(40)])
    assert card.sources == ()
    assert not card.coupled


@pytest.mark.parametrize("latest_s", [16.1, pytest.param(46.3, id="transform of odd size")])
def test_gaps_after_parts_that_the_robot_did_not_wait_for_count(latest_s: float) -> None:
    """After a wait the robot is away for too long to see the short gaps; else it comes back soon."""
    rng = np.random.default_rng(0)
    came_s = np.array([(1.0, 16.1) if number % 3 == 0 else (10.0, 12.6) for number in range(120)])
    came_s[1, 1] = latest_s
    parts_s = np.cumsum(np.column_stack([rng.uniform(2.7, 3.3, 120), rng.choice([11.0, 14.0], 120)]), axis=1)
    visits = PartVisits(came_s, np.maximum(came_s, parts_s) + 0.6, 0.6)
    at, first, gaps = part_gaps(visits, Times(np.array([3.0]), np.ones(1)), Times(np.array([14.0]), np.ones(1)), 2)
    assert first[(at > 2.5) & (at < 3.5)].sum() == pytest.approx(1.0, abs=0.01)
    assert gaps[(at > 10.0) & (at < 12.0)].sum() == pytest.approx(0.5, abs=0.1)
    assert gaps[(at > 13.0) & (at < 15.0)].sum() == pytest.approx(0.5, abs=0.1)


def test_the_density_of_many_times_is_that_of_each_alone() -> None:
    rng = np.random.default_rng(0)
    times = Times(rng.uniform(0.0, 20.0, 50), np.full(50, 0.02))
    asked_s = rng.uniform(0.0, 30.0, (4, 7))
    asked_s[2, 3] = times.at[5]
    each = [[times.density(np.array([at_s]))[0] for at_s in row] for row in asked_s]
    assert times.density(asked_s) == pytest.approx(np.array(each), rel=1e-12)


def test_transforms_have_sizes_that_are_fast() -> None:
    assert [_fast(size) for size in (2, 526, 1024, 2047)] == [2, 540, 1024, 2048]


def test_a_wait_for_such_a_part_is_named() -> None:
    rng = np.random.default_rng(3)
    courses = [_fed(rng, str(number), 2) for number in range(25)]
    rows = [
        {
            "execution": course.name,
            "index": index,
            "agent": "robot",
            "arrival_s": visit.arrived_s,
            "end_s": visit.left_s,
            "dwell_s": visit.left_s - visit.arrived_s,
            "wait_s": 0.0,
        }
        for course in courses
        for index, visit in enumerate(course.visits["robot"][1:])
    ]
    tasks = schema.conform(pl.DataFrame(rows), schema.TASKS)
    found = with_waits_named(tasks, courses, learn_courses(courses))
    named = found.filter(pl.col("waited_for").is_not_null())
    assert named["waited_for"].unique().to_list() == ["part at belt arrives"]
    long = tasks.filter(pl.col("dwell_s").is_between(0.95, 1000.0))
    assert named.height == long.height
    assert named["wait_s"].sum() == pytest.approx((long["dwell_s"] - 0.605).sum(), rel=0.02)
    assert named["dwell_s"].to_numpy() == pytest.approx(np.full(named.height, 0.605), abs=0.02)
