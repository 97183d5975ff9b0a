"""Task lists and safety logs in a dataset: tasks of both agents, executions, and no positions."""

from __future__ import annotations

import json
from pathlib import Path

import polars as pl
import pytest
from ingested import ROUND_TRIP, without_checksums

from cyclekit.adapter import Recording, TimeUnit
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.trace import trace
from cyclekit.errors import CyclekitError, DatasetError
from cyclekit.ingest.ingest import IngestReport, ingest
from cyclekit.ingest.validate.validate import examined
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit.replay import write_replay
from cyclekit.report import compose_report
from cyclekit.schema import TASK_LIST, TASKS, conform

T0 = 1_690_833_425.0
HEADER = "run,agent,task,t_start,t_end,t_start_planned,outcome"


def write_list(file: Path, rows: list[tuple[str, str, str, float, float | str, float, str]]) -> Path:
    lines = [f"{run},{agent},{task},{T0 + begin},{T0 + end if end != '' else ''},{plan},{outcome}"
             for run, agent, task, begin, end, plan, outcome in rows]  # fmt: skip
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join([HEADER, *lines]) + "\n", encoding="utf-8")
    return file


TWO_RUNS = [
    ("b", "human", "pick", 100.0, 104.0, 0.0, "1"),
    ("b", "ur5", "feed", 100.5, 103.0, 0.5, "1"),
    ("b", "ur5", "drill", 103.0, 109.0, 2.5, "0"),
    ("a", "ur5", "feed", 0.0, 2.5, 0.0, "1"),
    ("a", "human", "pick", 0.5, 4.5, 0.0, "1"),
]


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> tuple[IngestReport, Dataset]:
    folder = tmp_path_factory.mktemp("listed")
    write_list(folder / "logs" / "plan.csv", TWO_RUNS)
    report = ingest([folder / "logs"], folder / "dataset")
    return report, Dataset.open(report.dataset)


def test_a_folder_of_task_lists_becomes_a_dataset_with_both_agents_tasks(listed) -> None:
    report, dataset = listed
    assert (report.executions, report.tasks, report.samples) == (2, 5, 0)
    tasks = dataset.every_task()
    assert tasks.columns == list(TASKS)
    rows = tasks.select("execution", "index", "agent", "agent_name", "task", "start_s", "end_s", "outcome").rows()
    assert rows == [
        ("plan.001", 0, "robot", "ur5", "feed", 0.0, 2.5, "done"),
        ("plan.001", 0, "operator", "human", "pick", 0.5, 4.5, "done"),
        ("plan.002", 0, "operator", "human", "pick", 100.0, 104.0, "done"),
        ("plan.002", 0, "robot", "ur5", "feed", 100.5, 103.0, "done"),
        ("plan.002", 1, "robot", "ur5", "drill", 103.0, 109.0, "failed"),
    ]
    assert tasks["planned_start_s"].to_list() == [0.0, 0.0, 100.0, 100.5, 102.5]
    assert dataset.tasks().is_empty()
    assert dataset.done_tasks().is_empty()


def test_executions_are_those_that_the_list_names(listed) -> None:
    _, dataset = listed
    told = [(entry.execution, entry.logged_as, list(entry.places)) for entry in dataset.card.executions]
    assert told == [("plan.001", "a", []), ("plan.002", "b", [])]
    spans = dataset.executions.select("start_s", "end_s", "complete").rows()
    assert spans == [(0.0, 4.5, True), (100.0, 109.0, True)]
    assert dataset.samples().is_empty()
    assert dataset.verify() > 0


def test_the_dataset_says_that_it_has_no_positions(listed) -> None:
    report, dataset = listed
    card = json.loads((dataset.path / "dataset.json").read_text(encoding="utf-8"))
    assert card["positions"] == []
    assert [entry["positions"] for entry in card["recordings"]] == [False]
    assert card["recordings"][0]["duration_s"] == 109.0
    assert report.warnings == (
        "no positions of robot and people: train learns task times and waits, and no safety function",
    )
    assert dataset.positions == ()


@pytest.mark.parametrize("stage", ["train", "report", "replay", "trace", "model"])
def test_what_needs_positions_ends_with_one_sentence(listed, tmp_path: Path, stage: str) -> None:
    from cyclekit.learning.networks.cell import refuse_other_cell

    _, dataset = listed
    asked = {
        "train": lambda: train(dataset, ModelSpec.of("now")),
        "report": lambda: compose_report(dataset, None, tmp_path / "a.html"),
        "replay": lambda: write_replay(dataset, "1", tmp_path / "a.rrd"),
        "trace": lambda: trace(dataset, "1", 1.0),
        "model": lambda: refuse_other_cell({}, dataset, other_cell=True),
    }
    with pytest.raises(DatasetError, match="made of task lists alone: the positions of robot and people") as caught:
        asked[stage]()
    assert "cyclekit inspect" in str(caught.value.cure)
    assert list(tmp_path.iterdir()) == []


