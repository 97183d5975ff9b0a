"""The tables of many short recordings share files, and nothing but the files shows it."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING, Any

import polars as pl
import pytest
from ingested import only_bytes
from polars.testing import assert_frame_equal

from cyclekit.dataset.cards import plain
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import DatasetError
from cyclekit.ingest.ingest import ingest
from cyclekit.ingest.read import shared_files
from cyclekit.parallel.engine import Engine

if TYPE_CHECKING:
    from pathlib import Path

TRIP = [("stand", 0.3), ("move", 0.4), ("stand", 0.3)]


@pytest.fixture
def short_runs(tmp_path: Path, robot_log: Any) -> Path:
    """Five logs of a second, of which one has no joints."""
    for number in range(5):
        robot_log(tmp_path / "logs" / f"run_{number}.csv", [*TRIP, ("stand", 0.1 * number)])
    joints_gone = pl.read_csv(tmp_path / "logs" / "run_2.csv", separator=" ")
    joints_gone.select(pl.exclude("^actual_q.*$")).write_csv(tmp_path / "logs" / "run_2.csv", separator=" ")
    return tmp_path / "logs"


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the recordings of more than two logs share files, three at a time."""
    monkeypatch.setattr(shared_files, "MAX_SEPARATE_LOGS", 2)
    monkeypatch.setattr(shared_files, "LOGS_PER_BATCH", 3)


@pytest.fixture
def both(short_runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Dataset, Dataset]:
    """The dataset in which each recording has its own files, and that in which they share."""
    ingest([short_runs], tmp_path / "alone")
    monkeypatch.setattr(shared_files, "MAX_SEPARATE_LOGS", 2)
    monkeypatch.setattr(shared_files, "LOGS_PER_BATCH", 3)
    ingest([short_runs], tmp_path / "shared")
    return Dataset.open(tmp_path / "alone"), Dataset.open(tmp_path / "shared")


def test_recordings_that_share_files_are_read_as_they_are_alone(both: tuple[Dataset, Dataset]):
    alone, shared = both
    assert not (shared.path / "recordings").exists()
    assert len(list((shared.path / "shared").glob("robot-*.parquet"))) == 3  # one of other columns
    cards = [json.loads((one.path / CARD).read_text(encoding="utf-8")) for one in both]
    for card in cards:
        del card["files"], card["card_blake3"]
    assert cards[0] == cards[1]
    assert_frame_equal(shared.samples(), alone.samples(), check_exact=True)
    for record in alone.recordings:
        name = record.id
        assert_frame_equal(shared.recorded(name, "robot"), alone.recorded(name, "robot"), check_exact=True)
        within = [one.recorded_between(name, "robot", 0.2, 0.5) for one in both]
        assert_frame_equal(*within, check_exact=True)
        times = [pl.concat(one.times(name, "robot")) for one in both]
        assert_frame_equal(*times, check_exact=True)
        assert shared.recorded(name, "people") is None
    for execution in alone.executions["execution"]:
        rows = [one.native_robot(execution, ["t_s", "tcp_x_m"]) for one in both]
        assert_frame_equal(*rows, check_exact=True)
    assert shared.verify() == alone.verify() - 5 + 3 + 1


def test_a_shared_file_says_whose_its_rows_are(both: tuple[Dataset, Dataset]):
    alone, shared = both
    rows = pl.concat([pl.read_parquet(f) for f in (shared.path / "shared").glob("*.parquet")], how="diagonal")
    counts = {record.id: record.rows["robot"] for record in alone.recordings}
    assert dict(rows.group_by("recording").len().iter_rows()) == counts


def test_of_a_log_that_has_gone_no_row_is_left_and_the_others_are_not_read_again(
    short_runs: Path, tmp_path: Path, few: None, reads: list[str]
):
    out = tmp_path / "dataset"
    ingest([short_runs], out)
    reads.clear()
    (short_runs / "run_1.csv").unlink()
    shutil.copy(short_runs / "run_0.csv", short_runs / "run_9.csv")
    report = ingest([short_runs], out)
    assert reads == ["run_9.csv"]
    assert (report.recordings_new, report.recordings_kept) == (1, 4)
    ingest([short_runs], tmp_path / "afresh")
    assert only_bytes(out) == only_bytes(tmp_path / "afresh")


def test_a_dataset_that_gets_few_logs_gives_each_its_own_files_again(
    short_runs: Path, tmp_path: Path, few: None, reads: list[str]
):
    out = tmp_path / "dataset"
    ingest([short_runs], out)
    reads.clear()
    for number in (2, 3, 4):
        (short_runs / f"run_{number}.csv").unlink()
    ingest([short_runs], out)
    ingest([short_runs], tmp_path / "afresh")
    assert reads == ["run_0.csv", "run_1.csv"]  # by the second one
    assert only_bytes(out) == only_bytes(tmp_path / "afresh")
    assert not (out / "shared").exists()


