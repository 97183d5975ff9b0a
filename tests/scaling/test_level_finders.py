"""Self-labelling by every method: what each finds, what it is proven against, when it says that nothing is there."""

from __future__ import annotations

import json
import warnings

import numpy as np
import polars as pl
import pytest
from examples import at_most
from fabricated import LEVELS, fabricate_dataset
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from sklearn.cluster import DBSCAN, KMeans
from sklearn.metrics import silhouette_score

from benchmarks.rival_levels import register
from cyclekit.cli import run
from cyclekit.config import Cell
from cyclekit.dataset.cards import texts
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.dataset.time_grid import stretches
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.learning.labelling import staircase_of
from cyclekit.plots.levels import draw_levels
from cyclekit.scaling.levels import FINDERS, PLATEAU, dbscan_1d, find_staircase, label_in_time, second_opinion
from cyclekit.scaling.levels.kmeans import by_silhouette, condense, kmeans_1d, silhouette_1d
from cyclekit.scaling.levels.plateaus import find_plateaus, noise_of

STEPS = np.array(LEVELS)


def series(noise: float, ramp_s: float, seed: int, *, rare: bool = False, count: int = 300) -> np.ndarray:
    """Holds of 3 to 12 s on five levels; with `rare`, level 0.25 is held once, for 2 s."""
    rng = np.random.default_rng(seed)
    usual = [0, 2, 3, 4] if rare else [0, 1, 2, 3, 4]
    now, parts = 4, [np.full(60, 1.0)]
    for number in range(count):
        after = 1 if rare and number == count // 2 else int(rng.choice([i for i in usual if i != now]))
        ramp = round(abs(STEPS[after] - STEPS[now]) * ramp_s * 10)
        hold = 20 if rare and number == count // 2 else int(rng.integers(30, 120))
        parts += [np.linspace(STEPS[now], STEPS[after], ramp + 2)[1:-1], np.full(hold, STEPS[after])]
        now = after
    whole = np.concatenate(parts)
    return whole + rng.normal(0, noise, whole.size)


