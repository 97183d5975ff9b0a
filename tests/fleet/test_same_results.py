"""Whoever does the work, the same comes out: datasets to the last byte, models, judgements and estimates."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from threadpoolctl import threadpool_limits

from cyclekit.api.train import Training, train_at
from cyclekit.cli import run
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.parallel.engine import LOCAL, Engine

pytestmark = pytest.mark.tests_clocks

WHOLE_WAY = Path(__file__).parents[1] / "support" / "whole_way.py"
NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS")


def digest(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file of a folder, by its name in it."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture(params=["processes", pytest.param("ray", marks=pytest.mark.slow)])
def elsewhere(request: pytest.FixtureRequest) -> list[str]:
    """The options that have two workers do the work."""
    if request.param == "processes":
        return ["--jobs", "2"]
    engine: Engine = request.getfixturevalue("cluster")
    return ["--engine", "ray", "--ray-address", str(engine.address)]


@pytest.mark.slow  # quick: the two below
def test_one_thread_or_four_the_same_is_stored_and_said(small_cell: Path, tmp_path: Path) -> None:
    runs = []
    for threads in ("1", "4"):
        (folder := tmp_path / threads).mkdir()
        words = [sys.executable, str(WHOLE_WAY), threads, str(small_cell)]
        runs.append(subprocess.Popen(words, cwd=folder, env={**os.environ, **dict.fromkeys(NAMES, threads)}))
    assert [run.wait() for run in runs] == [0, 0]
    one, four = (digest(tmp_path / threads) for threads in ("1", "4"))
    assert {"dataset/dataset.json", "now/model.json", "ahead/weights.safetensors", "zones.json"} <= set(one)
    assert [name for name in one if one[name] != four[name]] == []
    assert set(one) == set(four)


@pytest.mark.slow  # quick: two jobs in test_ingest
def test_a_dataset_does_not_depend_on_the_number_of_threads(small_cell: Path, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "cyclekit", "ingest", str(small_cell / "logs"), "--out", "dataset", "--quiet"]
    subprocess.run(words, cwd=tmp_path, env={**os.environ, **dict.fromkeys(NAMES, "4")}, check=True)
    assert digest(tmp_path / "dataset") == digest(small_cell / "dataset")


def test_a_model_does_not_depend_on_the_number_of_threads(small_cell: Path, tmp_path: Path) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(4)
    try:
        with threadpool_limits(4):
            train_at(Training(str(small_cell / "dataset"), ModelSpec.of(epochs=2), str(tmp_path / "model")))
    finally:
        torch.set_num_threads(before)
    assert digest(tmp_path / "model") == digest(small_cell / "model")


def answer(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    capsys.readouterr()
    assert run([*map(str, words), "--quiet", "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow  # quick: two jobs in test_ingest
def test_a_dataset_is_the_same_to_the_last_byte(
    small_cell: Path, elsewhere: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cyclekit.derive.over_sessions.SHARED_ROWS", 0)  # as with many hours of logs
    shared, by_themselves = [], Engine.map
    monkeypatch.setattr(Engine, "map", lambda *words: shared.append(words[0]) or by_themselves(*words))
    assert run(["ingest", str(small_cell / "logs"), "--out", str(tmp_path / "dataset"), "-q", *elsewhere]) == 0
    assert len(shared) >= 5  # the logs, and the passes over the sessions
    assert LOCAL not in shared
    found = digest(tmp_path / "dataset")
    assert sum(name.endswith(".parquet") for name in found) >= 8
    assert found == digest(small_cell / "dataset")


@pytest.mark.slow  # quick: estimates by two processes below, a model at four threads above
def test_models_are_equal_and_so_are_their_judgements(
    small_cell: Path, elsewhere: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, engine in (("one", LOCAL), ("two", engine_of_words(elsewhere))):
        todo = [Training(str(small_cell / "dataset"), spec(seed), str(tmp_path / name / f"{seed}")) for seed in (1, 2)]
        for done in engine.map(train_at, todo):
            done.get()
    assert len(digest(tmp_path / "one")) == 4
    assert digest(tmp_path / "two") == digest(tmp_path / "one")
    if "ray" not in elsewhere:  # gradient boosting takes seconds: once is enough
        return
    words = ["evaluate", tmp_path / "one", small_cell / "dataset"]
    here = answer(capsys, *words)
    assert set(here["models"]) == {"1", "2"}
    assert here == answer(capsys, *words, *elsewhere)


def spec(seed: int) -> ModelSpec:
    return ModelSpec.of("ahead", "regressor", 2.0, seed=seed, epochs=2)


def engine_of_words(words: list[str]) -> Engine:
    return Engine("ray", address=words[-1]) if "ray" in words else Engine(jobs=2)


@pytest.mark.slow
def test_estimates_are_the_same_to_the_last_bit(
    small_cell: Path, elsewhere: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("spread", "walk"):
        monkeypatch.setattr(f"cyclekit.estimate.cycle.{module}.ROWS", 12)  # two sequences a task, as with many tracks
    words = ["estimate", small_cell / "model", small_cell / "sequences.toml", "--dataset", small_cell / "dataset"]
    words.append("--no-check")
    here, there = answer(capsys, *words), answer(capsys, *words, *elsewhere)
    assert len(here["sequences"]) == 4
    assert here == there
