"""Trips of the operator while he waits, and own work by the next place, in joint rollouts."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

import numpy as np
import pytest
from known_cells import Constant
from one_track import one_track

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, OwnWorkCard, TripCard
from cyclekit.errors import EstimateError
from cyclekit.estimate.joint.draws import TripTimes
from cyclekit.estimate.joint.legs import Gates, operator_agenda
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.roll import JointCell, RolledBoth
from cyclekit.estimate.joint.shares import planned_shares
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.whatif.change import Change
from cyclekit.estimate.whatif.coupled import altered_coupling

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.joint.roll import Plan

HOME_LEFT = ConditionCard(agent="robot", place="home", event="leaves", lag_s=(0.5,))
TRIP = TripCard(places=("rest",), waiting=0.5, free=0.0, took_s=(40.0,) * 4, late_s=(1.0, 2.0, 3.0, 4.0))


def _cell(logged: Dataset, trip: TripCard) -> JointCell:
    """Return a cell in which the operator, at inbound, waits for the robot's first motion before he goes on."""
    gate = GateCard(agent="operator", at="approach", place="out_left_1", conditions=(HOME_LEFT,), trip=trip)
    own = GateCard(agent="operator", at="leave", place="inbound", own_s=(1.0,))
    return JointCell(Constant(1.0), logged, CouplingCard(gates=(gate, own)))


def _plan(cell: JointCell, robot_s: float, operator: tuple[str, ...]) -> Plan:
    tasks = [PlannedTask("robot", "home->conveyor", not_before_s=robot_s)]
    tasks += [PlannedTask("operator", place) for place in operator]
    return Planner(cell, nominal_tasks(cell.dataset)).plan(TaskSequence.of_plan("both", tasks))


def _rolled(cell: JointCell, plan: Plan, cycles: int = 100) -> RolledBoth:
    (found,) = cell.roll([plan], cycles=cycles, until_s=300.0)
    if isinstance(found, EstimateError):
        raise found
    return found


@pytest.mark.parametrize("robot_s", [0.0, 20.0])
def test_trips_are_made_in_their_share_of_the_waits_and_end_before_he_goes_on(logged: Dataset, robot_s: float) -> None:
    cell = _cell(logged, TRIP)
    found = _rolled(cell, _plan(cell, robot_s, ("inbound", "out_left_1")))
    (operator,) = found.operators
    (hold,) = (n for n, leg in enumerate(operator.agenda.legs) if leg.hold)
    went, stood_s = operator.times.trips[:, hold], operator.times.waits_s[:, hold]
    if robot_s == 0.0:  # it has left before he is done: he need not wait, and goes on no trip
        assert not went.any()
        assert stood_s == pytest.approx(0.0, abs=0.6)
    else:
        assert went.mean() == pytest.approx(0.5, abs=0.02)
        assert stood_s[went] == pytest.approx(40.0)
        assert operator.times.passes_s[~went, hold] == pytest.approx(robot_s + 0.5, abs=0.1)


def test_tasks_of_the_operator_end_with_the_cycle_of_places_and_with_his_own_in_a_plan(logged: Dataset) -> None:
    """The robot is done long before him: a plan waits for him, a sequence of places does not."""
    cell = _cell(logged, TRIP)
    planner = Planner(cell, nominal_tasks(cell.dataset))
    order = ("inbound", "out_left_1", "inbound", "out_left_1")
    both = _rolled(cell, _plan(cell, 0.0, order))
    alone = _rolled(cell, planner.plan(TaskSequence("places", ("home", "conveyor"), order)))
    ends, cut = ([one.end_s for one in planned_shares(each) if one.agent == "operator"] for each in (both, alone))
    assert len(ends) == 4
    assert max(ends) == pytest.approx(float(both.duration_s.mean()))
    assert 1 <= len(cut) < 4
    assert max(cut) <= float(alone.duration_s.mean()) + 1e-9
    assert max(ends) > float(alone.duration_s.mean()) + 1.0


def test_no_trips_are_added_to_a_plan_that_goes_there_itself(logged: Dataset) -> None:
    cell = _cell(logged, TRIP)
    found = _rolled(cell, _plan(cell, 20.0, ("inbound", "rest", "inbound", "out_left_1")), cycles=20)
    assert not found.operators[0].times.trips.any()


