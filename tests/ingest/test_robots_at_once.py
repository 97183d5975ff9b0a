"""Two robots that run at once are not one robot: their logs are named."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.ingest.ingest import ingest
from cyclekit_sim import simulate
from cyclekit_sim.options import SimulationOptions

if TYPE_CHECKING:
    from pathlib import Path


def two_robots(folder: Path, later_s: float) -> Path:
    """Log two robots since 1970, the second one this much later."""
    for number in (1, 2):
        one = folder / f"made_{number}"
        simulate("laser-zones", one, executions=3, seed=number, options=SimulationOptions(people="none"))
        (log,) = one.rglob("robot.csv")
        rows = pl.read_csv(log, separator=" ")
        since_s = pl.col("timestamp") - pl.col("timestamp").first() + 1.78e9 + later_s * (number - 1)
        (folder / "logs").mkdir(exist_ok=True)
        rows.with_columns(since_s).write_csv(folder / "logs" / f"robot_{number}.csv", separator=" ")
    return folder / "logs"


def test_robot_logs_of_the_same_time_are_named(tmp_path: Path) -> None:
    done = ingest([two_robots(tmp_path, 5.0)], tmp_path / "dataset")
    (said,) = [text for text in done.warnings if "robot logs of the same time" in text]
    assert "robot_1.csv" in said
    assert "robot_2.csv" in said
    assert "ignore" in said


def test_logs_of_one_robot_after_each_other_are_not(tmp_path: Path) -> None:
    done = ingest([two_robots(tmp_path, 50000.0)], tmp_path / "dataset")
    assert not [text for text in done.warnings if "robot logs of the same time" in text]
