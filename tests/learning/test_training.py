"""Training on small fabricated cells: it learns, it repeats, and it says what bad data lack."""

from __future__ import annotations

import json
import sys

import numpy as np
import polars as pl
import pytest
import torch
from fabricated import LEVELS, THRESHOLDS_M, fabricate_dataset
from msgspec import structs

from cyclekit.dataset.cards import plain, texts
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import DatasetError, MissingExtra
from cyclekit.learning.networks import fitting
from cyclekit.learning.networks.fitting import CutOff
from cyclekit.learning.networks.network import Bounded
from cyclekit.learning.networks.saved import load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import fingerprint, train
from cyclekit.learning.windows import build_samples
from cyclekit.storage.atomic import write_parquet


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> Dataset:
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=16, seed=1)


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Dataset:
    """Enough to learn from, and too little to learn much."""
    return fabricate_dataset(tmp_path_factory.mktemp("small") / "dataset", executions=4, seed=1)


@pytest.fixture(scope="module")
def model(cell):
    return train(cell, ModelSpec.of(batch=256, epochs=24))


def changed(dataset: Dataset, folder, *columns: pl.Expr, keep: int | None = None) -> Dataset:
    """Write the dataset again with other samples and, if asked, only the first executions."""
    card = plain(dataset.card)
    card["executions"] = card["executions"][:keep]
    kept = pl.col("execution").is_in([entry["execution"] for entry in card["executions"]])
    for file in (dataset.path / "samples").glob("*.parquet"):
        rows = pl.read_parquet(file).with_columns(*columns).filter(kept)
        write_parquet(rows, folder / "samples" / file.name)
    (folder / CARD).write_text(json.dumps({**card, "files": None}))
    return Dataset.open(folder)


def test_the_slow_down_is_learned_from_the_logs_alone(model):
    metrics = model.card.metrics
    assert metrics.mse_mean < 0.02  # guessing the mean: about 0.13
    assert metrics.accuracy > 0.85


def test_the_model_slows_down_where_the_operator_comes_near(model):
    near, far = [0.6, 0, 0.4, 1.1, 0.5, 1.0], [0.6, 0, 0.4, 3.2, 0.3, 1.0]
    scaling = model.predict(np.array([near, far]))
    assert np.linalg.norm(np.subtract(near[:3], near[3:])) < THRESHOLDS_M[0]
    assert scaling[0] < 0.2
    assert scaling[1] > 0.8


def test_the_levels_are_found_in_the_logs(model):
    assert model.levels == LEVELS
    assert sum(level.share for level in model.card.levels) == pytest.approx(1, abs=1e-3)


def test_what_holds_without_operator_is_read_from_the_logs_and_kept_in_the_card(model):
    assert model.card.scaling_without_operator == 1.0
    assert model.card.may_be_unknown == ("human",)
    assert model.card.dropped == {}


def test_no_execution_serves_two_purposes(model, cell):
    parts = [set(part) for part in structs.astuple(model.card.split)]
    assert set.union(*parts) == set(cell.executions["execution"])
    assert sum(len(part) for part in parts) == cell.executions.height


def test_the_card_says_where_the_model_comes_from(model, cell):
    card = model.card
    assert card.dataset_sha256 == fingerprint(cell)
    assert card.inputs == tuple(model.inputs)
    assert card.spec.batch == 256
    assert card.rows.train > card.rows.validation > 0
    assert len(card.history) == 24


def test_the_kept_weights_are_those_of_the_best_epoch(model, cell):
    rows = cell.samples(model.card.split.validation).drop_nulls(["scaling"])
    X = rows.select(model.inputs).to_numpy()
    assert np.isnan(X).any()
    p = model.probabilities(X) ** model.card.temperature  # as it was before calibration
    before = p @ np.array(model.levels) / p.sum(axis=1)
    mse = float(np.mean((before - rows["scaling"].to_numpy()) ** 2))
    assert mse == pytest.approx(min(epoch.validation_mse for epoch in model.card.history), rel=1e-3)


