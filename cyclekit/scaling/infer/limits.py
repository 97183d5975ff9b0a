"""Limits of a path that hold in every repetition: the speed jumps at the same place each time.

A slow-down that every repetition shares looks like programmed speed. But programmed speed changes with the robot's
acceleration, while a limit that the controller applies at once makes the speed jump between two smooth parts. The
jumps along a motion give the share of full speed of each part. Limits that change as slowly as the robot accelerates
are not found. A limit leaves the direction as it is: where the path turns (a waypoint passed with a blend, a linear
approach before a joint motion) the speed jumps too, as other joints move, and this is no limit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Floats, Points, Vector

NEAR_S, FAR_S = 0.03, 0.12
"""Range of times from an edge, s, for the line that gives the speed on its side; nearer rows are smoothed."""
MIN_ROWS = 4
"""Minimum number of rows for a line; in slower logs, no edge is found."""
MIN_STEP = 0.1
"""Minimum jump, as share of the speed."""
BEYOND_S = 0.1
"""Minimum jump, as time, s, that the robot's acceleration would need for it."""
CLEAR = 6.0
"""Minimum jump, in standard deviations of the residuals of the lines."""
SLOW = 0.1
"""Minimum speed at a jump, as share of the maximum speed."""
BEGUN = 0.9
"""Share of the maximum speed at which the initial acceleration ends; likewise for the final deceleration."""
SAME = 0.03
"""Tolerance for equal shares of full speed."""
AHEAD = 0.98
"""Minimum cosine of the angle between the directions before and after a jump."""
_LARGE = 0.9  # quantile of accelerations


def limits_along(nominal_s: Vector, points: Points) -> Vector:
    """Return the share of full speed at each row of a path, shape (M,), in (0, 1]; 1 = no limit found.

    Args:
        nominal_s: Nominal time including the limits, shape (M,), never decreasing, s.
        points: Path, shape (M, D), in units of their noise.
    """
    none = np.ones(len(nominal_s))
    lasts_s = float(nominal_s[-1] - nominal_s[0])
    period = lasts_s / max(len(nominal_s) - 1, 1)
    rows, gap = (round(part / period) if period > 0.0 else 0 for part in (FAR_S - NEAR_S, NEAR_S))
    if rows < MIN_ROWS or len(nominal_s) < 4 * (rows + gap):
        return none
    even = nominal_s[0] + period * np.arange(len(nominal_s))
    place = np.column_stack([np.interp(even, nominal_s, column) for column in points.T])
    velocity = np.gradient(place, period, axis=0)
    gap = max(gap, 1)
    found = _edges(np.linalg.norm(velocity, axis=1), rows, gap, period)
    turns = [row for row, _ in found if not _goes_ahead(velocity, row, rows, gap)]
    edges = [edge for edge in found if all(abs(edge[0] - turn) > rows + gap for turn in turns)]
    if not edges:
        return none
    heights = np.concatenate([[0.0], np.cumsum([height for _, height in edges])])
    part = np.exp(heights - heights.max())
    part = np.where(part > 1.0 - SAME, 1.0, part)
    at_s = even[[row for row, _ in edges]]
    return np.asarray(part[np.searchsorted(at_s, nominal_s, side="right")])


def _edges(speed: Vector, rows: int, gap: int, period: float) -> list[tuple[int, float]]:
    """Return the rows at which the speed (M,) jumps, and the logarithm of the ratio of speeds."""
    before, before_slope, missed_before = _lines(speed, rows, gap, period)
    after, after_slope, missed_after = (values[::-1] for values in _lines(speed[::-1], rows, gap, period))
    most = float(np.quantile(speed, 0.98))
    begun = np.flatnonzero(speed >= BEGUN * most)[[0, -1]]
    gains, falls = before_slope[: begun[0] + rows], after_slope[begun[1] - rows :]
    gentle = max(float(np.quantile(some[some > 0.0], _LARGE)) if (some > 0.0).any() else 0.0 for some in (gains, falls))
    jump = after - before
    usual = np.maximum(before, after)
    with np.errstate(invalid="ignore"):
        least = np.maximum(
            np.maximum(MIN_STEP * usual, BEYOND_S * gentle), CLEAR * np.maximum(missed_before, missed_after)
        )
        edge = (np.minimum(before, after) > SLOW * most) & (np.abs(jump) > least)
    found: list[tuple[int, float]] = []
    for first, end in np.flatnonzero(np.diff(np.pad(edge, 1).astype(np.int8))).reshape(-1, 2).tolist():
        sign = np.sign(jump[first:end].sum())
        steepest = first + int((sign * np.gradient(speed)[first:end]).argmax())
        found.append((steepest, float(np.log(after[steepest] / before[steepest]))))
    return found


def _goes_ahead(velocity: Points, row: int, rows: int, gap: int) -> bool:
    """Return whether a path, with velocities (M, D), keeps its direction at a row, from lines on both sides of it."""
    sides = velocity[max(row - gap - rows + 1, 0) : row - gap + 1], velocity[row + gap : row + gap + rows][::-1]
    if min(map(len, sides)) < 2:
        return False
    ends = []
    for side in sides:
        steps = np.arange(-len(side) - gap + 1, 1 - gap)
        ends.append(np.polyfit(steps, side, 1)[1])
    lengths = [float(np.linalg.norm(end)) for end in ends]
    return min(lengths) > 0.0 and float(ends[0] @ ends[1]) >= AHEAD * lengths[0] * lengths[1]


def _lines(speed: Vector, rows: int, gap: int, period: float) -> tuple[Vector, Vector, Vector]:
    """Return value, slope and residual at each row of the line through the `rows` rows that end `gap` rows before it.

    Each of shape (M,); NaN where there are too few rows.
    """
    offsets = np.arange(-rows - gap + 1, 1 - gap) * period
    basis = np.column_stack([np.ones(rows), offsets])
    fit = np.linalg.pinv(basis)
    windows: Floats = np.lib.stride_tricks.sliding_window_view(speed, rows)
    line = windows @ fit.T
    missed = np.sqrt(((windows - line @ basis.T) ** 2).sum(axis=1) / max(rows - 2, 1))
    count = len(speed) - rows - gap + 1
    shifted = np.full((3, len(speed)), np.nan)
    shifted[:, rows + gap - 1 :] = np.array([line[:count, 0], line[:count, 1], missed[:count]])
    return shifted[0], shifted[1], shifted[2]


__all__ = ["limits_along"]