def test_a_dataset_whose_tasks_table_is_of_an_earlier_version_opens(robot_dataset: Path) -> None:
    without_checksums(robot_dataset)
    file = robot_dataset / "tasks.parquet"
    before = pl.read_parquet(file)
    later = ["agent", "agent_name", "planned_start_s", "planned_end_s", "outcome"]
    before.drop(later).write_parquet(file)
    tasks = Dataset.open(robot_dataset).every_task()
    assert tasks.columns == before.columns
    assert set(tasks["agent"]) == {"robot"}
    assert tasks["outcome"].null_count() == tasks.height
    assert Dataset.open(robot_dataset).tasks().equals(before)


@pytest.fixture
def robot_dataset(tmp_path: Path, robot_log) -> Path:
    logs = tmp_path / "there"
    robot_log(logs / "robot.csv", ROUND_TRIP)
    return ingest([logs], tmp_path / "dataset").dataset


def test_lists_without_executions_are_one_or_begin_anew_after_gaps(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    lines = ["agent,task,start_s,end_s", "human,a,0,3", "r,b,1,9", "human,a,10,12", "r,b,20,21"]
    (logs / "plan.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    one = Dataset.open(ingest([logs], tmp_path / "one").dataset)
    assert one.executions.select("start_s", "end_s").rows() == [(0.0, 21.0)]
    assert any("a file is taken for one" in text for text in one.recordings[0].said)
    (logs / "cell.toml").write_text('[executions]\nbegin = "gap"\ngap_s = 5.0\n', encoding="utf-8")
    split = Dataset.open(ingest([logs], tmp_path / "split").dataset)
    assert split.executions.select("start_s", "end_s").rows() == [(0.0, 12.0), (20.0, 21.0)]


def test_an_execution_with_a_task_that_never_ended_is_not_complete(tmp_path: Path) -> None:
    rows = [("a", "ur5", "feed", 0.0, 2.5, 0.0, "1"), ("a", "human", "pick", 1.0, "", 0.0, "1")]
    write_list(tmp_path / "logs" / "plan.csv", rows)
    report = ingest([tmp_path / "logs"], tmp_path / "dataset")
    dataset = Dataset.open(report.dataset)
    assert dataset.executions.select("end_s", "complete").rows() == [(2.5, False)]
    assert "plan.csv: 1 of 2 tasks have no end: how long they took is unknown" in report.warnings


def test_tasks_of_one_agent_at_the_same_time_are_counted() -> None:
    rows = [("ur5", 0.0, 5.0), ("ur5", 1.0, 2.0), ("ur5", 3.0, 6.0), ("human", 0.0, 1.0), ("human", 1.0, 2.0)]
    table = pl.DataFrame(rows, schema=["agent_name", "t_s", "end_s"], orient="row")
    found = examined(Recording(task_list=conform(table, TASK_LIST)))
    assert found.task_list is not None
    assert found.task_list.height == 5
    assert found.warnings == ("2 of 3 tasks of 'ur5' start before its previous task has ended, by up to 4.0 s",)


def test_executions_that_each_count_from_zero_do_not_overlap() -> None:
    rows = [("ur5", run, begin, begin + 2.0) for run in "ab" for begin in (0.0, 2.5)]
    table = pl.DataFrame(rows, schema=["agent_name", "execution", "t_s", "end_s"], orient="row")
    assert examined(Recording(task_list=conform(table, TASK_LIST))).warnings == ()


def test_tasks_of_days_are_named_as_a_slip_of_units() -> None:
    table = pl.DataFrame({"agent_name": ["r"], "t_s": [0.0], "end_s": [200_000.0]})
    listed = conform(table, TASK_LIST)
    (said,) = examined(Recording(task_list=listed, time_units=(TimeUnit("s", 1.0),))).warnings
    assert said == "half of the tasks take 200000 s: check the unit of time and give time_unit"
    (said,) = examined(Recording(task_list=listed)).warnings  # written dates have no other unit
    assert said == "half of the tasks take 200000 s: check which columns are start and end"


def test_beside_a_robot_log_the_operators_tasks_are_put_into_its_executions(tmp_path: Path, robot_log) -> None:
    logs = tmp_path / "logs"
    robot_log(logs / "robot.csv", ROUND_TRIP)
    lines = ["run,agent,task,start_s,end_s", "1,human,pick,0.1,0.9", "1,robot,feed,0.2,1.0", "1,human,rest,90.0,91.0"]
    (logs / "plan.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (logs / "cell.toml").write_text('[[sources]]\npath = "plan.csv"\nclock_offset_s = 10.1\n', encoding="utf-8")
    report = ingest([logs], tmp_path / "dataset")
    dataset = Dataset.open(report.dataset)
    listed = dataset.every_task().filter(pl.col("agent") == "operator")
    (row,) = listed.select("task", "start_s").rows()
    assert row == ("pick", pytest.approx(0.2))
    assert dataset.tasks().height == dataset.every_task().height - 1 > 0
    assert dataset.positions == ("robot",)
    entry = next(entry for entry in dataset.recordings if entry.id == "plan")
    assert [text for text in entry.said if text.startswith("task list: ")] == [
        "task list: 1 tasks of the robot are not used: its log already shows them",
        "task list: 1 of 2 tasks of the operator are outside of every execution",
    ]
    again = ingest([logs], tmp_path / "dataset", rate_hz=5.0)
    assert again.recordings_kept == 2
    entry = next(entry for entry in Dataset.open(again.dataset).recordings if entry.id == "plan")
    assert sum(text.startswith("task list: ") for text in entry.said) == 2


def test_logs_of_a_safety_system_in_one_clock_are_one_session_without_samples(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    override = [f"{T0 + i / 10},{100 - i}" for i in range(50)]
    distance = [f"{T0 + 1 + i / 10},{2 - i / 50}" for i in range(50)]
    late = [f"{T0 + 500 + i / 10},{50}" for i in range(50)]
    for name, column, rows in (("a", "ovr", override), ("b", "distance", distance), ("c", "ovr", late)):
        (logs / f"{name}.csv").write_text("\n".join([f"time_s,{column}", *rows]) + "\n", encoding="utf-8")
    report = ingest([logs], tmp_path / "dataset")
    dataset = Dataset.open(report.dataset)
    assert (report.executions, report.samples) == (0, 0)
    assert {entry.id: entry.session for entry in dataset.recordings} == {"a": "a", "b": "a", "c": "c"}
    clocks = {entry.id: entry.clock for entry in dataset.recordings}
    assert clocks["a"].offset_s == clocks["b"].offset_s == -T0
    kept = dataset.recorded("a", "safety")
    assert kept is not None
    assert kept["override"].to_list() == [(100 - i) / 100 for i in range(50)]
    with pytest.raises(DatasetError, match="made of overrides or distances alone"):
        dataset.require_positions()


def test_a_pseudonymised_task_list_holds_no_names_and_no_date(tmp_path: Path) -> None:
    rows = [
        ("line_2023-07-31", "worker_Anna", "help worker_Anna", 0.0, 2.5, 0.0, "1"),
        ("line_2023-08-01", "ur5", "feed", 90_000.0, 90_004.0, 0.0, "1"),
    ]
    write_list(tmp_path / "logs" / "plan.csv", rows)
    dataset = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "dataset", pseudonymise=True).dataset)
    table = dataset.recorded(dataset.recordings[0].id, "task_list")
    assert table is not None
    assert table.select("t_s", "end_s", "planned_start_s").rows()[1] == (90_000.0, 90_004.0, 90_000.0)
    assert table["t_s"].min() == 0.0
    assert table["agent_name"].to_list() == ["person_1", "ur5"]
    assert table["task"].to_list() == ["help person_1", "feed"]
    assert [entry.logged_as for entry in dataset.card.executions] == ["execution_1", "execution_2"]
    every = (dataset.path / "dataset.json").read_text(encoding="utf-8") + str(dataset.every_task().rows())
    assert "Anna" not in every
    assert "2023" not in every
    assert "1690833" not in every


def test_a_task_list_with_names_of_many_lines_is_shown_in_one(tmp_path: Path) -> None:
    records = [{"agent": "human\n! all is well", "task": "t", "start_s": 0.5, "end_s": 1.0, "run": "1"}]
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.json").write_text(json.dumps(records), encoding="utf-8")
    dataset = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "dataset").dataset)
    assert "\n" not in dataset.every_task()["agent_name"][0]


def test_role_tasks_is_refused_by_what_reads_no_task_lists(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "a.csv").write_text("t,x,y\n0,1,2\n", encoding="utf-8")
    source = '[[sources]]\npath = "a.csv"\nadapter = "csv"\nrole = "tasks"\nmap = { time = "t", x = "x", y = "y" }\n'
    (logs / "cell.toml").write_text(source, encoding="utf-8")
    with pytest.raises(CyclekitError, match="task-list"):
        ingest([logs], tmp_path / "dataset")


def test_of_many_agents_that_overlap_a_few_are_named() -> None:
    rows = [(f"r{i}", begin, begin + 5.0) for i in range(10) for begin in (0.0, 1.0)]
    table = pl.DataFrame(rows, schema=["agent_name", "t_s", "end_s"], orient="row")
    said = examined(Recording(task_list=conform(table, TASK_LIST))).warnings
    assert len(said) == 7
    assert said[0] == "1 of 2 tasks of 'r0' start before its previous task has ended, by up to 4.0 s"
    assert said[-1] == "so do tasks of 4 other agents"
