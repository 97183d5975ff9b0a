"""A motion's path in nominal time, and the position of another repetition along it.

Points are joint angles if logged, else TCP positions, each coordinate divided by its noise, so that distances are in
standard deviations. Repetitions are matched by place, never by time: a robot that stops, is slowed, or blends a corner
slightly differently is still on its path. Its speed along the path is computed by `rate_along_path`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter1d

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Points, Vector


SMOOTH_S = 0.024
"""Half width of the smoothing window, s: a cubic over 48 ms follows any jerk-limited motion."""
COARSE_S = 0.04
"""Period of the coarse matching, s."""
COARSE_POINTS = 256
HALT_S = 0.1
"""Time before and after a row, s, within which a stopped robot moves no farther than its noise."""
VAGUE_S = 0.002
"""Maximum standard deviation of nominal time by noise, s; above, the robot is nearly at rest and its place unknown."""
RENEWED_S = 0.025
"""Maximum update period of positions by any controller, s; positions equal for longer are a standstill."""
FITS = 2.0
"""Maximum distance from the path, in units of noise, without additional variance. Larger ones occur at a stop in
mid-motion, where few rows are logged and the path bends between them."""
_NEWTON = 4


@dataclass(frozen=True)
class Path:
    """A motion from start to goal.

    Attributes:
        own_s: Time along the repetition it was made from, without stops, shape (M,), strictly increasing, s.
        nominal_s: Nominal time, shape (M,), never decreasing, s.
        points: Smoothed points, shape (M, D), in units of their noise.
        slope: Derivatives of the points by `own_s`, shape (M, D).
        misfit: Local distance of the smoothed points from the logged ones, shape (M,), in units of the noise.
    """

    own_s: Vector
    nominal_s: Vector
    points: Points
    slope: Points
    misfit: Vector

    @property
    def length(self) -> float:
        """Length of the path, in units of the noise."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    def retimed(self, nominal_s: Vector) -> Path:
        """Return the path with other nominal times, shape (M,)."""
        return replace(self, nominal_s=nominal_s)


def path_of(t_s: Vector, points: Points) -> Path:
    """Return the path of one repetition, with its own time as nominal time.

    Args:
        t_s: Time, shape (T,), strictly increasing, s.
        points: Shape (T, D), in units of their noise.
    """
    fresh = np.concatenate([[True], (np.diff(points, axis=0) != 0).any(axis=1)])
    fresh[-1] = True
    t, x = t_s[fresh], points[fresh]
    period = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    going = ~_halted(t, x, period)
    step = np.where(going[1:], np.diff(t), 0.0)
    going[0] = True
    own = np.concatenate([[0.0], np.cumsum(step)])[going]
    x = x[going]
    even = np.arange(max(round(own[-1] / period), 1) + 1) * (own[-1] / max(round(own[-1] / period), 1))
    x = np.column_stack([np.interp(even, own, column) for column in x.T])
    half = max(2, round(SMOOTH_S / max(period, 1e-4)))
    smooth, slope = _smoothed(x, half, float(even[1] - even[0]))
    misfit = maximum_filter1d(np.linalg.norm(smooth - x, axis=1) / np.sqrt(x.shape[1]), 2 * half + 1)
    return Path(even, even, smooth, slope, misfit)


def _halted(t_s: Vector, points: Points, period_s: float) -> Bools:
    half = max(1, round(HALT_S / period_s))
    row = np.arange(len(t_s))
    after, before = np.minimum(row + half, len(t_s) - 1), np.maximum(row - half, 0)
    moved = np.linalg.norm(points[after] - points[before], axis=1)
    return np.asarray(moved < 4.0 * np.sqrt(points.shape[1]))