@pytest.mark.slow
def test_workers_write_the_same_shared_files(short_runs: Path, tmp_path: Path, few: None):
    ingest([short_runs], tmp_path / "here")
    ingest([short_runs], tmp_path / "workers", engine=Engine(jobs=2))
    assert only_bytes(tmp_path / "here") == only_bytes(tmp_path / "workers")


def test_pseudonymised_recordings_share_no_files(short_runs: Path, tmp_path: Path, few: None):
    ingest([short_runs], tmp_path / "dataset", pseudonymise=True)
    dataset = Dataset.open(tmp_path / "dataset")
    assert not (dataset.path / "shared").exists()
    assert all(record.first_s == 0.0 for record in dataset.recordings)


@pytest.mark.parametrize("name", ["index.json", "robot-00000-0.parquet"])
def test_a_flipped_bit_in_a_shared_file_is_refused_and_made_anew(
    both: tuple[Dataset, Dataset], name: str, short_runs: Path
):
    shared = both[1]
    file = shared.path / "shared" / name
    whole = file.read_bytes()
    file.write_bytes(bytes([*whole[:100], whole[100] ^ 1, *whole[101:]]))
    with pytest.raises(DatasetError, match=f"{name}: damaged"):
        shared.recorded("run_0", "robot")
    ingest([short_runs], shared.path)
    assert file.read_bytes() == whole


@pytest.mark.parametrize("where", [["shared/robot-00000-0.parquet", 0, 99], ["../other.parquet", 0, 126]])
def test_an_index_that_means_other_rows_or_files_is_refused(both: tuple[Dataset, Dataset], where: list[Any]):
    path = both[1].path
    index = json.loads((path / "shared" / "index.json").read_text())
    index["run_0"]["robot"] = where
    (path / "shared" / "index.json").write_text(json.dumps(index))
    card = {key: value for key, value in plain(Dataset.open(path).card).items() if key not in ("files", "card_blake3")}
    (path / CARD).write_text(json.dumps(card))
    with pytest.raises(DatasetError, match=r"the index states 99 rows of run_0|robot\.parquet"):
        list(Dataset.open(path).times("run_0", "robot"))


EPOCH_S = 1_791_172_800.0


def test_a_tracker_file_of_the_day_is_beside_each_robot_log_of_that_day(tmp_path: Path, robot_log: Any):
    """Names and folders do not tell which belong together, the times since 1970 do; each has the people of its time."""
    logs = tmp_path / "logs"
    (logs / "robot").mkdir(parents=True)
    (logs / "tracker").mkdir()
    for number in range(2):
        path = logs / "robot" / f"shift_{number}.csv"
        robot_log(path, TRIP * 20)
        table = pl.read_csv(path, separator=" ")
        later = pl.col("timestamp") - table["timestamp"][0] + EPOCH_S + 300.0 * number
        table.with_columns(later).write_csv(path, separator=" ")
    rows = [f"{1000 * EPOCH_S + 100 * i:.0f},7,{1.0 + 0.002 * i:.3f},0.5" for i in range(4000)]
    (logs / "tracker" / "people.csv").write_text("\n".join(["epoch_ms,track_id,x,y", *rows, ""]), encoding="utf-8")
    map_ = 'time = "epoch_ms"\nclock = "epoch"\ntime_unit = "ms"\nx = "x"\ny = "y"\nperson = "track_id"'
    source = f'[[sources]]\npath = "tracker/*.csv"\nadapter = "csv"\nrole = "people"\n[sources.map]\n{map_}\n'
    (logs / "cell.toml").write_text(source, encoding="utf-8")
    ingest([logs], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    sessions = [{"session": one.session, "tables": one.tables, "rows": one.rows} for one in dataset.recordings]
    people = {one["session"]: one["rows"]["people"] for one in sessions if one["tables"] == ("people",)}
    robots = {one["session"] for one in sessions if one["tables"] == ("robot",)}
    assert len(robots) == 2
    assert set(people) == robots
    assert sorted(people.values()) == [1330, 4000]  # of the second, what lies within a minute of its 13 s
    seen = dataset.samples().group_by("execution").agg(pl.col("human_x_m").is_not_null().mean())
    assert seen["human_x_m"].to_numpy().min() > 0.9
    ingest([logs], tmp_path / "dataset")  # nothing changed: what it took over lies where it was
    assert Dataset.open(tmp_path / "dataset").samples().equals(dataset.samples())