def test_a_trained_model_survives_the_disk(model, tmp_path):
    save_model(tmp_path / "model", model)
    assert load_model(tmp_path / "model").card == model.card


@pytest.mark.parametrize("optimiser", ["adamw", "muon"])
def test_the_same_seed_gives_the_same_weights_and_another_seed_others(small, optimiser):
    specs = [ModelSpec.of(epochs=2, seed=seed, optimiser=optimiser) for seed in (3, 3, 4)]
    weights = [train(small, spec).weights.layers[1][0] for spec in specs]
    assert np.array_equal(weights[0], weights[1])
    assert not np.array_equal(weights[0], weights[2])


@pytest.mark.parametrize(
    ("problem", "network"),
    [
        ("now", "regressor"),
        ("ahead", "classifier"),
        pytest.param("ahead", "regressor", marks=pytest.mark.slow),
        ("average", "mixed"),
        pytest.param("average", "regressor", marks=pytest.mark.slow),
    ],
)
def test_every_other_network_beats_the_constant_mean(cell, problem, network):
    horizon_s = None if problem == "now" else 2.0
    model = train(cell, ModelSpec.of(problem, network, horizon_s, batch=256, epochs=8))
    assert model.card.history[-1].loss < model.card.history[0].loss
    held_out = build_samples(cell.samples(model.card.split.test), problem, model.horizon_s, LEVELS, rate_hz=10.0)
    assert model.card.metrics.mse_mean < 0.9 * held_out.scaling.var()
    assert (model.card.metrics.accuracy is None) == (problem == "average")


def test_progress_is_told_after_every_epoch(small):
    told = []
    train(small, ModelSpec.of(epochs=3), progress=lambda fraction, text: told.append((fraction, text)))
    assert [round(fraction, 3) for fraction, _ in told] == [0.333, 0.667, 1.0]
    assert "epoch 3 of 3" in told[-1][1]


def test_an_input_that_never_varies_is_switched_off(cell, tmp_path):
    flat = changed(cell, tmp_path, pl.when(pl.col("human_z_m").is_not_null()).then(pl.lit(1.3)).alias("human_z_m"))
    model = train(flat, ModelSpec.of(epochs=2, features="positions"))  # in a distance it counts as metres do
    inputs = np.array([[0.5, 0.1, 0.3, 2.0, 0.2, z] for z in (1.3, 1.8)])
    assert np.ptp(model.predict(inputs)) == 0


def test_without_any_scaling_the_message_says_how_to_get_one(cell, tmp_path):
    with pytest.raises(DatasetError, match=r"scaling is unknown in all[\s\S]*reference run"):
        train(changed(cell, tmp_path, pl.lit(None, pl.Float64).alias("scaling")), ModelSpec.of())


def test_with_one_level_only_there_is_nothing_to_learn(cell, tmp_path):
    with pytest.raises(DatasetError, match=r"1\.00 everywhere"):
        train(changed(cell, tmp_path, pl.lit(1.0).alias("scaling")), ModelSpec.of())


def test_without_an_operator_the_message_says_so(tmp_path):
    alone = fabricate_dataset(tmp_path / "alone", executions=4, operator=False)
    with pytest.raises(DatasetError, match="operator absent or not seen"):
        train(alone, ModelSpec.of())


def test_ten_samples_are_too_few(cell, tmp_path):
    few = changed(cell, tmp_path, pl.when(pl.int_range(pl.len()) < 5).then(pl.col("scaling")).alias("scaling"))
    with pytest.raises(DatasetError, match=r"only \d+ of \d+ samples can be learned from"):
        train(few, ModelSpec.of())


