"""The learned zones: how fast the model lets the robot go, for an operator on each square of the floor.

The picture belongs to the robot's position of the instant and moves with it. Only squares near which an operator was
ever logged are drawn: elsewhere the model would extrapolate. It is the prediction of the model, not a guarantee of the
safety system, and the name of the view says so.
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
"""The zones are drawn anew when so much time has passed and the tool has moved so far."""


class PredictsNow(Protocol):
    """What the replay needs of a trained model of problem `now`."""

    @property
    def problem(self) -> str:
        """Which question the model answers."""
        ...

    def predict(self, x: NDArray[np.float32], /) -> NDArray[np.floating]:
        """Speed scaling (N,) for robot and operator positions (N, 6), metres, base frame."""
        ...


@dataclass(frozen=True)
class FloorZones:
    """Learned zones on the floor.

    Attributes:
        centre_m: Centres of the squares, shape (C, 2), base frame.
        t_s: When they change, seconds of the execution, shape (U,).
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
    """Ask the model for the zones along one execution; None where robot or operator are unknown.

    Args:
        dataset: Says where operators were ever seen.
        model: Model of problem `now`.
        t_s: Times of the samples, shape (T,).
        robot_m: x_r, shape (T, 3), NaN = unknown.
        human_m: x_h, shape (T, 3), NaN = unknown; the operator's usual height is taken from it.
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
    """Return what of the model's rule lies still on the floor; distances to the TCP move with it and are not among it.

    Args:
        model: What answers for the model; shapes has only a rule.
        human_m: x_h, shape (T, 3), NaN = unknown: as far as he went edges that were never crossed are drawn.
    """
    seen = human_m[np.isfinite(human_m[:, 0]), :2]
    if not isinstance(model, RuleSafety) or not len(seen):
        return ()
    return tuple(shapes_of(model.rule, np.empty((0, 2)), within_m=float(np.abs(seen).max())))


def walked_squares(dataset: Dataset) -> NDArray[np.float64]:
    """Return the centres of all squares at or beside which an operator was logged, shape (C, 2), metres."""
    column, row = ((pl.col(f"human_{axis}_m") / SQUARE_M).floor().cast(pl.Int64) for axis in "xy")
    seen = dataset.scan_samples().select(column=column, row=row).drop_nulls().unique().collect().to_numpy()
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
