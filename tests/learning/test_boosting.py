"""Boosted trees as a model: what scikit-learn grew is what plain arrays answer, from the disk as well."""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest
from fabricated import fabricate_dataset
from safetensors.numpy import load_file, save

from cyclekit.cli import run
from cyclekit.errors import ConfigError, ModelError
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.last_second import window_features
from cyclekit.learning.networks import boosting
from cyclekit.learning.networks.saved import load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.networks.trees import Trees, sound
from cyclekit.learning.training import train
from cyclekit.learning.windows import build_samples


@pytest.fixture(scope="module", autouse=True)
def _few_trees():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(boosting, "TREES", 30)
        yield


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=8, seed=1)


@pytest.fixture(scope="module")
def rows(cell):
    spec = ModelSpec.of("ahead", "boosting").at_rate(cell.rate_hz)
    return build_samples(cell.samples(), "ahead", 2.0, (), rate_hz=cell.rate_hz, history=spec.history, past=True)


@pytest.fixture(scope="module")
def folder(cell, tmp_path_factory):
    out = tmp_path_factory.mktemp("boosting") / "model"
    words = ["train", str(cell.path), "--out", str(out), "--problem", "ahead", "--network", "boosting", "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cyclekit.learning.training.need", lambda *_: pytest.fail("trees need no torch"))
        assert run(words) == 0
    return out


def test_the_arrays_answer_what_scikit_learn_does_unknown_inputs_included(rows):
    some = rows.where(np.arange(len(rows)) % 3 == 0)
    table = some.table.copy()
    table[np.random.default_rng(0).random(len(table)) < 0.2, 9:12] = np.nan
    some = replace(some, table=table)
    grown = boosting.grow(some)
    trees = Trees(grown.nodes(boosting.TREES))
    np.testing.assert_allclose(np.clip(trees.run(some.model_inputs)[:, 0], 0, 1), grown.predict(some), atol=2e-6)
    assert sound(trees.nodes, window_features(some.model_inputs).shape[1])


@pytest.mark.slow
def test_as_many_trees_are_kept_as_are_best_in_executions_that_none_has_seen(folder, cell):
    model = load_model(folder)
    assert 0 < len(model.weights.nodes) <= boosting.TREES
    best = min(model.card.history, key=lambda stage: stage.validation_mse)
    assert abs(best.epoch - len(model.weights.nodes)) <= 10
    assert model.card.metrics.mse_mean < 0.8 * model.card.metrics.mse_constant
    with pytest.raises(ModelError, match="history"):
        run_export(model, folder)


def run_export(model, folder):
    from cyclekit.learning.networks.onnx_file import write_onnx

    write_onnx(folder.parent / "m.onnx", model)


@pytest.mark.usefixtures("no_boosting")
def test_it_is_evaluated_and_shown_as_any_other(folder, cell, capsys):
    assert run(["evaluate", str(folder), str(cell.path)]) == 0
    assert run(["inspect", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "boosting for problem ahead" in said
    assert "constant mean" in said


@pytest.mark.slow
def test_the_same_trees_come_back_and_the_same_seed_gives_the_same_bytes(folder, cell, tmp_path):
    model = load_model(folder)
    save_model(tmp_path / "again", train(cell, ModelSpec.of("ahead", "boosting")))
    assert (tmp_path / "again" / "weights.safetensors").read_bytes() == (folder / "weights.safetensors").read_bytes()
    assert model.inputs[-4:] == ("robot_goal_age_s", "human_goal_age_s", "scaling", "human_still_s")


@pytest.mark.parametrize(
    ("column", "value"), [(0, 1000), (0, -1), (0, 0.5), (2, 1e9), (2, -5), (3, 0), (5, np.nan), (1, np.inf)]
)
def test_trees_that_lead_nowhere_are_refused(folder, tmp_path, column, value):
    save_model(tmp_path / "m", load_model(folder))
    nodes = load_file(tmp_path / "m" / "weights.safetensors")["trees"].copy()
    nodes[0, 0, column] = value
    content = save({"trees": nodes})
    (tmp_path / "m" / "weights.safetensors").write_bytes(content)
    card = json.loads((tmp_path / "m" / "model.json").read_text())
    card["weights_sha256"] = sha256(content).hexdigest()
    (tmp_path / "m" / "model.json").write_text(json.dumps(card))
    with pytest.raises(ModelError, match=r"leads nowhere|not finite"):
        load_model(tmp_path / "m")


@pytest.mark.parametrize(
    "settings", [{"features": "positions"}, {"noise_m": 0.02}, {"optimiser": "muon"}, {"history": (1, 1)}]
)
def test_settings_of_networks_are_refused(settings):
    with pytest.raises(ConfigError):
        ModelSpec.of("ahead", "boosting", **settings)


@pytest.mark.slow
def test_boosting_sees_what_a_network_sees_and_what_is_known_of_the_last_second(cell):
    model = train(cell, ModelSpec.of("ahead", "lstm-1", epochs=1, features="past"))
    assert len(model.inputs) == 16
    found = [row.name for row in evaluate(model, cell).mse]
    assert found[-1] == "gradient boosting"
    model = train(cell, ModelSpec.of("ahead", "regressor", epochs=1))
    judged = evaluate(model, cell)
    mse = {row.name: row.mse for row in judged.mse}
    assert mse["gradient boosting, last second"] < mse["gradient boosting"]
    assert judged.better is None or judged.better.otherwise[-2:] == ("--network", "boosting")