def test_an_operator_seen_only_in_ramps_gives_a_classifier_nothing_to_name(cell, tmp_path):
    ramp = pl.when(pl.col("human_x_m").is_null()).then(pl.lit(1.0)).otherwise(0.1 + pl.int_range(pl.len()) % 7 / 10)
    held = pl.when(pl.int_range(pl.len()) < 20).then(pl.lit(0.0)).otherwise(ramp)
    with pytest.raises(DatasetError, match=r"samples on a level with an operator seen|at least two levels"):
        train(changed(cell, tmp_path, held.alias("scaling")), ModelSpec.of())


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_executions_are_too_few(cell, tmp_path, count):
    with pytest.raises(DatasetError, match=rf"{count} usable execution"):
        train(changed(cell, tmp_path, keep=count), ModelSpec.of())


def test_three_executions_are_just_enough(cell, tmp_path):
    split = train(changed(cell, tmp_path, keep=3), ModelSpec.of(epochs=1)).card.split
    assert [len(part) for part in structs.astuple(split)] == [1, 1, 1]


def test_a_scaling_without_steps_is_no_case_for_a_classifier_but_for_a_regressor(cell, tmp_path):
    noise = np.random.default_rng(0)
    jumpy = pl.col("scaling").map_batches(lambda s: pl.Series(noise.random(len(s))), return_dtype=pl.Float64)
    continuous = changed(cell, tmp_path, jumpy.alias("scaling"))
    with pytest.raises(DatasetError, match="--network regressor"):
        train(continuous, ModelSpec.of())
    assert train(continuous, ModelSpec.of("now", "regressor", epochs=1)).card.warnings


def test_without_torch_the_message_names_the_extra(cell, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingExtra, match=r"cyclekit\[train\]"):
        train(cell, ModelSpec.of())


@pytest.mark.parametrize("network", ["lstm-1", "lstm-2"])
def test_a_recurrent_network_learns_from_the_history_of_each_execution(cell, network):
    model = train(cell, ModelSpec.of("ahead", network, 1.0, batch=256, epochs=4, history=(3, 3)))
    held_out = build_samples(
        cell.samples(model.card.split.test), "ahead", 1.0, LEVELS, allow=model.weights.known, rate_hz=10.0
    )
    assert model.card.metrics.mse_mean < 0.7 * held_out.scaling.var()
    assert model.history == (3, 3)


def test_the_probabilities_of_a_classifier_hold_on_executions_it_never_saw(model):
    assert model.card.metrics.calibration_error < 0.03
    assert model.card.temperature > 0


def test_an_absent_operator_is_predicted_from_his_absence(model):
    nobody = np.array([[0.6, 0.0, 0.4, np.nan, np.nan, np.nan]])
    assert model.predict(nobody)[0] > 0.98  # the log's operator leaves, and the robot runs free


def test_rows_that_are_less_sure_count_less(cell, tmp_path):
    wrong = pl.when(pl.int_range(pl.len()) % 3 == 0).then(1.0 - pl.col("scaling")).otherwise(pl.col("scaling"))
    sure = pl.when(pl.int_range(pl.len()) % 3 == 0).then(2.0).otherwise(0.0)
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    spec = ModelSpec.of("now", "regressor", batch=256, epochs=4)
    blind = train(changed(cell, tmp_path / "a", wrong.alias("scaling")), spec)
    told = train(changed(cell, tmp_path / "b", wrong.alias("scaling"), sure.alias("scaling_sd")), spec)
    rows = build_samples(cell.samples(told.card.split.test), "now", 0.0, LEVELS, rate_hz=10.0)
    errors = [float(np.mean((m.predict(rows.X) - rows.scaling) ** 2)) for m in (blind, told)]
    assert errors[1] < errors[0] / 2


def test_training_with_noise_suits_a_tracker_that_is_noisier_than_the_logs(cell):
    clean, aware = (
        train(cell, ModelSpec.of("now", "regressor", batch=256, epochs=6, noise_m=noise)) for noise in (0.0, 0.3)
    )
    rows = build_samples(cell.samples(clean.card.split.test), "now", 0.0, LEVELS, rate_hz=10.0)
    noisy = rows.X.copy()
    noisy[:, 3:6] += np.random.default_rng(0).normal(0, 0.3, (len(rows), 3))
    errors = [float(np.mean((m.predict(noisy) - rows.scaling) ** 2)) for m in (clean, aware)]
    assert errors[1] < errors[0]


