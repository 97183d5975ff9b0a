"""What an engineer is told of a plan or a change that cannot be answered as it is, or only in part."""

from __future__ import annotations

from pathlib import Path

import pytest
from known_cells import Constant, Coupled

from cyclekit.api.plan import plan_order
from cyclekit.cli.estimate import plan_table
from cyclekit.cli.plan import _text
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, SourceCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, EstimateError, UnknownName
from cyclekit.estimate.joint.check import JointCheck
from cyclekit.estimate.plan.answer import OrderPlan
from cyclekit.estimate.plan.jobs import Jobs, load_jobs
from cyclekit.estimate.result import CycleEstimate, PlannedShare
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif.change import Change
from cyclekit.estimate.whatif.coupled import altered_coupling

OPERATOR_LEAVES = ConditionCard(agent="operator", place="inbound", event="leaves", lag_s=(0.2,))
ROBOT_LEAVES = ConditionCard(agent="robot", place="left_2", event="leaves", lag_s=(0.5,))
CIRCLE = (
    GateCard(agent="robot", at="leave", place="conveyor", own_s=(1.0,), conditions=(OPERATOR_LEAVES,)),
    GateCard(agent="operator", at="leave", place="inbound", own_s=(1.0,), conditions=(ROBOT_LEAVES,)),
)


def plan(robot: tuple[str, ...], operator: tuple[str, ...] = ()) -> TaskSequence:
    tasks = [("robot", name) for name in robot] + [("operator", name) for name in operator]
    return TaskSequence.of_plan("p", [PlannedTask(agent, name) for agent, name in tasks])


def answered(logged: Dataset, card: CouplingCard, sequence: TaskSequence) -> CycleEstimate:
    (found,) = estimate(Coupled(card), logged, [sequence], validate=False, extrapolate=True)
    return found


def test_a_task_never_logged_is_refused_with_the_places_by_which_the_robot_goes(logged: Dataset) -> None:
    asked = [TaskSequence("A", ("home", "conveyor", "left_2", "left_5"))]
    with pytest.raises(EstimateError, match="'left_2->left_5' was never logged") as caught:
        estimate(Constant(1.0), logged, asked, validate=False)
    times = sum(
        (one.places[n], one.places[n + 2]) == ("left_2", "left_5")
        for one in logged.card.executions
        for n in range(len(one.places) - 2)
    )
    assert times > 0
    assert caught.value.cure == (
        f"In the logs the robot goes from left_2 to left_5 by conveyor ({times} times): name conveyor between them."
    )


def test_a_task_to_which_no_logged_way_leads_is_refused_with_the_tasks_there_are(logged: Dataset) -> None:
    with pytest.raises(EstimateError) as caught:
        estimate(Constant(1.0), logged, [TaskSequence("A", ("home", "left_2"))], validate=False)
    assert caught.value.cure.startswith(
        ("Use tasks that were: home->", "In the logs the robot goes from home to left_2")
    )


def test_a_plan_of_the_robot_alone_says_that_nobody_is_there(logged: Dataset) -> None:
    gate = GateCard(agent="robot", at="leave", place="conveyor", own_s=(1.0,), conditions=(OPERATOR_LEAVES,))
    card = CouplingCard(gates=(gate,))
    said = "the plan has no task of the operator: nobody slows the robot"
    alone = answered(logged, card, plan(("conveyor", "left_2")))
    assert any(doubt.startswith(said) for doubt in alone.doubts)
    both = answered(logged, card, plan(("conveyor", "left_2"), ("inbound", "rest")))
    assert not any(doubt.startswith(said) for doubt in both.doubts)


@pytest.mark.parametrize("told", [False, True])
def test_a_deadlock_by_waits_of_the_cell_file_names_that_file(logged: Dataset, told: bool) -> None:
    gates = tuple(
        GateCard(agent=one.agent, at=one.at, place=one.place, own_s=one.own_s, conditions=one.conditions, told=told)
        for one in CIRCLE
    )
    with pytest.raises(EstimateError, match="deadlock: robot waits at conveyor") as caught:
        answered(logged, CouplingCard(gates=gates), plan(("conveyor", "left_2"), ("inbound", "rest")))
    assert ("[[waits]] in the cell file" in caught.value.cure) is told
    assert "Change the order of one agent" in caught.value.cure


def test_jobs_with_an_unknown_place_of_the_operator_are_refused_by_their_file(logged: Dataset) -> None:
    jobs = Jobs(visit=("left_2", "left_5"), start="home", operator=("inbound", "kitchen"), via="conveyor")
    with pytest.raises(UnknownName, match="the jobs: unknown place of the operator 'kitchen'"):
        plan_order(Coupled(CouplingCard(gates=CIRCLE)), logged, jobs, validate=False)


