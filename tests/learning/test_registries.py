"""A network, an estimator, a level finder: each is one module and one line of a table, and every command knows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from fabricated import fabricate_dataset

from cyclekit import find_levels
from cyclekit.cli import run
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.cycle.estimators import ESTIMATORS, Estimator, by_nominal
from cyclekit.learning.networks.kinds import NETWORKS, Inputs, Network
from cyclekit.learning.networks.saved import load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit.scaling.levels import FINDERS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from torch import nn

    from cyclekit.estimate.cycle.walk import Rolled
    from cyclekit.estimate.robot.program import Program


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=8, seed=1)


def _toy(spec: ModelSpec, inputs: Inputs, levels: Sequence[float]) -> nn.Module:
    from torch import nn

    from cyclekit.learning.networks.network import feed_forward

    return nn.Sequential(
        *feed_forward((inputs.width, *spec.hidden), spec.norm), nn.Linear(spec.hidden[-1], len(levels))
    )


def test_a_network_of_one_line_is_trained_saved_read_and_judged(
    cell: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "model"
    words = ["train", str(cell.path), "--out", str(out), "--network", "toy"]
    assert run(words) != 0
    assert "unknown network 'toy'" in capsys.readouterr().err
    monkeypatch.setitem(NETWORKS, "toy", Network("toy", ("now",), (8, 8), _toy, is_classifier=True))
    assert run(["train", str(cell.path), "--out", str(out), "--network", "toys"]) != 0
    assert "the nearest is 'toy'" in capsys.readouterr().err
    save_model(out, train(cell, ModelSpec.of("now", "toy", epochs=2)))
    model = load_model(out)
    assert (model.network, model.card.network) == ("toy", "toy")
    chances = model.probabilities(np.zeros((2, len(model.inputs)), np.float32))
    np.testing.assert_allclose(chances.sum(axis=1), 1.0, atol=1e-6)
    assert run(["inspect", str(out)]) == 0
    assert "toy" in capsys.readouterr().out


def _twice(dataset: Dataset, program: Program, _seed: int) -> Rolled:
    return by_nominal(dataset, program)


def test_an_estimator_of_one_line_answers(
    cell: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.toml"
    task = cell.tasks()["task"][0]
    file.write_text(f'[[sequence]]\nname = "A"\ntasks = ["{task}"]\n', encoding="utf-8")
    monkeypatch.setitem(ESTIMATORS, "toy", Estimator("a toy estimator", alone=_twice))
    save_model(tmp_path / "model", train(cell, ModelSpec.of(epochs=1)))
    words = ["--dataset", str(cell.path), "--estimator", "toy", "--no-check", "--json"]
    assert run(["estimate", str(tmp_path / "model"), str(file), *words]) == 0
    assert "a toy estimator" in capsys.readouterr().out


def test_a_level_finder_of_one_line_is_a_method(
    cell: Dataset, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["levels", str(cell.path), "--method", "toy"]) != 0
    assert "unknown method 'toy'" in capsys.readouterr().err
    monkeypatch.setitem(FINDERS, "toy", lambda values, _eps, _least: (values > 0.5).astype(np.int64))
    assert run(["levels", str(cell.path), "--method", "toy"]) == 0
    assert "P = 2 levels by toy" in capsys.readouterr().out
    assert len(find_levels(cell, method="toy").levels) == 2
