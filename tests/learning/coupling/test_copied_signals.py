"""Signals of a PLC that repeat the robot's own inputs and outputs, and machines that work while the robot waits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.dataset.cards.dataset import ExecutionCard
from cyclekit.dataset.signals import SignalChanges
from cyclekit.learning.coupling.events.logged_visits import courses_of
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits
from cyclekit.learning.coupling.learn import learn_courses

EXECUTIONS, LONG_S = 24, 60.0
RNG = np.random.default_rng(5)
WORK_S = RNG.uniform(5.0, 9.0, EXECUTIONS)
ARRIVES_S = RNG.uniform(6.0, 14.0, EXECUTIONS)
BACK_S, BIN_S = 1.5, 3.0


def _tasks() -> pl.DataFrame:
    """A robot that gives a part to a machine, waits until its door has opened, and brings the part to a bin."""
    rows: list[dict[str, Any]] = []
    for number, (work_s, arrives_s) in enumerate(zip(WORK_S.tolist(), ARRIVES_S.tolist(), strict=True)):
        begin_s = number * LONG_S
        leaves_s = begin_s + arrives_s + 1.0 + work_s + BACK_S
        for index, (start, goal, start_s, arrival_s, end_s) in enumerate(
            (
                ("rest", "machine", begin_s + 1.0, begin_s + arrives_s, leaves_s),
                ("machine", "bin", leaves_s, leaves_s + 3.0, leaves_s + 3.0 + BIN_S),
                ("bin", "rest", leaves_s + 3.0 + BIN_S, leaves_s + 9.0, leaves_s + 9.0),
            )
        ):
            times = {"start_s": start_s, "arrival_s": arrival_s, "end_s": end_s, "execution": str(number)}
            rows.append({"agent": "robot", "start_place": start, "goal_place": goal, "index": index, **times})
    return schema.conform(pl.DataFrame(rows, infer_schema_length=None), schema.TASKS)


def _bit(seconds: list[list[float]], first: str) -> SignalChanges:
    """Return a bit that changes at these times of each execution."""
    t_s = np.array([number * LONG_S + s for number, some in enumerate(seconds) for s in some])
    return SignalChanges(np.append(-1.0, t_s), ((np.arange(len(t_s) + 1) + (first == "1")) % 2).astype(str))


CLOSES_S, OPENS_S = ARRIVES_S + 1.0, ARRIVES_S + 1.0 + WORK_S
DOOR = _bit(np.column_stack([CLOSES_S, OPENS_S]).tolist(), "1")
GRIPPER = _bit(np.column_stack([CLOSES_S - 0.1, OPENS_S + 1.4]).tolist(), "0")


def _courses(logs: dict[str, SignalChanges]) -> list[ExecutionVisits]:
    """Return the executions, of a robot log with two bits and a PLC's log with these signals."""
    bits = {"digital-output 0": GRIPPER, "digital-input 6": DOOR}
    clock = SimpleNamespace(rate=1.0, offset_s=0.0)
    records: Any = [
        SimpleNamespace(id="r", session="s", rows={"robot": 9}, tables=("robot",), clock=clock),
        SimpleNamespace(id="p", session="s", rows={"events": 9}, tables=("events",), clock=clock),
    ]
    events = pl.concat(
        pl.DataFrame({"t_s": changes.t_s, "signal": [name] * len(changes.t_s), "value": changes.value.tolist()})
        for name, changes in logs.items()
    )
    cards = [
        ExecutionCard(execution=str(n), session="s", start_s=n * LONG_S, end_s=n * LONG_S + 40.0, complete=True)
        for n in range(EXECUTIONS)
    ]

    def read(recording: str, table: str) -> pl.DataFrame | None:
        return events if (recording, table) == ("p", "events") else None

    return courses_of(cards, _tasks(), records, read, lambda record: bits if record.id == "r" else {})


def _scanned(changes: SignalChanges, seed: int) -> SignalChanges:
    """Return a bit as a PLC logs it: some hundredths of a second early or late."""
    late_s = np.random.default_rng(seed).uniform(-0.05, 0.07, len(changes.t_s))
    return SignalChanges(changes.t_s + late_s, changes.value)


def test_a_copy_of_the_robots_output_or_input_in_the_log_of_a_plc_is_no_signal_of_its_own() -> None:
    other = _bit([[20.0 + work_s, 30.0 + work_s] for work_s in WORK_S.tolist()], "0")
    found = _courses({"gripper": _scanned(GRIPPER, 1), "door": _scanned(DOOR, 2), "conveyor": other})
    names = {event.place for course in found for event in course.events if event.agent == "signal"}
    assert names == {"digital-input 6", "conveyor"}


def test_a_machine_that_closes_and_opens_its_door_while_the_robot_waits_is_not_open_before() -> None:
    at_s = np.random.default_rng(7).uniform(0.0, 30.0, EXECUTIONS).tolist()
    found = _courses({"conveyor": _bit([[s, s + 20.0] for s in at_s], "0")})
    opened = [course.events[Event("signal", "digital-input 6", "set")] for course in found]
    assert [len(at) for at in opened] == [1] * EXECUTIONS
    card = learn_courses(found)
    (gate,) = (gate for gate in card.gates if gate.conditions)
    (one,) = gate.conditions
    assert (gate.place, one.place, one.event, one.back) == ("machine", "digital-input 6", "set", 0)
    assert abs(float(np.median(one.lag_s)) - BACK_S) < 0.05
    (source,) = card.sources
    (after,) = source.after
    assert (after.place, after.event, after.back) == ("machine", "arrives", 0)
    assert abs(float(np.median(after.lag_s)) - (1.0 + float(np.median(WORK_S)))) < 0.5