def test_jobs_of_task_lists_are_refused_in_a_cell_with_positions(tmp_path: Path) -> None:
    (tmp_path / "jobs.toml").write_text('[[task]]\nagent = "robot"\nname = "bring"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"\[\[task\]\] is for models of task lists") as caught:
        load_jobs(tmp_path / "jobs.toml")
    assert 'operator = ["bench->fixture", "shelf"]' in caught.value.cure


def plain(text: str) -> str:
    return text.replace("\N{NO-BREAK SPACE}", " ")


def test_the_order_of_both_agents_is_printed() -> None:
    told = {"places": ("home", "a"), "expected_s": 38.5, "against": "random orders", "against_s": 43.0, "tried": 16}
    told |= {"order": ("a->b", "c"), "searched": "search", "executions": 40}
    both = _text(OrderPlan(**told, saves_s=(4.4, 4.3, 4.5), operator=("bench", "fixture")))
    assert both.splitlines()[:2] == ["robot: a->b, c", "operator: bench, fixture"]
    assert "expected 38.5 s; random orders 43.0 s on average\nsaves 4.5 s (95 % CI 4.3 to 4.5 s) a cycle\n" in plain(
        both
    )
    alone = _text(OrderPlan(**told, saves_s=(4.4, 4.3, 4.5), allowance=1.004))
    assert alone.splitlines()[0] == "order: a->b, c"
    assert "expected: with 0.4 % more, because the same logs chose the order" in plain(alone)


def test_every_wait_in_the_table_of_a_plan_has_its_cause(logged: Dataset) -> None:
    rows = [("short", 0.1, {"operator: fixture": 0.3, "own task before": 0.7}), ("none", 0.0, {"own task before": 1.0})]
    entry = answered(logged, CouplingCard(gates=CIRCLE[:1]), plan(("conveyor",), ("inbound", "rest")))
    shares = tuple(PlannedShare("robot", "robot", name, 0.0, 1.0, wait, decided) for name, wait, decided in rows)
    object.__setattr__(entry, "plan", shares)
    short, none = (line for line in plan_table(entry).splitlines() if line.startswith("robot"))
    assert short.endswith("operator: fixture (30 %)")
    assert none.endswith("-")


FED = CouplingCard(
    gates=(
        GateCard(agent="robot", at="approach", place="fixture", conditions=(OPERATOR_LEAVES,)),
        GateCard(agent="operator", at="leave", place="bench", conditions=(ROBOT_LEAVES,)),
    ),
    sources=(SourceCard(signal="digital-input 3", gap_s=(6.0, 9.0), buffer=2, taken_by="conveyor"),),
)


@pytest.mark.parametrize("name", ["robot before fixture", "robot approach fixture"])
def test_a_change_removes_a_wait_by_the_name_that_inspect_shows(name: str) -> None:
    found = altered_coupling(Change("c", without_waits=(name,)), FED)
    assert [len(gate.conditions) for gate in found.gates] == [0, 1]


def test_a_wait_that_is_not_known_is_refused_with_the_names_of_inspect() -> None:
    with pytest.raises(UnknownName, match="unknown wait 'robot before oven'") as caught:
        altered_coupling(Change("c", without_waits=("robot before oven",)), FED)
    assert caught.value.cure == "Known: operator at bench, robot before fixture."


@pytest.mark.parametrize("name", ["conveyor", "digital-input 3"])
def test_a_buffer_is_named_by_its_place_or_its_signal(name: str) -> None:
    (source,) = altered_coupling(Change("c", buffer={name: 5}), FED).sources
    assert source.buffer == 5


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        (Change("c", faster={"worker": 1.2}), "unknown agent in faster 'worker'"),
        (Change("c", faster={"robot": 1.2}), "a faster robot is for models of task lists"),
        (Change("c", no_wait=(("bring", "mount"),)), "no_wait is for models of task lists"),
        (Change("c", buffer={"shelf": 2}), "unknown source of parts 'shelf'"),
    ],
)
def test_each_change_that_a_cell_with_positions_cannot_take_has_its_own_reason(change: Change, seen: str) -> None:
    with pytest.raises((EstimateError, UnknownName), match=seen):
        altered_coupling(change, FED)


def test_an_error_between_logged_orders_widens_the_interval_of_the_share_within_the_takt(logged: Dataset) -> None:
    gate = GateCard(agent="robot", at="leave", place="conveyor", own_s=(1.0,), conditions=(OPERATOR_LEAVES,))
    model, asked = Coupled(CouplingCard(gates=(gate,))), [plan(("conveyor", "left_2"), ("inbound", "rest"))]
    told = {"executions": 40, "held_out": 0, "own_bias": 0.0, "own_error": 0.0, "crossed_bias": 0.0, "reacts_z": 0.0}
    told |= {"residuals": (0.0,) * 40, "coverage": 0.9, "coverage_held_out": None, "levels": (0.05, 0.95)}
    (first,) = estimate(model, logged, asked, check=JointCheck(**told), extrapolate=True)
    width = []
    for by_order in (0.0, 0.05):
        check = JointCheck(**told, by_order=by_order)
        (found,) = estimate(model, logged, asked, check=check, extrapolate=True, takt_s=first.expected_s)
        share, low, high = found.takt_probability
        assert low <= share <= high
        (late,) = estimate(model, logged, asked, check=check, extrapolate=True, takt_s=found.quantiles_s[0.95] + 1e-6)
        assert late.takt_probability[0] == pytest.approx(0.95, abs=1.5 / len(found.durations_s))
        width.append(high - low)
    assert width[1] > width[0] + 0.1
