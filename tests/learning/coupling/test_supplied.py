"""A robot that often finds its part there when it comes, and else waits for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses
from cyclekit.learning.coupling.waits import with_waits_named

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent


def _supplied(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return one in which a part often lies there when the robot comes, else the robot waits for it."""
    robot, operator, came, at = [PlaceVisit("home", 0.0, 0.0)], [PlaceVisit("shelf", 0.0, np.nan)], [], 0.0
    for number in range(6):
        arrived = at + rng.uniform(2.0, 3.0)
        came.append(arrived + (rng.uniform(1.0, 6.0) if rng.random() < 0.3 else 0.004))
        stays_s = 0.75 if (name, number) == ("0", 0) else rng.uniform(0.885, 0.9)  # one was read too short
        robot.append(PlaceVisit("belt", arrived, came[-1] + stays_s))
        robot.append(PlaceVisit(f"tray {number % 2}", robot[-1].left_s + 2.0, robot[-1].left_s + 2.7))
        at = robot[-1].left_s
    robot.append(PlaceVisit("home", at + 2.0, np.nan))
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": operator}
    return ExecutionVisits(name, visits, events_of(visits) | {Event("signal", "part", "set"): np.array(came)})


def test_stays_that_are_all_as_short_as_each_other_are_own_work_and_no_wait() -> None:
    """A signal that comes when the robot does, and is followed by its process, does not make every stay a wait."""
    rng = np.random.default_rng(3)
    courses = [_supplied(rng, str(number)) for number in range(20)]
    (gate,) = (one for one in learn_courses(courses).gates if one.conditions)
    assert gate.place == "belt"
    assert gate.own_s == pytest.approx((0.89,), abs=0.02)


def test_a_wait_after_a_pause_on_the_way_keeps_its_seconds() -> None:
    rng = np.random.default_rng(7)
    courses = [_supplied(rng, str(number)) for number in range(20)]
    rows = [
        {
            "execution": course.name,
            "index": index,
            "agent": "robot",
            "arrival_s": after.arrived_s,
            "end_s": after.left_s,
            "dwell_s": 0.89,
            "wait_s": after.left_s - after.arrived_s - 0.89 + 10.0,
            "lost_wait_s": after.left_s - after.arrived_s - 0.89,
            "lost_pause_s": 10.0,
        }
        for course in courses
        for index, after in enumerate(course.visits["robot"][1:])
        if after.place == "belt" and after.left_s - after.arrived_s > 1.5
    ]
    tasks = schema.conform(pl.DataFrame(rows), schema.TASKS)
    found = with_waits_named(tasks, courses, learn_courses(courses))
    assert found["lost_wait_s"].to_numpy() == pytest.approx(tasks["lost_wait_s"].to_numpy(), abs=0.03)
    assert found["wait_s"].to_numpy() == pytest.approx(tasks["wait_s"].to_numpy(), abs=0.03)
