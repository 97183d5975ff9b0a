"""What the cell file says of logs: one file beside them, logs to be left out, sources that match no log."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ingested import ROUND_TRIP

from cyclekit.config import Cell, Source
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError
from cyclekit.ingest.discover import find_all
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.coupling.learn import courses_of_dataset


def test_two_cell_files_beside_the_logs_are_one_too_many(three_runs: Path, tmp_path: Path, robot_log: Any):
    robot_log(tmp_path / "more" / "run.csv", ROUND_TRIP)
    for folder in (three_runs, tmp_path / "more"):
        (folder / "cell.toml").write_text("", encoding="utf-8")
    with pytest.raises(ConfigError, match="two cell files"):
        ingest([three_runs, tmp_path / "more"], tmp_path / "dataset")


def test_files_to_be_ignored_are(three_runs: Path, tmp_path: Path):
    (three_runs / "truth").mkdir()
    shutil.copy(three_runs / "run_0.csv", three_runs / "truth" / "run_9.csv")
    (three_runs / ".run_8.csv").write_text("hidden", encoding="utf-8")
    for globs in (("truth/*", "run_1.csv"), ("truth", "*_1.csv")):
        report = ingest([three_runs], tmp_path / "dataset", cell=Cell(ignore=globs))
        assert report.not_read == ()
        assert [entry.id for entry in Dataset.open(report.dataset).recordings] == ["run_0", "run_2"]


def test_a_source_that_means_no_log_is_said_aloud(three_runs: Path, tmp_path: Path):
    cell = Cell(sources=(Source("run_*.csv", clock_offset_s=1.0), Source("trakcer/*.csv")), reference=("empty/*",))
    warnings = ingest([three_runs], tmp_path / "dataset", cell=cell).warnings
    assert [text for text in warnings if "matches no log" in text] == [
        "source 'trakcer/*.csv' of the cell file matches no log",
        "source 'empty/*' of the cell file matches no log",
    ]


def test_a_signal_is_the_operators_goal_only_if_the_cell_file_says_so(tmp_path: Path, robot_log: Any):
    robot_log(tmp_path / "logs" / "robot.csv", [("stand", 1.0), *ROUND_TRIP, ("stand", 1.0)])
    rows = [f"{10.0 + k},{row}" for k in range(6) for row in (f"goal_reached,{k % 2}", "next,a")]
    (tmp_path / "logs" / "plc.csv").write_text("\n".join(["time,signal,value", *rows, ""]), encoding="utf-8")
    names = {"delimiter": ",", "time": "time", "time_unit": "s", "signal": "signal", "value": "value"}
    plc = Source("plc.csv", adapter="csv", role="events", clock_offset_s=0.0, map=names)

    def made(*goal_signals: str) -> tuple[Dataset, tuple[str, ...]]:
        report = ingest([tmp_path / "logs"], tmp_path / "d", cell=Cell(sources=(plc,), goal_signals=goal_signals))
        return Dataset.open(report.dataset), report.warnings

    dataset, _ = made()
    assert dataset.samples()["human_task"].is_null().all()
    (course,) = courses_of_dataset(dataset)
    assert {"goal_reached", "next"} <= {event.place for event in course.events}
    dataset, warnings = made("next", "nxet")
    assert set(dataset.samples()["human_task"].drop_nulls()) == {"a"}
    assert "next" not in {event.place for event in courses_of_dataset(dataset)[0].events}
    assert [text for text in warnings if "goal_signals" in text] == [
        "goal_signals of the cell file: no log holds a signal 'nxet'"
    ]


def test_a_source_without_the_folder_of_its_logs_is_told_the_pattern(three_runs: Path, tmp_path: Path):
    for number in range(3):
        (three_runs / f"shift_{number}").mkdir()
        (three_runs / f"run_{number}.csv").rename(three_runs / f"shift_{number}" / "robot.csv")
    source = Source("robot.csv", clock_offset_s=1.0)
    (text,) = [
        text
        for text in ingest([three_runs], tmp_path / "dataset", cell=Cell(sources=(source,))).warnings
        if "matches no log" in text
    ]
    assert text.endswith('the logs of that name lie in folders; write path = "*robot.csv"')
    done = ingest([three_runs], tmp_path / "other", cell=Cell(sources=(replace(source, path="*robot.csv"),)))
    assert not [text for text in done.warnings if "matches no log" in text]


@pytest.mark.parametrize("given", ["files", "folders", "one file"])
def test_a_source_means_logs_that_are_given_one_by_one(given: str, tmp_path: Path, robot_log: Any):
    logs = [robot_log(tmp_path / "logs" / f"day{n}" / f"robot{n}.csv", ROUND_TRIP) for n in (1, 2)]
    roots = {"files": logs, "folders": [log.parent for log in logs], "one file": logs[:1]}[given]
    cell = Cell(sources=(Source("day*/robot?.csv", role="events"), Source("day3/*.csv")), ignore=("day2/robot2.csv",))
    found, not_read = find_all(roots, cell)
    assert [(log.path, log.source) for log in found] == [(logs[0], cell.sources[0])]
    assert not_read == []


def test_a_source_of_another_folder_means_no_log_below_it(tmp_path: Path, robot_log: Any):
    log = robot_log(tmp_path / "logs" / "day1" / "robot.csv", ROUND_TRIP)
    for roots in ([log], [tmp_path / "logs"]):
        ((found,), _) = find_all(roots, Cell(sources=(Source("ay1/robot.csv"), Source("day2/*.csv"))))
        assert found.source is None
    ((found,), _) = find_all([tmp_path / "logs"], Cell(sources=(Source("logs/day1/robot.csv"),)))
    assert found.source is None  # a pattern is relative to the folder of logs
