"""Limits of a path that hold in every repetition: the speed drops or rises at once, at the same place each time.

What every repetition shares looks like the program's own speed. But a program speeds up and slows down by the robot's
accelerations, and a limit that a controller carries out at once does not: to either side of such an edge the speed is
smooth, and between them it jumps. The jumps along a motion tell by which part of full speed each stretch runs. Limits
that come and go as gently as the robot accelerates do not show.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Floats, Points, Vector

NEAR_S, FAR_S = 0.03, 0.12
"""The speed before an edge, and after it, is that of a line through what is so far from it: the path is smoothed."""
LEAST_ROWS = 4
"""A line needs so many rows; slower logs show no edge."""
LEAST = 0.1
"""A jump is at least this part of the speed."""
BEYOND_S = 0.1
"""A jump is more than the robot changes its speed in so long."""
CLEAR = 6.0
"""A jump is so many standard deviations of what the lines miss."""
SLOW = 0.1
"""At less than this part of the greatest speed nothing is told."""
BEGUN = 0.9
"""Until it has this part of its greatest speed, a motion begins, and from then on where it ends."""
SAME = 0.03
"""Parts of full speed that differ by less are the same."""
_LARGE = 0.9  # quantile of accelerations


def limits_along(nominal_s: Vector, points: Points) -> Vector:
    """Return by which part of full speed each row of a path runs, shape (M,), in (0, 1]; 1 = no limit shows.

    Args:
        nominal_s: Nominal time, shape (M,), never decreasing, seconds: with the limits in it.
        points: Path, shape (M, D), in units of their noise.
    """
    none = np.ones(len(nominal_s))
    lasts_s = float(nominal_s[-1] - nominal_s[0])
    period = lasts_s / max(len(nominal_s) - 1, 1)
    rows, gap = (round(part / period) if period > 0.0 else 0 for part in (FAR_S - NEAR_S, NEAR_S))
    if rows < LEAST_ROWS or len(nominal_s) < 4 * (rows + gap):
        return none
    even = nominal_s[0] + period * np.arange(len(nominal_s))
    place = np.column_stack([np.interp(even, nominal_s, column) for column in points.T])
    speed = np.linalg.norm(np.gradient(place, period, axis=0), axis=1)
    edges = _edges(speed, rows, max(gap, 1), period)
    if not edges:
        return none
    heights = np.concatenate([[0.0], np.cumsum([height for _, height in edges])])
    part = np.exp(heights - heights.max())
    part = np.where(part > 1.0 - SAME, 1.0, part)
    at_s = even[[row for row, _ in edges]]
    return np.asarray(part[np.searchsorted(at_s, nominal_s, side="right")])


def _edges(speed: Vector, rows: int, gap: int, period: float) -> list[tuple[int, float]]:
    """Return the rows at which the speed (M,) jumps, and the logarithm of its ratio there."""
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
            np.maximum(LEAST * usual, BEYOND_S * gentle), CLEAR * np.maximum(missed_before, missed_after)
        )
        edge = (np.minimum(before, after) > SLOW * most) & (np.abs(jump) > least)
    found: list[tuple[int, float]] = []
    for first, end in np.flatnonzero(np.diff(np.pad(edge, 1).astype(np.int8))).reshape(-1, 2).tolist():
        sign = np.sign(jump[first:end].sum())
        steepest = first + int((sign * np.gradient(speed)[first:end]).argmax())
        found.append((steepest, float(np.log(after[steepest] / before[steepest]))))
    return found


def _lines(speed: Vector, rows: int, gap: int, period: float) -> tuple[Vector, Vector, Vector]:
    """Return where a line through `rows` rows that end `gap` rows before each row leads: value, slope, misfit.

    Each of shape (M,); NaN where there are no such rows.
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
