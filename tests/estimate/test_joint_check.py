"""What the backtest of joint rollouts does to the intervals: a bias and unexplained waits make them wider."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.joint.check import JointCheck, judge_joint
from cyclekit.estimate.joint.unexplained import unexplained_waits


def judged(**told: Any) -> JointCheck:
    usual: dict[str, Any] = {
        "executions": 40, "held_out": 0, "own_bias": 0.0, "own_error": 0.005, "crossed_bias": 0.0, "reacts_z": 0.0,
        "residuals": (0.0,) * 40, "coverage": 0.9, "coverage_held_out": None, "levels": (0.05, 0.95),
    }  # fmt: skip
    return JointCheck(**(usual | told))


def test_a_bias_beyond_chance_is_in_the_interval_though_it_is_taken_out() -> None:
    assert judged(own_bias=0.05).doubted_bias == pytest.approx(0.05)
    assert judged(own_bias=0.012).doubted_bias == 0.0  # less than three standard errors


def test_cycles_that_vary_much_are_no_bias(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rollouts have the true mean; where logged cycles vary by a fifth, the mean of rolled / logged is 4 % above 1."""
    rng = np.random.default_rng(3)
    names, count = [str(number) for number in range(400)], 400
    logged = 50.0 * (1.0 + 0.2 * rng.standard_normal(count).clip(-2.5, 2.5))
    rolled = [SimpleNamespace(duration_s=np.full(60, 50.0) + rng.normal(0.0, 10.0, 60)) for _ in names]
    module = "cyclekit.estimate.joint.check"
    monkeypatch.setattr(f"{module}.logged_sequences", lambda *_: [TaskSequence(name, ("a", "b")) for name in names])
    monkeypatch.setattr(f"{module}.logged_durations", lambda _, some: logged[[int(one.name) for one in some]])
    monkeypatch.setattr(f"{module}.longest_s", lambda _: 100.0)
    monkeypatch.setattr(f"{module}.unexplained_waits", lambda *_: SimpleNamespace(wait_s=0.0, by_order_s=0.0))
    monkeypatch.setattr(f"{module}.MAX_EXECUTIONS", count)
    cell: Any = SimpleNamespace(
        dataset=None,
        logged=dict.fromkeys(names, ()),
        paces={},
        model=SimpleNamespace(card=SimpleNamespace(held_out=())),
        roll=lambda plans, **_: rolled[: len(plans)],
    )
    planner: Any = SimpleNamespace(nominal={}, plan=lambda sequence: sequence)
    found = judge_joint(cell, planner, levels=(0.05, 0.95), seed=0)
    assert found is not None
    assert abs(found.own_bias) < 0.022  # two standard errors
    assert found.own_bias == pytest.approx(50.0 / logged.mean() - 1.0, abs=0.003)


def test_single_cycles_scatter_as_the_logged_ones_do() -> None:
    scores = tuple(np.linspace(-3.0, 1.0, 41))
    cycles = np.random.default_rng(1).normal(50.0, 2.0, 1000)
    found = [judged(scores=scores).quantile(cycles, level) for level in (0.05, 0.95)]
    assert found == pytest.approx([cycles.mean() - 2.89 * cycles.std(), cycles.mean() + 0.89 * cycles.std()], abs=0.01)
    assert judged().quantile(cycles, 0.05) == pytest.approx(np.quantile(cycles, 0.05))


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
    assert "no condition explains" in check.doubts[-1]
    assert unexplained_waits(waited(9.0, away, waited_for="part set"), names, 50.0) == (0.0, 0.0)


@given(st.lists(st.lists(st.floats(0.0, 20.0), min_size=1, max_size=4), min_size=1, max_size=20))
def test_what_the_order_moves_is_finite_for_any_waits(away: list[list[float]]) -> None:
    found = unexplained_waits(waited(9.0, away), [str(number) for number in range(len(away))], 50.0)
    assert np.isfinite(found).all()
    assert min(found) >= 0.0
