"""The part to play with where the operator goes to a spot only if he has to wait: the library's own numbers."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import browser
import numpy as np
import pytest
from known_cells import logged
from msgspec import structs
from played import STAIRS, ask, both, same, some_deadlocks_are_left_out, staircase

from cyclekit import TaskSequence
from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.cards import (
    ConditionCard,
    CouplingCard,
    GateCard,
    OperatorPaceCard,
    OwnWorkCard,
    TrainingCard,
)
from cyclekit.dataset.cards.coupling import CommonPaceCard, TrendCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif import what_if
from cyclekit.estimate.whatif.change import Change
from cyclekit.report import compose_report

__all__ = ["logged", "some_deadlocks_are_left_out"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not())),
]
LEAVES = ConditionCard(agent="robot", place="conveyor", event="leaves", lag_s=(0.2, 0.5, 1.5))
BEGUN = OwnWorkCard(side="before", place="", own_s=(0.2, 0.4))
CARD = CouplingCard(
    gates=(
        GateCard(agent="operator", at="leave", place="inbound", own_s=(1.0, 2.0, 9.0), own_by=(BEGUN,)),
        GateCard(agent="operator", at="approach", place="inbound", conditions=(LEAVES,), wait_at="rest"),
        GateCard(agent="operator", at="approach", place="out_right_2", wait_at="out_right_3",
                 conditions=(structs.replace(LEAVES, place="left_2", needed=0.7),)),
        GateCard(agent="robot", at="leave", place="conveyor", own_s=(0.5, 0.7, 1.4), conditions=(
            ConditionCard(agent="operator", place="inbound", event="leaves", back=1, needed=0.2, lag_s=(0.1, 0.9)),)),
    ),
)  # fmt: skip
ROBOT = ("home", "conveyor", "left_2", "conveyor", "right_3")
OPERATOR = ("inbound", "out_right_1", "inbound", "out_right_2", "out_right_2", "rest")
NAMED = ("inbound", "rest", "inbound", "out_right_3", "out_right_2", "rest")
AHEAD = (*OPERATOR[1:], "inbound", "out_right_1", "inbound")
TOLD = TaskSequence.of_plan("told", [
    PlannedTask("operator", "out_right_1"),
    *(PlannedTask("robot", f"{start}->{goal}") for start, goal in pairwise(ROBOT)),
    PlannedTask("operator", "out_right_2", not_before_s=25.0),
    PlannedTask("operator", "inbound", after=("left_2->conveyor",)),
])  # fmt: skip
ORDERS = [
    both(ROBOT, OPERATOR, "given"), both(ROBOT, NAMED, "named"), TaskSequence("places", ROBOT, OPERATOR),
    TaskSequence("ahead", ROBOT, AHEAD), TOLD,
]  # fmt: skip
ASKED = {"given": (OPERATOR, True), "named": (NAMED, True), "places": (OPERATOR, False), "ahead": (AHEAD, False)}
CHANGES = {
    "faster": ({"pace": 1.3}, Change("p", faster={"operator": 1.3})),
    "no wait": ({"without": ["operator before inbound"]}, Change("n", without_waits=("operator approach inbound",))),
    "ramp": STAIRS["ramp"],
}
ANYWHERE = {"other_cell": True, "extrapolate": True}
GIVEN = {"robot": ROBOT, "operator": OPERATOR, "both": True}


def played_page(tab, logged, page, card, orders):
    """Return the cell and the library's answers; show their page."""
    data, model = Dataset.open(logged.path), replace(staircase(), card=TrainingCard(coupling=card))
    data.card = structs.replace(data.card, coupling=card)
    given = {each.name: each for each in estimate(model, data, orders, takt_s=60.0, **ANYWHERE)}
    assert compose_report(data, model, page, estimates=list(given.values()), takt_s=60.0).missing == ()
    tab.show(page)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    return data, model, given


def test_spots_are_gone_to_as_in_the_library(tab, logged, tmp_path):
    data, model, given = played_page(tab, logged, tmp_path / "page.html", CARD, ORDERS)
    stays = structs.replace(CARD, gates=tuple(structs.replace(gate, wait_at=None) for gate in CARD.gates))
    (no_spots,) = estimate(replace(model, card=TrainingCard(coupling=stays)), data, ORDERS[:1], **ANYWHERE)
    assert abs(given["given"].expected_s - no_spots.expected_s) > 0.5  # or the test would show nothing
    for name, (operator, plan) in ASKED.items():
        same(ask(tab, {"robot": ROBOT, "operator": operator, "both": plan}, {}, 60), given[name], within=1e-5)
    begin = (
        "(s => { s.value = [...s.options].find(o => o.text === 'told').value; s.dispatchEvent(new Event('change')); })"
    )
    tab.ask(f"{begin}(document.querySelector('#play select'))")
    same(ask(tab, tab.ask("cyclekitPlay.now()"), {}, 60), given["told"], within=1e-5)
    for changes, change in CHANGES.values():
        (found,) = what_if(model, data, ORDERS[:1], [change], check=given["given"].check, **ANYWHERE)
        same(ask(tab, GIVEN, changes), found.after, within=1e-5)
    assert tab.said() == []


def test_walks_have_the_latest_pace_of_an_operator_who_became_quicker(tab, logged, tmp_path):
    names = tuple(one.execution for one in logged.card.executions)
    pace = OperatorPaceCard(executions=names, walk=TrendCard(change=-0.4, count=len(names), error=0.1))
    card = structs.replace(CARD, pace=pace)
    _, _, given = played_page(tab, logged, tmp_path / "page.html", card, ORDERS[:1])
    same(ask(tab, GIVEN, {}, 60), given["given"], within=1e-5)
    assert tab.said() == []


def test_durations_of_one_cycle_move_together_as_in_the_library(tab, logged, tmp_path):
    """Slower and quicker people: works, walks and a lag share a part, and sessions of people who came once."""
    common = CommonPaceCard(work=0.3, walk=0.15, together=0.6, between=1.0, sessions=4, once=0.5)
    gates = tuple(
        structs.replace(gate, conditions=tuple(structs.replace(one, common=0.7) for one in gate.conditions))
        for gate in CARD.gates
    )
    card = structs.replace(CARD, gates=gates, common=common)
    data, model, given = played_page(tab, logged, tmp_path / "page.html", card, ORDERS)
    (apart,) = estimate(replace(model, card=TrainingCard(coupling=CARD)), data, ORDERS[:1], takt_s=60.0, **ANYWHERE)
    assert np.std(given["given"].durations_s) > 1.1 * np.std(apart.durations_s)  # or the test would show nothing
    for name, (operator, plan) in ASKED.items():
        same(ask(tab, {"robot": ROBOT, "operator": operator, "both": plan}, {}, 60), given[name], within=1e-4)
    (found,) = what_if(model, data, ORDERS[:1], [CHANGES["faster"][1]], check=given["given"].check, **ANYWHERE)
    same(ask(tab, GIVEN, CHANGES["faster"][0]), found.after, within=1e-4)
    assert tab.said() == []
