"""Robot logs whose clock was restarted while recording: a session for each part."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.ingest.restarts import MAX_PARTS

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.tests_clocks

CELL = """
[[sources]]
path = "*robot.csv"
adapter = "csv"
role = "robot"
map = { time = "t", clock = "uptime", x = "x", y = "y", z = "z", scaling = "s", tags = ["field"] }

[[sources]]
path = "*plc.csv"
adapter = "csv"
role = "events"
map = { time = "t", CLOCK signal = "signal", value = "value" }
"""


def written(folder: Path, spans_s: list[tuple[float, float]], clock: str = "") -> Path:
    """Write a robot log of parts, each of which counts from its own start, and a PLC's log of events."""
    folder.mkdir()
    rows = ["t,x,y,z,s,field"]
    for first_s, end_s in spans_s:
        for t in np.arange(first_s, end_s, 0.1):
            x = 0.3 * np.sin(t / 3.0)
            rows.append(f"{t:.1f},{0.5 + x:.4f},0.2,0.3,1.0,{int(end_s - t < 3.0)}")
    (folder / "robot.csv").write_text("\n".join(rows) + "\n")
    (folder / "plc.csv").write_text("t,signal,value\n1.0,door,0\n31.0,door,1\n52.5,door,0\n")
    (folder / "cell.toml").write_text(CELL.replace("CLOCK", clock))
    return folder


def column(dataset: Dataset, recording: str, table: str, name: str) -> list[float]:
    frame = dataset.recorded(recording, table)
    assert frame is not None
    return list(frame[name].to_list())


def test_each_part_is_a_session_with_its_own_events(tmp_path: Path) -> None:
    logs = written(tmp_path / "logs", [(500.0, 540.0), (20.0, 50.0), (3.0, 33.0)])
    ingest(logs, tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    robots = [one for one in dataset.recordings if "robot" in one.tables]
    assert [one.session for one in robots] == [robots[0].session + part for part in ("", "-2", "-3")]
    assert [(one.first_s, round(one.last_s, 1)) for one in robots] == [(500.0, 539.9), (20.0, 49.9), (3.0, 32.9)]
    assert [one.rows["robot"] for one in robots] == [400, 300, 300]
    for one in robots:
        times_s = column(dataset, one.id, "events", "t_s")
        assert times_s == pytest.approx([one.first_s, one.last_s - 2.9], abs=0.11)
    lines = [column(dataset, one.id, "robot", "source_row") for one in robots]
    assert all(before[-1] < after[0] for before, after in pairwise(lines))
    assert [one.code for one in dataset.card.warnings][:2] == ["log-divided", "log-in-first-part"]
    (plc,) = (one for one in dataset.recordings if one.shown.endswith("plc.csv"))
    assert plc.session == robots[0].session
    again = ingest(logs, tmp_path / "dataset")
    assert again.unchanged


def test_after_another_log_was_added_the_parts_are_the_same(tmp_path: Path) -> None:
    logs = written(tmp_path / "logs", [(500.0, 540.0), (20.0, 50.0)])
    ingest([logs / "robot.csv"], tmp_path / "dataset", cell=logs / "cell.toml")
    before = {one.id: one.rows for one in Dataset.open(tmp_path / "dataset").recordings}
    ingest([logs / "robot.csv", logs / "plc.csv"], tmp_path / "dataset", cell=logs / "cell.toml")
    after = {one.id: one.rows for one in Dataset.open(tmp_path / "dataset").recordings}
    assert len(before) == 2
    assert before.items() <= after.items()
    ingest([logs], tmp_path / "nameless", cell=logs / "cell.toml", pseudonymise=True)
    nameless = Dataset.open(tmp_path / "nameless")
    assert sorted(one.rows["robot"] for one in nameless.recordings if "robot" in one.tables) == [300, 400]


def test_a_clock_that_is_set_back_a_little_or_all_the_time_divides_nothing(tmp_path: Path) -> None:
    for name, spans_s in (
        ("little", [(500.0, 520.0), (519.5, 540.0)]),
        ("always", [(10.0, 13.0)] * (MAX_PARTS + 5)),
    ):
        logs = written(tmp_path / name, spans_s)
        ingest(logs, tmp_path / f"{name}.dataset")
        dataset = Dataset.open(tmp_path / f"{name}.dataset")
        assert sum("robot" in one.tables for one in dataset.recordings) == 1
        assert "log-divided" not in {one.code for one in dataset.card.warnings}
