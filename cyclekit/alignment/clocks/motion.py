"""Clock fit from motion: the robot's flange in the controller's log and in the tracker's log.

The speed of a body does not depend on the frame, so no calibration is needed. Both speeds are resampled to one grid and
correlated at every lag (without lost frames); a parabola refines the peak, and windows along the run give the drift. A
robot with repeated motion gives peaks one cycle apart: the second-best one is part of the result.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.alignment.clocks.fit import ClockFit
from cyclekit.dataset.cards import Note, note
from cyclekit.errors import ConfigError
from cyclekit.text.numbers import fixed, given

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Ints, Points, Vector


GRID_HZ = 50.0
HALF_S = 0.06
"""Half width of the window for speed, s: 1 mm of noise gives less than 12 mm/s."""
MIN_S, MIN_SHARE = 10.0, 0.5
"""Minimum overlap of the logs at a lag: in s, and as share of the shorter log."""
WEAK, TOO_WEAK = 0.7, 0.4
"""Correlation below which a fit gets a warning, and below which it is rejected."""
AMBIGUOUS = 0.9
WINDOWS, MIN_WINDOWS = 12, 5
WINDOW_S = (20.0, 120.0)
REACH_S = 1.0
"""Maximum difference of a window's lag from that of the window before, s."""
STRETCH_S = 200.0
"""Length of the part that is aligned first if drift blurs the whole, s: the worst clock drifts by 0.6 s in it."""


def fit_motion(log_s: Vector, log_m: Points, robot_s: Vector, robot_m: Points) -> ClockFit:
    """Return the line from the time of one log to that of another with the same body.

    Args:
        log_s: Times in the log to align, shape (N,), s, ascending.
        log_m: Positions of the body in it, any frame, shape (N, 3), m; NaN = not seen.
        robot_s: Times in the robot log, shape (M,), s, ascending.
        robot_m: Positions in it, shape (M, 3), m; NaN = not logged.

    Raises:
        ConfigError: The logs hardly overlap, or their speeds do not agree at any lag.
    """
    mine, theirs = _speed(log_s, log_m), _speed(robot_s, robot_m)
    fit = _common(log_s, mine, robot_s, theirs)
    rate = None if fit is None else fit.rate
    if fit is None or (fit.correlation or 0.0) < WEAK:
        rate = _followed_rate(mine, theirs) or rate
    if rate is not None and rate != 1.0:
        first = float(log_s[0])  # drift blurs every peak: remove it, fit again, and combine both fits
        straight = first + rate * (log_s - first)
        again = _common(straight, _speed(straight, log_m), robot_s, theirs)
        if again is not None and (fit is None or (again.correlation or 0.0) >= (fit.correlation or 0.0)):
            fit = replace(again, rate=again.rate * rate, offset_s=again.offset_s + again.rate * first * (1 - rate))
    if fit is None:
        raise ConfigError(
            f"the body moves in both logs at the same time for less than {given(MIN_S)} s",
            cure="Check that sees_as names the body on the flange, and that both logs are of one run.",
        )
    if (fit.correlation or 0.0) < TOO_WEAK:
        raise ConfigError(
            f"the speeds of the two logs never agree (correlation {fixed(fit.correlation, 2)} at best)",
            cure="Check that sees_as names the body on the flange, and that both logs are of one run.",
        )
    return fit


