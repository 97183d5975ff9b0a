"""A robot that waits for signals in a cell without a tracker: orders never logged, plans and changes."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec import structs

from cyclekit.api.report import write_report
from cyclekit.api.train import train_model
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, SourceCard
from cyclekit.errors import EstimateError, UnknownName
from cyclekit.estimate.joint.people import BINS, LoggedMotions
from cyclekit.estimate.joint.roll import JointCell
from cyclekit.estimate.plan.answer import plan
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif.answer import what_if
from cyclekit.estimate.whatif.change import Change
from cyclekit.learning.unseen.saved import save_unseen
from cyclekit_sim import fresh_cycles, random_orders

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells, SimulatedCell

    from cyclekit.learning.unseen.model import UnseenOperator

PART = "digital-input 3"
FRESH = 200


@pytest.fixture(scope="module")
def cell(cells: Cells) -> SimulatedCell:
    return cells("shared-fixture", 16, seed=31, people="none")


@pytest.fixture(scope="module")
def model(cell: SimulatedCell) -> UnseenOperator:
    found = train_model(cell.dataset)
    assert found.card.coupling is not None
    return found  # type: ignore[return-value]


def _places(scene: str = "shared-fixture") -> tuple[str, ...]:
    """Return an order in which the robot brings parts one right after the other, and so waits for most of them."""
    orders = (each["robot"] for each in random_orders(scene, 3, 40))
    return next(each for each in orders if "fixture,feeder,fixture,feeder,fixture" in ",".join(each))


def _operators() -> list[tuple[str, ...]]:
    return [each["operator"] for each in random_orders("shared-fixture", 4, FRESH)]


@pytest.mark.usefixtures("words_only")
def test_the_report_takes_the_model_of_an_unseen_operator(
    cell: SimulatedCell, model: UnseenOperator, tmp_path: Path
) -> None:
    save_unseen(tmp_path / "model", model)
    asked = {"sequences": [TaskSequence("new", _places())], "validate": False, "kind": "json"}
    write_report(cell.dataset, tmp_path / "r.json", model=tmp_path / "model", **asked)  # type: ignore[arg-type]
    found = json.loads((tmp_path / "r.json").read_text("utf-8"))
    (entry,) = estimate(model, cell.dataset, asked["sequences"], validate=False)  # type: ignore[arg-type]
    assert found["sequences"][0]["expected_s"] == pytest.approx(entry.expected_s)
    (wait,) = found["waits"]
    tasks = cell.dataset.tasks()
    assert wait["waited_s"] * len(cell.dataset.executions) == pytest.approx(tasks["lost_wait_s"].sum(), rel=0.01)
    facts = write_report(cell.dataset, tmp_path / "r.md", model=model, **asked | {"kind": "md"})  # type: ignore[arg-type]
    words = facts.path.read_text("utf-8").replace("\N{NO-BREAK SPACE}", " ")
    assert "No log shows people. The model has learned from the robot's log alone" in words
    assert "No model was given" not in words
    assert "Safety loss by operator task" not in words  # the states of the speed are no tasks of the operator
    bound = f"“new” takes {entry.expected_s:.1f} s, of which {entry.safety_loss_s:.1f} s are slow-down and"
    assert f"{bound} {entry.wait_s:.1f} s waits of the robot." in words


@pytest.mark.slow
def test_an_order_that_was_never_logged_has_the_waits_of_fresh_executions(
    cell: SimulatedCell, model: UnseenOperator
) -> None:
    places = _places()
    order = {"robot": places, "operator": _operators()[0]}
    fresh = fresh_cycles("shared-fixture", order, cycles=FRESH, seed=5, operators=_operators())
    (entry,) = estimate(model, cell.dataset, [TaskSequence("order", places)])
    assert entry.expected_s == pytest.approx(fresh.robot_s.mean(), rel=0.05)
    assert entry.wait_s == pytest.approx(fresh.robot_waits_s.mean(), rel=0.3)
    assert entry.expected_low_s <= fresh.robot_s.mean() <= entry.expected_high_s
    assert "ROBOT LOG ALONE" in entry.doubts[0]
    ended = {name for share in entry.plan for name in share.decided}
    assert "signal: digital-input 1" in ended
    (without,) = estimate(model, cell.dataset, [TaskSequence("order", places)], estimator="history")
    assert abs(without.expected_s / fresh.robot_s.mean() - 1.0) > 0.08  # logged waits are those of other orders


@pytest.mark.slow
def test_plan_and_changes_know_the_wait(cell: SimulatedCell, model: UnseenOperator) -> None:
    jobs = Jobs(visit=("feeder->fixture", "feeder->fixture", "tray->rack_1"), start="home", end="home")
    found = plan(model, cell.dataset, jobs, validate=False)
    assert ",".join(found.places) == "home,feeder,fixture,tray,rack_1,feeder,fixture,home"  # work in between
    sequence = TaskSequence("order", _places())
    changes = [
        Change("no wait", without_waits=("robot approach fixture",)),
        Change("second fixture", more_places={"fixture": 1}),
    ]
    for each in what_if(model, cell.dataset, [sequence], changes, validate=False):
        assert each.after.expected_s < each.before.expected_s - 3.0
    with pytest.raises(EstimateError, match="no log shows the operator"):
        what_if(model, cell.dataset, [sequence], [Change("quick", faster={"operator": 1.2})], validate=False)
    with pytest.raises(UnknownName, match="source of parts"):  # a release is no part
        what_if(model, cell.dataset, [sequence], [Change("room", buffer={"digital-input 1": 3})], validate=False)


def test_tasks_of_an_operator_whom_no_log_shows_are_refused(cell: SimulatedCell, model: UnseenOperator) -> None:
    tasks = [PlannedTask("robot", "home->feeder"), PlannedTask("robot", "feeder->fixture")]
    with pytest.raises(EstimateError, match="no log shows the operator"):
        estimate(model, cell.dataset, [TaskSequence.of_plan("both", [*tasks, PlannedTask("operator", "bench")])])


@pytest.mark.parametrize("after", [True, False], ids=["after what the robot did", "by themselves"])
def test_signals_come_after_what_the_robot_did_or_by_themselves(
    cell: SimulatedCell, model: UnseenOperator, after: bool
) -> None:
    lag = ConditionCard(agent="robot", place="feeder", event="leaves", lag_s=(9.0,))
    source = SourceCard(signal=PART, gap_s=(5.0,), first_s=(2.0,), taken_by="fixture", after=(lag,) if after else ())
    need = ConditionCard(agent="signal", place=PART, event="set", lag_s=(0.5,))
    gates = (GateCard(agent="robot", at="leave", place="fixture", own_s=(1.0,), conditions=(need,)),)
    asked = replace(model, card=structs.replace(model.card, coupling=CouplingCard(gates=gates, sources=(source,))))
    sequence = TaskSequence("twice", ("home", "feeder", "fixture", "feeder", "fixture", "home"))
    (entry,) = estimate(asked, cell.dataset, [sequence], validate=False)
    legs = {share.task: share for share in entry.plan}
    last = [share for share in entry.plan if share.task.startswith("fixture->")]
    waits = [share.wait_s for share in last]
    if after:
        way_s = legs["feeder->fixture"].end_s - legs["feeder->fixture"].start_s
        assert waits == pytest.approx([9.5 - way_s] * 2, abs=0.7)
    else:
        assert waits[0] == pytest.approx(0.0, abs=0.1)  # the first came at 2 s, the next at 7 s: before the robot
    assert entry.dwell_s == pytest.approx(2 * 1.0 + 2 * 0.6, abs=0.1)


def test_people_are_on_a_motion_as_they_were_on_a_logged_one(cell: SimulatedCell, model: UnseenOperator) -> None:
    card = model.card.coupling
    joint = JointCell(model, cell.dataset, card)
    assert joint.unseen
    assert joint.executions == 16
    motions, path = LoggedMotions(cell.dataset, joint.model), nominal_tasks(cell.dataset)["feeder->fixture"].xyz_m
    first, count = motions.on("feeder->fixture", path)
    assert count == cell.dataset.tasks().filter(task="feeder->fixture").height
    rows = first + np.arange(BINS * count)
    bins = path[np.rint(np.linspace(0.0, len(path) - 1.0, BINS)).astype(int)]
    s = joint.model.scaling_in(np.tile(bins, (count, 1)), motions.state[rows])  # type: ignore[union-attr]
    rolled = 1.0 / np.mean(1.0 / np.maximum(s, 0.05))
    tasks = cell.dataset.tasks().filter(task="feeder->fixture")
    logged = tasks["nominal_s"].sum() / (tasks["nominal_s"] + tasks["safety_loss_s"]).sum()
    assert rolled == pytest.approx(logged, rel=0.15)
