"""What a pseudonymised dataset holds, and what it does not."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from tracker_logs import kinect2, ur_rtde

from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError
from cyclekit.ingest.ingest import ingest


@pytest.fixture
def mapped(tmp_path: Path) -> Path:
    """A robot log and a tracker's log in epoch time, a person's name in it, and a date in a file name."""
    folder = tmp_path / "named"
    folder.mkdir()
    t = np.arange(400) / 20
    epoch = 1_700_000_000.0
    x = [0.0 if int(s) % 4 < 2 else 0.3 for s in t]
    pl.DataFrame({"t": epoch + t, "x": x, "y": 0.0 * t}).write_csv(folder / "robot.csv")
    people = pl.DataFrame({"t": epoch + 0.5 + t, "id": ["Subject"] * 400, "x": 1 + 0.01 * t, "y": 0.0 * t})
    people.write_csv(folder / "people_2023-11-14.csv")
    (folder / "cell.toml").write_text(
        '[[sources]]\npath = "robot.csv"\nadapter = "csv"\nrole = "robot"\n'
        'map = { time = "t", x = "x", y = "y", clock = "epoch" }\n'
        '[[sources]]\npath = "people*.csv"\nadapter = "csv"\nrole = "people"\n'
        'map = { time = "t", x = "x", y = "y", person = "id", clock = "epoch" }\n',
        encoding="utf-8",
    )
    return folder


def test_a_pseudonymised_dataset_holds_neither_names_nor_the_date_and_the_same_samples(mapped: Path, tmp_path: Path):
    plain = Dataset.open(ingest([mapped], tmp_path / "plain").dataset)
    report = ingest([mapped], tmp_path / "hidden", pseudonymise=True)
    hidden = Dataset.open(report.dataset)
    away, there = hidden.samples(), plain.samples()
    numbers = [name for name, dtype in there.schema.items() if dtype.is_float()]
    for name in numbers:
        assert np.allclose(away[name].fill_null(-9), there[name].fill_null(-9), atol=1e-6), name
    for entry in hidden.recordings:
        for table in entry.tables:
            frame = hidden.recorded(entry.id, table)
            assert frame["t_s"].min() == 0.0
            assert "person" not in frame.columns or set(frame["person"]) == {"person_1"}
    card = (hidden.path / "dataset.json").read_text(encoding="utf-8")
    assert "Subject" not in card
    assert "17000000" not in card
    assert "2023-11-14" not in card
    assert set(plain.recorded("people_2023-11-14", "people")["person"]) == {"Subject"}


def test_native_rows_of_a_pseudonymised_execution_lie_in_its_time(mapped: Path, tmp_path: Path):
    hidden = Dataset.open(ingest([mapped], tmp_path / "hidden", pseudonymise=True).dataset)
    for row in hidden.executions.iter_rows(named=True):
        native = hidden.native_robot(row["execution"])
        assert native.height > 0
        assert native["t_s"].min() == pytest.approx(row["start_s"], abs=0.06)


def test_names_come_back_only_from_the_logs(mapped: Path, tmp_path: Path):
    out = tmp_path / "dataset"
    ingest([mapped], out, pseudonymise=True)
    assert ingest([mapped], out, pseudonymise=True).unchanged
    again = ingest([mapped], out)
    assert (again.unchanged, again.recordings_new) == (False, 2)
    assert json.loads((out / "dataset.json").read_text(encoding="utf-8"))["pseudonymised"] is False
    assert ingest([mapped], out, pseudonymise=True).recordings_new == 2


def codes(logs: Path, out: Path) -> set[str]:
    """The codes of the words in a pseudonymised dataset of task lists."""
    data = Dataset.open(ingest([logs], out, pseudonymise=True).dataset)
    return {word for task in data.every_task()["task"] for word in task.split() if word.startswith("word_")}


def test_words_keep_their_codes_while_the_key_beside_the_dataset_is_kept(tmp_path: Path):
    (tmp_path / "logs").mkdir()
    for number, name in enumerate(("Kowalski", "Nowak")):
        rows = [f"{run};ur5;weld {name};{run * 9};{run * 9 + 5}" for run in range(3)]
        file = tmp_path / "logs" / f"list_{number}.csv"
        file.write_text("\n".join(["run;agent;task;start_s;end_s", *rows, ""]), encoding="utf-8")
        if not number:
            first = codes(tmp_path / "logs", tmp_path / "d")
    key = tmp_path / "d.key"
    assert os.name == "nt" or key.stat().st_mode & 0o77 == 0
    secret = key.read_bytes().strip()
    assert not [file for file in (tmp_path / "d").rglob("*") if file.is_file() and secret in file.read_bytes()]
    more = codes(tmp_path / "logs", tmp_path / "d")
    assert len(first) == 1
    assert len(more) == 2
    assert first < more
    key.write_text("forgotten", encoding="utf-8")
    (tmp_path / "logs" / "list_0.csv").unlink()
    with pytest.raises(ConfigError, match=r"d\.key: is no key"):
        codes(tmp_path / "logs", tmp_path / "d")
    key.unlink()
    assert codes(tmp_path / "logs", tmp_path / "d").isdisjoint(more)
    assert not codes(tmp_path / "logs", tmp_path / "other").issubset(more)


@pytest.mark.parametrize("pseudonymise", [False, True])
def test_joints_are_kept_on_request_only_and_under_no_other_name(tmp_path: Path, *, pseudonymise: bool):
    for write in (ur_rtde, kinect2):
        (tmp_path / "logs" / write.__name__).mkdir(parents=True)
        write(tmp_path / "logs" / write.__name__, 300)
    plain = ingest([tmp_path / "logs"], tmp_path / "plain", pseudonymise=pseudonymise)
    assert not list(Path(plain.dataset).rglob("skeletons.parquet"))
    joints = ingest([tmp_path / "logs"], tmp_path / "joints", pseudonymise=pseudonymise, keep_skeletons=True)
    (file,) = Path(joints.dataset).rglob("skeletons.parquet")
    table, people = pl.read_parquet(file), pl.read_parquet(file.with_name("people.parquet"))
    assert table["joint"].n_unique() == 25
    assert set(table["person"]) == set(people["person"]) == {f"person_{n}" if pseudonymise else f"{n}" for n in (1, 2)}
