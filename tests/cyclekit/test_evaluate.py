"""Judging a model: on what it never saw, beside rivals whose answers are known."""

from __future__ import annotations

import json

import numpy as np
import polars as pl
import pytest
from fabricated import LEVELS, THRESHOLDS_M, fabricate_dataset
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.atomic import write_parquet
from cyclekit.errors import DatasetError
from cyclekit.evaluate import evaluate
from cyclekit.evaluate.baselines import fit_thresholds
from cyclekit.models.spec import ModelSpec
from cyclekit.train import train


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=10, seed=5)


@pytest.fixture(scope="module")
def model(cell):
    return train(cell, ModelSpec.of(batch=256, epochs=12))


@pytest.fixture(scope="module")
def judged(model, cell):
    return evaluate(model, cell)


def test_a_model_is_judged_on_the_executions_it_never_saw(judged, model):
    assert judged.held_out
    assert list(judged.executions) == model.card["split"]["test"]
    assert judged.metrics.to_json() == pytest.approx(model.card["metrics"])


def test_another_dataset_is_judged_whole_and_without_rivals(model, tmp_path):
    other = fabricate_dataset(tmp_path / "other", executions=3, seed=6)
    found = evaluate(model, other)
    assert not found.held_out
    assert list(found.executions) == other.executions["execution"].to_list()
    assert [row.name for row in found.mse] == ["model", "model, step named"]
    assert found.notes


def test_the_rivals_stand_beside_the_model(judged):
    mse = {row.name: row.mse for row in judged.mse}
    assert list(mse) == [
        "model", "model, step named", "constant mean", "distance staircase", "gradient boosting",
    ]  # fmt: skip
    assert mse["model"] < mse["constant mean"] / 2
    assert mse["distance staircase"] < 0.003  # the cell's staircase is one of the distance
    assert mse["gradient boosting"] < mse["constant mean"] / 2


def test_the_true_thresholds_are_found_where_the_safety_function_is_one_of_the_distance(judged):
    note = next(row.note for row in judged.mse if row.name == "distance staircase")
    found = [float(word) for word in note.split(":")[1].removesuffix(" m").split(",")]
    assert found == pytest.approx(THRESHOLDS_M, abs=0.05)


def test_gradient_boosting_can_be_left_out(model, cell):
    assert "gradient boosting" not in [row.name for row in evaluate(model, cell, boosting=False).mse]


def test_the_confusion_counts_every_row_on_a_level_once(judged):
    confusion = np.array(judged.confusion)
    assert confusion.shape == (5, 5)
    assert confusion.sum() == judged.metrics.rows
    assert confusion.trace() / confusion.sum() == pytest.approx(judged.accuracy)
    assert [row.rows for row in judged.levels] == confusion.sum(axis=1).tolist()
    assert judged.levels[4].recall == pytest.approx(confusion[4, 4] / confusion[4].sum())
    assert judged.levels[4].precision == pytest.approx(confusion[4, 4] / confusion[:, 4].sum())


def test_an_evaluation_is_one_json_document(judged):
    document = json.loads(json.dumps(judged.to_json(), allow_nan=False))
    assert document["mse"][0].keys() == {"name", "mse", "note"}
    assert document["accuracy"] == judged.accuracy


def test_an_average_has_no_steps_to_confuse(cell):
    average = train(cell, ModelSpec.of("average", horizon_s=3.0, epochs=2))
    found = evaluate(average, cell, boosting=False)
    assert found.confusion is None
    assert found.accuracy is None


def test_a_dataset_without_scaling_cannot_judge(model, tmp_path):
    dark = fabricate_dataset(tmp_path / "dark", executions=2, seed=7)
    for file in (dark.path / "samples").glob("*.parquet"):
        write_parquet(pl.read_parquet(file).with_columns(scaling=pl.lit(None, pl.Float64)), file)
    with pytest.raises(DatasetError, match="scaling unknown"):
        evaluate(model, dark)


@given(
    st.lists(st.floats(0.2, 4), min_size=1, max_size=25, unique=True),
    st.lists(st.sampled_from(LEVELS), min_size=25, max_size=25),
)
def test_no_thresholds_fit_better_than_those_found(distances, scaling):
    distance, scaling = np.array(distances), np.array(scaling[: len(distances)])
    levels = (0.0, 0.5, 1.0)

    def error(thresholds):
        return float(((np.array(levels)[np.searchsorted(thresholds, distance, side="right")] - scaling) ** 2).sum())

    found = fit_thresholds(distance, scaling, levels)
    assert found[0] <= found[1]
    candidates = [-np.inf, *np.sort(distance), np.inf]
    best = min(error([a, b]) for a in candidates for b in candidates if a <= b)
    assert error(found) == pytest.approx(best)
