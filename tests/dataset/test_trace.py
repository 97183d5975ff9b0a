"""A number that looks wrong can be looked up where it was written: file and line, message or frame."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.trace import trace
from cyclekit.errors import DatasetError, UnknownName
from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from simulated_cells import Cells, SimulatedCell


def test_the_line_that_is_named_holds_the_position_of_the_sample(boxes: SimulatedCell):
    rows = boxes.dataset.samples().height
    for execution, at_s in [("1", 0.001), ("2", 17.3), ("4", 60.0)]:
        found = trace(boxes.dataset, execution, at_s, logs=boxes.logs)
        (robot,) = [origin for origin in found.origins if origin.table == "robot"]
        assert robot.row_is == "line"
        assert robot.t_s == pytest.approx(found.sample["t_s"], abs=1e-6)
        lines = (boxes.logs / robot.file).read_text(encoding="utf-8").splitlines()
        names, cells = lines[0].split(" "), lines[robot.source_row - 1].split(" ")
        assert robot.text == lines[robot.source_row - 1]
        assert float(cells[names.index("actual_TCP_pose_0")]) == pytest.approx(found.sample["robot_x_m"], abs=1e-9)
        people = [origin for origin in found.origins if origin.table == "people"]
        assert people
        assert all(abs(origin.t_s - found.sample["t_s"]) <= 0.21 for origin in people)
        frame = (boxes.logs / people[0].file).read_text(encoding="utf-8").splitlines()[people[0].source_row - 1]
        assert float(frame.split(",")[6]) == pytest.approx(people[0].values["x_m"], abs=1e-6)
    assert boxes.dataset.samples().height == rows


def test_a_time_after_the_end_is_refused_with_the_length_of_the_execution(boxes: SimulatedCell):
    length_s = boxes.dataset.executions["duration_s"][0]
    trace(boxes.dataset, "1", length_s - 0.01)
    with pytest.raises(DatasetError, match=f"lasts {length_s:.1f} s, so it holds no sample at 999 s"):
        trace(boxes.dataset, "1", 999.0)


def test_blank_lines_and_rows_set_aside_are_counted_as_an_editor_does(tmp_path: Path, robot_log: Any):
    path = robot_log(tmp_path / "logs" / "run.csv", [("stand", 0.5), ("move", 0.3), ("stand", 0.5), ("move", 0.0)])
    lines = path.read_text(encoding="utf-8").splitlines()
    garbled = [lines[0], "", *lines[1:60], "1.0 2.0", "", "", *lines[60:]]
    path.write_text("\n".join(garbled) + "\n", encoding="utf-8")
    found = trace(Dataset.open(ingest([path.parent], tmp_path / "dataset").dataset), "1", 0.4, logs=path.parent)
    (robot,) = [origin for origin in found.origins if origin.table == "robot"]
    assert robot.text == garbled[robot.source_row - 1]
    assert robot.text.split(" ")[1] == f"{found.sample['robot_x_m']:.7f}"


def test_without_the_logs_the_place_and_the_values_are_told(boxes: SimulatedCell):
    found = trace(boxes.dataset, "1", 5.0)
    (robot,) = [origin for origin in found.origins if origin.table == "robot"]
    assert robot.text is None
    assert robot.values["tcp_x_m"] == pytest.approx(found.sample["robot_x_m"])


def test_an_unknown_execution_is_refused(boxes: SimulatedCell):
    with pytest.raises(UnknownName, match="nowhere"):
        trace(boxes.dataset, "nowhere", 1.0)


@pytest.mark.parametrize("way", ["utf-16", "gzip", "the log itself"])
def test_the_line_is_shown_however_the_log_is_written_and_given(tmp_path: Path, robot_log: Any, way: str):
    plain = robot_log(tmp_path / "plain.csv", [("stand", 0.5), ("move", 0.3), ("stand", 0.5), ("move", 0.0)])
    text = plain.read_text(encoding="utf-8")
    log = tmp_path / "logs" / ("run.csv.gz" if way == "gzip" else "run.csv")
    log.parent.mkdir()
    log.write_bytes(
        gzip.compress(text.encode()) if way == "gzip" else text.encode("utf-16" if "utf" in way else "utf-8")
    )
    dataset = Dataset.open(ingest([log], tmp_path / "dataset").dataset)
    found = trace(dataset, "1", 0.4, logs=log if way == "the log itself" else log.parent)
    (robot,) = [origin for origin in found.origins if origin.table == "robot"]
    assert robot.source_row is not None
    assert robot.text == text.splitlines()[robot.source_row - 1]
    assert robot.text.split(" ")[1] == f"{found.sample['robot_x_m']:.7f}"


def test_a_message_is_one_of_a_topic(cells: Cells):
    found = trace(cells("laser-zones", 2, logs="mcap").dataset, "1", 5.0)
    among = {origin.table: origin.among for origin in found.origins}
    assert (among["robot"], among["people"]) == ("/tcp_pose_broadcaster/pose", "/poses")
