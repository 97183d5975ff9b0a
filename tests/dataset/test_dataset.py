"""The dataset: read by anybody, refused when foreign, and never half-written."""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
import pytest

from cyclekit import schema
from cyclekit.dataset import row_counts
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import CyclekitError, DatasetError, UnknownName
from cyclekit.ingest.ingest import ingest
from cyclekit.storage.atomic import clean_up, staged, write_text

if TYPE_CHECKING:
    from simulated_cells import SimulatedCell

CONTRACT = [
    *("execution", "t_s", "robot_x_m", "robot_y_m", "robot_z_m", "human_x_m", "human_y_m", "human_z_m"),
    *("robot_goal_x_m", "robot_goal_y_m", "robot_goal_z_m", "human_goal_x_m", "human_goal_y_m", "human_goal_z_m"),
    *("scaling", "scaling_origin", "scaling_sd", "scaling_gap", "slider", "step"),
    *("robot_task", "human_task", "robot_moving", "human_gap", "lost_to", "human_signals"),
]

BARE = {
    **{"schema_version": schema.SCHEMA_VERSION, "name": "bare", "rows": {"samples": 0, "tasks": 0}},
    **{"recordings": [], "executions": [], "places": {}, "human_places": {}, "levels": []},
}
"""The least that a dataset's card says."""


@pytest.fixture
def copied(boxes: SimulatedCell, tmp_path: Path) -> Path:
    return Path(shutil.copytree(boxes.dataset.path, tmp_path / "dataset"))


def changed_card(folder: Path, **changes: Any) -> None:
    card = json.loads((folder / "dataset.json").read_text(encoding="utf-8"))
    (folder / "dataset.json").write_text(json.dumps(card | changes), encoding="utf-8")


def test_polars_pandas_and_duckdb_read_the_samples_with_the_columns_of_the_contract(boxes: SimulatedCell):
    import duckdb  # here, as every process that collects the tests would import them
    import pandas as pd

    files = str(boxes.dataset.path / "samples" / "*.parquet")
    lazily = pl.scan_parquet(files).collect()
    by_pandas = pd.concat(pd.read_parquet(file) for file in sorted((boxes.dataset.path / "samples").iterdir()))
    by_duckdb = duckdb.sql(f"select * from '{files}'")
    assert lazily.columns == list(by_pandas.columns) == list(by_duckdb.columns) == CONTRACT
    assert lazily.height == len(by_pandas) == len(by_duckdb) == boxes.dataset.card.rows.samples
    assert lazily.schema == pl.Schema({name: column.dtype for name, column in schema.SAMPLES.items()})


def test_tasks_and_recordings_are_plain_tables_too(boxes: SimulatedCell):
    import duckdb
    import pandas as pd

    folder = boxes.dataset.path
    tasks = pd.read_parquet(folder / "tasks.parquet")
    assert list(tasks.columns) == list(schema.TASKS)
    robot = duckdb.sql(f"select count(*) from '{folder / 'recordings' / 'session_000.robot' / 'robot.parquet'}'")
    assert robot.fetchall() == [(boxes.dataset.recordings[2].rows["robot"],)]
    assert [entry.id for entry in boxes.dataset.recordings][2] == "session_000.robot"


def test_samples_come_ten_a_second_from_the_start_of_each_execution_on_rows_of_the_robot_log(boxes: SimulatedCell):
    for row in boxes.dataset.executions.iter_rows(named=True):
        t = boxes.dataset.samples([row["execution"]])["t_s"]
        assert t[0] == pytest.approx(row["start_s"])
        assert (t - t[0] - pl.int_range(len(t), eager=True) / 10).abs().max() <= 0.008
        assert 0 <= row["end_s"] - t[-1] < 0.1 + 0.008
        native = boxes.dataset.native_robot(row["execution"])
        assert native is not None
        assert t.is_in(native["t_s"].implode()).all()


def test_an_execution_is_found_by_its_name_and_by_its_number(boxes: SimulatedCell):
    names = boxes.dataset.executions["execution"].to_list()
    assert boxes.dataset.find_execution("2") == names[1]
    assert boxes.dataset.find_execution(names[2]) == names[2]
    for wrong in ("0", "99", "session_000.0003"):
        with pytest.raises(UnknownName, match=r"number from 1 to 4") as caught:
            boxes.dataset.find_execution(wrong)
    assert caught.value.nearest == names[2]


def test_the_samples_of_some_executions_are_theirs_alone(boxes: SimulatedCell):
    names = boxes.dataset.executions["execution"].to_list()
    assert boxes.dataset.samples([names[1]])["execution"].unique().to_list() == [names[1]]
    with pytest.raises(UnknownName):
        boxes.dataset.samples(["no such execution"])


