"""Computes learned zones: the scaling that the model predicts for an operator on each square of the floor.

Zones depend on the robot's position and change with it. Only squares near logged operators are used: elsewhere the
model would extrapolate. The zones are a prediction, not a guarantee of the safety system; the view's name says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import polars as pl

from cyclekit.dataset.unknown_height import inputs_in_plane
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.rules.shapes import RuleShape, shapes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset

SQUARE_M = 0.25
EVERY_S, MOVED_M = 0.35, 0.03
"""Zones are updated after at least this time, s, if the TCP has moved by at least this distance, m."""


class PredictsNow(Protocol):
    """Interface of a trained model of problem `now`."""

    @property
    def problem(self) -> str:
        """Problem of the model."""
        ...

    def predict(self, x: NDArray[np.float32], /) -> NDArray[np.floating]:
        """Return the scaling (N,) for positions of robot and operator (N, 6), m, base frame."""
        ...


@dataclass(frozen=True)
class FloorZones:
    """Learned zones on the floor.

    Attributes:
        centre_m: Centres of the squares, shape (C, 2), m, base frame.
        t_s: Times of the updates, seconds of the execution, shape (U,).
        scaling: Scaling for an operator on each square, shape (U, C), rounded to 0.01.
    """

    centre_m: NDArray[np.float64]
    t_s: NDArray[np.float64]
    scaling: NDArray[np.float64]


def learned_zones(
    dataset: Dataset,
    model: PredictsNow,
    t_s: NDArray[np.float64],
    robot_m: NDArray[np.float64],
    human_m: NDArray[np.float64],
) -> FloorZones | None:
    """Return the zones predicted along one execution; None if robot or operator are unknown.

    Args:
        dataset: Dataset with the logged positions of operators.
        model: Model of problem `now`.
        t_s: Times of the samples, shape (T,), s.
        robot_m: x_r, shape (T, 3), m; NaN = unknown.
        human_m: x_h, shape (T, 3), m; NaN = unknown. Its median height is used for all squares.
    """
    centre = walked_squares(dataset)
    heights = human_m[np.isfinite(human_m[:, 2]), 2]
    rows = _updates(t_s, robot_m)
    if not len(centre) or not np.isfinite(human_m[:, 0]).any() or not len(rows):
        return None
    height = float(np.median(heights)) if len(heights) else np.nan
    person = np.column_stack([centre, np.full(len(centre), height)])
    x = np.empty((len(rows) * len(centre), 6), dtype=np.float32)
    x[:, :3] = np.repeat(robot_m[rows], len(centre), axis=0)
    x[:, 3:] = np.tile(person, (len(rows), 1))
    x = inputs_in_plane(x)
    scaling = np.asarray(model.predict(x), dtype=np.float64).reshape(len(rows), len(centre))
    return FloorZones(centre, t_s[rows], np.round(scaling, 2))


def rule_shapes(model: PredictsNow | None, human_m: NDArray[np.float64]) -> tuple[RuleShape, ...]:
    """Return the static shapes of the model's rule on the floor, without distances to the TCP, which move.

    Args:
        model: The model; only one with a rule has shapes.
        human_m: x_h, shape (T, 3), m; NaN = unknown. Edges that were never crossed are drawn at its extremes.
    """
    seen = human_m[np.isfinite(human_m[:, 0]), :2]
    if not isinstance(model, RuleSafety) or not len(seen):
        return ()
    return tuple(shapes_of(model.rule, np.empty((0, 2)), within_m=float(np.abs(seen).max())))


def walked_squares(dataset: Dataset) -> NDArray[np.float64]:
    """Return the centres of all squares with a logged operator and of their neighbours, shape (C, 2), m."""
    column, row = ((pl.col(f"human_{axis}_m") / SQUARE_M).floor().cast(pl.Int64) for axis in "xy")
    seen = dataset.summed_up(lambda samples: samples.select(column=column, row=row).drop_nulls().unique()).to_numpy()
    if not len(seen):
        return np.empty((0, 2))
    around = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)])
    squares = np.unique((seen[:, None] + around).reshape(-1, 2), axis=0)
    return (squares + 0.5) * SQUARE_M


def _updates(t_s: NDArray[np.float64], robot_m: NDArray[np.float64]) -> NDArray[np.int64]:
    last_s, last_m = -np.inf, np.full(3, np.inf)
    rows = []
    for row in np.flatnonzero(np.isfinite(robot_m).all(axis=1)).tolist():
        if t_s[row] - last_s >= EVERY_S and np.abs(robot_m[row] - last_m).max() >= MOVED_M:
            rows.append(row)
            last_s, last_m = float(t_s[row]), robot_m[row]
    return np.array(rows, dtype=np.int64)
