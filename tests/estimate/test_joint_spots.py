"""Spots to which the operator goes only if he has to wait, and errands in the middle of his work, in joint rollouts."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

import msgspec
import pytest
from known_cells import Constant
from one_track import one_track

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard
from cyclekit.errors import EstimateError
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.roll import JointCell, RolledBoth
from cyclekit.estimate.robot.nominal import nominal_tasks

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.joint.roll import Plan

HOME_LEFT = ConditionCard(agent="robot", place="home", event="leaves", lag_s=(0.1,))
WAITS = GateCard(agent="operator", at="approach", place="out_left_1", conditions=(HOME_LEFT,), wait_at="rest")
OWN = GateCard(agent="operator", at="leave", place="inbound", own_s=(1.0,))


def _cell(logged: Dataset) -> JointCell:
    """Return a cell in which the operator stands at his rest place until the robot has left, if it has not yet."""
    return JointCell(Constant(1.0), logged, CouplingCard(gates=(WAITS, OWN)))


def _plan(cell: JointCell, robot_s: float, operator: tuple[str, ...]) -> Plan:
    tasks = [PlannedTask("robot", "home->conveyor", not_before_s=robot_s)]
    tasks += [PlannedTask("operator", place) for place in operator]
    return Planner(cell, nominal_tasks(cell.dataset)).plan(TaskSequence.of_plan("both", tasks))


def _rolled(cell: JointCell, plan: Plan) -> RolledBoth:
    (found,) = cell.roll([plan], cycles=50, until_s=300.0)
    if isinstance(found, EstimateError):
        raise found
    return found


def _ways_s(cell: JointCell, start: str, goal: str) -> set[float]:
    """Return how long logged walks between two places took, s."""
    return set(cell.segments.durations_s(cell.segments.walk(start, goal)).round(4).tolist())


@pytest.mark.parametrize("robot_s", [0.0, 40.0])
def test_he_goes_to_a_spot_only_if_he_has_to_wait(logged: Dataset, robot_s: float) -> None:
    cell = _cell(logged)
    (operator,) = _rolled(cell, _plan(cell, robot_s, ("inbound", "out_left_1"))).operators
    (hold,) = (n for n, leg in enumerate(operator.agenda.legs) if leg.hold)
    left_s, there_s = operator.times.passes_s[:, hold - 1], operator.times.arrives_s[:, hold]
    on_s, came_s = operator.times.passes_s[:, hold], operator.times.arrives_s[:, hold + 1]
    if robot_s == 0.0:  # it has left before he is done: he goes straight on
        assert on_s == pytest.approx(left_s)
        assert set((came_s - left_s).round(4).tolist()) <= _ways_s(cell, "inbound", "out_left_1")
    else:
        assert set((there_s - left_s).round(4).tolist()) <= _ways_s(cell, "inbound", "rest")
        assert on_s == pytest.approx(40.1, abs=0.1)
        assert set((came_s - on_s).round(4).tolist()) <= _ways_s(cell, "rest", "out_left_1")


def test_a_plan_that_begins_with_the_place_may_begin_at_the_spot(logged: Dataset) -> None:
    cell = _cell(logged)
    (operator,) = _rolled(cell, _plan(cell, 40.0, ("out_left_1",))).operators
    (hold,) = (n for n, leg in enumerate(operator.agenda.legs) if leg.hold)
    assert (operator.agenda.legs[hold].start, operator.agenda.legs[hold].place) == ("", "rest")
    assert operator.times.passes_s[:, hold] == pytest.approx(40.1, abs=0.1)


def test_a_plan_that_names_the_spot_waits_there(logged: Dataset) -> None:
    cell = _cell(logged)
    (operator,) = _rolled(cell, _plan(cell, 40.0, ("inbound", "rest", "out_left_1"))).operators
    (hold,) = (n for n, leg in enumerate(operator.agenda.legs) if leg.hold)
    assert not operator.agenda.legs[hold].if_waits
    assert operator.times.passes_s[:, hold] == pytest.approx(40.1, abs=0.1)


def test_the_search_goes_straight_where_he_need_not_wait(logged: Dataset) -> None:
    importlib.import_module("cyclekit.estimate.plan")  # before its search
    from cyclekit.estimate.joint.search import mean_times

    stays = msgspec.structs.replace(WAITS, wait_at=None)
    cell, plain = _cell(logged), JointCell(Constant(1.0), logged, CouplingCard(gates=(stays, OWN)))
    plans = [_plan(each, 0.0, ("inbound", "out_left_1")) for each in (cell, plain)]
    with_spot, without = (
        float(mean_times(each, [plan.robot], list(plan.operators), both=True)[0, 0])
        for each, plan in zip((cell, plain), plans, strict=True)
    )
    assert with_spot == pytest.approx(without, abs=1e-6)


def test_logged_errands_are_part_of_a_stay_and_spots_of_no_order(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """He goes from inbound to a shelf and back, stands aside at his rest place, and goes to the next place."""
    stays = (("inbound", 3.0), ("out_left_2", 2.0), ("inbound", 1.0), ("rest", 5.0), ("out_left_1", 4.0))
    found = one_track(logged, monkeypatch, stays, CouplingCard(gates=(WAITS,), errands=("out_left_2",)))
    assert [visit.place for visit in found.orders["1"]] == ["inbound", "out_left_1"]
    assert found.durations_s(found.stay("inbound")) == pytest.approx([8.0])  # 3 + 1 + 2 + 1 + 1 s
    assert found.durations_s(found.stay("rest")) == pytest.approx([5.0])
    assert found.durations_s(found.walk("rest", "out_left_1")) == pytest.approx([1.0])


def test_from_other_places_he_waits_where_he_is(logged: Dataset) -> None:
    gate = msgspec.structs.replace(WAITS, wait_from=("inbound",))
    cell = JointCell(Constant(1.0), logged, CouplingCard(gates=(gate, OWN)))
    legs = _plan(cell, 40.0, ("inbound", "out_left_1", "rest", "out_left_1")).operators[0].legs
    assert [(leg.place, leg.if_waits) for leg in legs if leg.hold] == [("rest", True), ("rest", False)]


def test_who_waits_at_the_place_of_his_next_task_has_left_it_before(logged: Dataset) -> None:
    gate = GateCard(agent="operator", at="approach", place="inbound", conditions=(HOME_LEFT,))
    cell = JointCell(Constant(1.0), logged, CouplingCard(gates=(gate, OWN)))
    legs = _plan(cell, 0.0, ("out_left_1", "inbound", "inbound")).operators[0].legs
    first = next(n for n, leg in enumerate(legs) if ("operator", "inbound", "arrives", 0) in leg.arrives)
    assert ("operator", "inbound", "leaves", 0) in legs[first].passes


def test_a_wait_before_the_first_task_is_none_of_its_way(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    stays = (("rest", 6.0), ("out_left_1", 4.0), ("inbound", 2.0))
    gate = GateCard(agent="operator", at="approach", place="out_left_1", conditions=(HOME_LEFT,))
    found = one_track(logged, monkeypatch, stays, CouplingCard(gates=(gate,)))
    assert found.durations_s(found.walk("", "out_left_1")) == pytest.approx([1.0])
    free = one_track(logged, monkeypatch, stays, CouplingCard(gates=()))
    assert free.durations_s(free.walk("", "out_left_1")) == pytest.approx([7.0])


def test_after_his_last_task_he_goes_where_he_went_in_the_logs(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    stays = (("inbound", 3.0), ("out_left_1", 4.0), ("rest", 5.0))
    found = one_track(logged, monkeypatch, stays, CouplingCard(gates=(WAITS,)))
    (number,) = found.after("out_left_1").tolist()  # "rest" is a spot where he only waits
    xyz_m, first, count = found.table()
    begin, end = first[number], first[number] + count[number] - 1
    places = logged.human_places
    assert xyz_m[begin, :2] == pytest.approx(places["out_left_1"].xyz_m[:2], abs=0.3)
    assert xyz_m[end, :2] == pytest.approx(places["rest"].xyz_m[:2], abs=0.3)
    assert found.durations_s(found.after("out_left_1")) == pytest.approx([1.0], abs=0.2)


def test_a_plan_begins_as_executions_that_begin_so(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    found = one_track(
        logged, monkeypatch, (("rest", 6.0), ("out_left_1", 4.0), ("inbound", 2.0)), CouplingCard(gates=())
    )
    assert found.durations_s(found.walk("", "out_left_1")) == pytest.approx([7.0])  # no execution begins with it
    found._ways["", "out_left_1"] = [found.stay("inbound")[0]] * 3
    assert found.walk("", "out_left_1").tolist() == [found.stay("inbound")[0]] * 3
