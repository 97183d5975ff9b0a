"""Cards may come from anywhere: what is not as it should be is one sentence, and the real ones are described whole."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import polars as pl
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit import Dataset
from cyclekit.config import load_cell
from cyclekit.config.sequences import load_sequences
from cyclekit.dataset.cards import BadCard, CellLedger, DatasetCard, checked, parse_json, plain
from cyclekit.errors import ConfigError, DatasetError, ModelError
from cyclekit.fleet.read import FleetCell
from cyclekit.fleet.stages import read_ledger
from cyclekit.ingest.discover import Log
from cyclekit.ingest.read.resume import ResumeStore
from cyclekit.learning.networks.saved import TrainedModel, load_model, save_model
from cyclekit.learning.networks.weights import Weights

if TYPE_CHECKING:
    from simulated_cells import SimulatedCell


def unsaid(told: object, known: object, where: str = "") -> list[str]:
    """Return the keys of a card that its class does not know."""
    if isinstance(told, dict) and isinstance(known, dict):
        missing = [f"{where}.{key}" for key in told if key not in known]
        return missing + [text for key in told if key in known for text in unsaid(told[key], known[key], key)]
    if isinstance(told, list) and isinstance(known, list):
        return [text for a, b in zip(told, known, strict=True) for text in unsaid(a, b, where)]
    return []


@pytest.fixture
def copied(boxes: SimulatedCell, tmp_path: Path) -> Path:
    return Path(shutil.copytree(boxes.dataset.path, tmp_path / "dataset"))


def test_the_class_of_a_datasets_card_knows_every_key_of_a_real_one(boxes: SimulatedCell):
    card = json.loads((boxes.dataset.path / "dataset.json").read_text(encoding="utf-8"))
    assert unsaid(card, msgspec.to_builtins(checked(card, DatasetCard))) == []


def test_a_card_of_a_version_that_said_less_or_more_still_opens(copied: Path):
    card = json.loads((copied / "dataset.json").read_text(encoding="utf-8"))
    for key in ("dynamics", "rate_hz", "skeletons", "not_read", "settings"):
        del card[key]
    card["mood"] = {"today": "good"}
    (copied / "dataset.json").write_text(json.dumps(card), encoding="utf-8")
    assert Dataset.open(copied).executions.height == 4


WRONG: dict[str, tuple[tuple[str | int, ...], Any, str]] = {
    "a list of texts for executions": (("executions",), ["a"], r"executions\[0\]: expected a table, got a text"),
    "no rate": (("rate_hz",), 0, "rate_hz: expected a number > 0"),
    "a rate of 400 digits": (("rate_hz",), 10**400, "rate_hz: number out of range"),
    "a rate of text": (("rate_hz",), "10", "rate_hz: expected a number, got a text"),
    "an infinite time": (("executions", 0, "end_s"), 1e999, "JSON"),
    "an end before the beginning": (("executions", 0, "end_s"), -1.0, r"executions\[0\]: end_s must not be before"),
    "two executions of one name": (("executions", 1, "execution"), "session_000.001", "two executions have the same"),
    "a place without a centre": (("places", "home"), {}, r"places\[...\]: xyz_m is missing"),
    "a place of two numbers": (("places", "home", "xyz_m"), [0, 0], "expected a list of length 3"),
    "falling levels": (("levels",), [1.0, 0.5], "levels must be ascending"),
    "no sources": (("recordings", 0, "sources"), [], r"recordings\[0\].sources: expected a list of length >= 1"),
    "a clock that stands still": (("recordings", 0, "clock", "rate"), 0, r"recordings\[0\].clock.rate: expected"),
    "no clock": (("recordings", 0, "clock"), None, r"recordings\[0\].clock: expected a table, got null"),
    "an unknown table": (("recordings", 0, "tables"), ["../x"], r"recordings\[0\].tables\[0\]: invalid enum"),
    "furniture of text": (("settings",), {"furniture": "table"}, "settings.furniture: expected a table, got a text"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_a_value_that_is_wrong_is_named_with_its_place_in_the_card(copied: Path, kind: str):
    way, value, said = WRONG[kind]
    card = json.loads((copied / "dataset.json").read_text(encoding="utf-8"))
    inner: Any = card
    for step in way[:-1]:
        inner = inner[step]
    inner[way[-1]] = value
    (copied / "dataset.json").write_text(json.dumps(card).replace("Infinity", "1e999"), encoding="utf-8")
    with pytest.raises(DatasetError, match=said) as refusal:
        Dataset.open(copied)
    assert refusal.value.seen.startswith(f"{copied / 'dataset.json'}: not a dataset card (")
    assert "Ingest the logs again" in str(refusal.value)


@pytest.mark.parametrize(
    "content", [b"[" * 100_000, b'{"schema_version": NaN}', b"\xff", b'{"name": "\\ud800"}', b'{"a": ' + b"1" * 5000]
)
def test_a_card_that_is_no_json_is_refused(copied: Path, content: bytes):
    (copied / "dataset.json").write_bytes(content)
    with pytest.raises(DatasetError, match=r"dataset\.json: not a dataset card"):
        Dataset.open(copied)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_in_place_of_a_card_is_refused_and_not_waited_for(copied: Path):
    (copied / "dataset.json").unlink()
    os.mkfifo(copied / "dataset.json")
    with pytest.raises(DatasetError, match=r"dataset\.json: cannot be read \(is a named pipe, not a file\)"):
        Dataset.open(copied)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


@given(st.binary(max_size=60) | JSON.map(lambda value: json.dumps(value).encode()))
def test_whatever_the_bytes_are_they_are_a_table_or_one_sentence(content: bytes):
    said: object
    try:
        said = parse_json(content)
    except BadCard as error:
        said = str(error)
    assert isinstance(said, dict) or (isinstance(said, str) and said and "\n" not in said)


@at_most(60)
@given(data=st.data())
def test_a_real_card_with_any_value_in_any_place_is_a_card_or_one_sentence(boxes: SimulatedCell, data: st.DataObject):
    card = plain(boxes.dataset.card)
    inner: Any = card
    while True:
        key = data.draw(st.sampled_from(sorted(inner) if isinstance(inner, dict) else range(len(inner))))
        if not isinstance(inner[key], dict | list) or not inner[key] or data.draw(st.booleans()):
            break
        inner = inner[key]
    inner[key] = data.draw(JSON)
    said: object
    try:
        said = checked(card, DatasetCard).rate_hz
    except BadCard as error:
        said = str(error)
    assert said


@pytest.mark.parametrize("name", ["samples/session_000.parquet", "tasks.parquet", "quarantine.parquet"])
def test_a_table_with_more_rows_than_the_card_says_is_refused_before_it_is_read(copied: Path, name: str):
    one = pl.read_parquet(file := copied / name).clear(1)
    one.select(pl.all().repeat_by(30_000).explode()).write_parquet(file)
    with pytest.raises(DatasetError, match=r"holds 30 000 rows, but dataset\.json states "):
        Dataset.open(copied)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("name", ["samples/session_000.parquet", "tasks.parquet"])
def test_a_pipe_in_place_of_a_table_is_refused_and_not_waited_for(copied: Path, name: str):
    (copied / name).unlink()
    os.mkfifo(copied / name)
    with pytest.raises(DatasetError, match="is a named pipe, not a file"):
        Dataset.open(copied)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_in_place_of_a_cell_or_sequence_file_or_weights_is_refused(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.toml")
    for load in (load_cell, load_sequences):
        with pytest.raises(ConfigError, match="is a named pipe, not a file"):
            load(tmp_path / "pipe.toml")
    layer = (np.zeros((6, 2), np.float32), np.zeros(2, np.float32))
    weights = Weights((layer, (np.zeros((2, 1), np.float32), np.zeros(1, np.float32))))
    save_model(tmp_path / "m", TrainedModel("now", "regressor", 0.0, (), weights))
    (tmp_path / "m" / "weights.safetensors").unlink()
    os.mkfifo(tmp_path / "m" / "weights.safetensors")
    with pytest.raises(ModelError, match=r"weights\.safetensors: .*is a named pipe, not a file"):
        load_model(tmp_path / "m")


@pytest.mark.parametrize("rows", [1, 60_000])
def test_weights_so_large_that_no_number_comes_out_are_a_message(rows: int):
    layer = (np.full((6, 2), 3.4e38, np.float32), np.zeros(2, np.float32))
    weights = Weights((layer, (np.array([[1.0], [-1.0]], np.float32), np.zeros(1, np.float32))))
    with pytest.raises(ModelError, match=f"gives no number in {rows} of {rows} rows: its weights are too large"):
        TrainedModel("now", "regressor", 0.0, (), weights).predict(np.ones((rows, 6)))


ENTRIES = ["", "{}", "[]", '{"id": 3}', "[" * 100_000, '{"id": "x", "tables": ["robot"]}']


@pytest.mark.parametrize("text", ENTRIES)
def test_a_kept_recording_whose_card_is_none_is_not_taken_over(tmp_path: Path, text: str):
    log = Log("a", tmp_path / "a.csv", "a.csv", "csv", "cyclekit", "0", None, "k" * 64)
    place = tmp_path / ".out.read" / f"{'k' * 32}-plain"
    place.mkdir(parents=True)
    (place / "entry.json").write_text(text, encoding="utf-8")
    assert ResumeStore(tmp_path / "out", "plain").find(log) is None
    assert not place.exists()


@pytest.mark.parametrize(
    "text", ["", "[]", '{"stages": 3}', '{"days": {"s": "2026-02-31"}}', '{"figures": {"cycle_s": "x"}}', "[" * 100_000]
)
def test_a_cell_of_a_fleet_that_says_nonsense_is_one_of_which_nothing_is_known(tmp_path: Path, text: str):
    (tmp_path / "cell.json").write_text(text, encoding="utf-8")
    found = read_ledger(FleetCell("press-1", ("logs",), str(tmp_path)))
    assert found == CellLedger(cell="press-1")
