"""Two robots that run at once are not one robot: their logs are named."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells


def two_robots(cells: Cells, folder: Path, later_s: float) -> Path:
    """Log two robots since 1970, the second one this much later."""
    for number in (1, 2):
        (log,) = cells.logs("laser-zones", 2, seed=number, people="none").rglob("robot.csv")
        rows = pl.read_csv(log, separator=" ")
        since_s = pl.col("timestamp") - pl.col("timestamp").first() + 1.78e9 + later_s * (number - 1)
        (folder / "logs").mkdir(exist_ok=True)
        rows.with_columns(since_s).write_csv(folder / "logs" / f"robot_{number}.csv", separator=" ")
    return folder / "logs"


def test_robot_logs_of_the_same_time_are_named(cells: Cells, tmp_path: Path) -> None:
    done = ingest([two_robots(cells, tmp_path, 5.0)], tmp_path / "dataset")
    (said,) = [text for text in done.warnings if "robot logs of the same time" in text]
    assert "robot_1.csv" in said
    assert "robot_2.csv" in said
    assert "ignore" in said


def test_local_times_without_a_zone_name_them_too(cells: Cells, tmp_path: Path) -> None:
    folder = two_robots(cells, tmp_path, 5.0)
    for log in sorted(folder.iterdir()):
        rows = pl.read_csv(log, separator=" ")
        local = pl.from_epoch((pl.col("timestamp") * 1e3).cast(pl.Int64), "ms").dt.strftime("%Y-%m-%d %H:%M:%S%.3f")
        places = [pl.col(f"actual_TCP_pose_{k}").alias(axis) for k, axis in enumerate("xyz")]
        rows.select(local.alias("when"), *places, "speed_scaling").write_csv(log)
    keys = 'time = "when"\ntime_format = "iso"\nx = "x"\ny = "y"\nz = "z"\nscaling = "speed_scaling"\n'
    source = '[[sources]]\npath = "robot_*.csv"\nadapter = "csv"\nrole = "robot"\n\n[sources.map]\n'
    (folder / "cell.toml").write_text(f'name = "two robots"\n\n{source}{keys}')
    done = ingest([folder], tmp_path / "dataset")
    assert [text for text in done.warnings if "robot logs of the same time" in text]


def test_logs_of_one_robot_after_each_other_are_not(cells: Cells, tmp_path: Path) -> None:
    done = ingest([two_robots(cells, tmp_path, 50000.0)], tmp_path / "dataset")
    assert not [text for text in done.warnings if "robot logs of the same time" in text]