def test_of_the_samples_only_the_columns_asked_for_are_read(boxes: SimulatedCell, tmp_path: Path):
    asked, whole = ["scaling", "t_s"], boxes.dataset.samples()
    names = boxes.dataset.executions["execution"].to_list()[1:3]
    assert boxes.dataset.samples(columns=asked).equals(whole.select(asked))
    assert boxes.dataset.samples(names, asked).equals(boxes.dataset.samples(names).select(asked))
    empty = Path(shutil.copytree(boxes.dataset.path, tmp_path / "empty"))
    shutil.rmtree(empty / "samples")
    changed_card(empty, files={})
    assert Dataset.open(empty).samples(columns=asked).schema == whole.select(asked).schema


def test_the_native_rows_of_an_execution_lie_within_it_at_the_rate_of_the_controller(boxes: SimulatedCell):
    row = boxes.dataset.executions.row(1, named=True)
    native = boxes.dataset.native_robot(row["execution"])
    assert native is not None
    assert native["t_s"].min() >= row["start_s"]  # type: ignore[operator]
    assert native["t_s"].max() <= row["end_s"]  # type: ignore[operator]
    assert native.height == pytest.approx(row["duration_s"] * 125, abs=2)


def test_further_columns_of_the_native_rows_are_read_where_the_log_has_them(boxes: SimulatedCell):
    name = boxes.dataset.executions["execution"][1]
    native = boxes.dataset.native_robot(name)
    some = boxes.dataset.native_robot(name, ["t_s"], if_there=["q5_rad", "q6_rad"])
    assert native is not None
    assert some is not None
    assert some.equals(native.select("t_s", "q5_rad"))  # the arm has six joints


def test_a_folder_that_is_no_dataset_is_refused_with_the_command_that_makes_one(tmp_path: Path):
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(DatasetError, match="cyclekit ingest"):
            Dataset.open(folder)


@pytest.mark.parametrize("version", [0, schema.SCHEMA_VERSION + 1, str(schema.SCHEMA_VERSION)])
def test_a_dataset_of_another_schema_version_is_refused(copied: Path, version: object):
    changed_card(copied, schema_version=version)
    with pytest.raises(
        DatasetError, match=f"schema version {version}, this cyclekit reads version {schema.SCHEMA_VERSION}"
    ):
        Dataset.open(copied)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", "3"])
def test_a_card_that_is_no_card_is_refused(copied: Path, text: str):
    (copied / "dataset.json").write_text(text, encoding="utf-8")
    with pytest.raises(DatasetError, match=r"dataset\.json: not a dataset card"):
        Dataset.open(copied)