def _smoothed(points: Points, half: int, period_s: float) -> tuple[Points, Points]:
    """Return a cubic fit around each row and its derivative (Savitzky and Golay 1964); one-sided at the ends."""
    count = len(points)
    half = min(half, (count - 1) // 2)
    if half < 2:
        slope = np.gradient(points, period_s, axis=0) if count > 1 else np.zeros_like(points)
        return points, np.asarray(slope)
    smooth, slope = np.empty_like(points), np.empty_like(points)
    offsets = np.arange(-half, half + 1) / half
    basis = np.linalg.pinv(np.vander(offsets, 4, increasing=True))  # (4, 2 half + 1)
    stretches = np.lib.stride_tricks.sliding_window_view(points, 2 * half + 1, axis=0)  # (N, D, 2 half + 1)
    smooth[half : count - half] = stretches @ basis[0]
    slope[half : count - half] = stretches @ basis[1] / (half * period_s)
    powers = np.vander(offsets, 4, increasing=True)
    rates = np.column_stack([np.zeros(len(offsets)), np.vander(offsets, 3, increasing=True) * [1.0, 2.0, 3.0]])
    for edge, inside in ((slice(0, half), slice(0, half)), (slice(count - half, count), slice(half + 1, None))):
        cubic = basis @ (stretches[0] if edge.start == 0 else stretches[-1]).T  # (4, D)
        smooth[edge], slope[edge] = powers[inside] @ cubic, rates[inside] @ cubic / (half * period_s)
    return smooth, slope


@dataclass(frozen=True)
class PathMatch:
    """Position of a repetition along a path, row by row.

    Attributes:
        own_s: Time of the path at each row, shape (T,), s.
        variance_s2: Its variance by the noise of the points, shape (T,), s²; infinite where the path is too slow.
        off: Distance from the path, shape (T,), in units of the noise.
    """

    own_s: Vector
    variance_s2: Vector
    off: Vector


def match_to_path(path: Path, t_s: Vector, points: Points) -> PathMatch:
    """Return the position of each row of a repetition along a path.

    Args:
        path: The path.
        t_s: Time, shape (T,), strictly increasing, s.
        points: Shape (T, D), in units of their noise.
    """
    own = _coarse(path, t_s, points)
    for _ in range(_NEWTON):
        x, slope = _at(path, own)
        speed2 = np.einsum("td,td->t", slope, slope)
        step = np.einsum("td,td->t", points - x, slope) / np.maximum(speed2, 1.0 / VAGUE_S**2)
        own = np.clip(own + np.clip(step, -COARSE_S, COARSE_S), path.own_s[0], path.own_s[-1])
    x, slope = _at(path, own)
    speed2 = np.einsum("td,td->t", slope, slope)
    variance = np.divide(1.0, speed2, out=np.full(len(own), np.inf), where=speed2 > 1.0 / VAGUE_S**2)
    variance[_written_twice(t_s, points) & np.isfinite(variance)] = np.inf
    off = np.linalg.norm(points - x, axis=1)
    misfit = np.maximum(np.interp(own, path.own_s, path.misfit), off / np.sqrt(points.shape[1]))
    return PathMatch(own, variance * (1.0 + np.maximum(misfit**2 - FITS**2, 0.0)), off)


def _written_twice(t_s: Vector, points: Points) -> Bools:
    """Return which rows repeat the one before because the recorder is faster than the controller, shape (T,)."""
    repeated = np.concatenate([[False], (np.diff(points, axis=0) == 0).all(axis=1)])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], repeated, [False]]).astype(np.int8))).reshape(-1, 2)
    for first, end in edges[t_s[edges[:, 1] - 1] - t_s[np.maximum(edges[:, 0] - 1, 0)] > RENEWED_S].tolist():
        repeated[first:end] = False
    return np.asarray(repeated)


def _at(path: Path, own_s: Vector) -> tuple[Points, Points]:
    """Return points and derivatives at times of the path: cubic (Hermite) between its rows."""
    period = float(path.own_s[1] - path.own_s[0])
    row = np.clip((own_s / period).astype(np.int64), 0, len(path.own_s) - 2)
    u = (own_s / period - row)[:, None]
    a, b, va, vb = path.points[row], path.points[row + 1], path.slope[row] * period, path.slope[row + 1] * period
    c2, c3 = 3 * (b - a) - 2 * va - vb, 2 * (a - b) + va + vb
    return a + u * (va + u * (c2 + u * c3)), (va + u * (2 * c2 + 3 * u * c3)) / period


def _coarse(path: Path, t_s: Vector, points: Points) -> Vector:
    """Match some rows to points of the path by dynamic programming: never backwards, with minimum total distance."""
    count = len(t_s)
    picked = np.unique(np.minimum(np.searchsorted(t_s, np.arange(t_s[0], t_s[-1] + COARSE_S, COARSE_S)), count - 1))
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.points, axis=0), axis=1))])
    way = length / length[-1] + path.own_s / path.own_s[-1]  # even in length and time: its ends are slow
    knots = np.interp(np.linspace(0.0, 2.0, COARSE_POINTS), way, path.own_s)
    spots, _ = _at(path, knots)
    seen = points[picked]
    distance = np.maximum((seen**2).sum(1)[:, None] + (spots**2).sum(1)[None] - 2.0 * seen @ spots.T, 0.0)
    distance[0, 1:] += distance.max()  # both go from start to goal
    best = np.empty((len(picked), COARSE_POINTS))
    best[0] = distance[0]
    for k in range(1, len(picked)):
        best[k] = np.minimum.accumulate(best[k - 1]) + distance[k]
    spot = np.empty(len(picked), np.int64)
    spot[-1] = COARSE_POINTS - 1
    for k in range(len(picked) - 2, -1, -1):
        spot[k] = int(best[k, : spot[k + 1] + 1].argmin())
    return np.interp(t_s, t_s[picked], knots[spot])
