"""A model on the disk: what was saved comes back, and anything else is refused by name, cause and cure."""

from __future__ import annotations

import json
import pickle
import struct
import subprocess
import sys
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from safetensors.numpy import save

from cyclekit.cli.facts import page
from cyclekit.dataset.cards import Note, SplitCard, TrainingCard
from cyclekit.errors import ModelError, ShapeError
from cyclekit.inspect.describe import describe
from cyclekit.learning.networks.saved import TrainedModel, load_model, save_model
from cyclekit.learning.networks.weights import Weights
from cyclekit.learning.windows import GROUPS

LEVELS = (0.0, 0.5, 1.0)


def model(
    network: str = "classifier", problem: str = "now", seed: int = 0, known: tuple[str, ...] = ()
) -> TrainedModel:
    rng = np.random.default_rng(seed)
    inputs = (6 if problem == "now" else 12) + len(known)
    sizes = {"classifier": [inputs, 8, 3], "mixed": [inputs, 8, 3, 1], "lstm-1": [5, 8, 1]}.get(network, [inputs, 8, 1])
    cells = {"lstm-1": [(inputs, 5), (5, 5)], "lstm-2": [(3 + ("human" in known), 5)]}.get(network, [])

    def some(*shape):
        return rng.normal(size=shape).astype(np.float32)

    weights = Weights(
        tuple((some(a, b), some(b)) for a, b in pairwise(sizes)),
        {"classifier": 1, "mixed": 1}.get(network),
        tuple((some(a, 4 * h), some(h, 4 * h), some(4 * h)) for a, h in cells),
        (some(5, 3), some(3)) if network == "lstm-2" else None,
        known,
        middle=some(inputs - len(known)) if known else np.empty(0, np.float32),
    )
    card = TrainingCard(seed=seed, split=SplitCard(test=("e1",)))
    horizon_s = 0.0 if problem == "now" else 2.0
    return TrainedModel(problem, network, horizon_s, LEVELS, weights, card, (4, 2) if cells else (1, 1))


def rows(count: int, inputs: int = 6) -> np.ndarray:
    return np.random.default_rng(9).normal(size=(count, inputs)).astype(np.float32)


@pytest.mark.parametrize(
    ("network", "problem", "known"),
    [
        ("classifier", "now", ()),
        ("regressor", "ahead", ()),
        ("mixed", "average", ("human", "human_goal")),
        ("regressor", "now", ("human",)),
        ("lstm-1", "ahead", ("robot_goal",)),
        ("lstm-2", "ahead", ("human", "human_goal")),
    ],
)
def test_a_model_comes_back_from_the_disk_with_the_same_predictions_and_card(tmp_path, network, problem, known):
    made = model(network, problem, known=known)
    save_model(tmp_path / "m", made)
    found = load_model(tmp_path / "m")
    X = rows(50, len(made.inputs)) if made.history == (1, 1) else rows(200, len(made.inputs)).reshape(50, 4, -1)
    for group in known:
        X[::3, ..., GROUPS[group]] = np.nan
    assert_array_equal(found.predict(X), made.predict(X))
    assert (found.card, found.levels, found.horizon_s, found.history) == (
        made.card, made.levels, made.horizon_s, made.history,
    )  # fmt: skip
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m"]


def test_an_input_that_may_be_unknown_changes_the_answer_by_being_unknown_not_by_a_made_up_position():
    made = model("regressor", known=("human",))
    X = rows(20)
    gone, half = X.copy(), X.copy()
    gone[:, 3:6], half[:, 4] = np.nan, np.nan
    assert_array_equal(made.predict(gone), made.predict(half))
    assert not np.allclose(made.predict(gone), made.predict(X))
    X[:, 0] = np.nan
    with pytest.raises(ShapeError, match="unknown input"):
        made.predict(X)


@pytest.mark.parametrize("shape", [(5, 12), (5, 3, 12), (5, 4, 11)])
def test_a_history_of_another_shape_is_refused(shape):
    with pytest.raises(ShapeError, match=r"\(N, 4, 12\)"):
        model("lstm-1", "ahead").predict(np.zeros(shape))


