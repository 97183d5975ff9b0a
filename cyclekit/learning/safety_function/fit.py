"""Finds the gamma(x_r, x_h) that explains the scaling, and the values of gamma at which the level changes.

Candidates are distances (of the TCP in space and on the floor, of the robot's base) and the operator's place on the
floor alone. Each is judged by the share of the scaling's variance that its best staircase explains.

With exact positions, the staircase with the smallest error gives the thresholds to the millimetre. With noise it is
biased, because more samples cross a threshold by noise from the side where the operator is more often. The times at
which the level changes are known from the scaling alone, so the mean of the noisy distances at these times is the
threshold (`crossings`); if both differ, `crossings` is used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.networks.comparison import fit_thresholds
from cyclekit.learning.rules.samples.distances import DISTANCES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Bools, Floats, Ints, Vector


FLOOR_M = 0.2
"""Width of a cell of the floor, m."""
RESAMPLES = 40
MAX_ROWS = 60_000
CROSSINGS = 60
"""Minimum number of changes of the level to locate a threshold."""
AROUND_S, FASTEST_M_S, BEND_M = 0.25, 4.0, 0.1
"""Half of the time over which speeds at a change are averaged, s; maximum walking speed, m/s; and maximum median
curvature over four samples, m, above which positions are too sparse or too noisy to interpolate."""
BETWEEN = 0.05
"""Systematic error of the mean of crossings, as a share of the distance moved in a sampling interval, because the exact
time of a change is unknown; up to 0.03 on simulated cells."""
MOVING_M_S = 0.2
"""Minimum rate of change of the distance, m/s, that counts as approaching or leaving."""


@dataclass(frozen=True)
class ScalingSamples:
    """Logged samples: x_r and x_h (N, 3), m; s (N,); execution number (N,); session time (N,)."""

    robot_m: Floats
    human_m: Floats
    scaling: Vector
    execution: Ints
    t_s: Vector

    def of(self, rows: Ints | Bools) -> ScalingSamples:
        """Return a subset of the samples."""
        return ScalingSamples(*(part[rows] for part in vars(self).values()))


@dataclass(frozen=True)
class Threshold:
    """Threshold between one level and the next, with 95 % confidence interval, m; bounds NaN if unknown."""

    slower: float
    faster: float
    metres: float
    low: float
    high: float


def explained(scaling: Vector, predicted: Vector) -> float:
    """Return the share of the scaling's variance that a prediction explains; negative if worse than the mean."""
    around = float(np.mean((scaling - scaling.mean()) ** 2))
    return 1.0 - float(np.mean((scaling - predicted) ** 2)) / around if around > 0 else 0.0


def by_distance(rows: ScalingSamples, levels: Sequence[float], distance: str) -> tuple[Vector, float]:
    """Return the best thresholds on a distance, shape (P - 1,), m, and the variance share that they explain."""
    gamma = DISTANCES[distance](rows.robot_m, rows.human_m)
    cuts = fit_thresholds(gamma, rows.scaling, levels)
    return cuts, explained(rows.scaling, np.array(levels)[np.searchsorted(cuts, gamma, side="right")])


def by_place(rows: ScalingSamples) -> float:
    """Return the variance share explained by the operator's floor cell, cross-validated between executions."""
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


def floor_cells(human_m: Floats) -> Ints:
    """Return the floor cell of each position, shape (N, 2), FLOOR_M wide."""
    return np.asarray(np.floor(human_m[:, :2] / FLOOR_M).astype(np.int64))


def thresholds(rows: ScalingSamples, levels: Sequence[float], distance: str, *, seed: int = 0) -> list[Threshold]:
    """Return the thresholds on a distance with confidence intervals from resampled executions.

    Thresholds of the staircase with the smallest error; those of the crossings if at least one of these contradicts it.
    """
    best, _ = by_distance(rows, levels, distance)
    rng = np.random.default_rng(seed)
    by_execution = [np.flatnonzero(rows.execution == e) for e in np.unique(rows.execution)]
    picks = [rng.integers(0, len(by_execution), len(by_execution)) for _ in range(RESAMPLES)]
    drawn = []
    for pick in picks:
        some = np.concatenate([by_execution[i] for i in pick.tolist()])
        if some.size > MAX_ROWS:
            some = rng.choice(some, MAX_ROWS)
        drawn.append(by_distance(rows.of(some), levels, distance)[0])
    low, high = np.quantile(np.array(drawn), (0.025, 0.975), axis=0, method="nearest")
    crossed = crossings(rows, levels, distance)
    fitted = [
        Threshold(levels[i], levels[i + 1], float(best[i]), float(low[i]), float(high[i])) for i in range(len(best))
    ]
    others = [_by_crossings(entry, crossed.of(i), picks) for i, entry in enumerate(fitted)]
    if any(not other.low <= entry.metres <= other.high for entry, other in zip(fitted, others, strict=True) if other):
        return [other or entry for entry, other in zip(fitted, others, strict=True)]
    return fitted