def test_a_rare_level_is_found_more_often_when_all_levels_weigh_alike(cell, tmp_path):
    number = pl.col("execution").str.extract(r"(\d+)$").cast(pl.Int64)
    unseen = (pl.col("scaling") == 0.25) & (number % 4 > 0)
    rare = pl.when(unseen).then(None).otherwise(pl.col("scaling"))
    few = changed(cell, tmp_path, rare.alias("scaling"))
    plain, balanced = (
        train(few, ModelSpec.of(batch=256, epochs=6, noise_m=0.3, balance=how)) for how in ("none", "classes")
    )
    assert plain.levels == balanced.levels == LEVELS
    rows = build_samples(cell.samples(plain.card.split.test), "now", 0.0, LEVELS, rate_hz=10.0)
    found = [float(np.mean(m.steps(rows.X)[rows.step == 1] == 1)) for m in (plain, balanced)]
    assert found[1] > found[0] + 0.2


def test_training_stops_early_when_asked_to(cell):
    history = train(cell, ModelSpec.of(batch=64, epochs=40, patience=1, learning_rate=0.05)).card.history
    assert len(history) < 40


@pytest.mark.parametrize(
    ("problem", "network"),
    [("now", "regressor"), ("average", "mixed"), pytest.param("ahead", "lstm-2", marks=pytest.mark.slow)],
)
def test_the_mean_error_over_the_rows_learned_from_is_zero(cell, problem, network):
    horizon_s = None if problem == "now" else 2.0
    bias = []
    for centre in (False, True):
        spec = ModelSpec.of(problem, network, horizon_s, batch=256, epochs=2, centre=centre)
        model = train(cell, spec)
        build = {"allow": model.weights.known, "history": model.history}
        rows = build_samples(
            cell.samples(model.card.split.train), problem, model.horizon_s, LEVELS, **build, rate_hz=10.0
        )
        bias.append(abs(float((model.predict(rows.model_inputs) - rows.scaling).mean())))
    assert bias[1] < 1e-3
    assert bias[1] < bias[0] / 3


