"""A logged scaling that never changes although the robot is slowed: the override that was set, such as $OV_PRO."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit.dataset.cards import texts
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.scaling.set_override import never_changes
from cyclekit.segmentation.motion import RobotRun

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells

SCENE = "scanner-visits"
SET = 0.8


def run(scaling: list[float]) -> RobotRun:
    count = len(scaling)
    return RobotRun(np.arange(count) * 0.01, np.zeros((count, 3)), np.zeros(count), np.array(scaling))


@pytest.mark.parametrize(
    ("runs", "constant"),
    [
        ([[1.0, 1.0, 1.0]], True),
        ([[1.0, np.nan, 1.0], [0.8, 0.8]], True),
        ([[1.0, 1.0], [1.0, 0.5]], False),
        ([[0.0, 0.0]], False),
        ([[1.0, 1.0], [np.nan, np.nan]], False),
        ([], False),
    ],
)
def test_only_a_known_scaling_that_changes_in_no_run_is_constant(runs: list[list[float]], constant: bool):
    assert never_changes([run(scaling) for scaling in runs]) is constant


def with_override(logs: Path, folder: Path, value: float) -> Path:
    """Copy logs, with this value in place of each logged scaling."""
    shutil.copytree(logs, folder, ignore=shutil.ignore_patterns("truth"))
    for robot in sorted(folder.rglob("robot.csv")):
        log = pl.read_csv(robot, separator=" ")
        log.with_columns(speed_scaling=pl.lit(value), target_speed_fraction=pl.lit(1.0)).write_csv(robot, separator=" ")
    return folder


def test_the_scaling_is_inferred_where_the_motion_shows_slow_downs(cells: Cells, tmp_path: Path):
    logs = with_override(cells.logs(SCENE, 4), tmp_path / "logs", 1.0)
    ingest([logs], tmp_path / "dataset")
    found, true = Dataset.open(tmp_path / "dataset"), cells(SCENE, 4, log_override=False).dataset
    assert "the logged speed scaling never changes" in texts(found.card.warnings)[0]
    assert found.card.scaling_origin == "inferred"
    assert [one.places for one in found.card.executions] == [one.places for one in true.card.executions]
    lost = [one.tasks()["safety_loss_s"].sum() for one in (found, true)]
    assert lost[0] == pytest.approx(lost[1], rel=1e-3)
    assert found.tasks()["lost_slider_s"].sum() == 0.0


def test_a_robot_that_nobody_slows_keeps_its_logged_scaling(cells: Cells, tmp_path: Path):
    logs = with_override(cells.logs(SCENE, 2, with_operator=False), tmp_path / "logs", SET)
    for file in logs.rglob("cell.toml"):
        file.unlink()  # it names the reference runs
    ingest([logs], tmp_path / "dataset")
    found = Dataset.open(tmp_path / "dataset")
    assert found.card.scaling_origin == "logged"
    assert found.samples()["scaling"].drop_nulls().to_numpy() == pytest.approx(SET)
