"""Robot and operator rolled out together: who waits for whom, plans for both, and what an estimate says of it."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from known_cells import Constant, Coupled, TrueStaircase

from cyclekit.api.estimate import estimate_cycles
from cyclekit.api.plan import plan_order
from cyclekit.api.whatif import what_if
from cyclekit.cli.estimate import estimates_table
from cyclekit.config.sequences import PlannedTask, TaskSequence, load_sequences
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, SourceCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import EstimateError, UnknownName
from cyclekit.estimate.joint.check import JointCheck
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.roll import JointCell, Plan, RolledBoth, longest_s
from cyclekit.estimate.joint.shares import planned_shares
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif.change import Change

ROBOT = ("home->conveyor", "conveyor->left_2", "left_2->conveyor", "conveyor->left_5", "left_5->conveyor")
ROUTE = ("home", *("conveyor", "left_2", "conveyor", "left_5") * 3)
OWN_S = 1.0
AFTER_INBOUND = ConditionCard(agent="operator", place="inbound", event="leaves", lag_s=(0.25,))


def gates(*more: GateCard, own_s: float = OWN_S) -> CouplingCard:
    """Return a card in which both work just as long at every place."""
    told = {(gate.agent, gate.at, gate.place) for gate in more}
    places = {"robot": ("conveyor", "left_2", "left_5", "home"), "operator": ("inbound", "out_left_1", "rest")}
    plain = [GateCard(agent=a, at="leave", place=p, own_s=(own_s,)) for a, some in places.items() for p in some]  # type: ignore[arg-type]
    return CouplingCard(gates=(*more, *(g for g in plain if (g.agent, g.at, g.place) not in told)))


def both(operator: tuple[str, ...], robot: tuple[str, ...] = ROBOT, **told: PlannedTask) -> TaskSequence:
    plan = [PlannedTask("robot", name) for name in robot] + [PlannedTask("operator", name) for name in operator]
    return TaskSequence.of_plan("both", [told.get(task.name.replace("->", "_to_"), task) for task in plan])


def rolled(logged: Dataset, card: CouplingCard | None, sequence: TaskSequence, cycles: int = 40) -> RolledBoth:
    cell = JointCell(Constant(1.0), logged, card)
    plan = Planner(cell, nominal_tasks(logged)).plan(sequence)
    (found,) = cell.roll([plan], cycles=cycles, until_s=300.0)
    if isinstance(found, EstimateError):
        raise found
    return found


def test_without_people_in_the_way_a_cycle_takes_its_nominal_time_exactly(logged: Dataset) -> None:
    found = rolled(logged, gates(), TaskSequence("alone", ("home", "conveyor", "left_2", "conveyor", "left_5")))
    nominal = nominal_tasks(logged)
    assert found.duration_s == pytest.approx(sum(nominal[task].nominal_s + OWN_S for task in ROBOT[:4]), abs=1e-9)


def test_the_robot_leaves_at_the_later_of_its_own_work_and_the_event_with_its_lag(logged: Dataset) -> None:
    gate = GateCard(agent="robot", at="leave", place="conveyor", own_s=(OWN_S,), conditions=(AFTER_INBOUND,))
    found = rolled(logged, gates(gate, own_s=2.0), both(("inbound", "out_left_1", "inbound", "rest")))
    robot, operator = found.robot, found.operators[0]
    left = [n for n, leg in enumerate(operator.agenda.legs) if leg.place == "inbound"]
    at = [n for n, leg in enumerate(robot.agenda.legs) if leg.place == "conveyor"]
    for turn in (0, 1):
        due = operator.times.passes_s[:, left[turn]] + 0.25
        own = robot.times.arrives_s[:, at[turn]] + OWN_S
        assert robot.times.passes_s[:, at[turn]] == pytest.approx(np.maximum(due, own), abs=1e-9)
    third = robot.times.passes_s[:, at[2]] - robot.times.arrives_s[:, at[2]]  # the operator is there but twice
    assert third == pytest.approx(OWN_S, abs=1e-9)
    assert robot.times.waits_s[:, at[1]].max() > 0.5


def test_an_event_that_half_of_the_passages_need_holds_half_of_them_up(logged: Dataset) -> None:
    need = msgspec.structs.replace(AFTER_INBOUND, needed=0.5)
    gate = GateCard(agent="robot", at="leave", place="conveyor", own_s=(OWN_S,), conditions=(need,))
    plan = both(("inbound", "out_left_1", "rest"), inbound=PlannedTask("operator", "inbound", not_before_s=30.0))
    found = rolled(logged, gates(gate), plan)
    (first, *_) = [n for n, leg in enumerate(found.robot.agenda.legs) if leg.place == "conveyor"]
    waits_s = found.robot.times.waits_s[:, first]
    assert np.mean(waits_s > 10.0) == pytest.approx(0.5)
    assert np.mean(waits_s == 0.0) == pytest.approx(0.5)


@pytest.mark.parametrize("together", [0, 1])
def test_waits_of_both_in_the_same_passages_are_drawn_once(logged: Dataset, together: int) -> None:
    some = {"needed": 0.5, "together": together, "lag_s": (30.0,)}
    mine, his = (
        ConditionCard(agent="robot", place="home", event="leaves", **some),  # type: ignore[arg-type]
        ConditionCard(agent="operator", place="inbound", event="arrives", **some),  # type: ignore[arg-type]
    )
    robot = GateCard(agent="robot", at="leave", place="left_2", conditions=(his,))
    operator = GateCard(agent="operator", at="approach", place="out_left_1", conditions=(mine,))
    found = rolled(logged, gates(robot, operator), both(("inbound", "out_left_1", "rest")), cycles=100)
    waits = [each.times.waits_s.max(axis=1) > 5.0 for each in (found.robot, found.operators[0])]
    assert np.mean(waits, axis=1) == pytest.approx([0.5, 0.5])
    assert (waits[0] == waits[1]).all() == bool(together)


@pytest.mark.parametrize(("needed", "cycles"), [(0.01, 99), (0.5, 100)])
def test_a_few_cycles_that_do_not_end_are_left_out_and_many_stay(logged: Dataset, needed: float, cycles: int) -> None:
    need = msgspec.structs.replace(AFTER_INBOUND, needed=needed)
    gate = GateCard(agent="robot", at="leave", place="conveyor", own_s=(OWN_S,), conditions=(need,))
    plan = both(("inbound", "out_left_1", "rest"), inbound=PlannedTask("operator", "inbound", not_before_s=290.0))
    found = rolled(logged, gates(gate), plan, cycles=100)
    assert len(found.duration_s) == len(found.robot.rows) == len(found.operators[0].rows) == cycles
    assert found.left_out == pytest.approx(1.0 - cycles / 100)
    assert np.isfinite(found.duration_s).all() == (cycles < 100)


def test_an_estimate_says_which_part_of_the_cycles_it_leaves_out_and_of_many_there_is_none(logged: Dataset) -> None:
    def circle(needed: float) -> GateCard:
        after = ConditionCard(agent="robot", place="left_5", event="leaves", lag_s=(0.0,), needed=needed)
        return GateCard(agent="operator", at="leave", place="inbound", own_s=(OWN_S,), conditions=(after,))

    mine = GateCard(agent="robot", at="leave", place="conveyor", own_s=(OWN_S,), conditions=(AFTER_INBOUND,))
    asked = {"validate": False, "extrapolate": True}
    (found,) = estimate(Coupled(gates(circle(0.01), mine)), logged, [both(("inbound", "rest"))], **asked)
    assert any("1.0 % of the cycles are left out: they end in a deadlock" in said for said in found.doubts)
    with pytest.raises(EstimateError, match=r"'both': deadlock in 2\.0 % of the cycles: robot waits") as caught:
        estimate(Coupled(gates(circle(0.02), mine)), logged, [both(("inbound", "rest"))], **asked)
    assert "learned from the logs are wrong for this order" in caught.value.cure
    (whole,) = estimate(Coupled(gates(mine)), logged, [both(("inbound", "rest"))], **asked)
    assert not any("of the cycles are left out" in said for said in whole.doubts)


@pytest.mark.parametrize("state", ["set", "cleared"])
def test_a_signal_that_neither_agent_gives_is_not_left_out_in_silence(logged: Dataset, state: str) -> None:
    need = ConditionCard(agent="signal", place="press", event=state, lag_s=(0.1,))  # type: ignore[arg-type]  # of two
    gate = GateCard(agent="operator", at="approach", place="out_left_1", conditions=(need,))
    press = SourceCard(signal="press", gap_s=(4.0,), first_s=(1.0,), taken_by="conveyor")
    asked = {"validate": False, "extrapolate": True}
    said = f"waits of the operator before out_left_1 for 'press {state}' are left out"
    for sources, told in (((), True), ((press,), state == "cleared")):
        card = msgspec.structs.replace(gates(gate), sources=sources)
        (found,) = estimate(Coupled(card), logged, [both(("inbound", "out_left_1", "rest"))], **asked)
        assert any(doubt.startswith(said) for doubt in found.doubts) is told


def test_a_wait_for_a_task_that_the_plan_lacks_is_not_left_out_in_silence(logged: Dataset) -> None:
    gate = GateCard(agent="robot", at="approach", place="left_5", phase=0.4, conditions=(AFTER_INBOUND,))
    asked = {"validate": False, "extrapolate": True}
    said = (
        "wait of the robot before left_5 until operator leaves inbound: left out once, the plan has no such task then"
    )
    for operator, told in ((("out_left_1", "rest"), True), (("inbound", "rest"), False)):
        (found,) = estimate(Coupled(gates(gate)), logged, [both(operator)], **asked)
        assert (said in found.doubts) is told


def test_the_operator_waits_where_he_is_until_the_robot_has_left(logged: Dataset) -> None:
    need = ConditionCard(agent="robot", place="left_2", event="leaves", lag_s=(0.5,))
    gate = GateCard(agent="operator", at="approach", place="out_left_1", conditions=(need,))
    found = rolled(logged, gates(gate), both(("inbound", "out_left_1", "rest")))
    robot, operator = found.robot.times, found.operators[0]
    hold = next(n for n, leg in enumerate(operator.agenda.legs) if leg.hold)
    assert operator.times.passes_s[:, hold] == pytest.approx(robot.passes_s[:, 2] + 0.5, abs=1e-9)
    (share,) = (one for one in planned_shares(found) if one.task == "out_left_1")
    assert share.wait_s > 2.0
    assert share.decided == {"robot: conveyor->left_2": 1.0}


def test_a_robot_waits_midway_at_a_part_of_its_motion(logged: Dataset) -> None:
    need = ConditionCard(agent="operator", place="rest", event="arrives", lag_s=(0.0,))
    gate = GateCard(agent="robot", at="approach", place="left_5", phase=0.4, conditions=(need,))
    late = PlannedTask("operator", "rest", not_before_s=60.0)
    found = rolled(logged, gates(gate), both(("inbound", "out_left_1", "rest"), rest=late))
    first, second = (one for one in planned_shares(found) if one.task == "conveyor->left_5")
    nominal = nominal_tasks(logged)["conveyor->left_5"].nominal_s
    assert first.end_s - first.start_s == pytest.approx(0.4 * nominal)
    assert second.end_s - second.start_s == pytest.approx(0.6 * nominal + OWN_S)
    assert second.decided == {"operator: rest": 1.0}
    assert (first.rest, second.rest) == (False, True)
    early = both(("rest", "inbound"))
    (whole,) = (one for one in planned_shares(rolled(logged, gates(gate), early)) if one.task == "conveyor->left_5")
    assert (whole.rest, whole.end_s - whole.start_s) == (False, pytest.approx(nominal + OWN_S))


def test_two_who_wait_for_each_other_are_named(logged: Dataset) -> None:
    need = ConditionCard(agent="robot", place="left_5", event="leaves", lag_s=(0.0,))
    gate = GateCard(agent="operator", at="leave", place="inbound", conditions=(need,))
    mine = GateCard(agent="robot", at="leave", place="conveyor", conditions=(AFTER_INBOUND,))
    with pytest.raises(EstimateError) as caught:
        rolled(logged, gates(gate, mine), both(("inbound", "rest")))
    assert "robot waits at conveyor until operator leaves inbound" in caught.value.seen
    assert "operator waits at inbound until robot leaves left_5" in caught.value.seen


def test_a_task_cannot_follow_itself(logged: Dataset) -> None:
    own = PlannedTask("operator", "rest", after=("rest",))
    with pytest.raises(EstimateError, match="operator: rest: after names the task itself"):
        rolled(logged, gates(), both(("inbound", "rest"), rest=own))


def test_told_precedence_and_earliest_start_hold(logged: Dataset) -> None:
    plan = both(
        ("inbound", "rest"),
        conveyor_to_left_5=PlannedTask("robot", "conveyor->left_5", after=("rest",)),
        inbound=PlannedTask("operator", "inbound", not_before_s=20.0),
    )
    found = rolled(logged, gates(), plan)
    share = {one.task: one for one in planned_shares(found)}
    assert share["inbound"].start_s == pytest.approx(20.0)
    assert share["inbound"].decided == {"planned start": 1.0}
    assert share["conveyor->left_5"].start_s == pytest.approx(share["rest"].end_s)
    assert share["conveyor->left_5"].decided == {"operator: rest": 1.0}
    with pytest.raises(UnknownName, match="nothing"):
        rolled(logged, None, both(("inbound",), inbound=PlannedTask("operator", "inbound", after=("nothing",))))


def test_a_cycle_for_both_lasts_to_the_last_end_of_either(logged: Dataset) -> None:
    found = rolled(logged, gates(), both(("inbound", "out_left_1", "inbound", "rest"), ROBOT[:1]))
    assert found.duration_s == pytest.approx(found.operators[0].times.passes_s[:, -1])
    assert found.duration_s.min() > found.robot.times.passes_s[:, -1].max() + 3.0


def test_the_time_that_the_operator_needs_after_the_robot_is_idle_time_and_no_wait(logged: Dataset) -> None:
    plan = both(("inbound", "out_left_1", "inbound", "rest"), ROBOT[:1])
    asked = {"validate": False, "extrapolate": True}
    (found,) = estimate(Coupled(gates(own_s=3.0)), logged, [plan], **asked)
    assert found.wait_s == pytest.approx(0.0, abs=1e-6)
    assert found.idle_s > 3.0
    said = estimates_table([found])
    assert "idle" in said.splitlines()[0]
    assert "motion" in said.splitlines()[0]


@pytest.mark.parametrize(("buffer", "first_s", "gap_s"), [(1, 10.0, 4.0), (2, 10.0, 4.0), (2, -9.0, 12.0)])
def test_parts_come_after_a_gap_as_long_as_there_is_room(
    logged: Dataset, buffer: int, first_s: float, gap_s: float
) -> None:
    """The first may have come before the cycle; then the next one comes the sooner."""
    need = ConditionCard(agent="signal", place="part", event="set", lag_s=(0.1,))
    gate = GateCard(agent="robot", at="leave", place="conveyor", own_s=(0.0,), conditions=(need,))
    card = msgspec.structs.replace(
        gates(gate),
        sources=(SourceCard(signal="part", gap_s=(gap_s,), first_s=(first_s,), buffer=buffer, taken_by="conveyor"),),
    )
    found = rolled(logged, card, both(("inbound",)))
    at = [n for n, leg in enumerate(found.robot.agenda.legs) if leg.place == "conveyor"]
    taken, arrives = found.robot.times.passes_s[0, at], found.robot.times.works_s[0, at]
    came = [first_s]
    for part in (1, 2):
        came.append(max(came[-1] + gap_s, taken[part - buffer] if part >= buffer else 0.0))
    assert taken == pytest.approx(np.maximum(np.array(came) + 0.1, arrives), abs=1e-9)


def test_a_cycle_is_given_the_time_of_the_longest_work_of_the_operator(logged: Dataset) -> None:
    planner = Planner(JointCell(Constant(1.0), logged, gates(own_s=5.0)), nominal_tasks(logged))
    short, long = (planner.plan(both(places)) for places in (("rest",), ("inbound", "out_left_1") * 6))
    mixed = Plan("mixed", short.robot, (*short.operators, *long.operators), both=True)
    assert longest_s(mixed) == longest_s(long) > longest_s(short)


def test_without_conditions_both_agree_with_operators_that_are_tracks(logged: Dataset) -> None:
    sequence = TaskSequence("logged", logged.card.executions[2].places)
    cell = JointCell(TrueStaircase(), logged, None)
    plan = Planner(cell, nominal_tasks(logged)).plan(sequence)
    (found,) = cell.roll([plan], cycles=160, until_s=400.0)
    assert isinstance(found, RolledBoth)
    (usual,) = estimate(TrueStaircase(), logged, [sequence], validate=False)
    error = np.std(usual.durations_s) / len(usual.durations_s) ** 0.5
    assert abs(found.duration_s.mean() - usual.expected_s) < 3.0 * error


@pytest.fixture
def judged_joint() -> JointCheck:
    """A validation of joint rollouts, which were 5 % too long."""
    found = JointCheck(20, 20, 0.05, 0.001, 0.05, 0.0, (0.001, -0.001) * 10, None, None, (0.05, 0.95))
    assert found.factor < 0.96
    return found


def test_an_estimate_says_who_waited_for_what(logged: Dataset, tmp_path: Path) -> None:
    gate = GateCard(agent="robot", at="leave", place="conveyor", own_s=(OWN_S,), conditions=(AFTER_INBOUND,))
    file = tmp_path / "sequences.toml"
    tasks = [("robot", name) for name in ROBOT] + [("operator", name) for name in ("inbound", "out_left_1", "inbound")]
    lines = [f'[[sequence.task]]\nagent = "{agent}"\nname = "{name}"\n' for agent, name in tasks]
    short = '[[sequence]]\nname = "short"\nplaces = ["home", "conveyor", "left_2"]\noperator = ["inbound", "rest"]\n'
    file.write_text('[[sequence]]\nname = "both"\n' + "".join(lines) + short, encoding="utf-8")
    model, out, chart = Coupled(gates(gate, own_s=3.0)), tmp_path / "out.json", tmp_path / "chart.svg"
    found = estimate_cycles(model, logged, load_sequences(file), out=out, gantt=chart, validate=False, extrapolate=True)
    assert {each.name for each in found} == {"both", "short"}
    both_ = next(each for each in json.loads(out.read_text())["sequences"] if each["name"] == "both")
    assert both_["wait_s"] > 1.0
    waited = next(task for task in both_["plan"] if task["task"] == "conveyor->left_5")
    assert max(waited["decided"], key=waited["decided"].get) == "operator: inbound"
    assert both_["wait_s"] == pytest.approx(sum(task["wait_s"] for task in both_["plan"] if task["agent"] == "robot"))
    parts = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s", "idle_s")
    assert both_["expected_s"] == pytest.approx(sum(both_[part] for part in parts))
    assert all(0.0 <= task["end_low_s"] <= task["end_s"] + 2.0 <= task["end_high_s"] + 4.0 for task in both_["plan"])
    assert max(task["end_high_s"] for task in both_["plan"]) == pytest.approx(both_["quantiles_s"]["0.95"], rel=0.02)
    assert ">operator</text>" in chart.read_text()


def test_an_earlier_validation_of_one_way_to_roll_out_does_not_correct_the_other(
    logged: Dataset, judged_joint: JointCheck
) -> None:
    """A plan is rolled out for both agents, a sequence of places with logged tracks; each has its own bias."""
    places = TaskSequence("places", logged.card.executions[2].places)
    asked = {"validate": False, "extrapolate": True, "check": judged_joint}
    told = list[tuple[float, str]]()
    model = Constant(1.0)
    found = estimate(model, logged, [both(("rest",)), places], progress=lambda *said: told.append(said), **asked)
    plan, tracks = sorted(found, key=lambda each: each.name)
    assert plan.check is judged_joint
    assert tracks.check is None
    assert tracks.expected_s == pytest.approx(estimate(model, logged, [places], validate=False)[0].expected_s)
    assert [part for part, _ in told] == sorted(part for part, _ in told)
    assert sum(part == 1.0 for part, _ in told) == 1


def test_plans_of_both_and_sequences_of_places_are_ranked_together(logged: Dataset) -> None:
    asked = [both(("rest",)), TaskSequence("short", ("home", "conveyor", "left_2")), TaskSequence("long", ROUTE)]
    found = estimate(Constant(1.0), logged, asked, validate=False)
    assert [each.name for each in found] == ["short", "both", "long"]
    assert found[0].expected_s < found[1].expected_s < found[2].expected_s


def test_plan_corrects_by_an_earlier_validation_of_both(logged: Dataset, judged_joint: JointCheck) -> None:
    jobs = Jobs(visit=("conveyor->left_2", "conveyor->left_5"), start="home", operator=("inbound",))
    model = Coupled(gates(*BOTH_WAIT, own_s=4.0))
    plain, corrected = (plan_order(model, logged, jobs, validate=False, check=each) for each in (None, judged_joint))
    assert corrected.expected_s == pytest.approx(plain.expected_s * judged_joint.factor)
    assert corrected.expected_s != pytest.approx(plain.expected_s, rel=0.01)


ROOM = ConditionCard(agent="operator", place="inbound", event="leaves", back=1, lag_s=(0.25,))
BOTH_WAIT = (
    GateCard(agent="robot", at="approach", place="conveyor", conditions=(ROOM,)),
    GateCard(
        agent="operator",
        at="approach",
        place="inbound",
        conditions=(ConditionCard(agent="robot", place="conveyor", event="leaves", lag_s=(0.5,)),),
    ),
)


@pytest.mark.slow
def test_plan_orders_the_work_of_both(logged: Dataset, tmp_path: Path) -> None:
    jobs = Jobs(
        visit=("conveyor->left_2", "conveyor->left_5", "conveyor->left_1"),
        start="home",
        operator=("inbound", "inbound", "out_left_1", "out_right_1"),
    )
    model, file = Coupled(gates(*BOTH_WAIT, own_s=4.0)), tmp_path / "planned.toml"
    found = plan_order(model, logged, jobs, out=file, validate=False)
    assert found.operator is not None
    assert sorted(found.operator) == sorted(jobs.operator)
    assert found.against_s > found.expected_s
    (sequence,) = load_sequences(file)
    (again,) = estimate_cycles(model, logged, [sequence], validate=False, extrapolate=True)
    assert again.expected_s == pytest.approx(found.expected_s)


@pytest.mark.slow
def test_what_if_takes_quicker_people_and_a_second_place(logged: Dataset) -> None:
    robot = ("home->conveyor", "conveyor->left_2", "left_2->conveyor", "conveyor->left_5", "left_5->conveyor")
    asked = [both(("inbound", "out_left_1", "inbound"), robot)]
    model = Coupled(gates(*BOTH_WAIT, own_s=0.5))
    changes = [
        Change("quick", faster={"operator": 2.0}),
        Change("two", more_places={"inbound": 1}),
        Change("free", without_waits=("robot approach conveyor",)),
    ]
    found = what_if(model, logged, asked, changes, validate=False, extrapolate=True)
    saved = {each.change: each.saves_s[0] for each in found}
    assert saved["quick"] > 1.0
    assert saved["free"] > 0.1
    assert saved["two"] > 0.1
    with pytest.raises(UnknownName, match="robot leave home"):
        what_if(model, logged, asked, [Change("wrong", without_waits=("robot leave home",))], validate=False)
    with pytest.raises(EstimateError, match="waits"):
        what_if(Constant(1.0), logged, [TaskSequence("plain", ("home", "conveyor"))], changes[:1], validate=False)
