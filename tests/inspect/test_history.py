"""The history of a dataset: tasks of both agents, task lists and signals in one table, in words and as a chart."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from cyclekit import ingest_logs, logged_history
from cyclekit.cli import run
from cyclekit.errors import UnknownName

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import SimulatedCell

LISTED = """agent,task,start_s,end_s,execution
arm,fetch,0.0,4.0,1
worker,screw,1.0,6.5,1
arm,place,4.5,9.0,1
arm,fetch,20.0,24.0,2
worker,screw,21.0,,2
"""


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("listed")
    (folder / "logs").mkdir()
    (folder / "logs" / "tasks.csv").write_text(LISTED)
    ingest_logs(folder / "logs", folder / "dataset")
    return folder / "dataset"


def test_motion_and_signals_are_rows_of_one_table(boxes: SimulatedCell):
    dataset = boxes.dataset
    name = dataset.executions["execution"][0]
    rows = logged_history(dataset, executions=[name]).rows
    assert set(rows["agent"]) == {"robot", "operator", "signal"}
    assert rows["begin_s"].drop_nulls().is_sorted()
    tasks = dataset.every_task().filter(execution=name, agent="robot")
    robot = rows.filter(agent="robot")
    assert robot["activity"].to_list() == tasks["task"].to_list()
    assert (robot["end_s"] - robot["begin_s"]).to_list() == pytest.approx((tasks["end_s"] - tasks["start_s"]).to_list())
    assert (robot["end_s"] - robot["ready_s"]).to_list() == pytest.approx(tasks["wait_s"].to_list())
    grips = rows.filter(agent="signal", activity="digital-output 0")
    picked = robot.filter(place="conveyor").height
    assert grips.height == pytest.approx(picked, abs=1)
    assert (grips["end_s"].drop_nulls() > grips["begin_s"][: grips["end_s"].count()]).all()


def test_a_task_list_is_the_same_table_and_what_has_no_end_is_cut(listed: Path):
    rows = logged_history(listed).rows
    assert rows.select("agent", "activity", "begin_s", "end_s", "cut").rows() == [
        ("arm", "fetch", 0.0, 4.0, False),
        ("worker", "screw", 1.0, 6.5, False),
        ("arm", "place", 4.5, 9.0, False),
        ("arm", "fetch", 0.0, 4.0, False),
        ("worker", "screw", 1.0, None, True),
    ]
    assert rows["place"].null_count() == rows.height


def test_inspect_prints_one_execution_and_draws_them(listed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["inspect", str(listed), "--history"]
    assert run([*words, "--gantt", str(tmp_path / "chart.svg")]) == 0
    told = capsys.readouterr().out
    assert told.count("screw") == 1
    assert "1 more execution: --execution" in told
    assert "worker" in (tmp_path / "chart.svg").read_text()
    assert run([*words, "--execution", "2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [row["end_s"] for row in told["rows"]] == [4.0, None]
    assert run([*words, "--execution", "3"]) == 1
    assert run(["inspect", str(listed), "--gantt", "chart.svg"]) == 2


def test_an_unknown_execution_is_refused(listed: Path):
    with pytest.raises(UnknownName, match="unknown execution '7'"):
        logged_history(listed, executions=["7"])
