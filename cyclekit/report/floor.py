"""The floor plan: operator positions, where time was lost, and the robot speed by operator position.

Squares of a grid in the base frame, computed from the samples. The zones come from the model, or from the log
without a model. `maps` draws them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.rules.shapes import RuleShape, shapes_of
from cyclekit.plots.labels import CellOnFloor
from cyclekit.report.findings import sample_s, slowed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.report.findings import Predicts

CELL_M = 0.2
MIN_SAMPLES = 10
"""Squares with fewer operator samples are left out of the zone map."""

ROBOT_SPOTS = 150


@dataclass(frozen=True)
class FloorPlan:
    """Floor plan; all squares have the side `cell_m`, all positions are metres in the base frame.

    Attributes:
        seen: Squares with an operator: x, y, seconds per execution; shape (C, 3).
        lost: Squares with time lost: x, y, seconds per execution, mean scaling during that time; shape (L, 4).
        zones: Squares with the mean scaling for an operator there, over the robot's path: x, y, scaling; shape (Z, 3).
        zones_of_model: True if the model predicted the zones, False if they are means of the log.
        robot_m: Tool path of one execution, shape (R, 2), NaN where unknown.
        robot_known: False without a robot log; the position of the base is then not drawn.
        cell: Places and furniture.
        shapes: The model's rule as outlines, if it has one.
        cell_m: Side of a square.
    """

    seen: NDArray[np.float64]
    lost: NDArray[np.float64]
    zones: NDArray[np.float64]
    zones_of_model: bool
    robot_m: NDArray[np.float64]
    robot_known: bool
    cell: CellOnFloor
    shapes: tuple[RuleShape, ...] = ()
    cell_m: float = CELL_M


def floor_plan(dataset: Dataset, samples: pl.DataFrame, model: Predicts | None = None) -> FloorPlan | None:
    """Put the samples on the floor plan; None where no operator position is known.

    Args:
        dataset: Names the places.
        samples: Samples of all executions.
        model: Model of problem `now`; others are ignored.
    """
    seen = samples.filter(pl.col("human_x_m").is_not_null() & pl.col("human_y_m").is_not_null())
    if seen.is_empty():
        return None
    column, row = ((pl.col(f"human_{axis}_m") / CELL_M).floor() for axis in "xy")
    seen = seen.with_columns(column=column, row=row)
    per = sample_s(samples) / max(1, dataset.executions.height)
    lost = seen.filter(slowed())
    usable = model if model is not None and model.problem == "now" else None
    first = samples.filter(pl.col("execution") == samples["execution"][0])
    robot_m = first.sort("t_s").select("robot_x_m", "robot_y_m").to_numpy().astype(np.float64)
    squares = _squares(seen, (pl.len() * per).alias("s"))
    return FloorPlan(
        seen=squares,
        lost=_squares(lost, ((1 - pl.col("scaling")).sum() * per).alias("s"), pl.mean("scaling")),
        zones=_of_model(usable, seen) if usable else _of_log(seen),
        zones_of_model=usable is not None,
        robot_m=robot_m,
        robot_known=has_robot(samples),
        cell=CellOnFloor(dataset.places, dataset.human_places, dataset.furniture),
        shapes=_shapes(usable, robot_m, squares),
    )


def _shapes(model: Predicts | None, robot_m: NDArray[np.float64], seen: NDArray[np.float64]) -> tuple[RuleShape, ...]:
    if not isinstance(model, RuleSafety):
        return ()
    return tuple(shapes_of(model.rule, robot_m, within_m=float(np.abs(seen[:, :2]).max())))


def has_robot(samples: pl.DataFrame) -> bool:
    """Tell whether any sample holds robot data."""
    return any(samples[name].count() > 0 for name in ("robot_x_m", "robot_moving", "scaling"))


def _squares(rows: pl.DataFrame, *values: pl.Expr) -> NDArray[np.float64]:
    found = rows.group_by("column", "row").agg(*values).sort("column", "row").to_numpy().astype(np.float64)
    found[:, :2] = (found[:, :2] + 0.5) * CELL_M
    return found


def _of_log(seen: pl.DataFrame) -> NDArray[np.float64]:
    known = seen.filter(pl.col("robot_moving") & pl.col("scaling").is_not_null())
    found = _squares(known, pl.mean("scaling"), pl.len().alias("count"))
    return found[found[:, 3] >= MIN_SAMPLES, :3]


def _of_model(model: Predicts, seen: pl.DataFrame) -> NDArray[np.float64]:
    """Mean prediction over the robot's path, for an operator of median height in each square."""
    robot = seen.filter(pl.col("robot_moving")).select("robot_x_m", "robot_y_m", "robot_z_m").drop_nulls()
    squares = _squares(seen, pl.len().alias("count"))
    squares = squares[squares[:, 2] >= MIN_SAMPLES]
    if robot.is_empty() or not len(squares):
        return np.empty((0, 3))
    spots = robot.gather_every(max(1, robot.height // ROBOT_SPOTS)).to_numpy()
    height = seen["human_z_m"].median()
    x = np.empty((len(squares) * len(spots), 6), dtype=np.float32)
    x[:, :3] = np.tile(spots, (len(squares), 1))
    x[:, 3:5] = np.repeat(squares[:, :2], len(spots), axis=0)
    x[:, 5] = height if isinstance(height, int | float) else x[:, 2]
    scaling = np.asarray(model.predict(x), dtype=np.float64).reshape(len(squares), len(spots)).mean(axis=1)
    return np.column_stack([squares[:, :2], scaling])
