"""Counts of visits: who begins an execution at a place, or does several tasks there in one stay, has been there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses
from cyclekit.learning.coupling.waits import with_waits_named

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent, ConditionCard

PRESSED = Event("operator", "panel", "leaves", "start set")


def _welded(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return one in which he loads a fixture three times and presses at a panel; he goes back once the robot has left.

    Between two parts he may go to a bench, else he waits at the panel. Every second execution begins at the fixture.
    """
    operator, robot, pressed = list[PlaceVisit](), [PlaceVisit("home", 0.0, 0.0)], list[float]()
    at = rng.uniform(1.0, 2.0)
    if rng.random() < 0.5:
        operator.append(PlaceVisit("bench", at, at + rng.uniform(3.0, 9.0)))
        at = operator[-1].left_s + 1.5
    for turn in range(3):
        operator.append(PlaceVisit("fixture", at, at + rng.uniform(4.0, 6.0)))
        came = operator[-1].left_s + 1.0
        pressed.append(came + rng.uniform(0.8, 1.2))
        reached = robot[-1].left_s + rng.uniform(2.0, 14.0)
        went_on = max(reached, pressed[-1] + rng.uniform(0.1, 0.2))
        robot.append(PlaceVisit("seam", went_on + 1.0, went_on + rng.uniform(6.0, 7.0), reached, went_on))
        own = pressed[-1]
        if turn < 2 and rng.random() < 0.5:
            operator.append(PlaceVisit("panel", came, own))
            came, own = own + 1.5, own + 1.5 + rng.uniform(4.0, 12.0)
        place = "panel" if operator[-1].place == "fixture" else "bench"
        left = max(own, robot[-1].left_s + rng.uniform(0.3, 0.6)) if turn < 2 else own
        operator.append(PlaceVisit(place, came, left))
        at = left + 1.5
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    operator.append(PlaceVisit("office", at, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits) | {PRESSED: np.array(pressed)})


def _of(courses: list[ExecutionVisits], agent: str, place: str) -> list[ConditionCard]:
    card = learn_courses(courses)
    return [one for gate in card.gates for one in gate.conditions if (gate.agent, gate.place) == (agent, place)]


def test_executions_that_begin_at_the_place_count_that_visit() -> None:
    rng = np.random.default_rng(4)
    courses = [_welded(rng, str(n)) for n in range(40)]
    (one,) = _of(courses, "operator", "fixture")
    assert (one.agent, one.event, one.place, one.back) == ("robot", "leaves", "seam", 1)
    waited = 0
    for course in courses:
        welded, visits = course.events[Event("robot", "seam", "leaves")], course.visits["operator"]
        waited += sum(bool(((v.left_s - welded > 0.29) & (v.left_s - welded < 0.61)).any()) for v in visits[:-1])
    assert one.decided > 0.9 * waited > 30


def test_who_waits_at_the_button_lets_the_robot_go_on_before_he_leaves() -> None:
    rng = np.random.default_rng(4)
    (one,) = _of([_welded(rng, str(n)) for n in range(40)], "robot", "seam")
    assert (one.agent, one.place, one.signal) == ("operator", "panel", "start set")
    assert min(one.lag_s) > 0.05
    assert max(one.lag_s) < 0.25


def _shown(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return one in which the robot shows three parts until he nods by a button; he leaves as it goes on."""
    robot, operator, pressed = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("door", 0.0, 0.0)], list[float]()
    for _ in range(3):
        shown = robot[-1].left_s + rng.uniform(4.0, 14.0)
        begins = operator[-1].left_s + 1.5 if pressed else 0.0
        operator += [PlaceVisit("packing", begins, begins + rng.uniform(1.0, 8.0))]
        came = operator[-1].left_s + 1.5
        pressed.append(max(shown, came) + rng.uniform(2.0, 4.0))
        robot += [PlaceVisit("show", shown, pressed[-1] + rng.uniform(0.1, 0.7))]
        operator += [PlaceVisit("view", came, robot[-1].left_s + rng.uniform(0.1, 0.15))]
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    nod = {Event("operator", "view", "leaves", "nod set"): np.array(pressed)}
    return ExecutionVisits(name, visits, events_of(visits) | nod)


def test_who_presses_and_then_leaves_as_the_robot_goes_on_did_not_wait_for_it() -> None:
    rng = np.random.default_rng(5)
    courses = [_shown(rng, str(n)) for n in range(40)]
    found = {(g.agent, one.event, one.place) for g in learn_courses(courses).gates for one in g.conditions}
    assert ("robot", "leaves", "view") in found
    assert ("operator", "arrives", "show") in found
    assert ("operator", "leaves", "show") not in found


def test_waits_of_the_robot_are_named_also_where_he_stays_at_the_button() -> None:
    rng = np.random.default_rng(6)
    courses = [_welded(rng, str(n)) for n in range(40)]
    rows = [
        {"execution": one.name, "index": n, "agent": "robot", "arrival_s": visit.arrived_s, "end_s": visit.left_s}
        | {"dwell_s": visit.left_s - visit.arrived_s, "wait_s": visit.went_on_s - visit.reached_s}
        for one in courses
        for n, visit in enumerate(one.visits["robot"][1:])
    ]
    tasks = schema.conform(pl.DataFrame(rows), schema.TASKS)
    found = with_waits_named(tasks, courses, learn_courses(courses)).filter(
        pl.col("wait_s").is_finite() & (pl.col("wait_s") > 0.3)
    )
    assert found.height > 30
    assert found["waited_for"].drop_nulls().unique().to_list() == ["operator leaves panel (start set)"]
    assert found["waited_for"].null_count() == 0