def test_logged_trips_are_cut_out_of_the_visits(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """He goes from inbound to his rest place, two metres away, and back, and then to the next place."""
    stays = (("inbound", 3.0), ("rest", 2.0), ("inbound", 1.0), ("out_left_1", 4.0))
    gate = GateCard(agent="operator", at="approach", place="out_left_1", conditions=(HOME_LEFT,), trip=TRIP)
    found = one_track(logged, monkeypatch, stays, CouplingCard(gates=(gate,)))
    assert [visit.place for visit in found.orders["1"]] == ["inbound", "out_left_1"]
    assert found.durations_s(found.trip("inbound")) == pytest.approx([4.0])  # from his leaving until he is back
    xyz_m, first, count = found.table()
    (number,) = found.trip("inbound")
    on_trip = xyz_m[first[number] : first[number] + count[number]]
    assert np.linalg.norm(on_trip - np.array(logged.human_places["rest"].xyz_m), axis=1).min() == 0.0
    plain = one_track(logged, monkeypatch, stays, None)
    assert [visit.place for visit in plain.orders["1"]] == [place for place, _ in stays]
    assert len(plain.trip("inbound")) == 0


def test_the_search_counts_trips_by_their_share(logged: Dataset) -> None:
    importlib.import_module("cyclekit.estimate.plan")  # before its search
    from cyclekit.estimate.joint.search import mean_times

    times = []
    for share in (0.0, 0.5, 1.0):
        cell = _cell(logged, TripCard(places=("rest",), waiting=share, took_s=(80.0,), late_s=(1.0,)))
        plan = _plan(cell, 20.0, ("inbound", "out_left_1"))
        times.append(float(mean_times(cell, [plan.robot], list(plan.operators), both=True)[0, 0]))
    assert times[0] < times[1] < times[2]
    assert times[2] - times[1] == pytest.approx(40.0, abs=0.1)


def test_a_trip_lasts_as_long_as_logged_ones_with_about_the_same_wait() -> None:
    late_s = tuple(np.arange(20.0).tolist())
    times = TripTimes(TripCard(places=("shelf",), waiting=1.0, took_s=late_s, late_s=late_s), pace=2.0)
    level = np.linspace(0.01, 0.99, 50)
    took_s = times.took_s(np.full(50, 10.0), level)
    assert (took_s.min(), took_s.max()) == (12.0, 26.0)  # eight neighbours, at twice the time
    assert times.took_s(np.array([-np.inf, np.inf]), np.array([0.0, 0.99])).tolist() == [0.0, 38.0]


def test_own_work_of_a_plan_is_that_before_the_next_place() -> None:
    by = tuple(OwnWorkCard(side="next", place=place, own_s=(s,)) for place, s in (("left", 2.0), ("right", 6.0)))
    before = (OwnWorkCard(side="before", place="left", own_s=(9.0,)),)
    waits = GateCard(agent="operator", at="approach", place="left", conditions=(HOME_LEFT,))
    cards = [
        GateCard(agent="operator", at="leave", place=p, own_s=(4.0,), own_by=b)
        for p, b in (("bench", by), ("rest", before))
    ]
    card = CouplingCard(gates=(waits, *cards))
    works = {place: np.ones(1) for place in ("bench", "left", "right", "rest")}
    agenda = operator_agenda(("bench", "left", "bench", "right", "bench", "rest"), Gates(card), works, {})
    assert [float(leg.own_s[0]) for leg in agenda.legs if leg.place == "bench" and not leg.hold] == [2.0, 6.0, 4.0]
    agenda = operator_agenda(("left", "rest"), Gates(card), works, {})
    assert float(agenda.legs[-1].own_s[0]) == 9.0
    quicker = altered_coupling(Change(name="quicker", faster={"operator": 2.0}), card)
    assert quicker is not None
    assert [one.own_s for gate in quicker.gates for one in gate.own_by] == [(1.0,), (3.0,), (4.5,)]


def test_without_a_wait_the_operators_work_is_what_it_was_and_so_are_his_orders(logged: Dataset) -> None:
    """His logged stays held the wait, which now is none, and he comes as often to the same work of the robot."""
    cell = _cell(logged, TRIP)
    change = Change(name="no wait", without_waits=("operator approach out_left_1",))
    card = altered_coupling(change, cell.coupling)
    altered = JointCell(Constant(1.0), logged, card, as_logged=cell.coupling)
    before, after = (Planner(each, nominal_tasks(logged)) for each in (cell, altered))
    assert before.waited_for == after.waited_for == {"home"}
    agenda = after.operator(("inbound", "out_left_1"), "test")
    assert [leg.hold for leg in agenda.legs] == [False, False, False]
    assert float(agenda.legs[1].own_s[0]) == 1.0
