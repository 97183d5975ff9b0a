"""How fast a path's nominal time advances: the scaling from noisy nominal times, with its uncertainty.

The scaling is piecewise constant with ramps between its levels. So a straight line is fitted to the nominal times
around each row, over as many rows as agree with one: to either side the stretch is doubled until the misfit is more
than the noise explains (the idea of locally adaptive windows, Lepski 1990, Goldenshluger and Nemirovski 1997). Where
the path is fast the stretch is short and an edge stays sharp; where it is slow the stretch is long and the noise is
averaged. Where the nominal times come from is the business of `path`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

DOUBLINGS = 7
"""A stretch has up to 2**7 rows to either side."""
MISFIT = 3.0
"""A stretch agrees with one scaling while its misfit is within so many standard deviations of what noise gives."""
_LEAST = 1e-18  # of information: the window says nothing


@dataclass(frozen=True)
class _Fit:
    """Sufficient statistics of weighted lines through stretches of rows; each shape (T,).

    Attributes:
        weight, t, y: Sum of the weights, weighted means of time and nominal time.
        tt, ty, yy: Weighted sums of squares and products about the means.
        rows: How many rows count.
    """

    weight: Vector
    t: Vector
    y: Vector
    tt: Vector
    ty: Vector
    yy: Vector
    rows: Vector

    def at(self, index: NDArray[np.int64]) -> _Fit:
        """Return the stretches that begin at the rows `index`; a negative one is empty."""
        here = np.clip(index, 0, len(self.t) - 1)
        inside = (index >= 0) & (index < len(self.t))
        zero = np.zeros(len(index))
        return _Fit(
            np.where(inside, self.weight[here], zero),
            self.t[here],
            self.y[here],
            np.where(inside, self.tt[here], zero),
            np.where(inside, self.ty[here], zero),
            np.where(inside, self.yy[here], zero),
            np.where(inside, self.rows[here], zero),
        )

    def joined(self, other: _Fit) -> _Fit:
        """Return the statistics of two stretches taken together (Chan, Golub and LeVeque 1979: no cancellation)."""
        weight = self.weight + other.weight
        share = np.divide(other.weight, weight, out=np.zeros_like(weight), where=weight > 0)
        dt, dy, between = other.t - self.t, other.y - self.y, self.weight * share
        return _Fit(
            weight,
            self.t + share * dt,
            self.y + share * dy,
            self.tt + other.tt + between * dt * dt,
            self.ty + other.ty + between * dt * dy,
            self.yy + other.yy + between * dy * dy,
            self.rows + other.rows,
        )

    def chosen(self, other: _Fit, which: NDArray[np.bool_]) -> _Fit:
        """Return `other` where `which` says so, else this."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Fit(*(np.where(which, theirs, mine) for mine, theirs in pairs))

    @property
    def slope(self) -> Vector:
        """The line's slope."""
        return np.divide(self.ty, self.tt, out=np.zeros_like(self.tt), where=self.tt > _LEAST)

    @property
    def variance(self) -> Vector:
        """The slope's variance; infinite where the stretch says nothing."""
        return np.divide(1.0, self.tt, out=np.full_like(self.tt, np.inf), where=self.tt > _LEAST)

    @property
    def agrees(self) -> NDArray[np.bool_]:
        """Whether the misfit is what noise gives: chi-squared with rows - 2 degrees of freedom."""
        misfit = self.yy - self.ty * self.slope
        freedom = np.maximum(self.rows - 2.0, 0.0)
        return np.asarray(misfit <= freedom + MISFIT * np.sqrt(2.0 * freedom) + MISFIT)


def advance(t_s: Vector, nominal_s: Vector, variance_s2: Vector) -> tuple[Vector, Vector]:
    """Return the rate of nominal time from each row to the next, and its standard deviation, shapes (T,).

    The last row repeats the one before it.

    Args:
        t_s: Time, shape (T,), T >= 2, strictly increasing, seconds.
        nominal_s: Nominal time on the path, shape (T,), seconds.
        variance_s2: Its variance, shape (T,), seconds squared; infinite = this row says nothing.
    """
    count = len(t_s)
    weight = np.divide(1.0, variance_s2, out=np.zeros(count), where=np.isfinite(variance_s2))
    zero = np.zeros(count)
    stretch = _Fit(weight, t_s - t_s[0], nominal_s - nominal_s[0], zero, zero, zero, (weight > 0).astype(np.float64))
    row = np.arange(count)
    here, following = stretch.at(row), stretch.at(row + 1)
    back, ahead = here, following
    back_fits = ahead_fits = np.ones(count, np.bool_)
    for doubling in range(1, DOUBLINGS + 1):
        size = 1 << (doubling - 1)
        stretch = stretch.joined(stretch.at(row + size))
        longer_back, longer_ahead = stretch.at(row + 1 - 2 * size), stretch.at(row + 1)
        back_fits = back_fits & (row + 1 >= 2 * size) & longer_back.joined(following).agrees
        ahead_fits = ahead_fits & (row + 2 * size < count) & here.joined(longer_ahead).agrees
        back, ahead = back.chosen(longer_back, back_fits), ahead.chosen(longer_ahead, ahead_fits)
    before, after, both = back.joined(following), here.joined(ahead), back.joined(ahead)
    side = after.chosen(before, before.variance < after.variance)
    best = side.chosen(both, both.agrees)
    rate, variance = best.slope, best.variance
    rate[-1], variance[-1] = rate[-2], variance[-2]
    return rate, np.sqrt(variance)
