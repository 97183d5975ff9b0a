"""Lost time by cause over all executions of a dataset, and rates of stops and of speed changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from cyclekit import schema

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

CAUSE_NAMES: Mapping[str, str] = {
    "person": "person near",
    "slider": "operator's speed slider",
    "input": "input, such as reduced mode",
    "limits": "limits of the path",
    "wait": "wait for operator, part or signal",
    "pause": "program paused",
    "stop": "protective stop",
    "unknown": "unknown cause",
}
"""Display names of LOST_CAUSES."""
COLUMNS = (
    *("execution", "scaling", "step", "lost_to", "robot_moving"),
    *("robot_x_m", "robot_y_m", "robot_z_m", "human_x_m", "human_y_m", "human_z_m"),
)
"""Columns of table SAMPLES that `lost_time` needs."""
_HALTED = 0.02


@dataclass(frozen=True)
class PersonLoss:
    """Time lost to people at one level, s, and the 5 and 95 % quantiles of the distance of robot and operator, m."""

    level: float
    lost_s: float
    nearest_m: float | None
    farthest_m: float | None


@dataclass(frozen=True)
class LostTime:
    """Lost time of a dataset.

    Attributes:
        seconds: Lost time by cause, s.
        duration_s: Total duration of the executions.
        stops_per_hour: Number of standstills between places per hour, by cause.
        changes_per_hour: Number of level changes of the speed scaling per hour.
        person: Time lost to people, by level.
    """

    seconds: Mapping[str, float]
    duration_s: float
    stops_per_hour: Mapping[str, float]
    changes_per_hour: float
    person: tuple[PersonLoss, ...]

    def share(self, cause: str) -> float:
        """Return the share of the executions' time lost to a cause."""
        return self.seconds[cause] / self.duration_s if self.duration_s > 0.0 else 0.0


def lost_time(
    tasks: pl.DataFrame, samples: pl.DataFrame, levels: Sequence[float], rate_hz: float, duration_s: float
) -> LostTime | None:
    """Return the lost time of a dataset; None if unknown.

    Args:
        tasks: Table TASKS of the robot.
        samples: Table SAMPLES, with at least COLUMNS.
        levels: Levels of the scaling, ascending.
        rate_hz: Rate of the samples.
        duration_s: Total duration of all executions.
    """
    if duration_s <= 0.0 or not tasks["lost_person_s"].count() + tasks["lost_wait_s"].count():
        return None
    seconds = {cause: float(tasks[f"lost_{cause}_s"].sum()) for cause in schema.LOST_CAUSES}
    same = pl.col("execution") == pl.col("execution").shift(1)
    halts = same & pl.col("robot_moving") & (pl.col("scaling") <= _HALTED) & (pl.col("scaling").shift(1) > _HALTED)
    stops = samples.filter(halts)["lost_to"].fill_null("unknown").value_counts(sort=True)
    held = samples.select("execution", "step").drop_nulls()
    changes = held.filter(same & (pl.col("step") != pl.col("step").shift(1))).height
    hours = duration_s / 3600.0
    return LostTime(
        seconds,
        duration_s,
        {str(cause): count / hours for cause, count in stops.rows()},
        changes / hours,
        _person(samples, levels, rate_hz),
    )


def _person(samples: pl.DataFrame, levels: Sequence[float], rate_hz: float) -> tuple[PersonLoss, ...]:
    ways = [(pl.col(f"robot_{axis}_m") - pl.col(f"human_{axis}_m").fill_null(0.0)) ** 2 for axis in "xyz"]
    distance = pl.when(pl.col("human_x_m").is_not_null()).then(pl.sum_horizontal(ways).sqrt())
    found = (
        samples.filter((pl.col("lost_to") == "person") & pl.col("step").is_not_null())
        .group_by("step")
        .agg(
            ((1.0 - pl.col("scaling")).sum() / rate_hz).alias("lost_s"),
            distance.quantile(0.05).alias("nearest_m"),
            distance.quantile(0.95).alias("farthest_m"),
        )
        .sort("step")
    )
    return tuple(
        PersonLoss(float(levels[row["step"]]), row["lost_s"], row["nearest_m"], row["farthest_m"])
        for row in found.iter_rows(named=True)
        if row["step"] < len(levels)
    )
