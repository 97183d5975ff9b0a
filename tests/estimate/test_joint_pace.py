"""Joint rollouts where the operator became quicker: all is at his latest pace, and the answer says so."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from known_cells import Constant, TrueStaircase

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, OperatorPaceCard, OwnWorkCard, TrainingCard
from cyclekit.dataset.cards.coupling import TrendCard
from cyclekit.estimate.joint.answer import pace_errors
from cyclekit.estimate.joint.check import judge_joint
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.roll import JointCell, RolledBoth
from cyclekit.estimate.joint.visits import Segments
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.rollout import estimate

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset

ROBOT = ("home->conveyor", "conveyor->left_2", "left_2->conveyor", "conveyor->left_5")
OPERATOR = ("inbound", "out_left_1", "inbound", "rest")
PLAN = TaskSequence.of_plan(
    "both", [PlannedTask("robot", name) for name in ROBOT] + [PlannedTask("operator", name) for name in OPERATOR]
)


def card_of(logged: Dataset, error: float = 0.0) -> CouplingCard:
    """Return a card of a cell in which the robot waits once, and whose operator became much quicker."""
    needs = ConditionCard(agent="operator", place="inbound", event="leaves", lag_s=(0.2,))
    names = tuple(one.execution for one in logged.card.executions)
    trend = TrendCard(change=-0.5, count=len(names), error=error)
    gates = (
        GateCard(agent="robot", at="leave", place="conveyor", own_s=(1.0,), conditions=(needs,)),
        GateCard(
            agent="operator",
            at="leave",
            place="inbound",
            own_s=(2.0,),
            own_by=(OwnWorkCard(side="next", place="rest", own_s=(4.0,)),),
        ),
    )
    return CouplingCard(gates=gates, pace=OperatorPaceCard(executions=names, work=trend, walk=trend, work_share=0.5))


def cell_of(logged: Dataset, card: CouplingCard, monkeypatch: pytest.MonkeyPatch) -> JointCell:
    monkeypatch.setattr(logged, "card", msgspec.structs.replace(logged.card, coupling=card))
    return JointCell(Constant(1.0), logged, card)


def rolled(cell: JointCell, cycles: int = 20) -> RolledBoth:
    (found,) = cell.roll([Planner(cell, nominal_tasks(cell.dataset)).plan(PLAN)], cycles=cycles, until_s=500.0)
    assert isinstance(found, RolledBoth)
    return found


def test_logged_stays_and_walks_last_as_long_as_at_the_latest_pace(logged: Dataset) -> None:
    usual = Segments(logged)
    quick = Segments(logged, None, dict.fromkeys(usual.orders, (2.0, 4.0)))
    walks = [each.durations_s(each.walk("inbound", "out_left_1")) for each in (usual, quick)]
    assert walks[0] == pytest.approx(4.0 * walks[1])
    assert usual.work_s("inbound") == pytest.approx(2.0 * quick.work_s("inbound"))
    assert (quick.stretch <= 1.0).all()


def test_an_execution_that_its_log_cuts_lends_stays_and_walks_and_is_no_order(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, (first, *others) = Segments(logged), logged.card.executions
    cards = (msgspec.structs.replace(first, complete=False), *others)
    monkeypatch.setattr(logged, "card", msgspec.structs.replace(logged.card, executions=cards))
    found = Segments(logged)
    assert whole.orders.keys() - found.orders.keys() == {first.execution}
    assert len(found.walk("inbound", "out_left_1")) == len(whole.walk("inbound", "out_left_1"))
    assert found.work_s("inbound") == pytest.approx(whole.work_s("inbound"))


def test_a_walk_at_another_pace_takes_longer_and_so_does_own_work(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = cell_of(logged, card_of(logged), monkeypatch)
    now, then = (rolled(each).operators[0] for each in (cell, cell.at_pace(2.0, 3.0)))
    legs = [n for n, leg in enumerate(now.agenda.legs) if leg.start]
    walks = [each.times.arrives_s[:, legs] - each.times.passes_s[:, np.array(legs) - 1] for each in (now, then)]
    assert walks[1] == pytest.approx(3.0 * walks[0])
    work = [each.times.works_s - each.times.arrives_s for each in (now, then)]
    assert work[1] == pytest.approx(2.0 * work[0])


def test_logged_executions_are_rolled_out_at_the_pace_they_had(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The walks are scaled to the latest pace and back to that of each execution, so the bias stays as it was."""
    monkeypatch.setattr("cyclekit.estimate.joint.check.MAX_EXECUTIONS", 4)
    card = card_of(logged)
    plain = msgspec.structs.replace(card, pace=None)
    then = judge_joint(*_asked(cell_of(logged, plain, monkeypatch)), levels=(0.05, 0.95), seed=0)
    found = judge_joint(*_asked(cell_of(logged, card, monkeypatch)), levels=(0.05, 0.95), seed=0)
    assert then is not None
    assert found is not None
    early, late = (
        np.mean(np.array(found.residuals)[part] - np.array(then.residuals)[part])
        for part in (slice(2), slice(-2, None))
    )
    assert early < late - 0.02  # own work of the card is that of today: it was longer in the first executions


def _asked(cell: JointCell) -> tuple[JointCell, Planner]:
    return cell, Planner(cell, nominal_tasks(cell.dataset))


def test_the_answer_names_the_change_and_its_interval_has_the_doubt_about_the_latest_pace(logged: Dataset) -> None:
    class Quick(TrueStaircase):
        def __init__(self, card: CouplingCard) -> None:
            super().__init__()
            self.card = TrainingCard(coupling=card)

    said = "the operator became 39 % quicker over"
    entries = []
    for error in (0.0, 0.2):
        card = card_of(logged, error)
        (found,) = estimate(Quick(card), logged, [PLAN], validate=False, extrapolate=True)
        assert any(said in warning for warning in found.warnings)
        assert any(said in warning for warning in json.loads(json.dumps(found.to_dict()))["warnings"])
        entries.append(found)
    sure, doubtful = (one.expected_high_s - one.expected_low_s for one in entries)
    assert doubtful > 1.5 * sure
    (plain,) = estimate(
        Quick(msgspec.structs.replace(card, pace=None)), logged, [PLAN], validate=False, extrapolate=True
    )
    assert not any("quicker" in warning for warning in plain.warnings)


def test_cycles_that_do_not_end_tell_nothing_about_the_doubt(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    cell, planner = _asked(cell_of(logged, card_of(logged, 0.2), monkeypatch))
    assert pace_errors(cell, planner, [PLAN], seed=0)[PLAN] > 0.01
    cell.model = Constant(0.0)
    assert pace_errors(cell, planner, [PLAN], seed=0) == {PLAN: 0.0}