@pytest.mark.parametrize("noise", [0.002, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("ramp_s", [0.0, 2.0, 5.0])
def test_plateaus_in_time_give_the_levels_through_ramps_noise_and_a_level_held_for_two_seconds(noise, ramp_s):
    found = find_staircase(series(noise, ramp_s, 20 + int(ramp_s), rare=True))
    assert found.levels == pytest.approx(LEVELS, abs=0.005)
    assert found.is_staircase


def test_a_ramp_that_passes_a_level_is_marked_as_transition():
    ramp = np.linspace(1.0, 0.0, 41)[1:-1]
    signal = np.concatenate(
        [np.full(60, 1.0), ramp, np.zeros(60), ramp[::-1], np.full(60, 1.0)] * 5 + [np.full(50, 0.5)]
    )
    found = find_staircase(signal)
    assert found.levels.tolist() == [0.0, 0.5, 1.0]
    assert set(found.label[61:98]) <= {-1, 1}
    assert (found.label[61:98] == -1).mean() > 0.9
    assert set(found.label[-40:]) == {1}


def test_a_plateau_never_spans_two_executions():
    values = np.concatenate([np.full(6, 0.5), np.full(6, 0.5)])
    assert find_plateaus(values, np.repeat([0, 1], 6)).samples.tolist() == [6, 6]
    assert find_plateaus(values, np.zeros(12, np.int64)).samples.tolist() == [12]


def test_levels_that_are_no_round_numbers_are_left_as_they_were_measured():
    rng = np.random.default_rng(0)
    truth = np.repeat(rng.choice([0.0, 0.137, 0.333, 0.662, 1.0], 300), 40)
    found = find_staircase(truth + rng.normal(0, 0.01, truth.size))
    assert found.levels == pytest.approx([0.0, 0.137, 0.333, 0.662, 1.0], abs=0.003)
    assert found.levels == pytest.approx(found.means, abs=1e-12)


def test_a_stop_is_a_stop_although_the_log_holds_it_with_a_few_rows_of_a_ramp():
    rows = np.tile(np.repeat([0.0, 0.3, 1.0], 200), 8)
    rows[:3] = 0.001
    assert find_staircase(rows).levels.tolist() == pytest.approx([0.0, 0.3, 1.0], abs=1e-9)


def test_a_rare_level_in_noise_is_rounded_where_the_others_show_how_levels_were_chosen():
    found = find_staircase(series(0.05, 0.5, 3, rare=True))
    assert found.levels[1] == 0.25
    assert found.means[1] != 0.25


def test_an_operator_slider_that_differs_between_executions_is_taken_out():
    sliders = (1.0, 0.8, 0.63)
    parts = [series(0.0, 0.5, seed, count=60) * slider for seed, slider in enumerate(sliders)]
    run = np.repeat(np.arange(3), [part.size for part in parts])
    found = find_staircase(np.concatenate(parts), run=run)
    assert found.levels == pytest.approx(LEVELS, abs=1e-6)
    assert np.unique(np.round(found.slider, 6)).tolist() == [0.63, 0.8, 1.0]
    assert any("slider" in text for text in texts(found.warnings))


def test_without_a_slider_none_is_invented_though_one_execution_never_reaches_full_speed():
    slow = np.tile(np.repeat([0.0, 0.25, 0.5, 0.75], 40), 5)
    both = np.concatenate([slow, series(0.0, 0.0, 1, count=60)])
    found = find_staircase(both, run=np.arange(both.size) >= slow.size)
    assert found.slider is None
    assert found.levels == pytest.approx(LEVELS)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("period_s", [20.0, 120.0])
def test_a_continuous_function_is_no_staircase_and_regression_is_offered(noise, period_s):
    time_s = np.arange(20_000) / 10
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * time_s / period_s) + np.random.default_rng(0).normal(0, noise, time_s.size)
    found = find_staircase(wave)
    assert not found.is_staircase
    assert "--network regressor" in " ".join(texts(found.warnings))


def test_fixed_levels_are_only_labelled():
    found = find_staircase(np.repeat([0.0, 0.5, 1.0], 30), levels=[0.0, 0.5, 0.75, 1.0])
    assert found.levels.tolist() == [0.0, 0.5, 0.75, 1.0]
    assert found.share[2] == 0
    assert found.label.tolist() == [0] * 30 + [1] * 30 + [3] * 30


@pytest.fixture
def with_rivals(monkeypatch):
    for name in ("kmeans-elbow", "hdbscan", "gmm-bic"):  # taken out again after the test
        monkeypatch.setitem(FINDERS, name, None)
    register()


@pytest.mark.parametrize("method", [PLATEAU, *FINDERS, "kmeans-elbow", "hdbscan", "gmm-bic"])
def test_every_method_finds_clean_levels_that_are_all_used_often(method, with_rivals):
    found = find_staircase(series(0.002, 0.0, 5, count=100), method=method)
    if method == "kmeans-elbow":  # known to stop too early on even levels
        assert 2 <= found.levels.size <= 5
    else:
        assert found.levels == pytest.approx(LEVELS, abs=0.01)


def test_an_unknown_method_is_answered_with_the_nearest():
    with pytest.raises(UnknownName, match="nearest is 'plateau'"):
        find_staircase([1.0] * 50, method="plato")


def test_two_methods_that_disagree_are_a_warning():
    rng = np.random.default_rng(0)
    close = np.repeat(rng.choice([0.0, 0.03, 0.5, 0.53, 1.0], 300), 30)
    close += rng.normal(0, 0.004, close.size)
    found = find_staircase(close)
    assert found.levels.size == 5
    assert "cell.toml" in second_opinion(close, found).text
    even = series(0.002, 0.0, 1)
    assert second_opinion(even, find_staircase(even)) is None


@at_most(60)
@given(seed=st.integers(0, 10_000), eps=st.floats(0.001, 0.1), least=st.integers(1, 20))
def test_weighted_clusters_are_those_of_scikit_learn_with_sample_weights(seed, eps, least):
    rng = np.random.default_rng(seed)
    x, weight = rng.random(80), rng.integers(1, 6, 80).astype(float)
    expected = DBSCAN(eps=eps, min_samples=least).fit(x[:, None], sample_weight=weight).labels_
    assert dbscan_1d(x, eps=eps, min_samples=least, weight=weight).tolist() == expected.tolist()


@at_most(40)
@given(seed=st.integers(0, 10_000), k=st.integers(2, 5))
def test_the_silhouette_is_that_of_scikit_learn_to_the_last_digits(seed, k):
    rng = np.random.default_rng(seed)
    x = np.round(rng.random(120), 2)  # with repeated values
    points = condense(x)
    cluster, _ = kmeans_1d(points, k)[k - 1]
    assert silhouette_1d(points, cluster) == pytest.approx(silhouette_score(x[:, None], cluster[points.of]), abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_exact_k_means_is_never_worse_than_the_best_of_many_starts(seed):
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.normal(c, 0.03, 60) for c in (0, 0.3, 0.4, 1)])
    for k in (2, 3, 4, 5):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            lloyd = KMeans(k, n_init=10, random_state=0).fit(x[:, None]).inertia_
        assert kmeans_1d(condense(x))[k - 1][1] <= lloyd + 1e-9


