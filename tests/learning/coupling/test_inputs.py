"""Inputs of the robot are events of the operator where he gives them, and nothing where grippers or conveyors do."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.dataset.cards.dataset import ExecutionCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.signals import SignalChanges
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.coupling.events.logged_visits import courses_of
from cyclekit.learning.coupling.events.visits import Event

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells

EXECUTIONS, LONG_S = 8, 60.0
OPERATOR = (("shelf", 2.0, 9.0), ("handover", 12.0, 20.0), ("shelf", 25.0, 32.0), ("handover", 35.0, 44.0))


def _rows() -> pl.DataFrame:
    """Return the tasks of a robot that goes to and fro, and of an operator who is at two places twice each."""
    rows: list[dict[str, Any]] = []
    for number in range(EXECUTIONS):
        begin_s, name = number * LONG_S, str(number)
        for index, (start, goal, at_s) in enumerate((("bin", "handover", 8.0), ("handover", "bin", 48.0))):
            times = {"start_s": begin_s + at_s - 2.0, "arrival_s": begin_s + at_s}
            rows.append({"agent": "robot", "start_place": start, "goal_place": goal, "index": index, **times})
            rows[-1]["execution"] = name
        for index, (place, came_s, left_s) in enumerate(OPERATOR):
            times = {"start_s": begin_s + came_s, "arrival_s": begin_s + came_s, "end_s": begin_s + left_s}
            rows.append({"agent": "operator", "goal_place": place, "index": index, "execution": name, **times})
    return schema.conform(pl.DataFrame(rows, infer_schema_length=None), schema.TASKS)


def _changes(seconds: list[float]) -> SignalChanges:
    """Return a bit that is off at first and changes at these times of every execution."""
    t_s = np.array([number * LONG_S + s for number in range(EXECUTIONS) for s in seconds])
    return SignalChanges(np.append(-1.0, t_s), (np.arange(len(t_s) + 1) % 2).astype(str))


def test_inputs_that_the_operator_gives_are_events_of_his_and_others_are_left_out() -> None:
    bits = {
        "digital-input 2": _changes([19.7, 19.9, 43.7, 43.9]),  # a button, just before he goes
        "digital-input 4": _changes([12.2, 20.1, 35.3, 44.2]),  # a field that sees him
        "digital-output 0": _changes([15.0, 30.0, 39.0, 50.0]),
        "digital-input 7": _changes([15.1, 30.1, 39.1, 50.1]),  # the gripper tells that it has opened and closed
        "digital-input 8": _changes([10.5, 14.0, 27.0, 47.0]),  # a conveyor
        "digital-input 9": _changes([1.0, 40.0]),  # the program
    }
    records: Any = [
        SimpleNamespace(id="r", session="s", rows={"robot": 9}, clock=SimpleNamespace(rate=1.0, offset_s=0))
    ]
    cards = [
        ExecutionCard(execution=str(n), session="s", start_s=n * LONG_S, end_s=(n + 1) * LONG_S - 1.0, complete=True)
        for n in range(EXECUTIONS)
    ]
    courses = courses_of(cards, _rows(), records, lambda *_: None, lambda _: bits)
    assert len(courses) == EXECUTIONS
    found = {event for course in courses for event in course.events if event.signal or event.agent == "signal"}
    assert {(event.agent, event.place, event.event, event.signal) for event in found} == {
        ("operator", "handover", "leaves", "digital-input 2 set"),
        ("operator", "handover", "leaves", "digital-input 2 cleared"),
        ("operator", "handover", "arrives", "digital-input 4 set"),
        ("operator", "handover", "leaves", "digital-input 4 cleared"),
    }


def test_an_input_that_is_on_when_the_log_begins_was_set_before_the_execution() -> None:
    rows = _rows().filter(pl.col("agent") == "robot", pl.col("execution").is_in(["0", "1"]))
    records: Any = [
        SimpleNamespace(id=n, session=n, rows={"robot": 9}, clock=SimpleNamespace(rate=1.0, offset_s=0)) for n in "01"
    ]
    cards = [
        ExecutionCard(execution=n, session=n, start_s=start_s, end_s=start_s + 59.0, complete=True)
        for n, start_s in (("0", 0.0), ("1", 60.0))
    ]
    machine = {  # it is done when the first log begins, and goes off with the start output each time
        "0": SignalChanges(np.array([-1.0, 10.0, 40.0, 50.0]), np.array(list("1010"))),
        "1": SignalChanges(np.array([59.0, 66.0, 110.0]), np.array(list("010"))),
    }
    door = {  # set in the second log only
        "0": SignalChanges(np.array([-1.0, 30.0]), np.array(list("10"))),
        "1": SignalChanges(np.array([59.0, 70.0]), np.array(list("01"))),
    }
    start = {
        "0": SignalChanges(np.array([-1.0, 9.9, 10.4, 49.9, 50.4]), np.array(list("01010"))),
        "1": SignalChanges(np.array([59.0, 109.9, 110.4]), np.array(list("010"))),
    }
    names = ("digital-input 2", "digital-input 3", "digital-output 3")
    bits = {n: dict(zip(names, (machine[n], door[n], start[n]), strict=True)) for n in "01"}
    courses = courses_of(cards, rows, records, lambda *_: None, lambda record: bits[record.id])
    of_machine, of_door = (
        [one.events.get(Event("signal", name, "set"), np.empty(0)).tolist() for one in courses] for name in names[:2]
    )
    assert of_machine == [[-1.0, 40.0], [66.0]]
    assert of_door == [[-1.0], [70.0]]
    assert not any(Event("signal", names[0], "cleared") in one.events for one in courses)  # it answers the output


@pytest.mark.slow
def test_a_button_wired_to_the_robot_serves_without_being_told(cells: Cells, tmp_path: Path) -> None:
    logs = cells.logs("handover", 8, seed=31)
    told = (logs / "cell.toml").read_text(encoding="utf-8")
    cell = tmp_path / "cell.toml"
    cell.write_text(told.replace('map = { inputs = "events" }\n', ""), encoding="utf-8")
    assert cell.read_text(encoding="utf-8") != told
    ingest([logs], tmp_path / "dataset", cell=cell)
    card = Dataset.open(tmp_path / "dataset").card.coupling
    assert card is not None
    found = {(gate.agent, gate.place, one.signal) for gate in card.gates for one in gate.conditions}
    assert found == {("robot", "handover", "digital-input 2 set"), ("operator", "handover", None)}


def test_an_execution_that_the_log_cuts_tells_what_it_saw_and_one_that_began_unseen_nothing() -> None:
    """The robot of execution 6 has left the handover when its log ends; execution 7 begins there."""
    ends = pl.col("arrival_s") + 4.0
    rows = _rows().with_columns(end_s=pl.coalesce("end_s", ends), cut=pl.col("index") == 1)
    rows = rows.filter((pl.col("execution") != "6") | (pl.col("start_s") < 6 * LONG_S + 20.0))
    rows = rows.with_columns(cut=pl.col("cut") & (pl.col("agent") == "robot") & (pl.col("execution") != "6"))
    records: Any = [SimpleNamespace(id="r", session="s", rows={"robot": 9}, clock=SimpleNamespace(rate=1, offset_s=0))]
    went = [("bin", "handover", "bin")] * 6 + [("bin", "handover"), ("handover", "bin")]
    cards = [
        ExecutionCard(
            execution=str(n), session="s", start_s=n * LONG_S, end_s=n * LONG_S + 50.0, complete=n < 6, places=places
        )
        for n, places in enumerate(went)
    ]
    courses = courses_of(cards, rows, records, lambda *_: None, lambda _: {})
    assert [course.name for course in courses] == list("0123456")
    assert [visit.left_s - 6 * LONG_S for visit in courses[6].visits["robot"]] == [6.0, 12.0]
    assert [visit.place for visit in courses[6].visits["operator"]] == ["shelf", "handover"]
    assert np.isnan(courses[5].visits["robot"][-1].left_s)