def test_normalisation_keeps_its_statistics_from_the_stated_part_of_the_run_on(cell, monkeypatch):
    frozen = []
    monkeypatch.setattr(fitting, "freeze_norm", frozen.append)
    model = train(cell, ModelSpec.of(batch=64, epochs=2, freeze_norm_after=0.75))
    steps = 2 * (int(model.card.rows.train) // 64)
    assert abs(len(frozen) - steps / 4) < steps / 20  # rows on no level are not learned from


def test_executions_under_different_sliders_teach_one_safety_function(cell, tmp_path):
    number = pl.col("execution").str.extract(r"(\d+)$").cast(pl.Int64)
    slowed = changed(
        cell, tmp_path, (pl.col("scaling") * pl.when(number % 2 == 0).then(0.7).otherwise(1.0)).alias("scaling")
    )
    model = train(slowed, ModelSpec.of(epochs=2))
    assert model.levels == LEVELS
    assert any("slider" in text for text in texts(model.card.warnings))


@pytest.mark.parametrize(
    ("problem", "settings", "sees"),
    [
        ("now", {}, "distance"),
        ("now", {"features": "positions"}, "positions"),
        ("average", {}, "positions"),
        ("ahead", {"network": "lstm-1"}, "positions"),
    ],
)
def test_a_network_sees_the_distance_too_where_the_present_scaling_is_asked_for(small, problem, settings, sees):
    model = train(small, ModelSpec.of(problem, horizon_s=None if problem == "now" else 2.0, epochs=1, **settings))
    assert model.card.spec.features == sees
    assert (model.weights.distance is not None) == (sees == "distance")


def test_a_network_that_the_staircase_beats_is_said_to_be_so(cell):
    spec = ModelSpec.of(batch=256, epochs=2, test_fraction=0.4, features="positions")
    poor = texts(train(cell, spec).card.warnings)
    assert any("distance staircase is better" in text and "--features distance" in text for text in poor)


@pytest.mark.parametrize("settings", [{"features": "positions"}, {"optimiser": "muon"}])
def test_what_differs_from_the_paper_learns_as_well_and_survives_the_disk(cell, tmp_path, settings):
    model = train(cell, ModelSpec.of(batch=256, epochs=5, **settings))
    assert model.card.metrics.mse_mean < 0.03
    save_model(tmp_path / "model", model)
    rows = build_samples(cell.samples(model.card.split.test), "now", 0.0, LEVELS, allow=("human",), rate_hz=10.0)
    assert np.array_equal(load_model(tmp_path / "model").predict(rows.X), model.predict(rows.X))
    assert model.card.spec.optimiser == settings.get("optimiser", "adamw")  # of the default: what it came to


@pytest.fixture
def thrown(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let Muon throw every network out of its range; return the optimisers of the runs begun since."""
    begun: list[str] = []

    class Throwing(fitting.Steps):
        def __init__(self, network: torch.nn.Module, spec: ModelSpec, decay: float, total: int) -> None:
            super().__init__(network, spec, decay, total)
            begun.append(spec.optimiser)
            self._bias = [module for module in network.modules() if isinstance(module, torch.nn.Linear)][-1].bias
            self._throws = spec.optimiser == "muon"

        def take(self, loss: torch.Tensor) -> None:
            super().take(loss)
            if self._throws:
                self._bias.data += 100.0

    monkeypatch.setattr(fitting, "Steps", Throwing)
    return begun


def test_a_network_that_answers_one_whatever_it_is_asked_is_learned_again_by_adamw(cell, thrown, monkeypatch):
    monkeypatch.setattr("cyclekit.learning.networks.spec.MUON_ROWS", 1)
    model = train(cell, ModelSpec.of(network="regressor", epochs=6, batch=256))
    assert thrown == ["muon", "adamw"]
    assert model.card.spec.optimiser == "adamw"
    assert model.card.metrics.mse_mean < 0.1


def test_where_muon_was_asked_for_such_a_network_is_refused(cell, thrown):
    with pytest.raises(CutOff, match=r"output is 1 for every input[\s\S]*--optimiser adamw"):
        train(cell, ModelSpec.of(network="regressor", epochs=2, batch=256, optimiser="muon"))
    assert thrown == ["muon"]


@pytest.mark.slow
def test_a_network_thrown_out_of_its_range_once_comes_back(cell, monkeypatch):
    class ThrowingOnce(fitting.Steps):
        def __init__(self, network: torch.nn.Module, spec: ModelSpec, decay: float, total: int) -> None:
            super().__init__(network, spec, decay, total)
            self._bias = [module for module in network.modules() if isinstance(module, torch.nn.Linear)][-1].bias
            self._taken = 0

        def take(self, loss: torch.Tensor) -> None:
            super().take(loss)
            self._taken += 1
            if self._taken == 20:
                self._bias.data += 1.0 - self._bias.data + 0.5

    monkeypatch.setattr(fitting, "Steps", ThrowingOnce)
    model = train(cell, ModelSpec.of(network="regressor", epochs=30, batch=256, norm="none"))
    assert model.card.metrics.mse_mean < 0.03


@pytest.mark.parametrize(("value", "given", "slope"), [(0.4, 0.4, 1.0), (3.0, 1.02, 0.01), (-2.0, -0.02, 0.01)])
def test_what_lies_beyond_the_bounds_comes_through_a_little_in_training_and_never_after(value, given, slope):
    bounded, x = Bounded(), torch.tensor([[value]], requires_grad=True)
    bounded(x).sum().backward()
    assert bounded(x).item() == pytest.approx(given)
    assert x.grad.item() == pytest.approx(slope)
    assert bounded.eval()(x).item() == pytest.approx(min(max(value, 0.0), 1.0))
