"""The only log of its kind that cannot be read, and values that cannot be, end an ingest unless the user accepts it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from cyclekit.adapter import CUT_LINE, Recording, TimeUnit
from cyclekit.cli import run
from cyclekit.config import Cell, Source
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import EstimateError, LogError
from cyclekit.ingest.ingest import ingest
from cyclekit.ingest.validate.validate import examined

ROUND = [("stand", 1.0), ("move", 0.3), ("stand", 0.6), ("move", 0.0), ("stand", 1.0)]
PEOPLE = {"delimiter": ",", "time": "time", "time_unit": "s", "x": "x", "y": "y", "length_unit": "m"}
TRACKER = Source("people.csv", adapter="csv", role="people", clock_offset_s=0.0, map=PEOPLE)


@pytest.fixture
def folder(tmp_path: Path, robot_log: Any) -> Path:
    """Logs of a robot and, in people.csv, of a person 2 m away."""
    robot_log(tmp_path / "logs" / "robot.csv", ROUND)
    people(tmp_path / "logs", 2.0)
    return tmp_path / "logs"


def people(folder: Path, x: float) -> None:
    rows = [f"{10.0 + 0.05 * k:.2f},{x + 0.001 * k:.3f},{0.5 * x:.3f}" for k in range(120)]
    (folder / "people.csv").write_text("\n".join(["time,x,y", *rows, ""]), encoding="utf-8")


def test_logs_as_they_should_be_are_read(folder: Path, tmp_path: Path) -> None:
    assert ingest([folder], tmp_path / "d", cell=Cell(sources=(TRACKER,))).tasks > 0


def refused(folder: Path, tmp_path: Path, cell: Cell, said: str) -> None:
    """Check that the logs are refused with this text, and read if the user accepts them."""
    with pytest.raises(LogError, match=said) as raised:
        ingest([folder], tmp_path / "d", cell=cell)
    assert "accept_bad_logs = true" in str(raised.value)
    assert not (tmp_path / "d").exists()
    assert Dataset.open(ingest([folder], tmp_path / "d", cell=cell, accept_bad_logs=True).dataset).recordings


def test_a_robot_log_that_nothing_reads_is_no_dataset_of_people_alone(folder: Path, tmp_path: Path) -> None:
    (folder / "robot.csv").write_text("this is no log\n", encoding="utf-8")
    refused(folder, tmp_path, Cell(sources=(TRACKER,)), "robot.csv: not read: .*no other log holds the robot or tasks")


def test_the_only_tracker_that_cannot_be_read_is_missed(folder: Path, tmp_path: Path) -> None:
    (folder / "people.csv").write_text("time,X,Y\n1,2,3\n2,3,4\n", encoding="utf-8")
    refused(folder, tmp_path, Cell(sources=(TRACKER,)), "people.csv: .*no other log of its kind could be read")


@pytest.mark.parametrize("key", ["accept_bad_logs = true\n", ""])
def test_people_in_millimetres_are_an_error_unless_the_cell_file_accepts_them(
    key: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    people(folder, 2000.0)
    source = '[[sources]]\npath = "people.csv"\nadapter = "csv"\nrole = "people"\nclock_offset_s = 0.0\n'
    told = ", ".join(f'{name} = "{value}"' for name, value in PEOPLE.items())
    (folder / "cell.toml").write_text(f"{key}{source}map = {{ {told} }}\n", encoding="utf-8")
    assert run(["ingest", str(folder), "--out", str(tmp_path / "d")]) == (0 if key else 1)
    said = capsys.readouterr().err
    assert "probably millimetres" in said
    assert ("--accept-bad-logs" in said) is (not key)


ROBOT = {
    "the tool in millimetres": ("tcp_x_m", np.linspace(100, 400, 300), True),
    "joints in degrees": ("q1_rad", np.linspace(-90, 90, 300), True),
    "the scaling in percent": ("scaling", np.linspace(0, 100, 300), True),
    "the speed in mm/s": ("tcp_speed_m_s", np.linspace(0, 400, 300), True),
    "one garbled speed": ("tcp_speed_m_s", np.array([400.0] + [0.2] * 299), False),
    "one garbled joint": ("q1_rad", np.array([4e5] + [0.2] * 299), False),
    "garbled joints": ("q1_rad", np.array([1e226, 0.2] * 150), True),
    "one garbled scaling": ("scaling", np.array([50.0] + [1.0] * 299), False),
}


@pytest.mark.parametrize("what", ROBOT)
def test_a_column_in_another_unit_cannot_be_and_a_garbled_row_is_only_said(what: str) -> None:
    name, values, cannot = ROBOT[what]
    others = {"t_s": np.arange(300) / 100, "tcp_x_m": np.sin(np.arange(300) / 30), "tcp_y_m": 0.2, "tcp_z_m": 0.3}
    found = examined(Recording(robot=pl.DataFrame({**others, name: values})))
    assert bool(found.impossible) is cannot
    assert found.warnings
    assert ("degrees" in found.warnings[-1]) is (what == "joints in degrees")


def test_a_task_list_in_milliseconds_read_as_seconds_cannot_be() -> None:
    rows = {"t_s": np.arange(9) * 1e6, "end_s": np.arange(9) * 1e6 + 9e5, "agent_name": "arm", "execution": "1"}
    listed = {**rows, "agent": "robot", "task": "pick"}
    (text,) = examined(Recording(task_list=pl.DataFrame(listed), time_units=(TimeUnit("s", 1.0),))).impossible
    assert "give time_unit" in text


def table(path: Path, rows: list[str], lost: dict[int, str]) -> None:
    """Write a table of a robot, with other lines in place of some of its rows."""
    rows = [lost.get(k, row) for k, row in enumerate(rows)]
    path.write_text("\n".join(["time,x,y,z", *rows, ""]), encoding="utf-8")


ROWS = [f"{k / 25:.2f},{0.4 + 0.3 * np.sin(k / 40):.4f},{0.1 * np.cos(k / 40):.4f},0.3" for k in range(1000)]
MAPPED = {"time": "time", "time_unit": "s", "x": "x", "y": "y", "z": "z", "length_unit": "m"}
TABLE = Cell(sources=(Source("robot.csv", adapter="csv", role="robot", map=MAPPED),))
SHORT, TWICE = "1,2", {k: ROWS[k - 1] for k in range(1, 1000, 2)}
LOST: dict[str, tuple[dict[int, str], str | None, bool]] = {
    "a cut row": ({500: SHORT}, None, False),
    "a torn last row": ({999: SHORT}, None, False),
    "2 % of the rows": (
        dict.fromkeys(range(0, 1000, 50), SHORT),
        "20 of 1000 lines (2.0 %) are set aside, the first is line 2: 2 fields where the header has 4",
        False,
    ),
    "two reasons": (
        {k: SHORT if k % 100 else "1,2,3,four" for k in range(50, 1000, 50)},
        "19 of 1000 lines (1.9 %) are set aside, the first is line 52: 2 fields where the header has 4 (10); 'four' in "
        "column 'z' is not a number (9)",
        False,
    ),
    "a short tail": (
        dict.fromkeys(range(997, 1000), SHORT),
        "3 of 1000 lines (0.3 %) are set aside, from line 999 to the end: 2 fields where the header has 4",
        False,
    ),
    "most of it": (
        dict.fromkeys(range(300, 1000), SHORT),
        "700 of 1000 lines (70 %) are set aside, from line 302 to the end: 2 fields where the header has 4",
        True,
    ),
    "each row twice": (TWICE, None, False),
    "two places at each time": (
        {k: ROWS[k].replace(ROWS[k].split(",")[0], ROWS[k - 1].split(",")[0]) for k in range(100, 500, 40)},
        "10 of 1000 lines (1.0 %) are set aside, the first is line 102: has the time of the row before it, and other "
        "values",
        False,
    ),
}


@pytest.mark.parametrize("what", LOST)
def test_what_is_lost_of_a_log_is_said_and_more_than_half_of_it_is_refused(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost, said, too_much = LOST[what]
    table(tmp_path / "robot.csv", ROWS, lost)
    if too_much:
        with pytest.raises(LogError, match="70 %") as raised:
            ingest([tmp_path / "robot.csv"], tmp_path / "d", cell=TABLE)
        assert "accept_bad_logs = true" in str(raised.value)
    report = ingest([tmp_path / "robot.csv"], tmp_path / "d", cell=TABLE, accept_bad_logs=too_much)
    assert [text for text in report.warnings if "set aside" in text] == ([f"robot.csv: {said}"] if said else [])
    assert run(["inspect", str(tmp_path / "d")]) == 0
    shown = " ".join(capsys.readouterr())
    assert ("! robot: " in shown) is (said is not None)


def test_the_cut_last_lines_of_a_log_of_several_files_are_no_lost_tail() -> None:
    rows = {"t_s": np.arange(900) / 100, "tcp_x_m": np.sin(np.arange(900) / 30), "source_row": np.arange(900)}
    cut = pl.DataFrame({"source_row": [900, 901, 902], "reason": [f"log_{k}.csv: {CUT_LINE}" for k in "abc"]})
    robot = pl.DataFrame({**rows, "tcp_y_m": 0.2, "tcp_z_m": 0.3})
    assert examined(Recording(robot=robot, rows_read=903, set_aside=cut)).warnings == ()
    cut = cut.with_columns(reason=pl.lit("4 fields where the header has 7"))
    (said,) = examined(Recording(robot=robot, rows_read=903, set_aside=cut, rows_are="line")).warnings
    assert said.startswith("3 of 903 lines (0.3 %) are set aside, from line 900 to the end: 4 fields")


def test_rows_that_hold_nothing_are_no_loss(tmp_path: Path) -> None:
    rows = [row if k % 5 == 0 else f"{row.split(',')[0]},,," for k, row in enumerate(ROWS)]
    table(tmp_path / "robot.csv", rows, {})
    report = ingest([tmp_path / "robot.csv"], tmp_path / "d", cell=TABLE)
    assert not [text for text in report.warnings if "set aside" in text]


def test_a_log_of_which_no_row_can_be_used_is_not_called_empty(tmp_path: Path) -> None:
    rows = [f"{133601418000000000 + 100000 * k},{k},0,0" for k in range(60)]
    (tmp_path / "robot.csv").write_text("\n".join(["Timestamp,X,Y,Z", *rows, ""]), encoding="utf-8")
    columns = {"time": "Timestamp", "time_unit": "us", "x": "X", "y": "Y", "z": "Z", "length_unit": "mm"}
    source = Source("robot.csv", adapter="csv", role="robot", map=columns)
    with pytest.raises(
        LogError, match=r"none of its 60 rows can be used; the first \(line 2\): its time is not"
    ) as raised:
        ingest([tmp_path / "robot.csv"], tmp_path / "d", cell=Cell(sources=(source,)))
    assert "remove the file" not in str(raised.value)


def test_a_trace_of_weeks_alone_is_refused_by_the_name_of_its_file(tmp_path: Path) -> None:
    rows = [f"{day * 86400 + 5 * k},release,{k % 2}" for day in (0, 23) for k in range(20)]
    (tmp_path / "plc.csv").write_text("\n".join(["time [s],signal,value", *rows, ""]), encoding="utf-8")
    with pytest.raises(EstimateError, match=r"^plc\.csv: lasts 23 days, more than 10 000 000 samples"):
        ingest([tmp_path / "plc.csv"], tmp_path / "d")
