"""Rate at which a path's nominal time advances: the scaling from noisy nominal times, with its uncertainty.

The scaling is piecewise constant with ramps between its levels. So a straight line is fitted to the nominal times
around each row, over as many rows as one line fits: on either side, the window is doubled until the misfit exceeds
what noise explains (locally adaptive windows, Lepski 1990, Goldenshluger and Nemirovski 1997). Where the path is fast,
the window is short and an edge stays sharp; where it is slow, the window is long and averages the noise. The nominal
times come from `path`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Floats, Vector


DOUBLINGS = 7
"""Maximum number of doublings: a window has up to 2**7 rows on either side."""
MISFIT = 3.0
"""Maximum excess of a window's misfit over that of noise, in standard deviations."""
_MIN_INFORMATION = 1e-18  # minimum information of a window


@dataclass(frozen=True)
class _Fit:
    """Sufficient statistics of weighted lines through windows of rows.

    Attributes:
        sums: Shape (7, T): sum of the weights, weighted means of time and nominal time, weighted sums of squares and
            products about the means (tt, ty, yy), and number of rows with weight.
    """

    sums: Floats

    def shifted(self, rows: int) -> _Fit:
        """Return, row by row, the window that starts `rows` rows later (negative: earlier); empty outside."""
        moved = np.zeros_like(self.sums)
        count = self.sums.shape[1]
        if abs(rows) < count:
            moved[:, max(-rows, 0) : count - max(rows, 0)] = self.sums[:, max(rows, 0) : count + min(rows, 0)]
        return _Fit(moved)

    def joined(self, other: _Fit) -> _Fit:
        """Return the statistics of two windows combined (Chan, Golub and LeVeque 1979: no cancellation)."""
        mine, theirs = self.sums, other.sums
        weight = mine[0] + theirs[0]
        share = np.divide(theirs[0], weight, out=np.zeros_like(weight), where=weight > 0)
        d = theirs[1:3] - mine[1:3]
        both = mine + theirs
        both[1:3] = mine[1:3] + share * d
        across = (mine[0] * share) * d
        both[3:5] += across[0] * d
        both[5] += across[1] * d[1]
        return _Fit(both)

    def chosen(self, other: _Fit, which: Bools) -> _Fit:
        """Return `other` where `which` is true, else this."""
        return _Fit(np.where(which, other.sums, self.sums))

    @property
    def slope(self) -> Vector:
        """The line's slope."""
        tt, ty = self.sums[3:5]
        return np.asarray(np.divide(ty, tt, out=np.zeros_like(tt), where=tt > _MIN_INFORMATION))

    @property
    def variance(self) -> Vector:
        """The slope's variance; infinite where the window has no information."""
        tt = self.sums[3]
        return np.asarray(np.divide(1.0, tt, out=np.full_like(tt, np.inf), where=tt > _MIN_INFORMATION))

    @property
    def agrees(self) -> Bools:
        """Whether noise explains the misfit: chi-squared with rows - 2 degrees of freedom."""
        _, _, _, _, ty, yy, rows = self.sums
        misfit = yy - ty * self.slope
        freedom = np.maximum(rows - 2.0, 0.0)
        return np.asarray(misfit <= freedom + MISFIT * np.sqrt(2.0 * freedom) + MISFIT)


def rate_along_path(t_s: Vector, nominal_s: Vector, variance_s2: Vector) -> tuple[Vector, Vector]:
    """Return the rate of nominal time from each row to the next, and its standard deviation, shapes (T,).

    The last row repeats the one before it.

    Args:
        t_s: Time, shape (T,), T >= 2, strictly increasing, s.
        nominal_s: Nominal time on the path, shape (T,), s.
        variance_s2: Its variance, shape (T,), s²; infinite = the row is not used.
    """
    count = len(t_s)
    weight = np.divide(1.0, variance_s2, out=np.zeros(count), where=np.isfinite(variance_s2))
    zero = np.zeros(count)
    stretch = _Fit(np.array([weight, t_s - t_s[0], nominal_s - nominal_s[0], zero, zero, zero, weight > 0]))
    row = np.arange(count)
    here, following = stretch, stretch.shifted(1)
    back, ahead = here, following
    back_fits = ahead_fits = np.ones(count, np.bool_)
    for doubling in range(1, DOUBLINGS + 1):
        size = 1 << (doubling - 1)
        stretch = stretch.joined(stretch.shifted(size))
        longer_back, longer_ahead = stretch.shifted(1 - 2 * size), stretch.shifted(1)
        back_fits = back_fits & (row + 1 >= 2 * size) & longer_back.joined(following).agrees
        ahead_fits = ahead_fits & (row + 2 * size < count) & here.joined(longer_ahead).agrees
        if not (back_fits.any() or ahead_fits.any()):
            break
        back, ahead = back.chosen(longer_back, back_fits), ahead.chosen(longer_ahead, ahead_fits)
    before, after, both = back.joined(following), here.joined(ahead), back.joined(ahead)
    side = after.chosen(before, before.variance < after.variance)
    best = side.chosen(both, both.agrees)
    rate, variance = best.slope, best.variance
    rate[-1], variance[-1] = rate[-2], variance[-2]
    return rate, np.sqrt(variance)