def _common(log_s: Vector, mine: Vector, robot_s: Vector, theirs: Vector) -> ClockFit | None:
    """Return the fit around the lag at which the whole logs agree best; None if they hardly overlap."""
    overlap = max(MIN_S * GRID_HZ, MIN_SHARE * min(np.isfinite(mine).sum(), np.isfinite(theirs).sum()))
    lags, score = _correlation(theirs, mine, overlap)
    if not np.isfinite(score).any():
        return None
    best = int(np.nanargmax(score))
    peak = float(score[best])
    shift = float(robot_s[0] - log_s[0])
    second, second_at = _second(score, best)
    offset = shift + _refined(lags, score, best) / GRID_HZ
    line = _line(log_s, *_windows(mine, theirs, len(mine) // 2, int(lags[best])), offset, shift)
    warnings: tuple[Note, ...] = ()
    if second is not None and second >= AMBIGUOUS * peak:
        away = float(lags[second_at] - lags[best]) / GRID_HZ
        warnings = (note("clock-motion-ambiguous", away_s=away, height=float(second / peak)),)
    elif peak < WEAK:
        warnings = (note("clock-motion-rough", correlation=peak),)
    return ClockFit(
        "motion",
        *line[:2],
        warnings=warnings,
        residual_s=line[2],
        events=line[3],
        correlation=round(peak, 4),
        second_best=round(second / peak, 4) if second is not None else None,
        second_best_s=float(lags[second_at] - lags[best]) / GRID_HZ if second is not None else None,
    )


def _speed(t_s: Vector, xyz_m: Points) -> Vector:
    """Return the speed on the grid that starts at the first time, m/s; NaN where the body is not seen."""
    seen = np.isfinite(xyz_m).all(axis=1)
    grid = t_s[0] + np.arange(int((t_s[-1] - t_s[0]) * GRID_HZ) + 1) / GRID_HZ
    t, xyz = t_s[seen], xyz_m[seen]
    if len(t) < 2:
        return np.full(len(grid), np.nan)
    limit = max(0.1, 2.5 * float(np.median(np.diff(t))))
    before, after = _positions(t, xyz, grid - HALF_S, limit), _positions(t, xyz, grid + HALF_S, limit)
    speed: Vector = np.linalg.norm(after - before, axis=1) / (2 * HALF_S)
    return speed


def _positions(t: Vector, xyz: Points, at: Vector, limit: float) -> Points:
    right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    known = (at >= t[0]) & (at <= t[-1]) & (t[right] - t[right - 1] <= limit)
    out = np.column_stack([np.interp(at, t, xyz[:, axis]) for axis in range(3)])
    out[~known] = np.nan
    return out


def _correlation(a: Vector, b: Vector, least: float) -> tuple[Ints, Vector]:
    """Return lags k and Pearson's correlation of a[i + k] with b[i] over the i at which both are known.

    NaN where there are fewer than `least` such i, or where one of them is constant. All lags are computed at once, by
    Fourier transforms of the values and of the masks of known values.
    """
    known_a, known_b = np.isfinite(a), np.isfinite(b)
    size = 1 << (len(a) + len(b) - 1).bit_length()
    mean_a = a[known_a].mean() if known_a.any() else 0.0
    mean_b = b[known_b].mean() if known_b.any() else 0.0
    va, vb = np.where(known_a, a - mean_a, 0.0), np.where(known_b, b - mean_b, 0.0)
    fa, fa2, fma = (np.fft.rfft(v, size) for v in (va, va * va, known_a.astype(float)))
    fb, fb2, fmb = (np.conj(np.fft.rfft(v, size)) for v in (vb, vb * vb, known_b.astype(float)))
    lags = np.arange(-(len(b) - 1), len(a))

    def at_lags(product: NDArray[np.complex128]) -> Vector:
        return np.asarray(np.fft.irfft(product, size)[lags])

    count = np.round(at_lags(fma * fmb))
    safe = np.maximum(count, 1.0)
    sum_a, sum_b = at_lags(fa * fmb), at_lags(fma * fb)
    var_a = at_lags(fa2 * fmb) - sum_a**2 / safe
    var_b = at_lags(fma * fb2) - sum_b**2 / safe
    still = (var_a <= 1e-6 * safe) | (var_b <= 1e-6 * safe)  # a millimetre per second
    usable = (count >= least) & ~still
    score = (at_lags(fa * fb) - sum_a * sum_b / safe) / np.sqrt(np.where(usable, var_a * var_b, 1.0))
    return lags, np.where(usable, score, np.nan)


def _refined(lags: Ints, score: Vector, best: int) -> float:
    """Return the lag of the vertex of the parabola through the peak and its neighbours."""
    if not 0 < best < len(score) - 1:
        return float(lags[best])
    left, top, right = score[best - 1 : best + 2]
    bend = left - 2 * top + right
    if not np.isfinite(bend) or bend >= 0:
        return float(lags[best])
    return float(lags[best]) + float(0.5 * (left - right) / bend)


def _second(score: Vector, best: int) -> tuple[float | None, int]:
    """Return height and index of the second peak: the highest one beyond where the first has fallen to half."""
    low = ~(score > 0.5 * score[best])
    after = np.flatnonzero(low[best:])
    before = np.flatnonzero(low[: best + 1])
    rest = score.copy()
    begin = int(before[-1]) if len(before) else 0
    end = best + int(after[0]) if len(after) else len(score)
    rest[begin:end] = np.nan
    middle = rest[1:-1]
    peaks = 1 + np.flatnonzero((middle >= rest[:-2]) & (middle > rest[2:]) & (middle > 0))
    if len(peaks) == 0:
        return None, best
    top = int(peaks[rest[peaks].argmax()])
    return float(rest[top]), top


def _followed_rate(mine: Vector, theirs: Vector) -> float | None:
    """Return the rate of a log whose drift blurs the common peak, from one aligned part followed in both directions."""
    stretch = int(GRID_HZ * STRETCH_S)
    if len(mine) < 3 * stretch:
        return None
    best: tuple[float, int, int] = (TOO_WEAK, 0, 0)
    for begin in (len(mine) // 5, len(mine) // 2 - stretch // 2, 4 * len(mine) // 5 - stretch):
        lags, score = _correlation(theirs, mine[begin : begin + stretch], MIN_SHARE * stretch)
        if np.isfinite(score).any():
            top = int(np.nanargmax(score))
            best = max(best, (float(score[top]), begin, int(lags[top]) - begin))
    if best[0] <= TOO_WEAK:
        return None
    middles, found = _windows(mine, theirs, best[1], best[2])
    if len(middles) < MIN_WINDOWS:
        return None
    i, j = np.triu_indices(len(middles), 1)
    return 1.0 + float(np.median((found[j] - found[i]) / (middles[j] - middles[i])))


def _windows(mine: Vector, theirs: Vector, anchor: int, lag: int) -> tuple[Vector, Vector]:
    """Return centres (in samples of this log's grid) and lags of the windows with a clear lag.

    From sample `anchor`, with a lag of about `lag`, each window is searched around the lag of the one before.
    """
    length = int(GRID_HZ * np.clip(len(mine) / GRID_HZ / WINDOWS, *WINDOW_S))
    begins = np.arange(0, len(mine) - length + 1, length)
    found: dict[int, float] = {}
    for way in (begins[begins >= anchor], begins[begins < anchor][::-1]):
        last = float(lag)
        for begin in way.tolist():
            here = _lag_of_window(mine, theirs, begin, length, round(last))
            if here is not None:
                found[begin] = last = here
    middles = np.array(sorted(found))
    return middles + length / 2, np.array([found[begin] for begin in middles.tolist()])


def _lag_of_window(mine: Vector, theirs: Vector, begin: int, length: int, lag: int) -> float | None:
    reach = int(REACH_S * GRID_HZ)
    first = max(0, begin + lag - reach)
    piece = theirs[first : max(first, begin + length + lag + reach)]
    if len(piece) < length:
        return None
    lags, score = _correlation(piece, mine[begin : begin + length], 0.5 * length)
    about = begin + lag - first
    score = np.where(np.abs(lags - about) <= reach, score, np.nan)
    if not np.isfinite(score).any():
        return None
    best = int(np.nanargmax(score))
    if score[best] < WEAK or abs(lags[best] - about) >= reach:
        return None
    return _refined(lags, score, best) + first - begin


def _line(
    log_s: Vector, middles: Vector, lags: Vector, offset: float, shift: float
) -> tuple[float, float, float | None, int | None]:
    """Return (offset, rate, residual, windows) of a robust line through the windows."""
    if len(middles) < MIN_WINDOWS:
        return offset, 1.0, None, None
    x, y = log_s[0] + middles / GRID_HZ, shift + lags / GRID_HZ
    about = float(np.median(x))
    i, j = np.triu_indices(len(x), 1)
    slope = float(np.median((y[j] - y[i]) / (x[j] - x[i])))
    level = float(np.median(y - slope * (x - about)))
    spread = 1.4826 * float(np.median(np.abs(y - level - slope * (x - about))))
    unsure = 1.25 * spread / (np.sqrt(len(x)) * float(np.std(x)))
    if abs(slope) <= 3 * unsure:  # no significant drift: a rate would only add noise away from the centre
        slope, level = 0.0, float(np.median(y))
        spread = 1.4826 * float(np.median(np.abs(y - level)))
    return level - slope * about, 1.0 + slope, spread, len(x)
