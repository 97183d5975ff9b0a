"""The operator's visits in joint rollouts: first stays, long stays of several tasks."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from one_track import many_tracks, one_track

from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, OwnWorkCard
from cyclekit.estimate.joint.legs import Gates, operator_agenda
from cyclekit.estimate.joint.long_stays import parted_stays
from cyclekit.estimate.joint.visits import Segments
from cyclekit.learning.coupling.events.visits import PlaceVisit

if TYPE_CHECKING:
    from simulated_cells import Cells

    from cyclekit.dataset.dataset import Dataset


def test_who_begins_at_a_place_leaves_it_as_late_as_he_did_in_the_logs() -> None:
    agenda = operator_agenda(
        ("rest", "inbound", "rest"), Gates(None), {"inbound": np.ones(1)}, {"rest": np.full(1, 0.7)}
    )
    assert [float(leg.own_s[0]) for leg in agenda.legs[1:]] == [0.7, 1.0, 0.0]  # at the end nothing is left to do
    known = operator_agenda(("rest",), Gates(None), {"rest": np.ones(1)}, {"rest": np.full(1, 0.7)})
    assert float(known.legs[1].own_s[0]) == 1.0  # of a place where he works the whole work is asked for


def test_who_begins_in_the_middle_of_his_work_has_the_rest_of_it_left_except_in_a_plan() -> None:
    needs = ConditionCard(agent="robot", place="fixture", event="leaves", lag_s=(0.5,))
    rest = OwnWorkCard(side="before", place="", own_s=(2.0,))
    gates = (
        GateCard(agent="operator", at="leave", place="bench", own_s=(8.0,), own_by=(rest,)),
        GateCard(agent="operator", at="approach", place="fixture", conditions=(needs,)),
    )
    ask = Gates(CouplingCard(gates=gates)), {"bench": np.full(1, 8.0), "fixture": np.ones(1)}, {}
    own_s = [
        [float(leg.own_s[0]) for leg in operator_agenda(("bench", "fixture", "bench"), *ask, begun=begun).legs
         if leg.task >= 0 and not leg.hold]
        for begun in (True, False)
    ]  # fmt: skip
    assert [one[0] for one in own_s] == [2.0, 8.0]
    assert [one[2] for one in own_s] == [8.0, 8.0]


def test_work_that_few_executions_show_to_its_end_is_still_work() -> None:
    """The robot ended all executions before he left a fixture, whose work is known from later on; he begins at rest."""
    needs = ConditionCard(agent="robot", place="jig", event="leaves", lag_s=(0.5,))
    gates = (
        GateCard(agent="operator", at="leave", place="jig", own_s=(6.0,)),
        GateCard(agent="operator", at="leave", place="rest", own_s=(0.9,)),
        GateCard(agent="operator", at="approach", place="jig", conditions=(needs,)),
    )
    agenda = operator_agenda(("rest", "jig", "rest"), Gates(CouplingCard(gates=gates)), {}, {"rest": np.full(1, 0.7)})
    own_s = [float(leg.own_s[0]) for leg in agenda.legs if leg.task >= 0 and not leg.hold]
    assert own_s == [0.7, 6.0, 0.0]


@pytest.mark.slow
def test_a_first_stay_too_short_to_be_seen_is_part_of_the_cycle(cells: Cells) -> None:
    """In this scene he stands at his rest place for 0.2 to 0.8 s when an execution begins; a stay lasts longer."""
    cell = cells("shared-fixture", 16, seed=31, signals=True)
    found = Segments(cell.dataset)
    stays_s = found.first_stays_s("rest")
    assert len(stays_s) == 16
    first = {order[order[0].place == "rest"].place for order in found.orders.values()}
    whole, walks = (sum(found.durations_s(found.walk(start, to)).sum() for to in first) for start in ("", "rest"))
    assert stays_s.sum() + walks == pytest.approx(whole, abs=16 * 0.11)
    assert stays_s.sum() > 16 * 0.5


@pytest.mark.slow
def test_one_long_stay_of_several_tasks_counts_as_several_visits(cells: Cells) -> None:
    """In this scene he checks three parts at his bench, sometimes one right after the other."""
    cell = cells("fed-line", 40, seed=31)
    found = Segments(cell.dataset)
    true = [row.split(",").count("bench") for row in cell.executions["operator_sequence"]]
    seen = cell.dataset.every_task().filter(agent="operator", goal_place="bench").height
    assert set(true) == {3}
    assert seen < 0.9 * 3 * 40
    visits = [sum(visit.place == "bench" for visit in found.orders[name]) for name in found.orders]
    assert np.mean(np.array(visits) == 3) > 0.9
    assert max(visits) == 3
    for order in found.orders.values():
        assert all(before.left_s <= after.arrived_s for before, after in pairwise(order))


def test_a_stay_is_parted_into_no_more_tasks_than_it_has_time_for() -> None:
    visits = [PlaceVisit("bench", 0.0, 6.2), PlaceVisit("shelf", 8.0, 20.0), PlaceVisit("bench", 22.0, 25.0)]
    parted = parted_stays(visits, "bench", 4, 2.0)
    assert [(visit.place, round(visit.arrived_s, 2)) for visit in parted] == [
        ("bench", 0.0),
        ("bench", 2.07),
        ("bench", 4.13),
        ("shelf", 8.0),
        ("bench", 22.0),
    ]
    assert parted_stays(visits, "bench", 2, 2.0) == tuple(visits)


@pytest.mark.parametrize("until_s", [6.4, 3.5])
def test_a_walk_that_ended_after_its_execution_counts(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch, until_s: float
) -> None:
    """Without them long walks would be missing, and there would be hardly any to the place where he ends his work."""
    stays = (("inbound", 3.0), ("out_left_1", 2.0), ("rest", 4.0))
    found = one_track(logged, monkeypatch, stays, None, until_s=until_s)
    for way in (("inbound", "out_left_1"), ("out_left_1", "rest")):
        (number,) = found.walk(*way).tolist()
        assert found.durations_s(np.array([number])) == pytest.approx([1.0])
        xyz_m, first, count = found.table()
        assert xyz_m[first[number] + count[number] - 1] == pytest.approx(logged.human_places[way[1]].xyz_m)
    assert {visit.place for visit in found.orders["1"]} <= {"inbound", "out_left_1"}


@pytest.mark.parametrize("lost", [False, True])
def test_a_seldom_way_on_which_a_stay_was_missed_takes_as_long_as_others(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch, lost: bool
) -> None:
    """The tracker lost him at the fixture once, so he seemed to walk from bench to shelf for eight seconds."""
    stays = [("inbound", 2.0), ("out_left_1", 6.0), ("rest", 2.0)] * 6
    found = one_track(logged, monkeypatch, stays, None, missed=[7], lost=lost)
    assert 0.5 < np.median(found.durations_s(found.walk("inbound", "rest"))) < 2.0
    assert len(found.walk("inbound", "out_left_1")) == 5


def test_who_idles_after_an_execution_is_on_no_walk(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    stays = (("inbound", 3.0), ("out_left_1", 2.0))
    found = one_track(logged, monkeypatch, stays, None, walks_s=60.0, until_s=5.0)
    assert found.durations_s(found.walk("inbound", "out_left_1")).max() < 30.0


def test_short_walks_within_a_long_stay_count_beside_the_longer_ones_that_are_seen(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two tasks of 3 s at one place with 0.8 s between them appear as one stay; once he was seen to walk, for 1 s."""
    apart = [("rest", 1.0), ("inbound", 3.0), ("out_left_1", 2.0), ("inbound", 3.0), ("rest", 4.0)]
    long = [("rest", 1.0), ("inbound", 6.8), ("out_left_1", 2.0), ("rest", 4.0)]
    seen = [("rest", 1.0), ("inbound", 3.0), ("inbound", 3.0), ("out_left_1", 2.0), ("rest", 4.0)]
    cut = [("rest", 1.0), ("out_left_1", 2.0), ("inbound", 6.8)]
    found = many_tracks(logged, monkeypatch, [apart] * 12 + [long] * 10 + [cut] + [seen])
    walks_s = np.sort(found.durations_s(found.walk("inbound", "inbound")))
    assert walks_s == pytest.approx([*[0.8] * 10, 1.0], abs=0.11)
    few = many_tracks(logged, monkeypatch, [apart] * 3 + [long] * 3 + [seen])
    assert few.durations_s(few.walk("inbound", "inbound")) == pytest.approx([1.0])  # too few to tell long stays


