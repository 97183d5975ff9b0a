"""Fits the law of speed and separation monitoring (ISO/TS 15066) to a scaling that has no levels.

The law allows the highest robot speed v at which the protective separation distance does not exceed the distance d:
v_h (T_r + v / a) + v T_r + v^2 / (2 a) + C <= d, with the speed v_h of a person, the reaction time T_r, the robot's
deceleration a, and a constant C. With v = s v_p, v_p the programmed speed, it reads

    stop + linear s + square s^2 <= d,    stop = C + v_h T_r, linear = v_p (T_r + v_h / a), square = v_p^2 / (2 a)

so logs of scaling and distance determine these three lengths and nothing more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards.rule import LawCard, MetresCard
from cyclekit.learning.rules.law.law_rows import limited, resting, resting_rates

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.learning.rules.law.law_rows import LawRows
    from cyclekit.scaling.transitions import RampRates
    from cyclekit.schema import Bools, Vector

LATEST_S, STEP_S = 1.0, 0.1
"""Maximum reaction time tried, and the step of the first search, s."""
FEW, MANY = 2500, 20_000
"""Maximum number of samples for choosing distance and reaction time, and for fitting the law."""
SAME = 0.02
"""Tolerance within which two scalings count as equal."""
SURE_M = 0.001
"""Minimum half-width of a confidence interval, m: the operator's position is a mean over a sample."""
_SOFT = 0.02
_RESAMPLES = 40
_BOUNDS = (0.025, 0.975)


class LawShape(NamedTuple):
    """The three lengths of a law, m, and the lowest scaling."""

    stop_m: float
    linear_m: float
    square_m: float
    lowest: float = 0.0

    def scaling(self, apart_m: Vector) -> Vector:
        """Return the scaling at distances (N,), m, shape (N,)."""
        left = np.maximum(apart_m - self.stop_m, 0.0)
        root = np.sqrt(self.linear_m**2 + 4 * self.square_m * left)
        return np.clip(2 * left / np.maximum(self.linear_m + root, 1e-12), self.lowest, 1.0)


class FittedLaw(NamedTuple):
    """A law with the response (latency and ramps) of the logged scaling."""

    distance: str
    shape: LawShape
    latency_s: float
    ramps: RampRates

    def rest(self, rows: LawRows) -> tuple[Vector, Bools]:
        """Return the scaling that the law allows in each row, and whether the logged one is at rest, shape (N,)."""
        allowed = self.shape.scaling(rows.earlier(rows.apart_m[self.distance], self.latency_s))
        return allowed, np.isfinite(allowed) & resting(rows, self.ramps)


def shape_of(law: LawCard) -> LawShape:
    """Return the lengths of a stored law."""
    return LawShape(law.stop.value, law.linear.value, law.square.value, law.lowest)


def fit_law(rows: LawRows) -> FittedLaw | None:
    """Return the law that fits best; None if too few rows are at rest between its bounds.

    Rows in which a ramp hides the command are left out; the reaction time is the one with the smallest error on the
    others.

    Args:
        rows: Rows of the executions to learn from.
    """
    ramps = resting_rates(rows)
    rest = resting(rows, ramps)
    lowest = _lowest(rows.scaling[rest])
    few = _some(rest, FEW)
    lags = np.arange(0.0, LATEST_S, STEP_S)
    tried = [
        (*_best(rows.scaling[few], rows.earlier(apart, float(lag))[few], lowest), name, float(lag))
        for name, apart in rows.apart_m.items()
        for lag in lags
    ]
    finite = [each for each in tried if np.isfinite(each[0])]
    if not finite:
        return None
    _, shape, name, lag = min(finite, key=lambda each: each[0])

    from scipy.optimize import minimize_scalar  # slow to import

    def cost(latency_s: float) -> float:
        return _best(rows.scaling[few], rows.earlier(rows.apart_m[name], latency_s)[few], lowest, shape)[0]

    found = minimize_scalar(
        cost, bounds=(max(0.0, lag - STEP_S), lag + STEP_S), method="bounded", options={"xatol": 2e-3}
    )
    latency_s = float(found.x) if found.x > 4e-3 else 0.0
    many = _some(rest, MANY)
    shape = _best(rows.scaling[many], rows.earlier(rows.apart_m[name], latency_s)[many], lowest, shape)[1]
    return _checked(FittedLaw(name, shape, latency_s, ramps), rows)