@dataclass(frozen=True)
class Crossings:
    """Times at which the level changed by one.

    Attributes:
        threshold: Number of the threshold that was crossed, shape (N,).
        metres: Distance in the middle of the sampling interval, corrected for curvature, shape (N,).
        speed_m_s: Rate of change of the distance, shape (N,).
        way_m: Change of the distance in the sampling interval, shape (N,).
        execution: Number of the execution from 0, shape (N,).
    """

    threshold: Ints
    metres: Vector
    speed_m_s: Vector
    way_m: Vector
    execution: Ints

    def of(self, threshold: int) -> Crossings:
        """Return the crossings of one threshold."""
        mine = self.threshold == threshold
        return Crossings(*(part[mine] for part in vars(self).values()))

    def metres_at_rest(self, times: Ints | None = None) -> float:
        """Return the distance at which the level changes at speed zero; weights `times`, shape (N,), default 1.

        A latency or clock error shifts each crossing by that time multiplied by its speed, so a straight line over the
        speed is fitted, without crossings that deviate by more than three standard deviations.
        """
        counts = np.ones(len(self.metres)) if times is None else times
        near = counts > 0
        at_rest, late_s = float("nan"), 0.0
        for _ in range(5):
            weight = np.sqrt(counts[near])
            columns = np.column_stack([weight, self.speed_m_s[near] * weight])
            at_rest, late_s = np.linalg.lstsq(columns, self.metres[near] * weight, rcond=None)[0].tolist()
            off = np.abs(self.metres - at_rest - late_s * self.speed_m_s)
            near = (counts > 0) & (off <= 3 * 1.4826 * np.median(off[near]) + 1e-9)
        return float(at_rest)


def crossings(rows: ScalingSamples, levels: Sequence[float], distance: str) -> Crossings:
    """Return the changes of the level by one between two consecutive samples of an execution."""
    gamma = DISTANCES[distance](rows.robot_m, rows.human_m)
    step = np.abs(rows.scaling[:, None] - np.array(levels)).argmin(axis=1)
    number = np.unique(rows.execution, return_inverse=True)[1].ravel()
    took_s = np.diff(rows.t_s)
    period_s = float(np.median(took_s[took_s > 0])) if (took_s > 0).any() else 1.0
    around = max(2, round(AROUND_S / period_s))
    at = np.flatnonzero((np.abs(np.diff(step)) == 1) & (np.abs(np.diff(gamma)) <= FASTEST_M_S * period_s))
    at = at[(at >= around - 1) & (at + around < len(gamma))]
    first, last = at - around + 1, at + around
    whole = (number[first] == number[last]) & (rows.t_s[last] - rows.t_s[first] < (2 * around - 0.5) * period_s)
    at, first, last = at[whole], first[whole], last[whole]
    bend = (gamma[at - 1] - gamma[at] - gamma[at + 1] + gamma[at + 2]) / 2
    if len(at) and np.median(np.abs(bend)) > BEND_M:
        at, bend, first, last = at[:0], bend[:0], first[:0], last[:0]
    return Crossings(
        threshold=np.minimum(step[at], step[at + 1]),
        metres=(gamma[at] + gamma[at + 1]) / 2 - bend / 12,
        speed_m_s=(gamma[last] - gamma[first]) / (rows.t_s[last] - rows.t_s[first]),
        way_m=np.abs(gamma[at + 1] - gamma[at]),
        execution=number[at],
    )


def _by_crossings(fitted: Threshold, crossed: Crossings, picks: Sequence[Ints]) -> Threshold | None:
    """Return the threshold and its interval by its crossings; None if these are too few."""
    drawn = []
    for pick in picks if len(crossed.metres) >= CROSSINGS else ():
        times = np.bincount(pick, minlength=len(pick))[crossed.execution]
        if (times > 0).sum() >= CROSSINGS // 2:
            drawn.append(crossed.metres_at_rest(times))
    if not drawn or not np.isfinite(fitted.metres):
        return None
    metres, slack = crossed.metres_at_rest(), BETWEEN * float(np.median(crossed.way_m))
    low, high = np.quantile(drawn, (0.025, 0.975), method="nearest").tolist()
    return replace(fitted, metres=metres, low=min(low, metres) - slack, high=max(high, metres) + slack)


def hysteresis(rows: ScalingSamples, levels: Sequence[float], distance: str) -> float | None:
    """Return how much farther out the level rises than it falls, median over the thresholds, m.

    Thresholds are fitted to samples where the distance grows and where it shrinks. A latency has the same effect: it
    adds itself times twice the speed of approach. None if there are too few of either, or if a level is never used.
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
    return float(np.median(out[known] - into[known])) if known.any() else None
