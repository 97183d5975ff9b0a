"""The staircase in a speed scaling: its levels, its labels, and the exactness of the clustering."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from sklearn.cluster import DBSCAN

from cyclekit.dataset.cards import texts
from cyclekit.errors import ShapeError
from cyclekit.scaling.levels import dbscan_1d, find_staircase, label
from cyclekit.scaling.levels.clusters import of_plateaus
from cyclekit.scaling.levels.plateaus import Plateaus

LEVELS = [0.0, 0.25, 0.5, 0.75, 1.0]


def holds(*pairs: tuple[float, int]) -> np.ndarray:
    return np.concatenate([np.full(count, value) for value, count in pairs])


@settings(deadline=None)
@given(
    values=st.lists(st.floats(0, 1, allow_subnormal=False), min_size=1, max_size=60),
    eps=st.floats(0.001, 0.3),
    min_samples=st.integers(1, 12),
)
def test_clusters_of_scalars_are_exactly_those_of_scikit_learn(values, eps, min_samples):
    x = np.array(values)
    apart = np.abs(x[:, None] - x[None, :])
    assume(not (np.abs(apart - eps) < 1e-12).any())  # two values exactly eps apart: rounding decides
    expected = DBSCAN(eps=eps, min_samples=min_samples).fit_predict(x[:, None])
    assert_array_equal(dbscan_1d(x, eps=eps, min_samples=min_samples), expected)


@pytest.mark.parametrize("seed", range(12))
def test_clusters_equal_scikit_learn_on_noisy_levels_with_border_and_noise_points(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(200, 2000))
    x = rng.choice(LEVELS, count) + rng.normal(0, rng.uniform(0.01, 0.08), count)
    eps, min_samples = rng.uniform(0.001, 0.03), int(rng.integers(2, 40))
    expected = DBSCAN(eps=eps, min_samples=min_samples).fit_predict(x[:, None])
    assert_array_equal(dbscan_1d(x, eps=eps, min_samples=min_samples), expected)


def test_a_million_values_are_clustered_in_a_moment():
    rng = np.random.default_rng(0)
    x = rng.choice(LEVELS, 1_000_000) + rng.normal(0, 0.01, 1_000_000)
    begin = time.process_time()
    labels = dbscan_1d(x, eps=0.02, min_samples=10)
    assert labels.max() == 4
    assert time.process_time() - begin < 10  # a quadratic algorithm would not end at all


@pytest.mark.parametrize("bad", [[[0.1, 0.2]], [0.1, np.nan], [np.inf]])
def test_values_that_cannot_be_clustered_are_refused(bad):
    with pytest.raises(ShapeError):
        dbscan_1d(bad, eps=0.1, min_samples=2)


def test_an_empty_log_has_no_cluster():
    assert dbscan_1d([], eps=0.1, min_samples=2).shape == (0,)


def test_the_levels_come_back_ascending_with_the_share_of_time_spent_on_each():
    found = find_staircase(holds((1.0, 600), (0.5, 300), (0.0, 100)))
    assert found.levels.tolist() == [0.0, 0.5, 1.0]
    assert found.share.tolist() == pytest.approx([0.1, 0.3, 0.6])
    assert_array_equal(found.label, [2] * 600 + [1] * 300 + [0] * 100)
    assert found.warnings == ()


def test_a_level_held_for_two_seconds_in_ten_hours_survives():
    rng = np.random.default_rng(1)
    common = np.repeat(rng.choice([0.0, 0.5, 0.75, 1.0], 6000), 60)
    found = find_staircase(np.concatenate([common, np.full(20, 0.25), common]))
    assert found.levels == pytest.approx(LEVELS)


def test_ramps_between_levels_do_not_join_them_and_get_no_level_of_their_own():
    ramp = np.linspace(1.0, 0.0, 11)[1:-1]  # 1 s for the whole range, at 10 Hz
    signal = np.concatenate([np.concatenate([np.full(40, 1.0), ramp, np.zeros(40), ramp[::-1]]) for _ in range(100)])
    found = find_staircase(signal)
    assert found.levels.tolist() == [0.0, 1.0]
    assert set(found.label[signal == ramp[4]]) == {-1}


def test_levels_five_percent_apart_with_a_little_noise_are_told_apart():
    rng = np.random.default_rng(2)
    truth = np.repeat(rng.choice(5, 400), 30)
    found = find_staircase(np.array([0.0, 0.05, 0.1, 0.5, 1.0])[truth] + rng.normal(0, 0.002, truth.size))
    assert found.levels == pytest.approx([0.0, 0.05, 0.1, 0.5, 1.0], abs=0.001)
    assert_array_equal(found.label, truth)


def test_where_the_scaling_is_unknown_the_label_is_unknown():
    signal = holds((1.0, 20), (0.5, 20))
    signal[5:8] = np.nan
    found = find_staircase(signal)
    assert found.levels.tolist() == [0.5, 1.0]
    assert set(found.label[5:8]) == {-1}


def test_a_continuous_safety_function_is_said_to_be_no_staircase():
    time_s = np.arange(20_000) / 10
    assert any("continuous" in text for text in texts(find_staircase(0.5 + 0.5 * np.sin(time_s / 30)).warnings))


def test_random_values_are_said_to_be_no_staircase():
    warnings = texts(find_staircase(np.random.default_rng(0).random(5000)).warnings)
    assert warnings


@pytest.mark.parametrize(
    ("signal", "said"),
    [([np.nan] * 50, "unknown everywhere"), ([1.0] * 50, "only one level"), ([0.1, 0.9] * 25, "no value")],
)
def test_a_log_without_a_staircase_says_what_it_shows(signal, said):
    assert said in " ".join(texts(find_staircase(signal).warnings))


def test_a_value_between_two_levels_is_on_neither():
    assert label([0.26, 0.4, np.nan, 1.02, 1.2], LEVELS).tolist() == [1, -1, -1, 4, -1]


def test_without_levels_nothing_is_labelled():
    assert label([0.1, 0.2], []).tolist() == [-1, -1]


@settings(deadline=None)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=8, unique=True), st.lists(st.floats(-0.5, 1.5), max_size=20))
def test_a_labelled_value_has_no_nearer_level_and_an_unlabelled_one_none_within_tolerance(levels, values):
    levels = sorted(levels)
    for value, found in zip(values, label(values, levels, tolerance=0.1), strict=True):
        distances = [abs(value - level) for level in levels]
        if found == -1:
            assert min(distances) > 0.1 - 1e-12
        else:
            assert distances[found] <= min(distances) + 1e-12


@pytest.mark.parametrize(("on_ramp", "levels"), [(200, [0.0, 0.3, 0.5, 1.0]), (0, [0.0, 0.13, 0.3, 0.5, 1.0])])
def test_beside_slow_ramps_a_level_is_what_is_held_for_a_second_at_once(on_ramp: int, levels: list[float]):
    held = [
        (0.0, 5),
        (0.0, 6),
        (0.13, 4),
        (0.3, 40),
        (0.13, 5),
        (1.0, 6),
        (0.13, 4),
        (0.5, 12),
        (1.0, 8),
    ]  # value, samples
    value, count = np.array([one for one, _ in held]), np.array([many for _, many in held])
    end = np.cumsum(count + 5)
    found = of_plateaus(Plateaus(end - count, end, value, 0.001, on_ramp), value, 0.01, 10)
    assert_array_equal(np.round(found.value, 2), levels)
