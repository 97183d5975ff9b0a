"""A model as an ONNX file: what onnxruntime makes of it is what cyclekit predicts."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from msgspec import structs
from ruled import near, ruled

from cyclekit.cli import run
from cyclekit.errors import ModelError
from cyclekit.learning.networks import onnx_file
from cyclekit.learning.networks.onnx_file import write_onnx
from cyclekit.learning.networks.saved import TrainedModel, save_model
from cyclekit.learning.networks.weights import Weights
from cyclekit.learning.rules.safety import predictor_of

onnxruntime = pytest.importorskip("onnxruntime")
LEVELS = (0.0, 0.5, 1.0)
SHAPES = {"classifier": [3], "mixed": [3, 1], "regressor": [1]}


def model(network: str, problem: str, *, distance: bool = False) -> TrainedModel:
    rng = np.random.default_rng(3)
    sizes = [(6 if problem == "now" else 12) + distance, 64, 64, *SHAPES[network]]
    layers = tuple(
        (rng.normal(0, 0.3, (a, b)).astype(np.float32), rng.normal(0, 0.3, b).astype(np.float32))
        for a, b in pairwise(sizes)
    )
    weights = Weights(layers, {"classifier": 2, "mixed": 2}.get(network), distance=2.0 if distance else None)
    return TrainedModel(problem, network, 0.0 if problem == "now" else 2.0, LEVELS, weights)


@pytest.mark.parametrize(("network", "problem"), [("classifier", "now"), ("regressor", "ahead"), ("mixed", "average")])
@pytest.mark.parametrize("distance", [False, True])
def test_onnxruntime_predicts_what_cyclekit_predicts(tmp_path, network, problem, distance):
    made = model(network, problem, distance=distance)
    assert write_onnx(tmp_path / "m.onnx", made) <= 1e-5
    session = onnxruntime.InferenceSession(tmp_path / "m.onnx")
    X = np.random.default_rng(1).uniform(-2, 2, (500, len(made.inputs))).astype(np.float32)
    assert session.run(["scaling"], {"positions": X})[0][:, 0] == pytest.approx(made.predict(X), abs=1e-5)
    assert np.ptp(made.predict(X)) > 1e-3


def test_a_file_that_would_predict_otherwise_is_not_written(tmp_path, monkeypatch):
    made = model("regressor", "now")
    other = replace(made, weights=model("regressor", "now").weights)
    weight, bias = other.weights.layers[-1]
    twisted = replace(other, weights=replace(other.weights, layers=(*other.weights.layers[:-1], (weight * 2, bias))))
    right = onnx_file._graph
    monkeypatch.setattr(onnx_file, "_graph", lambda _model: right(twisted))
    with pytest.raises(ModelError, match="not written"):
        write_onnx(tmp_path / "m.onnx", made)
    assert list(tmp_path.iterdir()) == []


def test_a_model_with_inputs_that_may_be_unknown_is_refused_with_a_cure(tmp_path):
    made = model("regressor", "now")
    with pytest.raises(ModelError, match="may be unknown"):
        write_onnx(tmp_path / "m.onnx", replace(made, weights=replace(made.weights, known=("human",))))


def test_the_command_says_how_near_the_file_is(tmp_path, capsys):
    save_model(tmp_path / "m", model("classifier", "now"))
    assert run(["export", str(tmp_path / "m"), "--out", str(tmp_path / "m.onnx")]) == 0
    assert "of cyclekit" in capsys.readouterr().out


def test_the_command_writes_the_network_that_stands_beside_a_rule(tmp_path, capsys):
    made = model("classifier", "now")
    made = replace(made, card=structs.replace(made.card, rule=ruled((0.0, near(1.0), None)).rule))
    save_model(tmp_path / "m", made)
    file = tmp_path / "network.onnx"
    assert run(["export", str(tmp_path / "m"), "--out", str(file)]) == 1
    assert "--network" in capsys.readouterr().err
    assert run(["export", str(tmp_path / "m"), "--network", "--out", str(file), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["onnx"], document["difference"] < 1e-5) == (str(file), True)
    assert run(["export", str(tmp_path / "m"), "--network", "--out", str(tmp_path / "network.json")]) == 1
    assert "--out FILE.onnx" in capsys.readouterr().err
    X = np.random.default_rng(1).uniform(-2, 2, (200, len(made.inputs))).astype(np.float32)
    written = onnxruntime.InferenceSession(file).run(["scaling"], {"positions": X})[0][:, 0]
    assert written == pytest.approx(made.predict(X), abs=1e-5)
    assert not np.allclose(written, predictor_of(made).predict(X), atol=0.05)
