"""What the backtest of joint rollouts does to the intervals: a bias and unexplained waits make them wider."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.finding import doubts_of
from cyclekit.estimate.joint.check import JointCheck, judge_joint, widening, with_every_visit
from cyclekit.estimate.joint.legs import Gates, operator_agenda, robot_agenda
from cyclekit.estimate.joint.repetitions import cycles_per_resample, repetitions
from cyclekit.estimate.joint.unexplained import unexplained_waits
from cyclekit.estimate.robot.nominal import NominalTask
from cyclekit.estimate.statistics.conformal import conformal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Vector


def judged(**told: Any) -> JointCheck:
    usual: dict[str, Any] = {
        "executions": 40, "held_out": 0, "own_bias": 0.0, "own_error": 0.005, "crossed_bias": 0.0, "reacts_z": 0.0,
        "residuals": (0.0,) * 40, "coverage": 0.9, "coverage_held_out": None, "levels": (0.05, 0.95),
    }  # fmt: skip
    return JointCheck(**(usual | told))


def test_a_bias_beyond_chance_is_in_the_interval_though_it_is_taken_out() -> None:
    assert judged(own_bias=0.05).doubted_bias == pytest.approx(0.05)
    assert judged(own_bias=0.012).doubted_bias == 0.0  # less than three standard errors


def _judged(
    monkeypatch: pytest.MonkeyPatch, logged: Vector, rolled: Floats, orders: Sequence[str] = ("ab",)
) -> JointCheck:
    """Return the check of logged cycles, shape (E,), s, by rolled-out ones, shape (E, 60); `orders` in turn."""
    names = [str(number) for number in range(len(logged))]
    cycles = [SimpleNamespace(duration_s=some) for some in rolled]
    module = "cyclekit.estimate.joint.check"
    monkeypatch.setattr(
        f"{module}.logged_sequences",
        lambda *_: [TaskSequence(name, tuple(orders[int(name) % len(orders)])) for name in names],
    )
    monkeypatch.setattr(f"{module}.logged_durations", lambda _, some: logged[[int(one.name) for one in some]])
    monkeypatch.setattr(f"{module}.longest_s", lambda _: 100.0)
    monkeypatch.setattr(f"{module}.unexplained_waits", lambda *_, **__: SimpleNamespace(wait_s=0.0, by_order_s=0.0))
    monkeypatch.setattr(f"{module}.repetitions", lambda _: 60)
    monkeypatch.setattr(f"{module}.MAX_EXECUTIONS", len(logged))
    cell: Any = SimpleNamespace(
        coupling=None,
        dataset=SimpleNamespace(recordings=()),
        logged=dict.fromkeys(names, ()),
        paces={},
        model=SimpleNamespace(card=SimpleNamespace(held_out=(), warnings=())),
        roll=lambda plans, **_: cycles[: len(plans)],
    )
    plan = SimpleNamespace(robot=None, operators=())
    planner: Any = SimpleNamespace(nominal={}, plan=lambda _: plan)
    found = judge_joint(cell, planner, levels=(0.05, 0.95), seed=0)
    assert found is not None
    return found


@pytest.mark.parametrize(("by_order", "orders"), [(0.06, 4), (0.0, 4), (0.06, 60)])
def test_errors_that_depend_on_the_order_widen_the_interval(
    monkeypatch: pytest.MonkeyPatch, by_order: float, orders: int
) -> None:
    """Orders that were logged once tell nothing of it."""
    rng = np.random.default_rng(5)
    names = [f"ab{chr(ord('c') + number)}" for number in range(orders)]
    errors = 1.0 + by_order * np.linspace(-1.5, 1.5, orders) / np.linspace(-1.5, 1.5, orders).std()
    logged = 100.0 * np.resize(errors, 60) * rng.normal(1.0, 0.03, 60)
    found = _judged(monkeypatch, logged, 100.0 * rng.normal(1.0, 0.03, (60, 60)), names)
    doubted = any("depends on the order was not learned" in doubt for doubt in doubts_of(found.findings))
    assert doubted is (by_order > 0.0 and orders == 4)
    assert found.by_order == pytest.approx(0.075 if doubted else 0.0, abs=0.015)
    assert (found.model_error > 0.05) is doubted


def test_errors_by_order_that_few_executions_cannot_show_are_in_the_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four orders that differ by a third of what single executions scatter by, four executions of each."""
    rng, seen = np.random.default_rng(5), []
    for _ in range(20):
        errors = np.resize([0.98, 0.99, 1.01, 1.02], 16)
        logged = 100.0 * errors * rng.normal(1.0, 0.03, 16)
        found = _judged(monkeypatch, logged, 100.0 * rng.normal(1.0, 0.03, (16, 60)), ["abc", "abd", "abe", "abf"])
        assert found.order_shown or "depends on the order" not in "".join(doubts_of(found.findings))
        seen.append((found.by_order, found.order_shown))
    widens, shown = np.array(seen).T
    assert shown.mean() < 0.5
    assert (widens**2).mean() ** 0.5 == pytest.approx(0.018, rel=0.5)
    assert (widens[shown == 0.0] > 0.0).mean() > 0.3