def test_the_same_model_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        save_model(tmp_path / name, model())
    for file in ("model.json", "weights.safetensors"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_the_best_estimate_of_a_classifier_is_the_mean_of_the_levels_and_its_step_the_likeliest():
    p = model().probabilities(rows(40))
    assert_allclose(p.sum(axis=1), 1, atol=1e-5)
    assert_allclose(model().predict(rows(40)), p @ np.array(LEVELS), atol=1e-6)
    assert_array_equal(model().steps(rows(40)), p.argmax(axis=1))


def test_the_step_of_a_regressor_is_the_level_nearest_to_its_value():
    made = model("regressor")
    nearest = np.abs(made.predict(rows(200))[:, None] - np.array(LEVELS)).argmin(axis=1)
    assert_array_equal(made.steps(rows(200)), nearest)


def test_lists_and_frames_are_inputs_too():
    made, X = model(), rows(20)
    expected = made.predict(X)
    assert_allclose(made.predict(X.tolist()), expected, atol=1e-6)
    frame = pl.DataFrame(X, schema=list(made.inputs), orient="row")
    for given in (frame, frame.select(reversed(made.inputs)), frame.to_pandas(), frame.with_columns(t_s=pl.lit(1.0))):
        assert_array_equal(made.predict(given), expected)
    assert_array_equal(made.steps(frame), made.steps(X))
    assert_array_equal(made.probabilities(frame), made.probabilities(X))
    with pytest.raises(ShapeError, match="inputs without human_x_m"):
        made.predict(frame.drop("human_x_m"))
    with pytest.raises(ShapeError, match="must be numbers"):
        made.predict([["a"] * 6])


def test_no_prediction_leaves_the_range_of_a_scaling():
    for network, problem in (("regressor", "now"), ("mixed", "average")):
        made = model(network, problem)
        predicted = made.predict(rows(500, len(made.inputs)) * 100)
        assert 0 <= predicted.min() <= predicted.max() <= 1


def test_many_rows_are_predicted_as_each_row_alone():
    X = rows(140_000)  # two threads share them
    together = model().predict(X)
    assert_allclose(together, np.concatenate([model().predict(part) for part in np.array_split(X, 7)]), atol=1e-6)
    for i in (0, 32_767, 32_768, 139_999):
        assert_allclose(together[i], model().predict(X[i : i + 1])[0], atol=1e-6)


def test_no_rows_give_no_predictions():
    assert model().predict(rows(0)).shape == (0,)


@pytest.mark.parametrize("bad", [np.zeros((3, 5)), np.zeros(6), np.full((2, 6), np.nan)])
def test_inputs_that_do_not_fit_or_are_unknown_are_refused(bad):
    with pytest.raises(ShapeError):
        model().predict(bad)


def test_only_a_classifier_has_probabilities():
    with pytest.raises(ModelError, match="no probabilities"):
        model("regressor").probabilities(rows(2))


def test_saving_replaces_a_model_but_never_anything_else(tmp_path):
    save_model(tmp_path / "m", model(seed=1))
    save_model(tmp_path / "m", model(seed=2))
    assert load_model(tmp_path / "m").card.seed == 2
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_bytes(b"meow")
    (tmp_path / "file").write_text("notes")
    for taken in ("photos", "file"):
        with pytest.raises(ModelError, match="not replaced"):
            save_model(tmp_path / taken, model())
    assert (tmp_path / "photos" / "cat.jpg").read_bytes() == b"meow"
    assert (tmp_path / "file").read_text() == "notes"


def test_a_model_that_cannot_be_written_leaves_the_old_one(tmp_path):
    save_model(tmp_path / "m", model(seed=1))
    broken = TrainedModel("now", "regressor", 0.0, LEVELS, model("regressor").weights, {"loss": float("nan")})
    with pytest.raises(ValueError, match="JSON"):
        save_model(tmp_path / "m", broken)
    assert load_model(tmp_path / "m").card.seed == 1


class Bomb:
    """Unpickled, it writes a file: proof that code ran."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return Path.write_text, (self.marker, "code ran")


def tensors(made: TrainedModel) -> dict[str, np.ndarray]:
    named = {}
    for i, (weight, bias) in enumerate(made.weights.layers):
        named |= {f"layer{i}.weight": weight, f"layer{i}.bias": bias}
    return named


def with_weights(folder: Path, content: bytes) -> None:
    """Put other weights in, and the checksum that goes with them, as a forger would."""
    (folder / "weights.safetensors").write_bytes(content)
    with_card(folder, weights_sha256=sha256(content).hexdigest())


def with_card(folder: Path, **changes: object) -> None:
    about = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps(about | changes))


GOOD = tensors(model())
HOSTILE_WEIGHTS = {
    "a pickle": pickle.dumps({"weights": 1}),
    "nothing": b"",
    "text": b"not weights " * 40,
    "a header of 2**60 bytes": struct.pack("<Q", 2**60) + b"{}",
    "a header of a megabyte": struct.pack("<Q", 2**20) + b" " * 2**20 + bytes(332),
    "cut in half": save(GOOD)[: len(save(GOOD)) // 2],
    "a byte too many": save(GOOD) + b"\0",
    "NaN": save(GOOD | {"layer0.bias": np.full(8, np.nan, np.float32)}),
    "infinity": save(GOOD | {"layer1.bias": np.full(3, np.inf, np.float32)}),
    "other shapes": save(GOOD | {"layer0.weight": GOOD["layer0.weight"].T}),
    "integers": save(GOOD | {"layer0.bias": np.zeros(8, np.int32)}),
    "halves": save({name: array.astype(np.float16) for name, array in GOOD.items()}),
    "other names": save({f"x{name}": array for name, array in GOOD.items()}),
    "a layer missing": save({name: array for name, array in GOOD.items() if name != "layer1.bias"}),
    "header without sense": struct.pack("<Q", 2) + b"[]" + bytes(332),
    "header of zero bytes": bytes(8) + bytes(332),
    "a zip": b"PK\x03\x04" + bytes(1000),
    "a git lfs pointer": b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 332\n",
}


@pytest.mark.parametrize("kind", HOSTILE_WEIGHTS)
def test_weights_that_are_not_ours_are_refused(tmp_path, kind):
    save_model(tmp_path / "m", model())
    with_weights(tmp_path / "m", HOSTILE_WEIGHTS[kind])
    with pytest.raises(ModelError, match=r"weights\.safetensors"):
        load_model(tmp_path / "m")


HOSTILE_CARDS = {
    "another schema version": ({"schema_version": 99}, "schema version 99"),
    "another model version": ({"model_version": 0}, "model version 0"),
    "another format": ({"format": "keras"}, "not the card"),
    "an unknown problem": ({"problem": "later"}, "no known network"),
    "a problem that is a list": ({"problem": ["now"]}, "problem: expected a text, got a list"),
    "a network of another problem": ({"network": "mixed"}, "no known network"),
    "a network that is a dict": ({"network": {}}, "network: expected a text, got a table"),
    "a horizon for now": ({"horizon_s": 2.0}, "horizon"),
    "an endless horizon": ({"horizon_s": 1e400}, "JSON"),
    "no levels": ({"levels": []}, "levels"),
    "falling levels": ({"levels": [1.0, 0.5, 0.0]}, "levels"),
    "levels of text": ({"levels": ["0", "1", "2"]}, "levels"),
    "levels beyond reason": ({"levels": [0, 1, 1e9]}, "levels"),
    "four levels for three outputs": ({"levels": [0, 0.2, 0.5, 1]}, "do not fit"),
    "layers that do not join": ({"layers": [[6, 8], [9, 3]]}, "do not join"),
    "layers of a terabyte": (
        {"layers": [[6, 10**9], [10**9, 3]]},
        "expected a whole number <= 4096",
    ),
    "ten thousand layers": ({"layers": [[6, 6]] * 10_000}, "layers"),
    "negative layers": ({"layers": [[6, -8], [-8, 3]]}, r"layers\[0\]\[1\]: expected a whole number >= 1"),
    "layers of true": (
        {"layers": [[6, True], [True, 3]]},
        "expected a whole number, got true or false",
    ),
    "no card": ({"card": None}, "card: expected a table, got null"),
    "a history for a classifier": ({"history": [5, 1]}, "history"),
    "an endless history": ({"history": [10**9, 1]}, "history"),
    "a history of text": ({"history": "6x2"}, "history"),
    "unknown groups": ({"known": ["legs"]}, "may be unknown"),
    "groups that are a number": ({"known": 3}, "known: expected a list, got a whole number"),
    "goals for now": ({"known": ["human_goal"]}, "may be unknown"),
    "LSTM layers for a classifier": ({"recurrent": [[6, 8]]}, "LSTM"),
    "LSTM layers of a terabyte": ({"recurrent": [[6, 10**9]]}, r"recurrent\[0\]\[1\]: expected a whole number <= 4096"),
    "a training seed of text": ({"card": {"seed": "0"}}, r"card\.seed: expected a whole number, got a text"),
    "metrics that are a list": ({"card": {"metrics": []}}, r"card\.metrics: expected a table, got a list"),
    "an accuracy of 1e308": (
        {"card": {"metrics": {"rows": 3, "mse_mean": 0.1, "mae": 0.1, "bias": 0.0, "accuracy": 1e308}}},
        r"card\.metrics\.accuracy",
    ),
    "a split of numbers": ({"card": {"split": {"test": [1]}}}, r"card\.split\.test\[0\]: expected a text"),
    "a rate of 0": ({"card": {"rate_hz": 0}}, r"card\.rate_hz: expected a number > 0"),
    "a rate of 400 digits": ({"card": {"rate_hz": 10**400}}, r"card\.rate_hz: number out of range"),
    "a checksum that is none": ({"weights_sha256": "00"}, "weights_sha256"),
    "a forecast for a classifier": ({"forecast": [8, 3]}, "LSTM"),
}


@pytest.mark.parametrize("kind", HOSTILE_CARDS)
def test_a_card_that_does_not_hold_together_is_refused(tmp_path, kind):
    changes, said = HOSTILE_CARDS[kind]
    save_model(tmp_path / "m", model())
    with_card(tmp_path / "m", **changes)
    with pytest.raises(ModelError, match=said) as refusal:
        load_model(tmp_path / "m")
    assert str(tmp_path / "m") in str(refusal.value)
    assert "cyclekit train" in str(refusal.value)


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[1]", b"\xff\xfe\x00", b'{"levels": [NaN]}', b"[" * 100_000, b" " * (17 * 2**20)]
)
def test_a_card_that_is_no_json_object_is_refused(tmp_path, content):
    save_model(tmp_path / "m", model())
    (tmp_path / "m" / "model.json").write_bytes(content)
    with pytest.raises(ModelError, match=r"model\.json"):
        load_model(tmp_path / "m")


def test_a_part_of_the_split_that_nobody_knows_is_passed_over(tmp_path):
    save_model(tmp_path / "model", model())
    with_card(tmp_path / "model", card={"seed": 0, "split": {"..": -1, "test": ["e1"]}})
    assert "executions 1 test" in page(describe(tmp_path / "model"))


def test_a_model_whose_warnings_are_sentences_opens_and_shows_them(tmp_path):
    save_model(tmp_path / "model", model())
    with_card(tmp_path / "model", card={"warnings": ["only one level, 0.50"]})
    assert load_model(tmp_path / "model").card.warnings == (Note("text", {"text": "only one level, 0.50"}),)
    assert "! only one level, 0.50" in page(describe(tmp_path / "model"))
    assert describe(tmp_path / "model").to_dict()["card"]["warnings"] == ["only one level, 0.50"]


def test_weights_changed_by_one_bit_are_noticed(tmp_path):
    save_model(tmp_path / "m", model())
    file = tmp_path / "m" / "weights.safetensors"
    content = bytearray(file.read_bytes())
    content[-7] ^= 1
    file.write_bytes(content)
    with pytest.raises(ModelError, match="checksum"):
        load_model(tmp_path / "m")


def test_a_pickle_in_place_of_a_model_is_never_run(tmp_path):
    marker = tmp_path / "marker"
    pickled = pickle.dumps(Bomb(marker))
    (tmp_path / "model.pkl").write_bytes(pickled)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "model.json").write_bytes(pickled)
    save_model(tmp_path / "m", model())
    with_weights(tmp_path / "m", pickled)
    for path in ("model.pkl", "folder", "m"):
        with pytest.raises(ModelError):
            load_model(tmp_path / path)
    assert not marker.exists()
    pickle.loads(pickled)  # the bomb is live
    assert marker.exists()


def test_what_is_no_model_folder_is_named_as_that(tmp_path):
    (tmp_path / "empty").mkdir()
    for name, said in (("nowhere", "no such folder"), ("empty", r"a folder with model\.json")):
        with pytest.raises(ModelError, match=said):
            load_model(tmp_path / name)


def test_loading_and_predicting_needs_no_torch(tmp_path):
    save_model(tmp_path / "m", model())
    code = (
        "import sys, numpy; from pathlib import Path; from cyclekit.learning.networks.saved import load_model;"
        f"load_model(Path({str(tmp_path / 'm')!r})).predict(numpy.zeros((2, 6)));"
        "sys.exit(any(m in sys.modules for m in ('torch', 'sklearn')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
