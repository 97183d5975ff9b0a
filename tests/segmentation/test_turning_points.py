"""A robot that never rests: its turns are its places, and nothing else is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import polars as pl
import pytest

from cyclekit.config import Cell
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest


def found_in(tmp_path: Path, log: Path) -> Dataset:
    return Dataset.open(ingest([log], tmp_path / "dataset", cell=Cell()).dataset)


def eased(log: Path) -> Path:
    """Make the corners of a log's motion at constant speed parabolic: speed falls to nearly zero in 0.1 s."""
    rows = pl.read_csv(log, separator=" ")
    x = rows["actual_TCP_pose_0"]
    smooth = x.rolling_mean(25, center=True, min_samples=1)
    speed = (smooth.shift(-1) - smooth.shift(1)).fill_null(0.0) / 0.016
    columns = {"actual_TCP_pose_0": smooth, "actual_q_0": smooth, "actual_TCP_speed_0": speed}
    rows.with_columns(**columns).write_csv(log, separator=" ")
    return log


def test_the_turns_of_a_robot_that_never_rests_are_its_places(tmp_path: Path, robot_log: Any):
    doing = [("move", 1.0), ("move", 0.0)] * 3
    found = found_in(tmp_path, eased(robot_log(tmp_path / "run.csv", doing, scaling=False)))
    assert sorted(place.xyz_m[0] for place in found.places.values()) == pytest.approx([0.025, 0.975], abs=0.02)
    tasks = found.tasks()
    assert tasks["task"].to_list()[-3:-1] in (
        ["place_1->place_2", "place_2->place_1"],
        ["place_2->place_1", "place_1->place_2"],
    )
    assert (tasks["arrival_s"] - tasks["start_s"]).to_list()[1:3] == pytest.approx([2.0] * 2, abs=0.05)
    assert tasks["dwell_s"].abs().max() < 0.05


def test_where_it_rests_a_turn_is_a_waypoint(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for _ in range(4):
        doing += [("move", 0.5), ("move", 0.3), ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)]
    found = found_in(tmp_path, eased(robot_log(tmp_path / "run.csv", doing)))
    assert len(found.places) == 2


def test_a_turn_that_is_seen_once_is_no_place(tmp_path: Path, robot_log: Any):
    doing = [("stand", 1.0), ("move", 1.0), ("move", 0.4), ("move", 2.0)]
    found = found_in(tmp_path, eased(robot_log(tmp_path / "run.csv", doing, scaling=False)))
    assert found.tasks().height == 0
