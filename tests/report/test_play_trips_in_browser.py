"""The part to play with where the operator makes trips while he waits: the library's own numbers."""

from __future__ import annotations

import json
from dataclasses import replace

import browser
import numpy as np
import pytest
from known_cells import logged
from msgspec import structs
from played import STAIRS, ask, both, same, some_deadlocks_are_left_out, staircase

from cyclekit import TaskSequence
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, TrainingCard, TripCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.joint.visits import Segments
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif import what_if
from cyclekit.estimate.whatif.change import Change
from cyclekit.report import compose_report

__all__ = ["logged", "some_deadlocks_are_left_out"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not())),
]
LATE_S = np.linspace(-2.0, 14.0, 20)
TRIP = TripCard(
    places=("out_left_1",), waiting=0.6, free=0.3, late_s=tuple(LATE_S.tolist()),
    took_s=tuple((12.0 + 3.0 * np.cos(LATE_S * 2.0)).tolist()),
)  # fmt: skip
LEAVES = ConditionCard(agent="robot", place="conveyor", event="leaves", lag_s=(0.2, 0.5, 1.5))
WAIT = GateCard(agent="operator", at="leave", place="inbound", own_s=(1.0, 2.0, 4.0), conditions=(LEAVES,), trip=TRIP)
CARD = CouplingCard(
    gates=(
        WAIT,
        GateCard(agent="operator", at="approach", place="out_right_2",
                 conditions=(structs.replace(LEAVES, place="left_2"),),
                 trip=structs.replace(TRIP, waiting=0.9, free=0.1)),
        GateCard(agent="robot", at="leave", place="conveyor", own_s=(0.5, 0.7, 1.4), conditions=(
            ConditionCard(agent="operator", place="inbound", event="leaves", lag_s=(0.1, 0.3, 0.9), needed=0.1),)),
    ),
)  # fmt: skip
ROBOT = ("home", "conveyor", "left_2", "conveyor", "right_3")
OPERATOR = ("inbound", "out_right_1", "inbound", "out_right_2", "inbound")
THERE = ("inbound", "out_left_1", "inbound", "out_right_2", "inbound")
LATE = (*OPERATOR, *("out_right_1", "inbound") * 4)
ORDERS = [
    both(ROBOT, OPERATOR, "given"),
    TaskSequence("places", ROBOT, OPERATOR),
    both(ROBOT, THERE, "goes there"),
    TaskSequence("late", ROBOT, LATE),
]
ASKED = {"given": (OPERATOR, True), "places": (OPERATOR, False), "goes there": (THERE, True), "late": (LATE, False)}
CHANGES = {
    "faster": ({"pace": 1.3}, Change("p", faster={"operator": 1.3})),
    "no wait": ({"without": ["operator at inbound"]}, Change("n", without_waits=("operator leave inbound",))),
    "ramp": STAIRS["ramp"],
}


def begin(name):
    """Return a script that chooses a sequence of the page."""
    chosen = f"[...s.options].find(o => o.text === {json.dumps(name)}).value"
    return (
        f"(s => {{ s.value = {chosen}; s.dispatchEvent(new Event('change')); }})"
        "(document.querySelector('#play select'))"
    )


def test_trips_are_drawn_as_in_the_library(tab, logged, tmp_path):
    data = Dataset.open(logged.path)
    assert len(Segments(data, CARD).trip("inbound")) > 5
    model = replace(staircase(), card=TrainingCard(coupling=CARD))
    asked = {"other_cell": True, "extrapolate": True}
    given = {each.name: each for each in estimate(model, data, ORDERS, takt_s=60.0, **asked)}
    page = tmp_path / "page.html"
    assert compose_report(data, model, page, estimates=list(given.values()), takt_s=60.0).missing == ()
    without = structs.replace(CARD, gates=tuple(structs.replace(gate, trip=None) for gate in CARD.gates))
    (no_trips,) = estimate(replace(model, card=TrainingCard(coupling=without)), data, ORDERS[:1], **asked)
    assert given["given"].expected_s > no_trips.expected_s + 1.0  # or the test would show nothing
    tab.show(page)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    for name, (operator, plan) in ASKED.items():
        same(ask(tab, {"robot": ROBOT, "operator": operator, "both": plan}, {}, 60), given[name], within=1e-5)
    assert sum(task.agent == "operator" for task in given["late"].plan) < len(LATE)  # the others begin after the cycle
    script = "[...document.querySelectorAll('#play .play-lane')].filter(bar => bar.textContent).length"
    counts = {name: tab.ask(f"{begin(name)}, {script}") for name in given}
    assert counts["given"] == counts["goes there"] == 0 < counts["late"]
    played = {"robot": ROBOT, "operator": OPERATOR, "both": True}
    for changes, change in CHANGES.values():
        (found,) = what_if(model, data, ORDERS[:1], [change], check=given["given"].check, **asked)
        same(ask(tab, played, changes), found.after, within=1e-5)
    assert tab.said() == []
