"""The estimators by name, the table of arrivals against the walk, the check by logged executions, the dynamics of s."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from report_pages import estimate as made
from scipy import stats

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import DynamicsCard, SplitCard, TrainingCard
from cyclekit.errors import UnknownName
from cyclekit.estimate import rollout
from cyclekit.estimate import walk as walking
from cyclekit.estimate.check import Check, check_rollout, compare
from cyclekit.estimate.conformal import conformal
from cyclekit.estimate.judges import judge, within
from cyclekit.estimate.limits import doubts_of
from cyclekit.estimate.nominal import nominal_tasks
from cyclekit.estimate.program import lay_out
from cyclekit.estimate.resample import interval_of_mean, resampled
from cyclekit.estimate.rollout import estimate as estimate_validated
from cyclekit.estimate.safety import Dynamics, Follower
from cyclekit.estimate.tracks import operator_tracks, phase_is_free
from cyclekit.estimate.transit import transit_table
from cyclekit.estimate.walk import Rolled, roll_all, roll_out

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset

estimate = partial(estimate_validated, validate=False)
"""The rollout itself, without what the logged executions correct."""


@pytest.fixture(scope="module")
def routes(logged: Dataset) -> list[tuple[str, ...]]:
    return [entry.places for entry in logged.card.executions]


def test_history_is_the_sum_of_the_logged_means_of_the_tasks(logged: Dataset, staircase: Any, routes: Any):
    sequence = TaskSequence("A", routes[0][:7])
    (found,) = estimate(staircase, logged, [sequence], estimator="history")
    means = logged.tasks().group_by("task").agg((pl.col("end_s") - pl.col("start_s")).mean().alias("s"))
    by_task = dict(means.iter_rows())
    assert found.expected_s == pytest.approx(sum(by_task[task] for task in sequence.tasks), rel=0.01)
    assert (found.estimator, found.tracks) == ("history", 0)


def test_nominal_is_motion_and_stands(logged: Dataset, staircase: Any, routes: Any):
    sequence = TaskSequence("A", routes[0][:7])
    (found,) = estimate(staircase, logged, [sequence], estimator="nominal")
    tasks = nominal_tasks(logged)
    whole = sum(tasks[task].nominal_s + tasks[task].dwell_s + tasks[task].wait_s for task in sequence.tasks)
    assert found.expected_s == pytest.approx(whole)
    assert found.safety_loss_s == 0.0


@pytest.mark.parametrize(("scaling", "horizon_s"), [(0.5, 2.0), (0.8, 14.0), (0.25, 0.7)])
def test_average_solves_for_the_time_in_which_the_mean_scaling_makes_the_nominal_time(
    logged: Dataset, constant: Any, routes: Any, scaling: float, horizon_s: float
):
    model = constant(scaling)
    model.problem, model.horizon_s = "average", horizon_s
    (found,) = estimate(model, logged, [TaskSequence("A", routes[0][:6])])
    assert found.estimator == "average"
    assert found.safety_loss_s == pytest.approx(found.nominal_s * (1 / scaling - 1))
    assert "average" in found.why or "mean scalings" in found.why


def test_an_estimator_that_does_not_exist_is_refused_with_the_nearest(logged: Dataset, staircase: Any, routes: Any):
    with pytest.raises(UnknownName) as caught:
        estimate(staircase, logged, [TaskSequence("A", routes[0][:4])], estimator="rolout")
    assert caught.value.nearest == "rollout"


def test_sequences_are_compared_on_the_same_operators(logged: Dataset, staircase: Any, routes: Any):
    asked = [TaskSequence("A", routes[0]), TaskSequence("other order", routes[1]), TaskSequence("twin", routes[0])]
    found = {entry.name: entry for entry in estimate(staircase, logged, asked, takt_s=90.0)}
    assert found["A"].durations_s == found["twin"].durations_s
    assert found["A"].beats["twin"] == 0.5
    assert found["A"].beats["other order"] == pytest.approx(1 - found["other order"].beats["A"])
    share, low, high = found["A"].takt_probability
    assert share == np.mean(np.array(found["A"].durations_s) <= 90.0)
    assert low <= share <= high


def test_sequences_that_do_different_work_are_not_held_against_each_other(logged: Dataset, staircase: Any, routes: Any):
    asked = [TaskSequence("long", routes[0]), TaskSequence("short", routes[0][:9]), TaskSequence("twin", routes[0])]
    found = estimate(staircase, logged, asked)
    assert [entry.name for entry in found] == ["short", "long", "twin"]
    assert [set(entry.beats) for entry in found] == [set(), {"twin"}, {"long"}]
    assert found[0].per_visit_s == found[0].expected_s / 8


def test_of_very_many_sequences_each_is_held_against_the_first_of_its_work(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("cyclekit.estimate.rollout.MANY", 2)
    some = [made(name) for name in "abc"]
    ranked = rollout._ranked(some, {name: np.full(4, float(n)) for n, name in enumerate("abc")})
    assert [entry.beats for entry in ranked] == [{}, {"a": 0.0}, {"a": 0.0}]


def test_many_sequences_walked_at_once_are_those_walked_one_by_one(logged: Dataset, staircase: Any, routes: Any):
    nominal = nominal_tasks(logged)
    programs = [lay_out(TaskSequence("A", route), nominal, logged) for route in (routes[0][:5], routes[1][:9])]
    tracks = operator_tracks(logged, horizon_s=120.0)
    for program, rolled in zip(programs, roll_all(staircase, programs, tracks, None), strict=True):
        alone = roll_out(staircase, program, tracks, None)
        np.testing.assert_allclose(rolled.duration_s, alone.duration_s)
        np.testing.assert_allclose(rolled.safety_s, alone.safety_s)


def test_the_table_of_arrivals_says_what_the_walk_says(logged: Dataset, staircase: Any, routes: Any):
    nominal = nominal_tasks(logged)
    sequence = TaskSequence("A", routes[2])
    tracks = operator_tracks(logged, horizon_s=200.0)
    table = transit_table(staircase, {task: nominal[task] for task in sequence.tasks}, tracks)
    (looked_up,) = table.durations([sequence.tasks])
    walked = roll_out(staircase, lay_out(sequence, nominal, logged), tracks, None).duration_s
    assert looked_up.mean() == pytest.approx(walked.mean(), rel=0.004)
    assert np.corrcoef(looked_up, walked)[0, 1] > 0.98


def test_very_many_sequences_are_looked_up_and_the_best_of_them_walked(
    logged: Dataset, staircase: Any, routes: Any, monkeypatch: pytest.MonkeyPatch
):
    asked = [TaskSequence(f"{n} places", routes[0][:n]) for n in (5, 7, 9, 11, 13)]
    walked = estimate(staircase, logged, asked)
    monkeypatch.setattr("cyclekit.estimate.cycles.MANY", 2)
    found = estimate(staircase, logged, asked)
    assert [entry.name for entry in found] == [entry.name for entry in walked]
    for table, walk in zip(found, walked, strict=True):
        assert table.expected_s == pytest.approx(walk.expected_s, rel=0.01)
        assert table.safety_loss_s == pytest.approx(walk.safety_loss_s, abs=0.01 * walk.expected_s)
        assert table.nominal_s == pytest.approx(walk.nominal_s)
    assert found[0].durations_s == walked[0].durations_s
    assert any("table of arrivals" in text for text in found[-1].warnings)
    assert not any("table of arrivals" in text for text in found[0].warnings)
    assert found[-1].beats == {}  # each does other work


def test_a_cycle_that_does_not_end_within_its_track_is_not_made_up(logged: Dataset, staircase: Any, routes: Any):
    nominal = nominal_tasks(logged)
    sequence = TaskSequence("A", routes[2])
    tracks = operator_tracks(logged, horizon_s=40.0)
    table = transit_table(staircase, {task: nominal[task] for task in sequence.tasks}, tracks)
    assert np.isinf(table.durations([sequence.tasks])).all()


def test_logged_executions_come_out_right_beside_their_own_operators(logged: Dataset, staircase: Any):
    held_out = tuple(logged.executions["execution"].to_list()[:4])
    staircase.card = TrainingCard(split=SplitCard(test=held_out))
    found = check_rollout(staircase, logged)
    assert (found.executions, found.held_out) == (16, 4)
    assert abs(found.own_bias) < 0.003
    assert found.coverage > 0.6
    assert found.doubts == ()
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
    assert any("backtest with their own operator tracks" in text for text in found.doubts)


def crossing(count: int, reaction_s: float) -> Check:
    """Executions of 100 s +- 5 s; `reaction_s` is what the logged operators save by minding the robot."""
    rng = np.random.default_rng(3)
    operators = rng.normal(100.0, 5.0, count)
    crossed = np.where(np.eye(count, dtype=bool), np.nan, operators[None, :] + rng.normal(0, 0.3, (count, count)))
    logged_s = operators - reaction_s
    return compare(logged_s, logged_s * 1.001, crossed, np.arange(count) < 20, (0.05, 0.5, 0.95))


def test_an_operator_who_minds_the_robot_is_found_out():
    assert crossing(100, 0.0).doubts == ()
    assert any("react to the robot" in text for text in crossing(100, 4.0).doubts)


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
        inside.append(check.quantile(cycles, 0.05) <= fresh <= check.quantile(cycles, 0.95))
    assert 0.86 < np.mean(inside) < 0.96


def test_one_other_turn_among_few_unseen_executions_is_not_taken_for_one_in_so_few():
    """Nine of 45 unseen, all within 0.1 % of what was logged but one, which took 9 % longer than its rollout."""
    rng = np.random.default_rng(8)
    logged_s, unseen = rng.normal(100.0, 4.0, 45), np.arange(45) < 9
    own_s = logged_s * (1 + rng.normal(0.0, 0.001, 45))
    own_s[4] = logged_s[4] / 1.09
    crossed = np.where(np.eye(45, dtype=bool), np.nan, own_s[None, :])
    check = compare(logged_s, own_s, crossed, unseen, (0.05, 0.95))
    assert len(check.residuals) == 45
    assert abs(check.own_bias) < 0.003
    cycles = rng.normal(100.0, 4.0, 4000)
    assert check.quantile(cycles, 0.95) == pytest.approx(100 + 1.645 * 4, abs=0.6)


def test_where_the_unseen_executions_come_out_worse_they_alone_judge():
    rng = np.random.default_rng(9)
    logged_s, unseen = rng.normal(100.0, 4.0, 45), np.arange(45) < 9
    own_s = logged_s * (1 + np.where(unseen, 0.02, 0.001) * rng.choice([0.5, 1.0, 1.5], 45))
    crossed = np.where(np.eye(45, dtype=bool), np.nan, own_s[None, :])
    check = compare(logged_s, own_s, crossed, unseen, (0.05, 0.95))
    assert len(check.residuals) == 9
    assert check.own_bias == pytest.approx((own_s / logged_s - 1)[:9].mean())


def test_what_the_network_leaves_open_widens_the_interval():
    """Logged cycles scatter by 4 s about the rolled ones, which know nothing of it."""
    rng = np.random.default_rng(7)
    own_s = rng.normal(100.0, 3.0, 400)
    crossed = np.where(np.eye(400, dtype=bool), np.nan, own_s[None, :])
    check = compare(own_s + rng.normal(0.0, 4.0, 400), own_s, crossed, np.ones(400, dtype=bool), (0.05, 0.95))
    assert check.quantile(rng.normal(100.0, 3.0, 4000), 0.95) == pytest.approx(100 + 1.645 * 5, abs=0.5)


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


class Sides:
    """0.2 where the operator is nearer than 2 m on the x axis, else 1."""

    problem, card = "now", TrainingCard()

    def predict(self, X: np.ndarray) -> np.ndarray:
        return np.where(np.abs(X[:, 3] - X[:, 0]) < 2.0, 0.2, 1.0)


def followed(dynamics: Dynamics, places: list[float]) -> list[float]:
    follower = Follower(Sides(), dynamics, 0.1)
    return [float(follower.advance(np.zeros((1, 3)), np.array([[x, 0.0, 0.0]]))[0]) for x in places]


def test_s_follows_late_and_on_ramps():
    steps = [3.0, 3.0, 1.0, 1.0, 1.0, 1.0, 3.0, 3.0]
    assert followed(Dynamics(), steps) == [1, 1, 0.2, 0.2, 0.2, 0.2, 1, 1]
    assert followed(Dynamics(latency_s=0.2), steps) == [1, 1, 1, 1, 0.2, 0.2, 0.2, 0.2]
    assert followed(Dynamics(ramp_down_per_s=4.0, ramp_up_per_s=2.0), steps) == pytest.approx(
        [1, 1, 0.6, 0.2, 0.2, 0.2, 0.4, 0.6]
    )


def test_s_rises_farther_out_than_it_falls():
    way = [2.3, 2.1, 2.0, 1.85, 2.0, 2.1, 2.3]
    assert followed(Dynamics(hysteresis_m=0.4), way) == [1, 1, 1, 1, 1, 1, 1]
    way = [2.3, 1.7, 1.9, 2.1, 2.3]
    assert followed(Dynamics(hysteresis_m=0.4), way) == [1, 0.2, 0.2, 0.2, 1]


def test_what_the_card_tells_of_the_dynamics_is_used():
    assert Dynamics.of(DynamicsCard()).none
    card = DynamicsCard(latency_s=0.1, hysteresis_m=0.0)
    assert Dynamics.of(card) == Dynamics(latency_s=0.1, hysteresis_m=0.0)
    assert not Dynamics.of(card).none


def test_an_operator_who_roams_is_entered_at_any_phase_and_one_who_begins_with_the_robot_is_not(
    hand_made: Any, logged: Dataset
):
    assert not phase_is_free(logged)
    t_s = np.arange(0.0, 80.0, 0.5)
    way = {float(t): (2.5 + np.sin(t / 2.3), np.cos(t / 3.1)) for t in t_s}
    found = hand_made({"a": ([0.0] * 13, way)})
    assert phase_is_free(found)
    tracks = operator_tracks(found, horizon_s=6.0)
    count = len(set(tracks.executions))
    assert len(tracks.executions) == 4 * count
    assert tracks.executions[:count] == tuple(found.executions["execution"])
    samples = found.samples([tracks.executions[0]])
    later = samples["human_x_m"].to_numpy()[len(samples) // 4 :]
    np.testing.assert_allclose(tracks.xyz_m[count, : len(later), 0], later[: tracks.xyz_m.shape[1]])
    assert replace(tracks, logged=tracks.logged).step_s == pytest.approx(0.1)


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


def test_beside_other_operators_s_follows_as_late_as_beside_their_own(
    logged: Dataset, staircase: Any, monkeypatch: Any
):
    """Slow recovery makes every cycle longer; no operator reacts to the robot because of it."""
    at_once = check_rollout(staircase, logged)
    monkeypatch.setattr(logged, "card", structs.replace(logged.card, dynamics=DynamicsCard(ramp_up_per_s=0.1)))
    slow = check_rollout(staircase, logged)
    assert slow.own_bias > at_once.own_bias + 0.02
    assert slow.crossed_bias - slow.own_bias == pytest.approx(at_once.crossed_bias - at_once.own_bias, abs=0.01)


def test_what_was_never_logged_is_a_doubt_that_says_what_the_interval_leaves_out(logged: Dataset, staircase: Any):
    (entry,) = estimate(staircase, logged, [TaskSequence("A", ("home", "conveyor"))])
    cycles = Rolled(np.ones(1), np.ones((1, 1)), np.zeros((1, 1)), np.zeros(0), 0.7, 0.0)
    (said,) = doubts_of(cycles, entry, None)
    assert "30% of the cycle" in said
    assert "not in the interval of the mean" in said
    (said,) = doubts_of(cycles, replace(entry, extrapolated=True), None)
    assert said.startswith("EXTRAPOLATED")
    assert doubts_of(replace(cycles, support=0.95), entry, None) == []


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
    none = judge(off, unseen)
    assert none.error == pytest.approx(off.std(ddof=1) / 45**0.5)
    off = np.where(np.arange(45) < 4, 0.034, off)
    found = judge(off, unseen)
    assert found.bias == pytest.approx(off.mean())
    assert len(found.off) == 45
    assert within(found.error, 45) > off[unseen].mean() - found.bias - 0.001
    assert within(found.error, 45) > 1.5 * within(off.std(ddof=1) / 45**0.5, 45)


@given(st.integers(2, 60))
def test_the_interval_of_a_bias_is_that_of_student(count: int):
    sample = np.random.default_rng(count).normal(0.0, 0.01, count)
    low, high = stats.ttest_1samp(sample, 0.0).confidence_interval(0.95)
    found = judge(sample, np.zeros(count, dtype=bool))
    assert (found.bias - within(found.error, count), found.bias + within(found.error, count)) == pytest.approx(
        (low, high)
    )


def test_few_executions_leave_the_model_error_wide():
    means = np.full(1000, 100.0)
    few, many = (interval_of_mean(means, model_error=0.01, judged=n, seed=0) for n in (4, 400))
    assert many[1] - many[0] == pytest.approx(2 * 1.96, rel=0.1)
    assert few[1] - few[0] > 1.4 * (many[1] - many[0])
