"""Arrays for the three problems: what a row's target is, and which rows are left out."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from cyclekit import schema
from cyclekit.errors import DatasetError, ShapeError, UnknownName
from cyclekit.learning.last_second import count_features, window_features
from cyclekit.learning.windows import build_samples, scaling_without_operator, split_executions

LEVELS = (0.0, 0.5, 1.0)
POSITIONS = [f"{who}{axis}_m" for who in ("robot_", "human_", "robot_goal_", "human_goal_") for axis in "xyz"]


def log(scaling: list[float | None], execution: str = "a", start_s: float = 0.0, **columns) -> pl.DataFrame:
    rows = len(scaling)
    data = {name: [float(i) for i in range(rows)] for name in POSITIONS}
    data |= {"execution": [execution] * rows, "t_s": [start_s + i / 10 for i in range(rows)], "scaling": scaling}
    return schema.conform(pl.DataFrame({**data, **columns}, strict=False), schema.SAMPLES)


def test_the_problem_now_maps_positions_to_the_scaling_of_the_same_instant():
    rows = build_samples(log([0.0, 0.5, 1.0]), "now", 0.0, LEVELS, rate_hz=10.0)
    assert rows.X.shape == (3, 6)
    assert rows.X.dtype == np.float32
    assert rows.inputs == tuple(f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz")
    assert_array_equal(rows.scaling, [0.0, 0.5, 1.0])
    assert_array_equal(rows.step, [0, 1, 2])


def test_the_problem_ahead_takes_the_scaling_two_samples_later():
    rows = build_samples(log([0.0, 0.5, 1.0, 0.5]), "ahead", 0.2, LEVELS, rate_hz=10.0)
    assert rows.X.shape == (2, 12)
    assert_array_equal(rows.scaling, [1.0, 0.5])
    assert_array_equal(rows.step, [2, 1])


def test_the_problem_average_is_the_mean_over_both_ends_of_the_window():
    rows = build_samples(log([0.0, 0.5, 1.0, 0.5]), "average", 0.2, LEVELS, rate_hz=10.0)
    assert_allclose(rows.scaling, [0.5, 2 / 3])
    assert_array_equal(rows.step, [-1, -1])


@pytest.mark.parametrize("problem", ["ahead", "average"])
def test_a_window_never_reaches_into_the_next_execution(problem):
    both = pl.concat([log([0.0] * 5), log([1.0] * 5, "b", 0.5)])
    rows = build_samples(both, problem, 0.3, LEVELS, rate_hz=10.0)
    assert [rows.executions[i] for i in rows.execution] == ["a", "a", "b", "b"]
    assert_array_equal(rows.scaling, [0, 0, 1, 1])
    assert rows.dropped == {"window leaves the execution or crosses a gap": 6}


def test_a_window_never_crosses_a_gap_in_the_log():
    gap = pl.concat([log([0.0] * 4), log([1.0] * 4, "a", 2.0)])
    assert_array_equal(build_samples(gap, "ahead", 0.2, LEVELS, rate_hz=10.0).scaling, [0, 0, 1, 1])


def test_an_average_over_an_unknown_scaling_is_unknown():
    rows = build_samples(log([1.0, 1.0, None, 1.0, 1.0, 1.0]), "average", 0.2, LEVELS, rate_hz=10.0)
    assert_allclose(rows.t_s, [0.3])
    assert rows.dropped["scaling unknown"] == 3


def test_rows_left_out_are_counted_by_reason():
    frame = log([1.0, None, 1.0, 1.0], human_x_m=[0.0, 0.0, None, 0.0], robot_z_m=[None, 0.0, 0.0, 0.0])
    rows = build_samples(frame, "now", 0.0, LEVELS, rate_hz=10.0)
    assert len(rows) == 1
    assert rows.dropped == {"robot position unknown": 1, "operator absent or not seen": 1, "scaling unknown": 1}


def test_a_value_in_a_ramp_is_kept_as_a_target_but_names_no_step():
    rows = build_samples(log([0.7]), "now", 0.0, LEVELS, rate_hz=10.0)
    assert (rows.scaling.tolist(), rows.step.tolist()) == ([0.7], [-1])


def test_an_unknown_problem_is_answered_with_the_known_ones():
    with pytest.raises(UnknownName, match="nearest is 'average'"):
        build_samples(log([1.0]), "averag", 0.0, LEVELS, rate_hz=10.0)


@pytest.mark.parametrize(("problem", "horizon_s"), [("now", 1.0), ("ahead", 0.0), ("average", 0.0), ("ahead", -1.0)])
def test_a_horizon_that_does_not_suit_the_problem_is_refused(problem, horizon_s):
    with pytest.raises(ShapeError, match="horizon"):
        build_samples(log([1.0] * 5), problem, horizon_s, LEVELS, rate_hz=10.0)


def test_the_scaling_without_operator_is_what_was_logged_while_nobody_was_seen():
    assert scaling_without_operator(log([0.5, 1.0, 1.0, None], human_x_m=[1.0, None, None, None])) == 1.0
    assert scaling_without_operator(log([0.5])) is None


def test_an_operator_who_is_hidden_does_not_say_what_holds_without_one():
    unseen = {"human_x_m": [None] * 4, "human_gap": ["occluded", "occluded", "outside", "absent"]}
    assert scaling_without_operator(log([0.25, 0.25, 0.0, 1.0], **unseen)) == 1.0
    assert scaling_without_operator(log([0.25], human_x_m=[None], human_gap=["occluded"])) is None


def test_rows_of_chosen_executions_are_all_of_theirs_and_no_others():
    rows = build_samples(pl.concat([log([0.0] * 2), log([1.0] * 3, "b")]), "now", 0.0, LEVELS, rate_hz=10.0)
    assert_array_equal(rows.of(["b"]).scaling, [1, 1, 1])


@given(st.integers(2, 60), st.floats(0.05, 0.9), st.integers(0, 9))
def test_a_split_puts_every_execution_on_exactly_one_side_and_both_sides_have_some(count, fraction, seed):
    names = [f"e{i}" for i in range(count)]
    train, test = split_executions(names, test_fraction=fraction, seed=seed)
    assert sorted(train + test) == sorted(names)
    assert train
    assert test
    again = split_executions(names[::-1], test_fraction=fraction, seed=seed)
    assert set(again[1]) == set(test)


def test_one_execution_cannot_be_split():
    with pytest.raises(DatasetError, match="held out"):
        split_executions(["only"])


def test_a_history_begins_with_its_execution_and_never_reaches_over_a_gap():
    both = pl.concat([log([0.0] * 4), log([1.0] * 4, "b", 0.4), log([1.0] * 3, "b", 3.0)])
    rows = build_samples(both, "ahead", 0.1, LEVELS, history=(3, 1), rate_hz=10.0)
    seen = rows.table[rows.before][:, :, 0].astype(int).tolist()
    assert seen == [[0, 0, 0], [0, 0, 1], [0, 1, 2]] * 2 + [[0, 0, 0], [0, 0, 1]]
    assert rows.model_inputs.shape == (8, 3, 12)
    assert_array_equal(rows.model_inputs[:, -1], rows.X)
    assert_array_equal(rows.table[rows.ahead][:, 3], [1, 2, 3, 1, 2, 3, 1, 2])


def test_a_history_never_holds_a_position_that_nobody_saw():
    gap = [None, None, "occluded", None, None, None]
    hidden = log([1.0] * 6, human_x_m=[0.0, 1.0, None, 3.0, 4.0, 5.0], human_gap=gap)
    rows = build_samples(hidden, "ahead", 0.1, LEVELS, allow=("human",), history=(3, 1), rate_hz=10.0)
    assert np.isfinite(rows.model_inputs).all()
    assert rows.model_inputs[:, :, 3].astype(int).tolist() == [[0, 0, 0], [0, 0, 1], [3, 3, 3], [3, 3, 4]]


def test_an_absent_operator_is_a_row_where_that_is_allowed_and_a_hidden_one_is_not():
    frame = log([1.0] * 3, human_x_m=[None, None, 0.0], human_gap=["absent", "occluded", None])
    rows = build_samples(frame, "now", 0.0, LEVELS, allow=("human",), rate_hz=10.0)
    assert np.isnan(rows.X[:, 3]).tolist() == [True, False]
    assert rows.dropped == {"operator absent or not seen": 1}


def test_an_unknown_goal_is_a_row_where_that_is_allowed():
    frame = log([1.0] * 4, human_goal_x_m=[None, 1.0, 1.0, 1.0])
    assert len(build_samples(frame, "ahead", 0.1, LEVELS, rate_hz=10.0)) == 2
    assert len(build_samples(frame, "ahead", 0.1, LEVELS, allow=("human_goal",), rate_hz=10.0)) == 3


def test_the_uncertainty_of_an_inferred_scaling_becomes_a_weight():
    frame = log([1.0] * 4).with_columns(scaling_sd=pl.Series([0.0, None, 0.05, 0.5]))
    assert_allclose(build_samples(frame, "now", 0.0, LEVELS, rate_hz=10.0).weight, [1, 1, 0.5, 0.0099], atol=1e-4)
    assert_allclose(build_samples(frame, "ahead", 0.2, LEVELS, rate_hz=10.0).weight, [0.5, 0.0099], atol=1e-4)
    assert_array_equal(build_samples(log([1.0] * 3), "now", 0.0, LEVELS, rate_hz=10.0).weight, [1, 1, 1])


def test_what_is_known_of_the_past_begins_anew_with_each_execution_and_each_goal():
    still = {name: [0.0] * 6 for name in POSITIONS}
    moving = {"human_goal_x_m": [1.0, 1.0, 2.0, 2.0, None, None], "human_x_m": [0.0, 0.0, 0.0, 0.2, 0.2, 0.2]}
    one = log([0.5, 0.5, 1.0, 1.0, 1.0, 1.0], **still | moving)
    two = log([0.5, 0.5, 1.0, 1.0], "b", 0.6, **{name: [0.0] * 4 for name in POSITIONS})
    rows = build_samples(
        pl.concat([one, two]), "ahead", 0.1, (), rate_hz=10.0, allow=["human_goal"], history=(2, 1), past=True
    )
    past = dict(zip(rows.inputs[12:], rows.X[:, 12:].T, strict=True))
    np.testing.assert_allclose(past["human_goal_age_s"], [0, 0.1, 0, 0.1, 0, 0, 0.1, 0.2], atol=1e-6)
    np.testing.assert_allclose(past["robot_goal_age_s"], [0, 0.1, 0.2, 0.3, 0.4, 0, 0.1, 0.2], atol=1e-6)
    np.testing.assert_allclose(past["human_still_s"], [0, 0.1, 0.2, 0, 0.1, 0, 0.1, 0.2], atol=1e-6)
    np.testing.assert_array_equal(past["scaling"], [0.5, 0.5, 1.0, 1.0, 1.0, 0.5, 0.5, 1.0])
    assert rows.model_inputs.shape == (8, 2, 16)


def test_a_row_whose_present_scaling_is_unknown_is_left_out_unless_that_is_allowed():
    frame = log([0.5, None, 0.5, 0.5])
    kept = {allow: build_samples(frame, "ahead", 0.1, (), rate_hz=10.0, allow=allow, history=(2, 1), past=True)
            for allow in ((), ("scaling",))}  # fmt: skip
    assert (len(kept[()]), len(kept["scaling",])) == (1, 2)
    assert kept[()].dropped["present scaling unknown"] == 1


def test_features_of_a_window_are_places_changes_and_distances_of_it():
    windows = np.random.default_rng(0).normal(size=(5, 3, 16)).astype(np.float32)
    features = window_features(windows)
    assert features.shape == (5, count_features(3, 16))
    np.testing.assert_array_equal(features[:, :16], windows[:, -1])
    apart = np.linalg.norm(windows[..., :3] - windows[..., 3:6], axis=-1)
    np.testing.assert_allclose(features[:, 28:31], apart, rtol=1e-6)
    np.testing.assert_allclose(features[:, 31:33], apart[:, -1:] - apart[:, :-1], atol=1e-6)
    np.testing.assert_array_equal(features[:, -2:], windows[:, :2, 14])
    np.testing.assert_array_equal(window_features(windows[:, -1, :6])[:, 6], features[:, 30])