def law_card(fitted: FittedLaw, rows: LawRows, *, seed: int) -> LawCard:
    """Return a law with 95 % confidence intervals of its lengths, from resampled executions."""
    rng = np.random.default_rng(seed)
    rest = np.flatnonzero(fitted.rest(rows)[1])
    rest = rest[:: max(1, len(rest) // (2 * FEW))]
    apart = rows.earlier(rows.apart_m[fitted.distance], fitted.latency_s)[rest]
    present, number = np.unique(rows.execution[rest], return_inverse=True)
    drawn = []
    for _ in range(_RESAMPLES):
        times = np.bincount(rng.integers(len(present), size=len(present)), minlength=len(present))
        again = np.repeat(np.arange(len(rest)), times[number.ravel()])
        drawn.append(_best(rows.scaling[rest][again], apart[again], fitted.shape.lowest, fitted.shape)[1][:3])
    low, high = np.quantile(drawn, _BOUNDS, axis=0)
    stop, linear, square = (
        MetresCard(value=value, low=min(value, float(a)) - SURE_M, high=max(value, float(b)) + SURE_M)
        for value, a, b in zip(fitted.shape[:3], low, high, strict=True)
    )
    return LawCard(
        distance=fitted.distance, stop=stop, linear=linear, square=square, lowest=fitted.shape.lowest,
        latency_s=fitted.latency_s, ramp_down_per_s=fitted.ramps.down_per_s, ramp_up_per_s=fitted.ramps.up_per_s,
    )  # fmt: skip


def _best(scaling: Vector, apart_m: Vector, lowest: float, start: LawShape | None = None) -> tuple[float, LawShape]:
    """Return the mean cost and the law that fits rows (N,) best; infinite cost if too few lie between the bounds."""
    known = np.isfinite(apart_m)
    s, d = scaling[known], apart_m[known]
    between = (s > lowest + SAME) & (s < 1.0 - SAME)
    if between.sum() < 20:
        return np.inf, LawShape(0.0, 1.0, 0.0, lowest)
    if start is None:
        slope, offset = np.polyfit(s[between], d[between], 1)
        begin = [offset, max(float(slope), 0.05), 0.3]
    else:
        begin = [start.stop_m, start.linear_m + start.square_m, start.square_m / (start.linear_m + start.square_m)]

    def shape(x: Vector) -> LawShape:
        """Return the law from stop distance, distance from there to full speed, and quadratic share of the latter."""
        return LawShape(float(x[0]), float(x[1] * (1 - x[2])), float(x[1] * x[2]), lowest)

    from scipy.optimize import least_squares

    bounds = ([-5.0, 0.01, 0.0], [20.0, 20.0, 1.0])
    begin = list(np.clip(begin, np.array(bounds[0]) + 1e-3, np.array(bounds[1]) - 1e-3))
    found = least_squares(
        lambda x: shape(x).scaling(d) - s, begin, bounds=bounds, loss="soft_l1", f_scale=_SOFT, x_scale=[1.0, 1.0, 0.3]
    )
    return float(found.cost) / len(s), shape(found.x)


def _checked(fitted: FittedLaw, rows: LawRows) -> FittedLaw:
    """Return the fit without ramps during which the law is not ahead of the scaling: these are no ramps."""
    allowed, _ = fitted.rest(rows)
    rates = fitted.ramps
    for rises in (False, True):
        on = np.isfinite(allowed) & limited(rows, rates, rises=rises)
        beyond = ((allowed - rows.scaling) * (1 if rises else -1))[on]
        if on.any() and beyond.mean() < 0.5 * np.abs(beyond).mean():
            rates = rates._replace(**{"up_per_s" if rises else "down_per_s": None})
    if rates == fitted.ramps:
        return fitted
    many = _some(resting(rows, rates), MANY)
    apart = rows.earlier(rows.apart_m[fitted.distance], fitted.latency_s)[many]
    shape = _best(rows.scaling[many], apart, fitted.shape.lowest, fitted.shape)[1]
    return FittedLaw(fitted.distance, shape, fitted.latency_s, rates)


def _lowest(scaling: Vector) -> float:
    """Return the minimum scaling if many rows share it; else 0, because the logs do not show a lower bound."""
    least = float(scaling.min())
    return least if least > SAME and (scaling < least + 2e-3).sum() >= 20 else 0.0


def _some(keep: Bools, most: int) -> NDArray[np.int64]:
    rows = np.flatnonzero(keep)
    return rows[:: max(1, -(-len(rows) // most))]
