"""Drift of an agent's pace over the executions: found where there is one, and only there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from cyclekit import TaskSequence
from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.cards.task_model import PaceCard
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.learning.task_times.learn import learn_runs
from cyclekit.learning.task_times.pace import pace_drift
from cyclekit.learning.task_times.runs import DoneTask, Run


@given(st.floats(-0.4, 0.4), st.sampled_from(["linear", "learning"]), st.integers(0, 10_000))
def test_a_drift_of_the_pace_is_found_where_there_is_one(change: float, law: str, seed: int) -> None:
    true = PaceCard(law=law, change=change, first=0, last=79)  # type: ignore[arg-type]
    number = np.repeat(np.arange(80), 5)
    log_work = change * true.passed(number) + 0.05 * np.random.default_rng(seed).standard_normal(len(number))
    found = pace_drift(number, log_work - log_work.mean())
    if abs(change) > 0.1:
        assert found is not None
        assert found.factor(0) == pytest.approx(np.exp(-change), rel=0.12)
    if found is not None:
        assert abs(found.change - change) < 0.1


@pytest.mark.parametrize(("seeds", "most"), [(20, 1), pytest.param(60, 3, marks=pytest.mark.slow)])
def test_no_drift_is_found_where_executions_near_each_other_are_alike(seeds: int, most: int) -> None:
    found = 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        number = np.repeat(np.arange(100), 5)
        log_work = np.repeat(0.1 * rng.standard_normal(10), 50) + 0.1 * rng.standard_normal(500)
        found += pace_drift(number, log_work) is not None
    assert found <= most


def test_the_interval_of_the_mean_holds_the_doubt_about_the_latest_pace() -> None:
    rng = np.random.default_rng(5)
    runs = [
        Run(str(n), {"worker": (DoneTask("mount", 0.0, float(6.0 * np.exp(-0.2 * n / 59 + 0.05 * rng.normal()))),)}, n)
        for n in range(60)
    ]
    model = learn_runs(runs, {"worker": "operator"}, folds=0)
    plan = TaskSequence.of_plan("all", [PlannedTask("worker", "mount")])

    def half_s(error: float) -> float:
        pace = {"worker": structs.replace(model.pace["worker"], error=error)}
        (found,) = estimate_plans(structs.replace(model, pace=pace), [plan], refused=lambda *_: None)
        return found.expected_high_s - found.expected_s

    assert 0.0 < model.pace["worker"].error < 0.1
    assert half_s(0.1) ** 2 - half_s(0.0) ** 2 == pytest.approx((1.96 * 0.105 * 6.0 * np.exp(-0.2)) ** 2, rel=0.1)
