"""Bad input: one message that names file, cause and cure, and nothing half-written."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Shell


def empty_folder(path: Path) -> None:
    path.mkdir()


def text_file(path: Path) -> None:
    path.write_text("Monday: robot stood still again.\nTuesday: the same.\n", encoding="utf-8")


def empty_file(path: Path) -> None:
    path.touch()


def lfs_pointer(path: Path) -> None:
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n", encoding="utf-8")


def csv_without_a_time_column(path: Path) -> None:
    path.write_text("x;y;z;grip\n1;2;3;0\n1;2;4;0\n", encoding="utf-8")


BAD_LOGS: list[tuple[Callable[[Path], None], str, str]] = [
    (empty_folder, "holds no file", "cyclekit adapters"),
    (text_file, "no adapter recognises this content", "cyclekit reads"),
    (empty_file, "the file is empty", "Check the copy"),
    (lfs_pointer, "Git LFS pointer", "git lfs pull"),
    (csv_without_a_time_column, "a table that no adapter recognises", "cyclekit inspect"),
]


@pytest.mark.parametrize(("make", "cause", "cure"), BAD_LOGS, ids=lambda value: getattr(value, "__name__", ""))
@pytest.mark.parametrize("command", ["ingest", "inspect"])
def test_a_bad_log_is_refused_with_file_cause_and_cure(
    cyclekit: Shell, tmp_path: Path, command: str, make: Callable[[Path], None], cause: str, cure: str
) -> None:
    path = tmp_path / "run"
    make(path)
    into = ["--out", tmp_path / "dataset"] if command == "ingest" else []
    failed = cyclekit(command, path, *into)
    assert failed.code == 1
    assert failed.err.startswith(f"error: {path}: ")
    assert cause in failed.err
    assert cure in failed.err
    assert failed.err.count("error:") == 1
    assert list(tmp_path.iterdir()) == [path]


def test_a_mapped_csv_without_its_time_column_is_refused_by_the_name_of_the_column(
    cyclekit: Shell, tmp_path: Path
) -> None:
    (tmp_path / "logs").mkdir()
    csv_without_a_time_column(tmp_path / "logs" / "run.csv")
    cell = '[[sources]]\npath = "run.csv"\nadapter = "csv"\nrole = "robot"\n'
    cell += 'map = { delimiter = ";", time = "stamp", time_unit = "s", x = "x", y = "y", z = "z", length_unit = "m" }\n'
    (tmp_path / "logs" / "cell.toml").write_text(cell, encoding="utf-8")
    failed = cyclekit("ingest", tmp_path / "logs", "--out", tmp_path / "dataset")
    assert failed.code == 1
    assert "run.csv" in failed.err
    assert "'stamp'" in failed.err
    assert not (tmp_path / "dataset").exists()


def test_of_a_bag_cut_in_half_the_whole_chunks_are_kept_and_the_loss_is_said(cyclekit: Shell, tmp_path: Path) -> None:
    made = cyclekit("simulate", "box-picking", "--out", tmp_path / "logs", "--executions", "1", "--logs", "mcap")
    assert made.code == 0, made.err
    (bag,) = (tmp_path / "logs").rglob("*.mcap")
    whole = bag.read_bytes()
    bag.write_bytes(whole[: len(whole) // 2])
    kept = cyclekit("ingest", bag, "--out", tmp_path / "dataset")
    assert kept.code == 0, kept.err
    assert kept.err.count("the bag is cut") == 1
    assert bag.name in kept.err
    assert "copy the bag again" in kept.err
    bag.write_bytes(whole[:2000])
    refused = cyclekit("ingest", bag, "--out", tmp_path / "other")
    assert refused.code == 1
    assert refused.err.startswith(f"error: {bag}: ")
    assert not (tmp_path / "other").exists()


def test_a_model_of_another_schema_version_is_refused(
    cyclekit: Shell, tmp_path: Path, dataset: Path, model: Path, sequences: Path
) -> None:
    shutil.copytree(model, tmp_path / "old")
    card = json.loads((tmp_path / "old" / "model.json").read_text(encoding="utf-8"))
    (tmp_path / "old" / "model.json").write_text(json.dumps({**card, "schema_version": 99}), encoding="utf-8")
    failed = cyclekit("estimate", tmp_path / "old", sequences, "--dataset", dataset, "--out", tmp_path / "x.json")
    assert failed.code == 1
    assert "schema version 99" in failed.err
    assert "cyclekit train" in failed.err
    assert not (tmp_path / "x.json").exists()


def test_a_dataset_of_another_schema_version_is_refused(cyclekit: Shell, tmp_path: Path, dataset: Path) -> None:
    shutil.copytree(dataset, tmp_path / "old")
    card = json.loads((tmp_path / "old" / "dataset.json").read_text(encoding="utf-8"))
    (tmp_path / "old" / "dataset.json").write_text(json.dumps({**card, "schema_version": 99}), encoding="utf-8")
    for words in (["inspect", tmp_path / "old"], ["train", tmp_path / "old", "--out", tmp_path / "m"]):
        failed = cyclekit(*words)
        assert failed.code == 1
        assert "schema version 99" in failed.err
    assert not (tmp_path / "m").exists()


def test_a_sequence_with_an_unknown_place_is_refused_with_the_nearest_known_one(
    cyclekit: Shell, tmp_path: Path, dataset: Path, model: Path
) -> None:
    file = tmp_path / "sequences.toml"
    file.write_text('[[sequence]]\nname = "A"\nplaces = ["home", "conveyer", "left_1"]\n', encoding="utf-8")
    failed = cyclekit("estimate", model, file, "--dataset", dataset, "--out", tmp_path / "x.json")
    assert failed.code == 1
    assert "'conveyer'" in failed.err
    assert "the nearest is 'conveyor'" in failed.err
    assert not (tmp_path / "x.json").exists()


def test_logs_are_not_ingested_over_a_folder_that_is_no_dataset(cyclekit: Shell, logs: Path, tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("keep me", encoding="utf-8")
    failed = cyclekit("ingest", logs, "--out", tmp_path)
    assert failed.code == 1
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]
