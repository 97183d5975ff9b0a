"""Judging a model: on what it never saw, beside rivals whose answers are known."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from fabricated import LEVELS, THRESHOLDS_M, fabricate_dataset
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from cyclekit.api.export import export_model
from cyclekit.cli import run
from cyclekit.dataset.cards import SplitCard, dataset_card, plain
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import DatasetError, ModelError
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.networks.comparison import better_rival, fit_thresholds
from cyclekit.learning.networks.saved import load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit.report import compose_report
from cyclekit.storage.atomic import write_parquet


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
    assert judged.executions == model.card.split.test
    assert structs.asdict(judged.metrics) == pytest.approx(structs.asdict(model.card.metrics))


def test_another_dataset_is_judged_whole_and_without_rivals(model, tmp_path):
    other = fabricate_dataset(tmp_path / "other", executions=3, seed=6)
    found = evaluate(model, other)
    assert not found.held_out
    assert list(found.executions) == other.executions["execution"].to_list()
    assert [row.name for row in found.mse] == ["model", "model, most likely step"]
    assert found.notes


def changed(cell, change):
    """Return a dataset with another card."""
    card = plain(cell.card)
    change(card)
    return Dataset(cell.path, dataset_card(card))


@pytest.mark.parametrize(
    "change",
    [
        lambda card: card.update(name="another name"),
        lambda card: card.update(cyclekit_version="next", fingerprint="ingested again"),
        lambda card: [one.update(key="touched") for one in card["recordings"]],
        lambda card: [source.update(path="elsewhere.csv") for one in card["recordings"] for source in one["sources"]],
        lambda card: [source.update(sha256=None) for one in card["recordings"] for source in one["sources"]],
    ],
    ids=["renamed", "ingested again", "touched", "moved", "without checksums"],
)
def test_the_dataset_of_a_model_is_known_by_its_logs(judged, model, cell, change):
    found = evaluate(model, changed(cell, change))
    assert found.held_out
    assert found.executions == judged.executions
    assert found.metrics == judged.metrics
    assert [row.name for row in found.mse] == [row.name for row in judged.mse]


def test_what_a_model_learned_from_is_never_judged_as_new(model, cell):
    def knowing(train, test):
        return replace(model, card=structs.replace(model.card, split=SplitCard(train=train, test=test)))

    test, train = model.card.split.test, model.card.split.train
    grown = evaluate(knowing(train, test[:1]), cell, boosting=False)
    assert set(grown.executions) == set(cell.executions["execution"]) - set(train)  # and what was logged since
    part = evaluate(model, cell.only([*train[1:], *test]), boosting=False)
    assert (part.held_out, part.executions, part.learned) == (True, test, 0)
    known = evaluate(model, cell.only(train), boosting=False)
    assert (known.held_out, known.learned) == (False, len(train))
    assert "learned from every execution" in known.notes[-1]
    renamed = evaluate(knowing(("an execution",), ("another",)), cell, boosting=False)
    assert (renamed.held_out, renamed.learned) == (False, 0)
    assert "had other names" in renamed.notes[-1]


def test_the_rivals_stand_beside_the_model(judged):
    mse = {row.name: row.mse for row in judged.mse}
    assert list(mse) == [
        "model", "model, most likely step", "constant mean", "distance staircase", "gradient boosting",
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


def squared_errors(each: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Squared errors of 20 rows of each execution, about one value each; and the execution of each row."""
    execution = np.repeat(np.arange(len(each)), 20)
    return np.array(each)[execution] * np.tile([0.5, 1.5], 10 * len(each)), execution


def test_a_rival_that_is_better_in_every_execution_is_named():
    model, execution = squared_errors([0.024, 0.026, 0.025, 0.027])
    rivals = {"distance staircase": model / 2, "constant mean": 2 * model, "gradient boosting": model / 1.9}
    better = better_rival(None, model, rivals, execution)
    assert (better.name, better.executions) == ("distance staircase", 4)
    assert better.model_mse / better.mse == pytest.approx(2.0)


@pytest.mark.parametrize(
    "rival",
    [
        [0.001, 0.030, 0.024, 0.026],  # in one execution alone
        [0.022, 0.023, 0.022, 0.023],  # hardly
        [0.050, 0.050, 0.050, 0.050],  # worse
    ],
)
def test_a_rival_that_is_not_surely_better_is_not_named(rival):
    model, execution = squared_errors([0.024, 0.026, 0.025, 0.027])
    assert better_rival(None, model, {"distance staircase": squared_errors(rival)[0]}, execution) is None


def test_few_executions_prove_nothing():
    model, execution = squared_errors([0.024, 0.026])
    assert better_rival(None, model, {"distance staircase": model / 10}, execution) is None