def test_binning_many_values_changes_no_number_of_levels():
    x = series(0.01, 0.0, 3)
    few, many = condense(x, bins=256), condense(x[:2000], bins=4096)
    assert int(by_silhouette(few).max()) + 1 == 5
    assert many.value.size == 2000
    assert few.weight.sum() == x.size


def test_the_noise_is_read_from_holds_and_ramps_alike():
    for noise in (0.002, 0.02, 0.05):
        assert noise_of(series(noise, 2.0, 1)) == pytest.approx(noise, rel=0.1)


def test_levels_in_time_label_a_stray_noisy_sample_with_its_neighbours_and_unknown_ones_not():
    values = np.repeat([0.0, 1.0], 30)
    values[10], values[40] = 0.012, np.nan
    found = label_in_time(values, [0.0, 1.0], np.zeros(60, np.int64))
    assert found.tolist() == [0] * 30 + [1] * 10 + [-1] + [1] * 19


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> Dataset:
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=4, seed=1)


def test_executions_and_gaps_divide_the_samples_of_a_dataset(cell):
    frame = cell.samples()
    assert stretches(frame, 10.0).max() == 4
    holed = frame.filter(pl.int_range(pl.len()) != 50)
    assert stretches(holed, 10.0).max() == 5


def test_levels_fixed_in_the_cell_file_are_used(cell, tmp_path):
    card = structs.replace(cell.card, settings=Cell(levels=(0.0, 0.25, 0.5, 0.75, 0.9, 1.0)))
    fixed = Dataset(cell.path, card)
    assert staircase_of(fixed, cell.samples()).levels.tolist() == [0.0, 0.25, 0.5, 0.75, 0.9, 1.0]
    assert staircase_of(cell, cell.samples()).levels.tolist() == list(LEVELS)


def test_the_command_prints_levels_and_draws_them(cell, tmp_path, capsys):
    picture = tmp_path / "levels.svg"
    assert run(["levels", str(cell.path), "--picture", str(picture), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["count"] == 5
    assert document["levels"] == list(LEVELS)
    assert picture.read_text().lstrip().startswith("<?xml")
    first = picture.read_bytes()
    values = cell.samples()["scaling"].to_numpy()
    draw_levels(picture, values, find_staircase(values), rate_hz=10.0)
    assert picture.read_bytes() == first


def test_a_picture_of_an_unknown_kind_is_refused(cell, tmp_path):
    with pytest.raises(ConfigError, match=r"\.svg"):
        draw_levels(tmp_path / "levels.gif", np.ones(9), find_staircase(np.ones(9)), rate_hz=10.0)
    assert (cell.path / CARD).is_file()