def test_executions_that_leave_the_validation_are_counted_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three of 60 lack a visit for which the robot waited, two end in a deadlock."""
    monkeypatch.setattr("cyclekit.estimate.joint.check.with_every_visit", lambda _, some: some[:-3])
    rolled = np.random.default_rng(3).normal(50.0, 2.0, (60, 60))
    rolled[:2] = np.inf
    found = _judged(monkeypatch, rolled[2:, 0].mean() + np.zeros(60), rolled)
    assert (found.executions, found.missed, found.unended) == (55, 3, 2)
    missed, deadlocks = (one for one in found.findings if one.code in ("missed-visits", "deadlocks"))
    assert missed.text.startswith("in 3 of 60 logged executions a visit of the operator was missed")
    assert deadlocks.text.startswith("2 of 57 logged orders end in a deadlock or do not end")
    assert (missed.blocks, deadlocks.blocks) == (False, True)


def test_cycles_that_vary_much_are_no_bias(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rollouts have the true mean; where logged cycles vary by a fifth, the mean of rolled / logged is 4 % above 1."""
    rng = np.random.default_rng(3)
    logged = 50.0 * (1.0 + 0.2 * rng.standard_normal(400).clip(-2.5, 2.5))
    found = _judged(monkeypatch, logged, np.full((400, 60), 50.0) + rng.normal(0.0, 10.0, (400, 60)))
    assert abs(found.own_bias) < 0.022  # two standard errors
    assert found.own_bias == pytest.approx(50.0 / logged.mean() - 1.0, abs=0.003)


def test_single_cycles_scatter_as_the_logged_ones_do() -> None:
    scores = tuple(np.linspace(-3.0, 1.0, 41))
    cycles = np.random.default_rng(1).normal(50.0, 2.0, 1000)
    found = [conformal(judged(scores=scores).single(cycles), level) for level in (0.05, 0.95)]
    assert found == pytest.approx([cycles.mean() - 2.89 * cycles.std(), cycles.mean() + 0.89 * cycles.std()], abs=0.01)
    assert conformal(judged().single(cycles), 0.05) == pytest.approx(np.quantile(cycles, 0.05), abs=0.01)


def _of_waits(rng: np.random.Generator, wait_s: float, *shape: int) -> Floats:
    """Return cycles of 40 s and a wait that is often short and sometimes long."""
    return np.asarray(40.0 + rng.exponential(wait_s, shape))


