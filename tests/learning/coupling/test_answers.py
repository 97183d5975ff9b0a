"""Cells without a tracker: what the robot waits for is found from its own visits and signals, and nothing else is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.cli.lists import coupling_table
from cyclekit.dataset.cards.coupling import Agent
from cyclekit.dataset.cards.dataset import ExecutionCard
from cyclekit.dataset.signals import SignalChanges
from cyclekit.learning.coupling.events.logged_visits import courses_of
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_courses, learn_executions

if TYPE_CHECKING:
    from simulated_cells import Cells

RELEASE = "digital-input 1"


def _course(name: str, robot: list[PlaceVisit], **signals: list[float]) -> ExecutionVisits:
    visits: dict[Agent, list[PlaceVisit]] = {"robot": robot, "operator": []}
    changes = {Event("signal", RELEASE, event): np.array(at) for event, at in signals.items()}
    return ExecutionVisits(name, visits, events_of(visits) | changes)


def _released(rng: np.random.Generator, name: str) -> ExecutionVisits:
    """Return one in which somebody mounts each part that the robot brings, between his own tasks, and releases it."""
    robot, pressed = [PlaceVisit("home", 0.0, 0.0)], list[float]()
    for turn in range(4):
        at = robot[-1].left_s + rng.uniform(3.0, 14.0)
        went_on = max(at, pressed[-1] + rng.uniform(0.1, 0.2)) if turn else at
        robot.append(PlaceVisit("fixture", went_on + 1.0, went_on + 2.2, at, went_on))
        free = (pressed[-1] if turn else 0.0) + 2.0 + rng.choice([0.0, 6.0, 12.0])
        pressed.append(max(free, robot[-1].left_s + rng.uniform(0.3, 0.8)) + rng.uniform(5.0, 7.0))
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    return _course(name, robot, set=pressed, cleared=[at + 0.3 for at in pressed])


def _gripped(rng: np.random.Generator, name: str, event: str, after_s: float) -> ExecutionVisits:
    """Return one in which a gripper closes and a signal tells that, or one changes because the robot goes."""
    robot, changes = [PlaceVisit("home", 0.0, 0.0)], list[float]()
    for _ in range(4):
        at = robot[-1].left_s + rng.uniform(3.0, 6.0)
        closed = at + rng.uniform(0.2, 0.6) if event == "set" else at + rng.uniform(0.5, 4.0)
        robot.append(PlaceVisit("bin", at, closed + 0.1))
        changes.append(closed + after_s)
    robot.append(PlaceVisit("home", robot[-1].left_s + 2.0, np.nan))
    return _course(name, robot, **{event: changes})


def test_a_release_is_waited_for_and_comes_after_what_the_robot_has_brought() -> None:
    rng = np.random.default_rng(5)
    found = learn_courses([_released(rng, str(n)) for n in range(60)])
    ((gate, one),) = [(gate, one) for gate in found.gates for one in gate.conditions]
    assert (gate.agent, gate.at, gate.place) == ("robot", "approach", "fixture")
    assert (one.agent, one.place, one.event, one.back) == ("signal", RELEASE, "set", 1)
    (source,) = found.sources
    (after,) = source.after
    assert (source.signal, source.event) == (RELEASE, "set")
    assert (after.agent, after.place, after.event, after.back) == ("robot", "fixture", "leaves", 0)
    assert after.lag_s[25] == pytest.approx(6.5, abs=0.3)
    assert source.gap_s[-5] == pytest.approx(20.0, abs=1.0)  # two tasks of his own in between
    said = coupling_table(found)
    assert f"{RELEASE} set comes" in said
    assert "after robot leaves fixture" in said


@pytest.mark.parametrize(("event", "after_s"), [("set", 0.0), ("cleared", 0.15)], ids=["gripper", "part taken away"])
def test_a_signal_of_the_robots_own_work_is_no_wait(event: str, after_s: float) -> None:
    rng = np.random.default_rng(6)
    assert not learn_courses([_gripped(rng, str(n), event, after_s) for n in range(60)]).coupled


def test_signals_in_another_order_are_no_waits_and_such_a_cell_has_no_card() -> None:
    rng = np.random.default_rng(7)
    courses = [_released(rng, str(n)) for n in range(60)]
    moved = [
        ExecutionVisits(one.name, one.visits, {**one.events, **{key: other.events[key] for key in _signals(other)}})
        for one, other in zip(courses, [*courses[7:], *courses[:7]], strict=True)
    ]
    assert learn_executions(moved, schema.empty(schema.TASKS)) is None


def _signals(course: ExecutionVisits) -> list[Event]:
    return [key for key in course.events if key.agent == "signal"]


def test_a_part_that_is_there_at_the_start_counts_and_fields_of_people_do_not() -> None:
    rows: list[dict[str, Any]] = [
        {"agent": "robot", "start_place": a, "goal_place": b, "index": n, "start_s": at, "arrival_s": at + 2.0}
        for n, (a, b, at) in enumerate((("home", "conveyor", 10.0), ("conveyor", "home", 14.0)))
    ]
    tasks = schema.conform(pl.DataFrame([{**row, "execution": "0"} for row in rows]), schema.TASKS)
    changes = SignalChanges(np.array([0.0, 7.0, 13.0, 15.0]), np.array(["0", "1", "0", "1"]))
    records: Any = [SimpleNamespace(id="r", session="s", rows={"robot": 9}, clock=SimpleNamespace(rate=1, offset_s=0))]
    cards = [ExecutionCard(execution="0", session="s", start_s=10.0, end_s=16.0, complete=True)]
    bits = {RELEASE: changes, "digital-input 4": changes}
    (course,) = courses_of(cards, tasks, records, lambda *_: None, lambda _: bits, ["digital-input 4"])
    assert {event.place for event in _signals(course)} == {RELEASE}
    assert course.events[Event("signal", RELEASE, "set")].tolist() == [7.0, 15.0]


@pytest.mark.slow
def test_the_waits_of_a_robot_without_a_tracker_are_those_of_the_truth(cells: Cells) -> None:
    cell = cells("shared-fixture", 16, seed=31, people="none")
    card = cell.dataset.card.coupling
    assert card is not None
    ((gate, one),) = [(gate, one) for gate in card.gates for one in gate.conditions]
    assert (gate.at, gate.place, one.place, one.event, one.back) == ("approach", "fixture", RELEASE, "set", 1)
    true = cell.tasks.filter(pl.col("agent") == "robot")
    mine = cell.dataset.tasks().filter(pl.col("waited_for").is_not_null())
    assert set(mine["waited_for"]) == {f"{RELEASE} set"}
    assert mine.height == pytest.approx(true["wait_ended_by"].count(), abs=4)
    assert mine["wait_s"].sum() == pytest.approx(true["wait_s"].sum(), rel=0.15)
