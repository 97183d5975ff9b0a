"""Logs become a dataset: each log once, the same bytes again, good logs in spite of bad ones, one message per fault."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
import pytest
from blake3 import blake3
from ingested import ROUND_TRIP, bytes_and_times, only_bytes

from cyclekit.config import Cell, Executions, Source
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, CyclekitError, LogError, OutputError, UnknownFormat, UnknownName
from cyclekit.ingest.ingest import ingest
from cyclekit.parallel.engine import Engine

if TYPE_CHECKING:
    from simulated_cells import Cells

WALK = [(1.0 + 0.01 * i, 2.0, 0.2) for i in range(150)]


def test_the_same_ingest_again_changes_nothing_and_reads_nothing(three_runs: Path, tmp_path: Path, reads: list[str]):
    out = tmp_path / "dataset"
    first = ingest([three_runs], out)
    before = bytes_and_times(out)
    assert (first.recordings_new, first.recordings_kept, first.unchanged) == (3, 0, False)
    assert sorted(reads) == ["run_0.csv", "run_1.csv", "run_2.csv"]
    reads.clear()
    again = ingest([three_runs], out)
    assert (again.recordings_new, again.recordings_kept, again.unchanged) == (0, 3, True)
    assert (again.executions, again.tasks, again.samples) == (first.executions, first.tasks, first.samples)
    assert bytes_and_times(out) == before
    assert reads == []


def test_one_changed_log_is_the_only_one_read_again(three_runs: Path, tmp_path: Path, reads: list[str], robot_log: Any):
    out = tmp_path / "dataset"
    ingest([three_runs], out)
    before = only_bytes(out)
    reads.clear()
    robot_log(three_runs / "run_1.csv", [*ROUND_TRIP, ("move", 0.3), ("stand", 1.0)])
    report = ingest([three_runs], out)
    assert reads == ["run_1.csv"]
    assert (report.recordings_new, report.recordings_kept) == (1, 2)
    after = only_bytes(out)
    assert after["recordings/run_0/robot.parquet"] == before["recordings/run_0/robot.parquet"]
    assert after["recordings/run_1/robot.parquet"] != before["recordings/run_1/robot.parquet"]
    assert only_bytes(Path(ingest([three_runs], tmp_path / "afresh").dataset)) == after


def test_a_log_more_or_less_changes_only_what_is_its_own(three_runs: Path, tmp_path: Path, reads: list[str]):
    out = tmp_path / "dataset"
    ingest([three_runs], out)
    reads.clear()
    (three_runs / "run_2.csv").rename(tmp_path / "run_2.csv")
    assert ingest([three_runs], out).recordings_kept == 2
    assert not (out / "recordings" / "run_2").exists()
    (tmp_path / "run_2.csv").rename(three_runs / "run_2.csv")
    assert ingest([three_runs], out).recordings_new == 1
    assert reads == ["run_2.csv"]


def test_recordings_that_somebody_deleted_are_read_again(three_runs: Path, tmp_path: Path, robot_log: Any):
    out = tmp_path / "dataset"
    ingest([three_runs], out)
    whole = only_bytes(out)
    shutil.rmtree(out / "recordings" / "run_0")
    extra = robot_log(three_runs / "run_3.csv", ROUND_TRIP)
    ingest([three_runs], out)
    extra.unlink()
    ingest([three_runs], out)
    assert only_bytes(out) == whole


@pytest.mark.slow
def test_two_jobs_write_the_same_bytes_as_one(three_runs: Path, tmp_path: Path):
    (three_runs / "broken.csv").write_text("timestamp actual_TCP_pose_0\n", encoding="utf-8")
    one = ingest([three_runs], tmp_path / "one")
    two = ingest([three_runs], tmp_path / "two", engine=Engine(jobs=2))
    assert only_bytes(one.dataset) == only_bytes(two.dataset)
    assert one.not_read == two.not_read


def test_a_broken_log_among_good_ones_is_named_and_the_good_ones_are_in(three_runs: Path, tmp_path: Path):
    (three_runs / "cut.csv").write_text("timestamp actual_qd_0 actual_TCP_pose_0\n0.0 0.1 0.2\n", encoding="utf-8")
    (three_runs / "notes.txt").write_text("the gripper squeaks", encoding="utf-8")
    report = ingest([three_runs], tmp_path / "dataset")
    assert sorted(path for path, _ in report.not_read) == ["cut.csv", "notes.txt"]
    assert report.recordings_new == 3
    recordings = sorted(folder.name for folder in (tmp_path / "dataset" / "recordings").iterdir())
    assert recordings == ["run_0", "run_1", "run_2"]
    assert ingest([three_runs], tmp_path / "dataset").unchanged


def test_a_copy_of_a_log_is_named(tmp_path: Path, robot_log: Any):
    for run in ("a", "b"):
        robot_log(tmp_path / run / "robot.csv", [*ROUND_TRIP, ("stand", 1.0 if run == "a" else 1.5)])
    shutil.copytree(tmp_path / "a", tmp_path / "a (copy)")
    folders = [tmp_path / name for name in ("a", "b", "a (copy)")]
    said = {len(logs): " ".join(ingest(logs, tmp_path / f"{len(logs)}").warnings) for logs in (folders[:2], folders)}
    assert "copies" not in said[2]
    assert "1 log(s) are copies of others" in said[3]


def test_a_log_of_a_header_alone_leaves_no_trace(three_runs: Path, tmp_path: Path):
    head = (three_runs / "run_0.csv").read_text(encoding="utf-8").splitlines()[0]
    (three_runs / "header.csv").write_text(head + "\n", encoding="utf-8")
    report = ingest([three_runs], tmp_path / "dataset")
    assert [path for path, _ in report.not_read] == ["header.csv"]
    assert not (tmp_path / "dataset" / "recordings" / "header").exists()


def test_a_cell_file_in_place_of_logs_is_named_as_one(tmp_path):
    (tmp_path / "cell.toml").write_text("", "utf-8")
    with pytest.raises(LogError, match="is a cell file, and no log") as caught:
        ingest([tmp_path / "cell.toml"], tmp_path / "dataset")
    assert "--cell" in str(caught.value.cure)


def test_an_empty_folder_is_refused(tmp_path: Path):
    (tmp_path / "logs").mkdir()
    with pytest.raises(LogError, match="holds no file"):
        ingest([tmp_path / "logs"], tmp_path / "dataset")
    assert not (tmp_path / "dataset").exists()


def test_a_path_that_is_not_there_is_refused(tmp_path: Path):
    with pytest.raises(LogError, match="no such file or folder"):
        ingest([tmp_path / "nowhere"], tmp_path / "dataset")


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (b'{"people":[{"pose_keypoints_2d":[1,2,0.9,3,4,0.8]}],"version":1.3}', "JSON that no adapter"),
        (b"the gripper squeaks\nand the belt slips\n", "no adapter recognises this content"),
        (b"", "the file is empty"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "Git LFS pointer"),
    ],
)
@pytest.mark.parametrize("alone", [True, False])
def test_a_file_that_is_no_log_is_refused_with_its_name_and_a_cure(
    tmp_path: Path, content: bytes, cause: str, alone: bool
):
    (tmp_path / "logs").mkdir()
    log = tmp_path / "logs" / "run.csv"
    log.write_bytes(content)
    with pytest.raises(UnknownFormat, match=cause) as caught:
        ingest([log if alone else log.parent], tmp_path / "dataset")
    assert str(log) in caught.value.seen
    assert caught.value.cure
    assert [file.name for file in tmp_path.iterdir()] == ["logs"]


def test_a_table_that_no_adapter_knows_is_named_with_the_way_to_map_it(three_runs: Path, tmp_path: Path):
    (three_runs / "tracker.csv").write_text("zeit;links;oben\n0.0;1.0;2.0\n0.1;1.1;2.1\n", encoding="utf-8")
    (three_runs / "notes.txt").write_text("first, the gripper squeaks\nand the belt slips\n", encoding="utf-8")
    reasons = dict(ingest([three_runs], tmp_path / "dataset").not_read)
    assert 'map its columns in cell.toml, with adapter = "csv"' in reasons["tracker.csv"]
    assert "map" not in reasons["notes.txt"]


def test_a_dataset_given_for_logs_is_called_one(three_runs: Path, tmp_path: Path):
    ingest([three_runs], tmp_path / "dataset")
    with pytest.raises(LogError, match="is a dataset, and no log"):
        ingest([tmp_path / "dataset"], tmp_path / "other")


def test_the_logs_cannot_be_the_dataset(three_runs: Path):
    before = only_bytes(three_runs)
    with pytest.raises(OutputError, match="is an input"):
        ingest([three_runs], three_runs)
    assert only_bytes(three_runs) == before


def test_a_folder_with_other_things_in_it_is_not_replaced(three_runs: Path, tmp_path: Path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter_1.tex").write_text("In the beginning", encoding="utf-8")
    with pytest.raises(OutputError, match="is not replaced"):
        ingest([three_runs], tmp_path / "thesis")
    with pytest.raises(OutputError, match="is not replaced"):
        ingest([three_runs], tmp_path / "thesis" / "chapter_1.tex")
    assert [file.name for file in (tmp_path / "thesis").iterdir()] == ["chapter_1.tex"]


@pytest.mark.skipif(os.name == "nt" or getattr(os, "geteuid", lambda: 1)() == 0, reason="root may write anywhere")
def test_a_place_where_nothing_can_be_written_is_told(three_runs: Path, tmp_path: Path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(CyclekitError, match="cannot be written"):
        ingest([three_runs], tmp_path / "locked" / "dataset")


def test_a_dataset_is_not_put_into_the_folder_of_the_logs_and_one_that_lies_there_is_no_log(
    three_runs: Path, tmp_path: Path
):
    with pytest.raises(OutputError, match="lies in the input"):
        ingest([three_runs], three_runs / "dataset")
    ingest([three_runs], tmp_path / "dataset").dataset.rename(three_runs / "dataset")
    again = ingest([three_runs], tmp_path / "dataset")
    assert again.recordings_new == 3
    assert again.not_read == ()


def test_a_dataset_of_another_version_is_read_anew(three_runs: Path, tmp_path: Path):
    out = ingest([three_runs], tmp_path / "dataset").dataset
    whole = only_bytes(out)
    card = json.loads((out / "dataset.json").read_text(encoding="utf-8"))
    (out / "dataset.json").write_text(json.dumps(card | {"schema_version": 0}), encoding="utf-8")
    report = ingest([three_runs], out)
    assert (report.recordings_new, report.recordings_kept) == (3, 0)
    assert only_bytes(out) == whole


def test_provenance_tells_every_file_by_its_checksum_and_its_rows(three_runs: Path, tmp_path: Path):
    out = ingest([three_runs], tmp_path / "dataset").dataset
    for entry in Dataset.open(out).recordings:
        (source,) = entry.sources
        log = three_runs / source.path
        assert source.blake3 == blake3(log.read_bytes()).hexdigest()
        assert source.size == log.stat().st_size
        rows = len(log.read_text(encoding="utf-8").splitlines()) - 1
        assert entry.rows_read == entry.rows["robot"] == rows
        assert (entry.adapter, entry.adapter_package) == ("ur-rtde", "cyclekit")
        assert entry.rate_hz == pytest.approx(125.0, abs=0.01)
    assert str(tmp_path) not in (out / "dataset.json").read_text(encoding="utf-8")


def test_the_cell_file_beside_the_logs_is_followed(three_runs: Path, tmp_path: Path):
    (three_runs / "cell.toml").write_text('name = "press 2"\n[places.here]\nxyz_m = [0.3, 0, 0]', encoding="utf-8")
    found = Dataset.open(ingest([three_runs], tmp_path / "dataset").dataset)
    assert found.card.name == "press 2"
    assert set(found.places) == {"here", "place_1"}
    assert not found.places["here"].inferred
    beside_a_file = Dataset.open(ingest([three_runs / "run_0.csv"], tmp_path / "other").dataset)
    assert beside_a_file.card.name == "press 2"


def test_another_cell_file_gives_other_samples_out_of_the_same_readings(
    three_runs: Path, tmp_path: Path, reads: list[str]
):
    out = tmp_path / "dataset"
    ingest([three_runs], out, cell=Cell(name="a"))
    reads.clear()
    report = ingest([three_runs], out, cell=Cell(name="a", rate_hz=20.0))
    assert (report.recordings_kept, reads) == (3, [])
    dense = Dataset.open(out).samples()
    assert dense["t_s"].diff().median() == pytest.approx(0.05, abs=0.008)


def test_a_forced_adapter_that_does_not_exist_is_refused_with_the_nearest(three_runs: Path, tmp_path: Path):
    with pytest.raises(UnknownName) as caught:
        ingest([three_runs], tmp_path / "dataset", cell=Cell(sources=(Source("*.csv", adapter="ur-rdte"),)))
    assert caught.value.nearest == "ur-rtde"


def test_a_log_with_brackets_in_its_name_is_a_log_like_any_other(tmp_path: Path, robot_log: Any):
    for name in ("run[a].csv", "run[b].csv", "run a (2).csv"):
        robot_log(tmp_path / "logs[1]" / name, ROUND_TRIP)
    found = Dataset.open(ingest([tmp_path / "logs[1]"], tmp_path / "data[1]").dataset)
    assert found.executions.height == 3
    assert found.samples().height == found.card.rows.samples
    assert found.recorded(found.recordings[0].id, "robot") is not None


def test_a_robot_and_its_tracker_in_one_folder_are_one_session(tmp_path: Path, robot_log: Any, motive_log: Any):
    robot_log(tmp_path / "logs" / "robot.csv", ROUND_TRIP)
    motive_log(tmp_path / "logs" / "operator.csv", WALK)
    found = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "dataset").dataset)
    assert {entry.session for entry in found.recordings} == {found.executions["session"][0]}
    assert found.samples()["human_x_m"].null_count() == 0
    assert any("a common start is assumed" in text for entry in found.recordings for text in entry.said)


def test_sessions_in_folders_of_their_own_keep_apart(tmp_path: Path, robot_log: Any, motive_log: Any):
    for number, day in enumerate(("monday", "tuesday")):
        robot_log(tmp_path / "logs" / day / "robot.csv", ROUND_TRIP)
        motive_log(tmp_path / "logs" / day / "operator.csv", [(5.0 + number, 0.0, 0.2)] * 200)
    together = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "together").dataset)
    apart = Dataset.open(ingest([tmp_path / "logs" / d for d in ("monday", "tuesday")], tmp_path / "apart").dataset)
    for found in (together, apart):
        assert found.executions["session"].to_list() == ["monday", "tuesday"]
        at = found.samples().group_by("execution", maintain_order=True).agg(pl.col("human_x_m").mean())
        assert at["human_x_m"].to_list() == pytest.approx([5.0, 6.0])


def test_two_robots_and_their_trackers_in_one_folder_are_refused_with_the_cure(
    tmp_path: Path, robot_log: Any, motive_log: Any
):
    for number in range(2):
        robot_log(tmp_path / "logs" / f"robot_{number}.csv", ROUND_TRIP)
        motive_log(tmp_path / "logs" / f"operator_{'ab'[number]}.csv", WALK)
    with pytest.raises(ConfigError, match="unclear which belong together") as caught:
        ingest([tmp_path / "logs"], tmp_path / "dataset")
    assert "its own folder" in str(caught.value.cure)
    assert "dates without a time zone need time_zone" in str(caught.value.cure)
    assert not (tmp_path / "dataset").exists()


def test_a_robot_alone_has_samples_without_an_operator(three_runs: Path, tmp_path: Path):
    samples = Dataset.open(ingest([three_runs], tmp_path / "dataset").dataset).samples()
    assert samples.height > 0
    assert samples["robot_x_m"].null_count() == 0
    for name in ("human_x_m", "human_goal_x_m", "human_task"):
        assert samples[name].null_count() == samples.height


def test_a_tracker_alone_has_samples_without_a_robot(tmp_path: Path, motive_log: Any):
    motive_log(tmp_path / "logs" / "operator.csv", WALK)
    report = ingest([tmp_path / "logs"], tmp_path / "dataset")
    found = Dataset.open(report.dataset)
    assert (report.executions, report.tasks) == (1, 0)
    assert found.samples().height == pytest.approx(30, abs=1)
    assert found.samples()["human_x_m"][10] == pytest.approx(1.5)
    assert found.samples()["robot_x_m"].null_count() == found.samples().height
    assert found.executions["complete"].to_list() == [False]


def test_a_bag_is_ingested_as_the_same_cell_as_the_csv_logs(cells: Cells):
    bags, tables = cells("laser-zones", 2, logs="mcap"), cells("laser-zones", 2)
    assert bags.routes_found == tables.routes_found == tables.routes
    lost = [cell.dataset.tasks()["safety_loss_s"].sum() for cell in (bags, tables)]
    assert lost[0] == pytest.approx(lost[1], rel=0.01)
    assert {entry.adapter for entry in bags.dataset.recordings} == {"rosbag"}


def test_executions_that_begin_by_a_register_nobody_logged_are_refused(three_runs: Path, tmp_path: Path):
    for begin in ("register", "digital-output"):
        cell = Cell(executions=Executions(begin=begin))  # type: ignore[arg-type]
        with pytest.raises(ConfigError, match=f"begin by {begin}, but the log does not hold it"):
            ingest([three_runs], tmp_path / "dataset", cell=cell)
    for signal in ("register=100", "digital-output 3"):
        cell = Cell(executions=Executions("signal", signal=signal))
        with pytest.raises(ConfigError, match=f"begin by {signal}, but the log does not hold it"):
            ingest([three_runs], tmp_path / "dataset", cell=cell)


def test_progress_goes_from_nothing_to_the_whole(three_runs: Path, tmp_path: Path):
    told: list[float] = []
    ingest([three_runs], tmp_path / "dataset", progress=lambda fraction, text: told.append(fraction))
    assert told == sorted(told)
    assert 0 <= told[0] < told[-1] <= 1


def test_another_rate_gives_other_samples_of_the_same_recordings(three_runs: Path, tmp_path: Path, reads: list[str]):
    ten = Dataset.open(ingest([three_runs], tmp_path / "dataset").dataset).samples()
    reads.clear()
    fifty = Dataset.open(ingest([three_runs], tmp_path / "dataset", rate_hz=50.0).dataset)
    assert reads == []
    assert fifty.card.rate_hz == 50.0
    assert fifty.samples().height == pytest.approx(5 * ten.height, rel=0.05)
    with pytest.raises(ConfigError, match=r"0\.1 to 1000"):
        ingest([three_runs], tmp_path / "dataset", rate_hz=0.0)


def test_checksums_can_be_left_out_and_are_made_good_later(three_runs: Path, tmp_path: Path, reads: list[str]):
    def sums(dataset: Path) -> list[str | None]:
        return [source.blake3 for entry in Dataset.open(dataset).recordings for source in entry.sources]

    true = [blake3(file.read_bytes()).hexdigest() for file in sorted(three_runs.glob("*.csv"))]
    assert sums(ingest([three_runs], tmp_path / "dataset", checksums=False).dataset) == [None, None, None]
    reads.clear()
    assert sums(ingest([three_runs], tmp_path / "dataset").dataset) == true
    assert reads == []
    assert sums(ingest([three_runs], tmp_path / "dataset", checksums=False).dataset) == true
    assert sums(ingest([three_runs], tmp_path / "two", engine=Engine(jobs=2)).dataset) == true
