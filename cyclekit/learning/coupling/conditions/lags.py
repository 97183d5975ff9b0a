"""Separates own work from waiting in departures at max(own work, event + lag).

Only the latest cause of each departure is observed. The time of every other cause is left-censored: it is known only to
be shorter. The distribution of each cause is the reverse Kaplan-Meier estimate, weighted by the probability that the
cause decided; distributions and probabilities are estimated alternately (EM).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import ndtr

if TYPE_CHECKING:
    from collections.abc import Callable

    from cyclekit.schema import Bools, Floats, Ints, Vector

LEVELS = 51
"""Number of quantiles stored per distribution."""
REGULAR_S = 0.05
"""Minimum kernel width, s: the resolution of times."""
WIDE = 8.0
OF_OWN, OF_LAG = 0.1, 0.01
"""Share of irregular times of own work and of lags; their kernel is WIDE times wider."""
ANY, ANY_S = 1e-3, 100.0
"""Share of outliers, and the range of their uniform density, s."""
ROUNDS, SETTLED = 10, 2
"""Number of EM iterations, and the iteration from which the kernels stay fixed."""
FEW, REMEMBERED, ANSWERS = 128, 32, 1000
"""Kernels of at most FEW departures are kept for further calls, REMEMBERED of them (8 MB): own work and its width are
often the same beside each condition that is tried. So are the last ANSWERS (15 MB): conditions are searched again when
something else of the cell is known, and most departures and events are then as before."""
_TINY = 1e-300


@dataclass(frozen=True)
class Causes:
    """The causes of N departures: the agent's own work first, then its conditions.

    Attributes:
        share: Probability that each cause decided each departure, shape (C, N).
        mass: Probability mass of each cause at each of its times, shape (C, N); sums to at most 1 per cause.
        log_likelihood: Log-likelihood of each departure given the others, shape (N,).
    """

    share: Floats
    mass: Floats
    log_likelihood: Vector


def deciding_causes(since_s: Floats) -> Causes:
    """Return which of C causes decided each of N departures.

    Args:
        since_s: Time from each cause to the departure, shape (C, N), s; NaN = no such cause, -inf = it came after the
            departure, which did not need it.
    """
    since_s = np.ascontiguousarray(since_s, dtype=np.float64)
    if since_s.shape[1] > FEW:
        return _deciding(since_s, lru_cache(maxsize=len(since_s))(_kernels))
    return _answered(since_s.tobytes(), *since_s.shape)


@lru_cache(maxsize=ANSWERS)
def _answered(since_s: bytes, causes: int, departures: int) -> Causes:
    """Return the causes of few departures, whose times are given as bytes; to be read, not changed."""
    found = _deciding(np.frombuffer(since_s).reshape(causes, departures), _remembered)
    for each in (found.share, found.mass, found.log_likelihood):
        each.flags.writeable = False
    return found


def _deciding(since_s: Floats, kernels_of: Callable[[bytes, float, float], _Kernels]) -> Causes:
    known, there = np.isfinite(since_s), ~np.isnan(since_s)
    since, ranked = np.where(known, since_s, 0.0), _ranked(since_s, there)
    share = _first_guess(np.where(known, since_s, np.nan))
    kernels: list[_Kernels] = []
    others_of = ~np.eye(len(since), dtype=bool)
    for number in range(ROUNDS if len(since) > 1 else 1):
        mass = _mass(ranked, share, there)
        if number <= SETTLED:
            kernels = [
                kernels_of(t[on].tobytes(), _width(t[on], m[on]), OF_LAG if c else OF_OWN)
                for c, (t, m, on) in enumerate(zip(since, mass, known, strict=True))
            ]
        parts = [_smooth(*each) for each in zip(mass, known, there, kernels, strict=True)]
        cdf = np.array([below for _, below in parts])
        others = [cdf[rows].prod(axis=0) for rows in others_of]
        joint = np.array([pdf for pdf, _ in parts]) * others
        share = joint / np.maximum(joint.sum(axis=0), _TINY)
    return Causes(share, mass, np.log(np.maximum(joint.sum(axis=0), _TINY)))


def reverse_kaplan_meier(since_s: Vector, decided: Vector, known: Bools) -> Vector:
    """Return the probability mass at each time, shape (N,); mass below the shortest deciding time is missing.

    Args:
        since_s: Times, shape (N,): exact where the cause decided, otherwise upper bounds; -inf = shorter than all.
        decided: Weight with which the cause decided, 0 to 1, shape (N,).
        known: Whether there is a time, shape (N,).
    """
    return _mass(_ranked(since_s, known), decided, known)


class _Ranked(NamedTuple):
    """Times in ascending order, and how many are not longer than each of these, both (..., N)."""

    order: Ints
    at_risk: Ints


def _ranked(since_s: Floats, known: Bools) -> _Ranked:
    order = np.argsort(np.where(known, since_s, np.inf), axis=-1, kind="stable")
    return _Ranked(order, np.maximum(np.cumsum(np.take_along_axis(known, order, axis=-1), axis=-1), 1))


def _mass(ranked: _Ranked, decided: Floats, known: Bools) -> Floats:
    """Return the mass of `reverse_kaplan_meier` at each time, shape (..., N)."""
    weight = np.take_along_axis(np.where(known, decided, 0.0), ranked.order, axis=-1)
    kept = 1.0 - weight / ranked.at_risk
    above = np.ones_like(kept)  # probability of a longer time
    above[..., :-1] = np.cumprod(kept[..., :0:-1], axis=-1)[..., ::-1]
    mass = np.empty_like(kept)
    np.put_along_axis(mass, ranked.order, above * (1.0 - kept), axis=-1)
    return mass


def quantiles(since_s: Vector, mass: Vector, *, shortest: bool = True) -> tuple[float, ...]:
    """Return the quantiles of a distribution at evenly spaced levels, s; a single value if it does not vary.

    Args:
        since_s: Times, shape (N,).
        mass: Probability mass of each, shape (N,).
        shortest: Assign missing mass to the shortest time; otherwise normalise without it.
    """
    some = mass > 1e-9
    if not some.any():
        return (0.0,)
    order = np.argsort(since_s[some], kind="stable")
    times, parts = since_s[some][order], mass[some][order]
    parts[0] += max(0.0, 1.0 - parts.sum()) if shortest else 0.0
    middle = (np.cumsum(parts) - 0.5 * parts) / parts.sum()
    values = np.interp(np.linspace(0.0, 1.0, LEVELS), middle, times)
    values[0], values[-1] = (
        _outer_end(middle, times, values[0], values[1]),
        _outer_end(1.0 - middle[::-1], times[::-1], values[-1], values[-2]),
    )
    rounded = tuple(round(float(value), 4) for value in values)
    return rounded if rounded[-1] - rounded[0] > 1e-3 else rounded[LEVELS // 2 : LEVELS // 2 + 1]


def _outer_end(level: Vector, times: Vector, outermost: float, following: float) -> float:
    """Return the value at level 0 with which interpolation to the next of LEVELS keeps the mean up to that level.

    One unusual time of several hundred would otherwise be drawn, or nearly, in one cycle of a hundred.

    Args:
        level: Level of each time, ascending, shape (N,).
        times: The times, shape (N,), s.
        outermost: The first of them, s.
        following: Value at the next of LEVELS, s.
    """
    width = 1.0 / (LEVELS - 1)
    at = np.concatenate([[0.0], level[level < width], [width]])
    mean = float(np.trapezoid(np.interp(at, level, times), at)) / width
    return float(np.clip(2.0 * mean - following, min(outermost, following), max(outermost, following)))


def _first_guess(since_s: Floats) -> Floats:
    """Return initial shares: the cause nearest to its shortest times most likely decided."""
    count = np.count_nonzero(np.isfinite(since_s), axis=1)[:, None]
    at = np.maximum(0.05 * (count - 1), 0.0)  # the quantile of 5 % of the times there are; NaN are last
    first = at.astype(np.int64)
    pair = np.sort(since_s, axis=1)
    low, above = (np.take_along_axis(pair, np.minimum(each, count.clip(1) - 1), axis=1) for each in (first, first + 1))
    low = np.where(count, low + (above - low) * (at - first), 0.0)
    far = np.where(np.isfinite(since_s), np.abs(since_s - low), np.inf)
    guess = np.full(since_s.shape, 0.1 / len(since_s))
    guess[far.argmin(axis=0), np.arange(far.shape[1])] += 0.9
    return np.where(np.isfinite(since_s), guess, 0.0)


class _Kernels(NamedTuple):
    """Kernel density and kernel distribution function of each known time at every other one, both (K, K)."""

    density: Floats
    below: Floats


def _kernels(known: bytes, width: float, irregular: float) -> _Kernels:
    """Return the kernels of K known times, given as bytes, with a width; to be read, not changed."""
    times = np.frombuffer(known)
    row, column, above, mirrored = _off_diagonal(len(times))
    apart = times.take(row) - times.take(column)
    pdf, cdf = np.zeros(len(apart)), np.zeros(len(apart))
    for part, scale in ((1.0 - irregular, width), (irregular, WIDE * width)):
        z = apart / scale
        pdf += part * np.exp(-0.5 * z * z) / (scale * np.sqrt(2.0 * np.pi))
        cdf += part * ndtr(z)
    density, below = np.zeros((len(times), len(times))), np.full((len(times), len(times)), 0.5)
    density.put(above, pdf)
    density.put(mirrored, pdf)
    below.put(above, cdf)
    below.put(mirrored, 1.0 - cdf)
    return _Kernels(density, below)


@lru_cache(maxsize=REMEMBERED)
def _off_diagonal(count: int) -> tuple[Ints, Ints, Ints, Ints]:
    """Return rows and columns above the diagonal of a matrix (count, count), their places if flat, and the mirrored."""
    row, column = np.triu_indices(count, 1)
    return row, column, row * count + column, column * count + row


_remembered = lru_cache(maxsize=REMEMBERED)(_kernels)


def _smooth(mass: Vector, known: Bools, there: Bools, kernels: _Kernels) -> tuple[Vector, Vector]:
    """Return leave-one-out density and distribution function of a cause at each departure, both (N,).

    Unknown times have no mass.
    """
    mine, total = mass[known], float(mass.sum())
    missing = 1.0 - total  # below all observed times
    pdf, cdf = np.zeros(len(mass)), np.where(there, np.clip(missing, 1e-9, 1.0), 1.0)
    pdf[known] = (1.0 - ANY) * total * (kernels.density @ mine) / np.maximum(total - mine, 1e-9) + ANY / ANY_S
    cdf[known] = np.clip(kernels.below @ mine + missing, 1e-9, 1.0)
    return pdf, cdf


def _width(times: Vector, mass: Vector) -> float:
    """Return the kernel width by Silverman's rule, s."""
    some = mass > 1e-9
    if some.sum() < 2:
        return 10.0 * REGULAR_S
    order = np.argsort(times[some])
    at, part = times[some][order], np.cumsum(mass[some][order])
    low, high = np.interp([0.25, 0.75], part / part[-1], at)
    many = float(part[-1] ** 2 / (mass[some] ** 2).sum())
    return float(max(REGULAR_S, 1.06 * (high - low) / 1.34 * many**-0.2))