def test_tasks_that_follow_each_other_at_once_have_no_walk_between_them(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    apart = [("rest", 1.0), ("inbound", 2.8), ("out_left_1", 2.0), ("inbound", 3.2), ("rest", 4.0)]
    long = [("rest", 1.0), ("inbound", 5.9), ("out_left_1", 2.0), ("rest", 4.0)]
    seen = [("rest", 1.0), ("inbound", 3.0), ("inbound", 3.0), ("out_left_1", 2.0), ("rest", 4.0)]
    found = many_tracks(logged, monkeypatch, [apart] * 12 + [long] * 10 + [seen])
    assert np.sort(found.durations_s(found.walk("inbound", "inbound"))) == pytest.approx([*[0.0] * 10, 1.0])


def test_a_long_stay_with_a_wait_in_it_is_no_walk(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """He waits for seven seconds at the place; nobody walks for so long within it, as one walk that is seen tells."""
    apart = [("rest", 1.0), ("inbound", 3.0), ("out_left_1", 2.0), ("inbound", 3.0), ("rest", 4.0)]
    long = [("rest", 1.0), ("inbound", 13.0), ("out_left_1", 2.0), ("rest", 4.0)]
    seen = [("rest", 1.0), ("inbound", 3.0), ("inbound", 3.0), ("out_left_1", 2.0), ("rest", 4.0)]
    walks_s = [
        found.durations_s(found.walk("inbound", "inbound"))
        for some in ([seen], [])
        for found in [many_tracks(logged, monkeypatch, [apart] * 12 + [long] * 10 + some)]
    ]
    assert walks_s[0] == pytest.approx([1.0])
    assert walks_s[1].max() == 0.0  # none is seen