def test_a_dataset_is_opened_and_replaced_from_within_its_own_folder(
    boxes: SimulatedCell, copied: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(copied)
    assert Dataset.open(".").executions.height == 4
    assert ingest([boxes.logs], ".").unchanged


def test_what_is_built_takes_the_place_of_the_old_as_a_whole(copied: Path):
    with staged(copied) as folder:
        write_text(folder / "dataset.json", json.dumps(BARE))
        assert Dataset.open(copied).executions.height == 4
    assert [file.name for file in copied.iterdir()] == ["dataset.json"]
    assert [file.name for file in copied.parent.iterdir()] == ["dataset"]


def test_work_that_fails_leaves_the_old_dataset_and_nothing_else(copied: Path):
    def fail() -> None:
        with staged(copied) as folder:
            write_text(folder / "dataset.json", "{}")
            raise ValueError("in the middle")

    with pytest.raises(ValueError, match="in the middle"):
        fail()
    assert Dataset.open(copied).executions.height == 4
    assert [file.name for file in copied.parent.iterdir()] == ["dataset"]


def test_a_full_disk_is_told_as_such(copied: Path):
    with pytest.raises(CyclekitError, match=r"cannot be written \(No space left on device\)"), staged(copied):
        raise OSError(28, "No space left on device")
    assert Dataset.open(copied).executions.height == 4


def test_what_a_killed_ingest_left_is_swept_by_the_next(boxes: SimulatedCell, tmp_path: Path):
    orphan = tmp_path / ".dataset.new-1-abc"
    orphan.mkdir()
    (orphan / "half.parquet").write_bytes(b"PAR1")
    with staged(tmp_path / "dataset") as folder:
        assert list(folder.iterdir()) == []
    assert [file.name for file in tmp_path.iterdir()] == ["dataset"]


def test_a_process_killed_between_the_two_renames_has_finished_all_the_same(copied: Path):
    finished = Path(shutil.copytree(copied, copied.with_name(".dataset.new-1-abc")))
    changed_card(finished, name="the new one")
    (finished / ".complete").touch()
    copied.rename(copied.with_name(".dataset.old-1-abc"))
    assert Dataset.open(copied).card.name == "the new one"
    assert not copied.with_name(".dataset.new-1-abc").exists()
    clean_up(copied)  # as the next ingest does
    assert [file.name for file in copied.parent.iterdir()] == ["dataset"]


def test_a_process_killed_before_the_first_rename_is_finished_by_the_next_ingest_not_by_a_reader(copied: Path):
    finished = Path(shutil.copytree(copied, copied.with_name(".dataset.new-1-abc")))
    changed_card(finished, name="the new one")
    (finished / ".complete").touch()
    assert Dataset.open(copied).card.name == "box-picking"
    clean_up(copied)
    assert Dataset.open(copied).card.name == "the new one"
    assert [file.name for file in copied.parent.iterdir()] == ["dataset"]
    assert not (copied / ".complete").exists()


REPLACE_FOREVER = """
import sys
from pathlib import Path
from cyclekit.storage.atomic import staged, write_text

print("begun", flush=True)
while True:
    with staged(Path(sys.argv[1])) as folder:
        write_text(folder / "dataset.json", sys.argv[2])
"""


def test_a_reader_beside_a_running_ingest_always_finds_a_dataset(copied: Path):
    words = [sys.executable, "-c", REPLACE_FOREVER, str(copied), json.dumps(BARE)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as writer:
        try:
            assert writer.stdout is not None
            writer.stdout.readline()
            for _ in range(300):
                assert Dataset.open(copied).card.schema_version == schema.SCHEMA_VERSION
            assert writer.poll() is None
        finally:
            writer.kill()


def test_a_dataset_replaced_between_its_card_and_its_tables_is_read_anew(copied: Path, monkeypatch: pytest.MonkeyPatch):
    regular = row_counts.regular

    def replaced_first(file: Path) -> Path:
        monkeypatch.setattr(row_counts, "regular", regular)
        with staged(copied) as folder:
            write_text(folder / "dataset.json", json.dumps(BARE))
        return regular(file)

    monkeypatch.setattr(row_counts, "regular", replaced_first)
    assert Dataset.open(copied).card.name == "bare"


def test_a_process_killed_before_it_was_done_leaves_the_old_dataset(copied: Path):
    shutil.copytree(copied, copied.with_name(".dataset.new-1-abc"))
    copied.rename(copied.with_name(".dataset.old-1-abc"))
    assert Dataset.open(copied).executions.height == 4


@pytest.mark.skipif(os.name == "nt", reason="making links needs rights on Windows")
def test_a_dataset_behind_a_link_is_replaced_where_it_lies(boxes: SimulatedCell, copied: Path, tmp_path: Path):
    link = tmp_path / "link"
    link.symlink_to(copied)
    with staged(link) as folder:
        write_text(folder / "dataset.json", json.dumps(BARE))
    assert link.is_symlink()
    assert [file.name for file in copied.iterdir()] == ["dataset.json"]


INGEST_FOREVER = """
import sys
from itertools import cycle
from pathlib import Path
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest

root = Path(sys.argv[1])
dataset = Dataset.open(root / "dataset")
assert dataset.samples().height == dataset.card.rows.samples > 0
assert dataset.tasks().height == dataset.card.rows.tasks > 0
for entry in dataset.recordings:
    for table in entry.tables:
        assert dataset.recorded(entry.id, table).height == entry.rows[table]
print(dataset.card.name, flush=True)
for name in cycle(["b", "a"] if dataset.card.name == "a" else ["a", "b"]):
    ingest([root / name], root / "dataset")
"""


@pytest.mark.slow
def test_an_ingest_killed_at_any_moment_leaves_the_old_dataset_or_the_new_one(tmp_path: Path, robot_log: Any):
    round_trip = [("stand", 0.4), ("move", 0.3), ("stand", 0.4), ("move", 0.0), ("stand", 0.4)]
    for name in "ab":
        for number in range(3 if name == "a" else 2):
            robot_log(tmp_path / name / f"run_{number}.csv", round_trip)
    begin = time.perf_counter()
    ingest([tmp_path / "a"], tmp_path / "dataset")
    longest_s = max(0.3, 2 * (time.perf_counter() - begin))
    when, seen, caught_at_work, most_s = random.Random(7), [], 0, 8 * longest_s
    while len(seen) < 10 or ((caught_at_work < 3 or len(set(seen)) < 2) and len(seen) < 150):
        longest_s = min(1.05 * longest_s, most_s)  # on a busy machine too some ingest comes to its end
        with subprocess.Popen([sys.executable, "-c", INGEST_FOREVER, str(tmp_path)], stdout=subprocess.PIPE) as child:
            assert child.stdout is not None
            seen.append(child.stdout.readline().decode().strip())
            time.sleep(when.uniform(0.0, longest_s))
            child.kill()
        caught_at_work += any(tmp_path.glob(".dataset.*-*"))
    seen.append(Dataset.open(tmp_path / "dataset").card.name)
    assert set(seen) == {"a", "b"}  # every child found a whole dataset, of the one kind or the other
    assert caught_at_work >= 3  # and the kills did hit ingests that were under way