@pytest.mark.parametrize(
    ("settings", "options"),
    [
        ({"features": "positions"}, ["--features", "distance"]),
        ({}, ["--features", "distance", "--seed", "1"]),
        ({"features": "distance", "seed": 3}, ["--features", "distance", "--seed", "4"]),
        (
            {"network": "regressor", "norm": "none", "features": "positions"},
            ["--network", "regressor", "--norm", "none", "--features", "distance"],
        ),
        ({"noise_m": 0.02, "seed": 1}, ["--noise", "0.02", "--features", "distance", "--seed", "2"]),
        (
            {"problem": "ahead", "network": "lstm-1"},
            ["--problem", "ahead", "--horizon", "2s", "--network", "lstm-1", "--seed", "1"],
        ),
    ],
)
def test_the_better_training_is_like_the_first_but_for_one_thing(settings, options):
    model, execution = squared_errors([0.024, 0.026, 0.025, 0.027])
    spec = ModelSpec.of(**settings).with_features().card()
    better = better_rival(spec, model, {"distance staircase": model / 2}, execution)
    assert list(better.otherwise) == options
    line = better.said("my dataset", "model")
    assert shlex.split(line.partition("cyclekit ")[2]) == ["train", "my dataset", "--out", "model", *options]


@pytest.mark.slow
def test_what_beats_a_model_is_said_with_the_command_that_mends_it(cell, tmp_path, capsys):
    """A network that hardly learned is beaten by the staircase; the command as printed gives one that is not."""
    out = tmp_path / "model"
    save_model(out, train(cell, ModelSpec.of(batch=256, epochs=2, test_fraction=0.4, features="positions")))
    assert run(["evaluate", str(out), str(cell.path)]) == 0
    line = next(text for text in capsys.readouterr().out.splitlines() if "beyond chance" in text)
    assert line.startswith("the distance staircase is better than the model beyond chance")
    command = shlex.split(line.partition("train again: cyclekit ")[2])
    assert run([*command, "--quiet"]) == 0
    assert load_model(out).card.spec.features == "distance"
    assert load_model(out).card.metrics.mse_mean < 0.01


def test_an_evaluation_is_one_json_document(judged):
    document = json.loads(json.dumps(judged.to_dict(), allow_nan=False))
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


@pytest.fixture(scope="module")
def ruled_model(cell):
    """A model whose rule is the true staircase; its network has learned next to nothing."""
    learned = train(cell, ModelSpec.of(batch=256, epochs=1), rules=True)
    assert learned.card.rule is not None
    return learned


def test_what_answers_is_evaluated_and_the_network_stands_beside_it(ruled_model, cell):
    judged, alone = (
        evaluate(each, cell, boosting=False)
        for each in (ruled_model, replace(ruled_model, card=structs.replace(ruled_model.card, rule=None)))
    )
    errors = {row.name: row.mse for row in judged.mse}
    assert [row.name for row in judged.mse][:2] == ["rule", "network"]
    assert (judged.network, alone.network) == ("rule", ruled_model.network)
    assert errors["rule"] == judged.metrics.mse_mean < 0.1 * alone.metrics.mse_mean
    assert errors["network"] == pytest.approx(alone.metrics.mse_mean)
    confusion = np.array(judged.confusion)
    assert confusion.trace() / confusion.sum() == pytest.approx(judged.metrics.accuracy)
    assert judged.metrics.accuracy > alone.metrics.accuracy
    assert judged.better is None
    page = compose_report(cell, ruled_model, cell.path.parent / "r.md", kind="md", evaluation=judged)
    text = page.path.read_text("utf-8").replace("\N{NO-BREAK SPACE}", " ")
    assert "come from the rule (row “rule”)" in text
    assert "| Mean squared error: rule |" in text
    assert "| Mean squared error: network |" in text


def test_the_rule_that_answers_is_exported_and_the_network_by_its_name(ruled_model, cell, tmp_path):
    done = export_model(ruled_model, tmp_path / "rule.json")
    document = json.loads(done.path.read_text("utf-8"))
    assert done.to_dict() == {"rule": str(done.path), "difference": None}
    assert len(document["rule"]["limits"]) == len(LEVELS) - 1
    assert document["in_words"][-1] == "speed 100 % otherwise"
    export_model(ruled_model, tmp_path / "rule.json")  # its own file is replaced
    with pytest.raises(ModelError, match=r"the rule .* answers for this model") as refused:
        export_model(ruled_model, tmp_path / "model.onnx")
    assert "--network" in refused.value.cure
    with pytest.raises(ModelError, match="no rule answers"):
        export_model(replace(ruled_model, card=structs.replace(ruled_model.card, rule=None)), tmp_path / "other.json")
