"""Which gamma(x_r, x_h) explains the scaling, and at which values of it the level changes.

Candidates are distances (of the TCP in space and on the floor, of the robot's base) and the operator's place on the
floor alone. Each is judged by the part of the scaling's variance that its best staircase explains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.evaluate.baselines import fit_thresholds

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

FLOOR_M = 0.2
"""Edge of a cell of the floor."""
RESAMPLES = 40
MOST_ROWS = 60_000
MOVING_M_S = 0.2
"""A distance that changes faster than this is approaching or leaving."""

DISTANCES: Mapping[str, Callable[[NDArray[np.float64], NDArray[np.float64]], Vector]] = {
    "distance TCP to operator": lambda robot, human: _norm(robot - human),
    "distance TCP to operator on the floor": lambda robot, human: _norm((robot - human)[:, :2]),
    "distance robot base to operator on the floor": lambda _robot, human: _norm(human[:, :2]),
}
"""Distances gamma by name, of TCP (N, 3) and operator (N, 3) in the base frame, m."""


@dataclass(frozen=True)
class Rows:
    """Logged samples: x_r and x_h (N, 3), m; s (N,); execution number (N,); session time (N,)."""

    robot_m: NDArray[np.float64]
    human_m: NDArray[np.float64]
    scaling: Vector
    execution: NDArray[np.int64]
    t_s: Vector

    def of(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Rows:
        """Return some rows."""
        return Rows(*(part[rows] for part in vars(self).values()))


@dataclass(frozen=True)
class Threshold:
    """Where the scaling changes from one level to the next: value and 95 % interval, m; NaN bounds where unknown."""

    slower: float
    faster: float
    metres: float
    low: float
    high: float


def explained(scaling: Vector, predicted: Vector) -> float:
    """Return the part of the scaling's variance that a prediction explains; negative: worse than the mean."""
    around = float(np.mean((scaling - scaling.mean()) ** 2))
    return 1.0 - float(np.mean((scaling - predicted) ** 2)) / around if around > 0 else 0.0


def by_distance(rows: Rows, levels: Sequence[float], distance: str) -> tuple[Vector, float]:
    """Return the best thresholds on a distance, shape (P - 1,), m, and what their staircase explains."""
    gamma = DISTANCES[distance](rows.robot_m, rows.human_m)
    cuts = fit_thresholds(gamma, rows.scaling, levels)
    return cuts, explained(rows.scaling, np.array(levels)[np.searchsorted(cuts, gamma, side="right")])


def by_place(rows: Rows) -> float:
    """Return what the operator's place on the floor explains: the mean of each cell, judged by other executions."""
    cell = floor_cells(rows.human_m)
    _, code = np.unique(cell, axis=0, return_inverse=True)
    code = code.ravel()
    odd = rows.execution % 2 == 1
    predicted = np.full(len(code), rows.scaling.mean())
    for judge in (odd, ~odd):
        count = np.bincount(code[~judge], minlength=code.max() + 1)
        total = np.bincount(code[~judge], rows.scaling[~judge], minlength=code.max() + 1)
        means = np.where(count > 0, total / np.maximum(count, 1), rows.scaling.mean())
        predicted[judge] = means[code[judge]]
    return explained(rows.scaling, predicted)


def floor_cells(human_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the cell of the floor of each position, shape (N, 2), FLOOR_M wide."""
    return np.asarray(np.floor(human_m[:, :2] / FLOOR_M).astype(np.int64))


def thresholds(rows: Rows, levels: Sequence[float], distance: str, *, seed: int = 0) -> list[Threshold]:
    """Return the thresholds on a distance with their intervals: executions drawn again, and half the sampling step."""
    best, _ = by_distance(rows, levels, distance)
    rng = np.random.default_rng(seed)
    by_execution = [np.flatnonzero(rows.execution == e) for e in np.unique(rows.execution)]
    drawn = []
    for _ in range(RESAMPLES):
        pick = rng.integers(0, len(by_execution), len(by_execution))
        some = np.concatenate([by_execution[i] for i in pick.tolist()])
        if some.size > MOST_ROWS:
            some = rng.choice(some, MOST_ROWS)
        drawn.append(by_distance(rows.of(some), levels, distance)[0])
    low, high = np.quantile(np.array(drawn), (0.025, 0.975), axis=0, method="nearest")
    return [
        Threshold(levels[i], levels[i + 1], float(best[i]), float(low[i]), float(high[i])) for i in range(len(best))
    ]


def hysteresis(rows: Rows, levels: Sequence[float], distance: str) -> float | None:
    """Return how much farther out the level rises than it falls, median over the thresholds, m.

    From thresholds fitted to samples where the distance grows and where it shrinks. A latency looks the same: it adds
    itself times twice the speed of approach. None where either kind is rare or a level is never used.
    """
    gamma = DISTANCES[distance](rows.robot_m, rows.human_m)
    step = np.diff(gamma, prepend=np.nan)
    took_s = np.where(np.diff(rows.execution, prepend=-1) != 0, np.nan, np.diff(rows.t_s, prepend=np.nan))
    broken = ~(took_s <= 1.5 * np.nanmedian(took_s)) if np.isfinite(took_s).any() else np.ones(len(step), np.bool_)
    speed = np.where(broken, np.nan, step) / took_s
    leaving, coming = speed > MOVING_M_S, speed < -MOVING_M_S
    if min(leaving.sum(), coming.sum()) < 500:
        return None
    out, into = (by_distance(rows.of(part), levels, distance)[0] for part in (leaving, coming))
    known = np.isfinite(out) & np.isfinite(into)
    return float(np.median((out - into)[known])) if known.any() else None


def _norm(way: NDArray[np.float64]) -> Vector:
    return np.asarray(np.linalg.norm(way, axis=1))