def test_a_few_long_waits_do_not_widen_all_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rollouts know how waits are distributed, and the longest few of 60 logged cycles do not."""
    inside = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        wait_s = rng.choice([1.0, 4.0], 60)
        rolled = np.stack([_of_waits(rng, wait, 60) for wait in wait_s])
        logged = np.array([float(_of_waits(rng, wait)) for wait in wait_s])
        found = _judged(monkeypatch, logged, rolled)
        cycles, true = _of_waits(rng, 4.0, 1000), _of_waits(rng, 4.0, 4000)
        low_s, high_s = (conformal(found.single(cycles), level) for level in (0.05, 0.95))
        inside.append(np.mean((true >= low_s) & (true <= high_s)))
    assert np.mean(inside) == pytest.approx(0.9, abs=0.02)
    assert min(inside) >= 0.84
    assert max(inside) <= 0.94


@pytest.mark.parametrize(("outside", "alone"), [(10, False), (11, True)])
def test_logged_cycles_alone_count_at_the_level_of_task_lists(
    monkeypatch: pytest.MonkeyPatch, outside: int, *, alone: bool
) -> None:
    """Of 60, ten or more are in the outer tenth with a chance of 7 %, eleven or more with one of 3 %."""
    levels = np.concatenate([np.resize([0.01, 0.99], outside), np.linspace(0.1, 0.9, 60 - outside)])
    found = _judged(monkeypatch, 45.0 + 10.0 * levels, np.tile(np.linspace(45.0, 55.0, 60), (60, 1)))
    assert bool(found.scores) is alone
    assert bool(found.ranks) is not alone


def test_where_logged_cycles_scatter_more_than_rollouts_they_alone_count(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    logged = rng.normal(50.0, 4.0, 60)
    found = _judged(monkeypatch, logged, rng.normal(50.0, 2.0, (60, 60)))
    cycles = rng.normal(50.0, 2.0, 1000)
    true = rng.normal(50.0, 4.0, 4000)
    low_s, high_s = (conformal(found.single(cycles), level) for level in (0.05, 0.95))
    assert np.mean((true >= low_s) & (true <= high_s)) > 0.85


def waited(gap_s: float, away_s: list[list[float]], **told: str) -> Dataset:
    """Return a stand-in of executions whose robot waits at a place until parts come every `gap_s`."""
    rows = []
    for number, some in enumerate(away_s):
        at = 0.0
        for index, away in enumerate(some):
            arrived, wait = at + away, max(gap_s - away, 0.0)
            rows.append({"execution": str(number), "index": index, "goal_place": "conveyor", "start_s": at,
                         "arrival_s": arrived, "end_s": arrived + wait + 1.0, "wait_s": wait})  # fmt: skip
            at = arrived + wait + 1.0
    frame = pl.DataFrame(rows).with_columns(waited_for=pl.lit(told.get("waited_for"), dtype=pl.String))
    return cast("Dataset", SimpleNamespace(tasks=lambda: frame))


def test_waits_that_depend_on_the_time_away_differ_by_the_order() -> None:
    rng = np.random.default_rng(2)
    away = rng.uniform(1.0, 8.0, (40, 3)).tolist()
    logged, names = waited(9.0, away), [str(number) for number in range(40)]
    waits = 27.0 - np.sum(away, axis=1)
    found = unexplained_waits(logged, names, 50.0)
    assert found == pytest.approx((waits.mean(), waits.std(ddof=1)))
    check = judged(unexplained_s=found.wait_s, unseen_error=found.by_order_s / 50.0)
    assert check.model_error > found.by_order_s / 50.0
    assert "no condition explains" in check.findings[-1].text
    assert unexplained_waits(waited(9.0, away, waited_for="part set"), names, 50.0) == (0.0, 0.0)


@given(st.lists(st.lists(st.floats(0.0, 20.0), min_size=1, max_size=4), min_size=1, max_size=20))
def test_what_the_order_moves_is_finite_for_any_waits(away: list[list[float]]) -> None:
    found = unexplained_waits(waited(9.0, away), [str(number) for number in range(len(away))], 50.0)
    assert np.isfinite(found).all()
    assert min(found) >= 0.0


def test_cycles_that_hardly_vary_do_not_widen_all_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    """In every fifth order the rollouts are nearly the same each time, though logged cycles vary by half a second."""
    inside = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        spread_s = np.resize([0.01, 1.0, 1.0, 1.0, 1.0], 60)
        rolled = 50.0 + spread_s[:, None] * rng.normal(0.0, 1.0, (60, 60))
        found = _judged(monkeypatch, 50.0 + np.hypot(spread_s, 0.5) * rng.normal(0.0, 1.0, 60), rolled)
        assert found.scores
        cycles, true = rng.normal(50.0, 1.0, 1000), rng.normal(50.0, np.hypot(1.0, 0.5), 4000)
        low_s, high_s = (conformal(found.single(cycles), level) for level in (0.05, 0.95))
        inside.append(np.mean((true >= low_s) & (true <= high_s)))
    assert np.mean(inside) == pytest.approx(0.9, abs=0.03)


def _repeated(rare_s: float, often_s: float) -> Any:
    """Return a stand-in of a cell with 30 executions of one task in each, and one of three others in a third each.

    Args:
        rare_s: Spread of the durations of these three, s.
        often_s: That of the task in each execution, s.
    """
    rng = np.random.default_rng(1)
    rows = [
        {
            "execution": str(number),
            "task": task,
            "start_s": 0.0,
            "end_s": 20.0 + spread_s * rng.normal(),
            "wait_s": None,
        }
        for number in range(30)
        for task, spread_s in (("a->b", often_s), (f"b->{number % 3}", rare_s))
    ]
    frame = pl.DataFrame(rows, schema_overrides={"wait_s": pl.Float64})
    return SimpleNamespace(
        executions=30,
        logged={str(number): () for number in range(30)},
        dataset=SimpleNamespace(tasks=lambda: frame),
        gates=SimpleNamespace(waits=lambda _: False),
    )


def test_parts_that_few_executions_have_are_known_from_these_alone() -> None:
    rare, often = _repeated(rare_s=1.0, often_s=0.0), _repeated(rare_s=0.0, often_s=1.0)
    assert [repetitions(rare), repetitions(often), repetitions(_repeated(rare_s=0.0, often_s=0.0))] == [10, 30, 30]
    assert 10 < repetitions(_repeated(rare_s=1.0, often_s=1.0)) < 20
    assert [cycles_per_resample(rare), cycles_per_resample(often)] == [8, 28]  # Student's t is 2.26 and 2.05


def test_single_cycles_scatter_more_where_few_executions_tell_of_their_parts() -> None:
    cycles = np.random.default_rng(1).normal(50.0, 2.0, 1000)
    assert [widening(count, count) for count in (40, 200)] == [1.0, 1.0]
    assert 1.0 < widening(20, 20) < widening(20, 10) < widening(10, 10) < widening(5, 5) == widening(2, 2) < 1.5
    usual, few = (conformal(judged(widening=each).single(cycles), 0.95) for each in (1.0, 1.2))
    assert few - cycles.mean() == pytest.approx(1.2 * (usual - cycles.mean()))


def test_an_execution_with_a_visit_that_was_missed_is_no_bias() -> None:
    """Its rollout lacks the wait of the robot for that visit; where most lack one, they all count."""
    gate = ConditionCard(agent="operator", place="bench", event="leaves", lag_s=(0.5,))
    gates = Gates(CouplingCard(gates=(GateCard(agent="robot", at="leave", place="show", conditions=(gate,)),)))
    task = NominalTask("home->show", np.zeros((2, 3)), 1.0, 1.0, 0.0, np.ones(1))
    robot = robot_agenda([task, task], gates)
    plans = {
        places: SimpleNamespace(robot=robot, operators=(operator_agenda(places, gates, {}, {}),))
        for places in (("bench", "shelf", "bench"), ("bench", "shelf"))
    }
    planner: Any = SimpleNamespace(plan=lambda sequence: plans[sequence.operator])
    whole, missed = (TaskSequence("one", ("home", "show"), places) for places in plans)
    assert with_every_visit(planner, [whole, missed, whole, whole]) == [whole, whole, whole]
    assert with_every_visit(planner, [whole, missed, missed, missed]) == [whole, missed, missed, missed]
