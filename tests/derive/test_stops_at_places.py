"""Standstills at places that were halts, told from waits by where people were."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cyclekit.derive.causes.cause_samples import Rows
from cyclekit.derive.causes.causes import Evidence
from cyclekit.derive.causes.stops_at_places import StopAtPlace, stops_at_places
from cyclekit.derive.causes.usual_levels import usual_levels
from cyclekit.segmentation.arrivals import PlaceStandstill
from cyclekit.segmentation.dwell import Dwell, EndSignal
from cyclekit.segmentation.executions import Execution, Visit
from cyclekit.segmentation.motion import ProgramStop as Pause
from cyclekit.segmentation.motion import RobotRun

ROWS = 300  # at 10 Hz
DWELL = {"b": Dwell(1.0, 1.2, EndSignal("gripper", 0.5, 0.6))}
ARRIVED_S, LEFT_S = 10.0, 16.0


def evidence() -> Evidence:
    """People within 1 m stop the robot."""
    distance = np.linspace(0.0, 3.0, 2000)
    features = np.column_stack([distance, distance, np.zeros(2000), distance])
    usual = usual_levels(features, (distance > 1.0).astype(np.int64), 2, np.arange(2000))
    return Evidence(1.0, np.array([0.0, 1.0]), usual, {}, (), {})


def samples(near_s: tuple[float, float]) -> Rows:
    """Return a robot that stands and somebody who is near it from and to some times."""
    t_s = np.arange(ROWS) / 10.0
    human_m = np.zeros((ROWS, 3))
    human_m[:, 1] = np.where((t_s >= near_s[0]) & (t_s < near_s[1]), 0.5, 2.5)
    none = np.zeros(ROWS, np.bool_)
    nothing = np.full(ROWS, np.nan)
    number = np.zeros(ROWS, np.int64)
    return Rows(
        t_s, number, number, ("a->b",), np.zeros((ROWS, 3)), human_m, none, none, nothing, nothing, number, none, {}
    )  # fmt: skip


def told(
    near_s: tuple[float, float], gripper_s: float, *, changes: dict[str, float] | None = None, overdue: int = 1,
    pauses: tuple[Pause, ...] = (),
) -> list[StopAtPlace]:  # fmt: skip
    """Return the halts of robots that stood at b from ARRIVED_S to LEFT_S, with a gripper that changed once."""
    t_s = np.arange(ROWS) / 10.0
    unknown = np.full(ROWS, np.nan)
    run = RobotRun(t_s, np.zeros((ROWS, 3)), np.zeros(ROWS), unknown, is_inferred=True, halts=pauses)
    visits = (Visit("a", 0, 20), Visit("b", 100, 160), Visit("c", 280, ROWS - 1))
    stand = PlaceStandstill(ARRIVED_S, ARRIVED_S, LEFT_S, LEFT_S, (("gripper", gripper_s), *(changes or {}).items()))
    work: Any = SimpleNamespace(
        runs={0: run}, executions=[Execution(0, visits, complete=True)], standstills={(0, 100, 160): stand}
    )
    return stops_at_places([(work, samples(near_s))] * overdue, DWELL, evidence())


def test_who_is_near_until_the_robot_leaves_stopped_it_after_its_process():
    assert told((8.0, 15.9), 10.5) == [StopAtPlace(0, 11.0, LEFT_S)]


def test_who_comes_while_the_robot_waits_stopped_it_from_then_on():
    ((_, first_s, last_s),) = told((13.0, 15.9), 10.5)
    assert (first_s, last_s) == (pytest.approx(13.0), LEFT_S)


def test_who_is_near_from_the_arrival_until_the_process_begins_stopped_it_before_its_place():
    assert told((9.0, 14.9), 15.5) == [StopAtPlace(0, ARRIVED_S, 15.0)]


def test_a_wait_with_nobody_near_before_the_process_is_a_wait():
    assert told((0.0, 1.0), 15.5) == []


def test_a_robot_that_seldom_stands_after_its_process_with_nobody_near_had_a_protective_stop():
    assert told((0.0, 1.0), 10.5) == [StopAtPlace(0, 11.0, LEFT_S)]
    assert told((0.0, 1.0), 10.5, overdue=10) == []  # it waits there often


def test_a_signal_just_before_it_leaves_is_what_it_waited_for():
    assert told((0.0, 1.0), 10.5, changes={"door": 15.8}) == []


def test_a_pause_may_have_paused_the_process():
    assert told((8.0, 15.9), 10.5, pauses=(Pause(120, 130, 1),)) == []
