"""Logged task durations beside the rollout: what they sum to, how they are resampled, and how both are weighed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.cli.estimate import basis_and_limits
from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.statistics.resample import resampled, resampled_alike
from cyclekit.estimate.validation.history import TaskTimes, chance_of_logs, history_share, order_error
from cyclekit.estimate.validation.logged import logged_sequences
from cyclekit.estimate.whatif import Change, what_if
from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.validation.check import Check


@pytest.fixture(scope="module")
def order(logged: Dataset) -> TaskSequence:
    return TaskSequence("A", tuple(logged.card.executions[0].places))


def test_the_sum_and_its_resamples_are_those_of_the_estimator_history(
    logged: Dataset, order: TaskSequence, staircase: Any
):
    times = TaskTimes(logged)
    (history,) = estimate(staircase, logged, [order], estimator="history")
    assert times.sum_s(order.tasks) == pytest.approx(history.expected_s, rel=2e-3)
    once = np.ones((1, len(times.executions)))
    assert times.resampled_s(order.tasks, once) == pytest.approx([times.sum_s(order.tasks)])
    assert times.resampled_s(order.tasks, 0.0 * once) == pytest.approx([times.sum_s(order.tasks)])


def test_history_is_drawn_with_the_executions_of_the_rollout():
    tracks = ("b", "a", "c", "b")
    weights = resampled(tracks, 3)
    times = resampled_alike(tracks, ["a", "b", "c", "not a track"], 3)
    assert (times[:, :3].sum(axis=1) == 3).all()
    assert (times[:, 3] == 1).all()
    np.testing.assert_allclose(weights[:, 1], times[:, 0] / (times[:, [1, 0, 2, 1]].sum(axis=1)))


def test_an_execution_is_judged_by_what_its_tasks_took_in_the_others(logged: Dataset):
    times, sequences = TaskTimes(logged), logged_sequences(logged, nominal_tasks(logged))
    elsewhere = np.array([times.elsewhere_s(sequence) for sequence in sequences])
    tasks = np.sqrt([len(sequence.tasks) for sequence in sequences])
    assert order_error(times, sequences, elsewhere * 1.02) == pytest.approx(
        np.sqrt(np.nanmean((tasks * (1 / 1.02 - 1))[np.isfinite(elsewhere)] ** 2))
    )
    assert order_error(times, sequences[:9], elsewhere[:9]) is None


def test_what_the_chance_of_a_few_walked_operators_explains_is_no_error_of_the_order(logged: Dataset):
    times, sequences = TaskTimes(logged), logged_sequences(logged, nominal_tasks(logged))
    names = [sequence.name for sequence in sequences]
    elsewhere = np.array([times.elsewhere_s(sequence) for sequence in sequences])
    luck = 1.0 + 0.2 * np.random.default_rng(0).standard_normal((len(names), 12))
    order = np.where(np.arange(len(names)) % 2, 0.7, 1.3)[:, None]
    found = []
    for cycles_s in (elsewhere[:, None] * luck, elsewhere[:, None] * luck * order):
        others_s = np.full((len(names), len(names)), np.nan)
        others_s[:, :12] = cycles_s
        chance = chance_of_logs(times, sequences, others_s, names, 1)
        mean_s = cycles_s.mean(axis=1)
        found.append(order_error(times, sequences, mean_s, chance) / order_error(times, sequences, mean_s))
    by_chance, by_order = found
    assert by_chance < 0.5
    assert by_order > 0.9


@given(st.floats(0.001, 0.05), st.floats(0.001, 0.05), st.floats(0.0, 0.9), st.floats(0.0, 0.05))
def test_no_other_weight_gives_less_variance(mine: float, other: float, alike: float, order: float):
    rng = np.random.default_rng(1)
    common, own, own_other = rng.standard_normal((3, 1000))
    rollout = 1 + mine * (alike**0.5 * common + (1 - alike) ** 0.5 * own)
    history = 1 + other * (alike**0.5 * common + (1 - alike) ** 0.5 * own_other)
    share = history_share(rollout, history, model_error=0.002, order_error=order)

    def variance(w: float) -> float:
        return float(((1 - w) * rollout + w * history).var(ddof=1) + ((1 - w) * 0.002) ** 2 + (w * order) ** 2)

    assert 0.0 <= share <= 1.0
    assert variance(share) <= min(variance(w) for w in np.linspace(0.0, 1.0, 21)) + 1e-12


def test_the_number_lies_between_both_and_says_so(logged: Dataset, staircase: Any, check: Check, order: TaskSequence):
    (found,) = estimate(staircase, logged, [order], check=check)
    both = found.combined
    assert both is not None
    assert 0.0 < both.history_share < 1.0
    assert found.expected_s == pytest.approx(
        (1 - both.history_share) * both.rollout_s + both.history_share * both.history_s
    )
    assert np.mean(found.durations_s) == pytest.approx(found.expected_s)
    assert sum(task.expected_s for task in found.tasks) == pytest.approx(found.expected_s)
    assert found.expected_low_s < found.expected_s < found.expected_high_s
    assert found.to_dict()["combined"]["history_share"] == both.history_share
    told = " ".join(basis_and_limits([found]).split())
    assert f"{percent(both.history_share)} with the logged durations of the same tasks" in told


def test_a_model_in_doubt_leaves_more_to_history(logged: Dataset, staircase: Any, check: Check, order: TaskSequence):
    shares = []
    for error in (0.0001, 0.02):
        (found,) = estimate(staircase, logged, [order], check=replace(check, own_error=error))
        assert found.combined is not None
        shares.append(found.combined.history_share)
    assert shares[1] > 1.5 * shares[0]


def test_what_the_logs_moved_a_number_by_moves_it_after_a_change_too(
    logged: Dataset, staircase: Any, check: Check, order: TaskSequence
):
    nothing = Change("nothing", levels=(0.0, 0.25, 0.5, 0.75, 1.0), thresholds_m=(1.2, 1.5, 1.9, 2.4))
    (found,) = what_if(staircase, logged, [order], [nothing], check=replace(check, own_bias=0.0))
    assert found.before.combined is not None
    assert found.before.expected_s != found.before.combined.rollout_s
    saved, low, high = found.saves_s
    assert saved == pytest.approx(0.0, abs=1e-9)
    assert low <= 0.0 <= high  # the error of the learned safety function, which a written one does not have
