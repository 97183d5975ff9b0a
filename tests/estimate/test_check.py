"""What the logged executions say of the rollout: their bias, what it corrects, and the intervals that follow."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import SplitCard, TrainingCard
from cyclekit.estimate.cycle import walk as walking
from cyclekit.estimate.finding import doubts_of, worst
from cyclekit.estimate.rollout import estimate as estimate_validated
from cyclekit.estimate.statistics.bias import bias_of, half_width_95
from cyclekit.estimate.statistics.conformal import PRIOR, conformal, with_expected
from cyclekit.estimate.statistics.resample import interval_of_mean, resampled
from cyclekit.estimate.validation.check import Check, check_rollout, compare, unseen_people

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset

estimate = partial(estimate_validated, validate=False)
"""The rollout itself, without what the logged executions correct."""


def test_logged_executions_come_out_right_beside_their_own_operators(logged: Dataset, staircase: Any):
    held_out = tuple(logged.executions["execution"].to_list()[:4])
    staircase.card = TrainingCard(split=SplitCard(test=held_out))
    found = check_rollout(staircase, logged)
    assert (found.executions, found.held_out) == (16, 4)
    assert abs(found.own_bias) < 0.003
    assert found.coverage > 0.6
    assert worst(found.findings) == "green"
    assert found.to_dict()["levels"] == [0.05, 0.95]


def test_the_check_of_single_executions_takes_small_steps_whatever_an_estimate_takes(
    logged: Dataset, staircase: Any, monkeypatch: pytest.MonkeyPatch
):
    found = check_rollout(staircase, logged, most=4)
    monkeypatch.setattr(walking, "TIME_STEP_S", 2.0)
    assert check_rollout(staircase, logged, most=4) == found


def test_fewer_executions_than_were_logged_judge_the_rollout_alike(logged: Dataset, staircase: Any):
    every, some = check_rollout(staircase, logged), check_rollout(staircase, logged, most=10)
    assert (every.executions, some.executions) == (16, 10)
    assert some.own_bias == pytest.approx(every.own_bias, abs=0.01)
    assert some.coverage is not None


def test_a_wrong_safety_function_is_told(logged: Dataset, constant: Any):
    found = check_rollout(constant(0.9), logged)
    assert found.own_bias < -0.1
    assert any("backtest with their own operators" in text for text in doubts_of(found.findings))


def crossing(count: int, reaction_s: float) -> Check:
    """Executions of 100 s +- 5 s; `reaction_s` is what the logged operators save by minding the robot."""
    rng = np.random.default_rng(3)
    operators = rng.normal(100.0, 5.0, count)
    others = np.where(np.eye(count, dtype=bool), np.nan, operators[None, :] + rng.normal(0, 0.3, (count, count)))
    logged_s = operators - reaction_s
    return compare(logged_s, logged_s * 1.001, others, np.arange(count) < 20, (0.05, 0.5, 0.95))


def test_an_operator_who_minds_the_robot_is_found_out():
    assert worst(crossing(100, 0.0).findings) == "green"
    assert any("react to the robot" in text for text in doubts_of(crossing(100, 4.0).findings))


def test_a_bias_that_is_no_chance_is_taken_out_and_the_parts_still_add_up(logged: Dataset, staircase: Any, routes: Any):
    biased = replace(crossing(100, 0.0), own_bias=0.02, own_error=0.001)
    assert biased.factor == pytest.approx(1 / 1.02, abs=1e-4)
    assert replace(biased, own_error=0.2).factor == 1.0
    assert replace(biased, own_error=0.02).factor == 1.0  # one standard error is chance
    assert 1 / 1.02 < replace(biased, own_error=0.01).factor < 0.99
    assert replace(biased, own_error=0.2).model_error == pytest.approx(0.2, rel=0.01)
    sequence = TaskSequence("A", routes[0][:9])
    (plain,) = estimate(staircase, logged, [sequence])
    (found,) = estimate(staircase, logged, [sequence], check=biased)
    assert found.expected_s == pytest.approx(plain.expected_s * biased.factor)
    assert found.nominal_s == plain.nominal_s
    assert found.dwell_s == pytest.approx(plain.dwell_s)
    whole = found.nominal_s + found.safety_loss_s + found.dwell_s + found.wait_s
    assert whole == pytest.approx(found.expected_s)
    assert sum(found.safety_by_activity_s.values()) == pytest.approx(found.safety_loss_s)


def test_conformal_quantiles_hold_on_new_cycles():
    check = crossing(200, 0.0)
    assert check.residuals == pytest.approx([-0.001] * 200, abs=1e-5)
    assert 0.85 < check.coverage < 0.95
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(400):
        cycles, fresh = rng.normal(100.0, 5.0, 50), rng.normal(100.0, 5.0)
        inside.append(conformal(check.single(cycles), 0.05) <= fresh <= conformal(check.single(cycles), 0.95))
    assert 0.86 < np.mean(inside) < 0.96


def test_one_other_turn_among_few_unseen_executions_is_not_taken_for_one_in_so_few():
    """Nine of 45 unseen, all within 0.1 % of what was logged but one, which took 9 % longer than its rollout."""
    rng = np.random.default_rng(8)
    logged_s, unseen = rng.normal(100.0, 4.0, 45), np.arange(45) < 9
    own_s = logged_s * (1 + rng.normal(0.0, 0.001, 45))
    own_s[4] = logged_s[4] / 1.09
    others = np.where(np.eye(45, dtype=bool), np.nan, own_s[None, :])
    check = compare(logged_s, own_s, others, unseen, (0.05, 0.95))
    assert len(check.residuals) == 45
    assert abs(check.own_bias) < 0.003
    cycles = rng.normal(100.0, 4.0, 4000)
    assert conformal(check.single(cycles), 0.95) == pytest.approx(100 + 1.645 * 4, abs=0.6)


def test_where_the_unseen_executions_come_out_worse_they_alone_judge():
    rng = np.random.default_rng(9)
    logged_s, unseen = rng.normal(100.0, 4.0, 45), np.arange(45) < 9
    own_s = logged_s * (1 + np.where(unseen, 0.02, 0.001) * rng.choice([0.5, 1.0, 1.5], 45))
    others = np.where(np.eye(45, dtype=bool), np.nan, own_s[None, :])
    check = compare(logged_s, own_s, others, unseen, (0.05, 0.95))
    assert len(check.residuals) == 9
    assert check.own_bias == pytest.approx((own_s / logged_s - 1)[:9].mean())


def test_what_the_network_leaves_open_widens_the_interval():
    """Logged cycles scatter by 4 s about the rolled ones, which know nothing of it."""
    rng = np.random.default_rng(7)
    own_s = rng.normal(100.0, 3.0, 400)
    others = np.where(np.eye(400, dtype=bool), np.nan, own_s[None, :])
    check = compare(own_s + rng.normal(0.0, 4.0, 400), own_s, others, np.ones(400, dtype=bool), (0.05, 0.95))
    assert conformal(check.single(rng.normal(100.0, 3.0, 4000)), 0.95) == pytest.approx(100 + 1.645 * 5, abs=0.5)


@given(st.integers(19, 200), st.sampled_from([0.05, 0.1, 0.9, 0.95]))
def test_of_k_values_in_a_row_one_more_is_below_the_conformal_quantile_as_often_as_it_says(count: int, level: float):
    """Values 1 ... K cut the line into K + 1 parts that one more falls into with the same probability."""
    assert conformal(np.arange(1.0, count + 1), level) / (count + 1) == pytest.approx(level)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60))
def test_conformal_quantiles_are_in_order_and_within_the_values(values: list[float]):
    found = [conformal(np.array(values), level) for level in (0.01, 0.05, 0.5, 0.95, 0.99)]
    assert found == sorted(found)
    assert min(values) <= found[0]
    assert found[-1] <= max(values)


def test_resampling_draws_tracks_of_an_execution_together():
    weights = resampled(["a", "b", "a", "c"], 0)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_array_equal(weights[:, 0], weights[:, 2])
    assert weights[:, 1].std() > 0


def test_the_interval_of_a_mean_is_no_narrower_than_the_bias_that_a_doubt_names(
    logged: Dataset, staircase: Any, routes: Any
):
    """An operator who reacts: beside others the logged executions come out 4 % off."""
    reacts, sequence = crossing(100, 4.0), TaskSequence("A", routes[0][:9])
    sure = replace(reacts, reacts_z=0.0)
    assert sure.doubted_bias == 0.0
    assert reacts.doubted_bias == abs(reacts.crossed_bias) > 0.03
    (plain,) = estimate(staircase, logged, [sequence], check=sure, takt_s=40.0)
    (found,) = estimate(staircase, logged, [sequence], check=reacts, takt_s=40.0)
    wider = reacts.doubted_bias * found.expected_s
    assert found.expected_low_s == pytest.approx(plain.expected_low_s - wider)
    assert found.expected_high_s == pytest.approx(plain.expected_high_s + wider)
    assert found.takt_probability[1] <= plain.takt_probability[1]
    assert found.takt_probability[2] >= plain.takt_probability[2]
    (doubt,) = set(found.doubts) - set(plain.doubts)
    assert "react to the robot" in doubt
    assert doubt in found.warnings
    assert doubt in found.to_dict()["doubts"]


def test_of_a_bias_that_was_taken_out_a_part_stays_in_the_interval():
    """It was measured on the logged orders; nothing of it is added to both sides again."""
    check = replace(crossing(100, 0.0), own_bias=0.02, own_error=0.001)
    assert check.doubted_bias == 0.0
    assert check.model_error == pytest.approx(0.3 * 0.02, rel=0.05)
    assert replace(check, own_bias=0.0).model_error == pytest.approx(0.001)


def test_what_nobody_saw_of_people_widens_the_interval(logged: Dataset, staircase: Any, routes: Any):
    sequence = TaskSequence("asked", routes[0])
    known = replace(check_rollout(staircase, logged), order_error=None)
    asked = partial(estimate_validated, staircase, logged, [sequence])
    (seen,), (unseen,) = asked(check=known), asked(check=replace(known, unseen_error=0.1))
    assert unseen.expected_s == seen.expected_s
    assert unseen.expected_high_s > seen.expected_high_s + 0.1 * seen.expected_s


def test_cycles_scatter_as_logged_executions_of_other_orders_do():
    rng = np.random.default_rng(0)
    logged_s, others_s = rng.normal(100.0, 4.0, 50), rng.normal(100.0, 8.0, (50, 40))
    unseen_error, spread = unseen_people(0.4, logged_s / 100.0, others_s)
    assert spread == pytest.approx(0.5, rel=0.2)
    assert unseen_error == pytest.approx(0.4 * 0.04, rel=0.3)
    check = replace(crossing(50, 0.0), residuals=(0.0,) * 50)
    (low, high), (nearer, less) = (
        [conformal(one.single(others_s.ravel()), level) for level in (0.05, 0.95)]
        for one in (check, replace(check, spread=spread))
    )
    assert (less - nearer) == pytest.approx(spread * (high - low))
    assert unseen_people(0.0, logged_s, others_s) == (0.0, 1.0)


def test_too_few_logged_executions_are_said_and_correct_nothing(logged: Dataset, staircase: Any, routes: Any):
    two = logged.only(logged.executions["execution"].to_list()[:2])
    sequence = TaskSequence("A", two.card.executions[0].places[:3])
    (found,) = estimate_validated(staircase, two, [sequence], extrapolate=True)
    assert found.check is None
    assert any("not validated on logged executions" in text for text in found.doubts)


def test_unseen_executions_that_lie_elsewhere_widen_the_bias():
    """All but the nine unseen ones come out as logged; those are 1.5 % off on average, which four of them cause."""
    unseen = np.arange(45) < 9
    off = np.tile([0.002, -0.002, 0.0], 15)
    none = bias_of(off, unseen)
    assert none.error == pytest.approx(off.std(ddof=1) / 45**0.5)
    off = np.where(np.arange(45) < 4, 0.034, off)
    found = bias_of(off, unseen)
    assert found.bias == pytest.approx(off.mean())
    assert len(found.off) == 45
    assert half_width_95(found.error, 45) > off[unseen].mean() - found.bias - 0.001
    assert half_width_95(found.error, 45) > 1.5 * half_width_95(off.std(ddof=1) / 45**0.5, 45)


@given(st.integers(2, 60))
def test_the_interval_of_a_bias_is_that_of_student(count: int):
    sample = np.random.default_rng(count).normal(0.0, 0.01, count)
    low, high = stats.ttest_1samp(sample, 0.0).confidence_interval(0.95)
    found = bias_of(sample, np.zeros(count, dtype=bool))
    assert (
        found.bias - half_width_95(found.error, count),
        found.bias + half_width_95(found.error, count),
    ) == pytest.approx((low, high))


def test_few_executions_leave_the_model_error_wide():
    means = np.full(1000, 100.0)
    few, many = (interval_of_mean(means, model_error=0.01, judged=n, seed=0) for n in (4, 400))
    assert many[1] - many[0] == pytest.approx(2 * 1.96, rel=0.1)
    assert few[1] - few[0] > 1.4 * (many[1] - many[0])


@pytest.mark.parametrize(("width", "alone"), [(0.5, False), (1.0, False), (3.0, True)])
def test_logged_cycles_count_in_one_way_whether_given_as_times_or_as_ranks(width: float, alone: bool):
    rolled = np.linspace(90.0, 110.0, 1999)
    logged = 100.0 + width * np.linspace(-9.9, 9.9, 40)
    ranks = (np.searchsorted(rolled, logged) + 0.5) / (len(rolled) + 1)
    of_times, of_ranks = with_expected(logged, rolled), with_expected(ranks, np.array([0.0, 1.0]))
    assert len(of_times) == len(of_ranks) == (40 if alone else 40 + PRIOR)
    if not alone:
        assert np.median(of_times[40:]) == pytest.approx(100.0)
