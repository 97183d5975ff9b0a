"""Plateaus of a speed scaling: the times over which one value is held, and that value.

Only the order in time separates a level from a ramp: in a histogram, a level used for two seconds a day looks like
ramps that pass its value a hundred times. A sample is *steady* if the means of the windows before and after it agree.
A sequence of steady samples without a slope is the core of a plateau. Between two plateaus, the times at which one is
left and the other reached are fitted by least squares (a hinge), so that a short plateau is averaged over all of its
samples. `clusters` groups plateaus into levels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.time_grid import USUAL_HZ, samples_in
from cyclekit.scaling.levels.slopes import find_slopes

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Ints, Vector


_MIN_NOISE = 1e-4
_WINDOW_S = 50.0
"""A window of (50 s x rate x noise)^(2/3) samples separates a ramp of 0.2 per second (full range in 5 s) from a
plateau."""
_SIGMAS = 3.5
_MIN_STEP = 0.01
"""Minimum tolerance for the means of two windows to agree."""
_DRIFT = 0.03
"""Maximum change along a plateau; more is a slow ramp."""
_NARROWEST_S, _WIDEST_S = 0.1, 1.0
"""Bounds of the window, s: in shorter ones, a slow ramp of many samples looks steady."""
_SHORTEST_S = 0.2
"""Minimum duration of a plateau, s; it has at least two samples."""
_EVIDENCE = 30.0
"""Minimum reduction of squared error by a short plateau over a straight transition, in noise variances (3 ln T)."""
_HINGE_PLACES = 120
"""Maximum number of candidate ends of plateaus between two cores, evenly spaced."""
_HINGE_NOISE = 0.008
"""Noise above which the ends of plateaus are fitted; below, they are found sample by sample."""


@dataclass(frozen=True)
class Plateaus:
    """K plateaus in order of time.

    Attributes:
        first: First sample of each, shape (K,).
        end: One past its last sample, shape (K,).
        value: Its mean without outliers, shape (K,).
        noise: Standard deviation of the noise of one sample.
        on_ramp: Number of samples on slow ramps, and so on no plateau.
        varied: Number of samples on slopes of various rates.
    """

    first: Ints
    end: Ints
    value: Vector
    noise: float
    on_ramp: int = 0
    varied: int = 0

    @property
    def samples(self) -> Ints:
        """Number of samples of each, shape (K,)."""
        return self.end - self.first


def noise_of(values: Vector) -> float:
    """Return the noise of a signal of plateaus and ramps from its second differences, which vanish on both.

    The median is robust against jumps if they are fewer than half, the lower quartile against more; the smaller of the
    two estimates is returned.

    Args:
        values: Shape (T,), finite.
    """
    if values.size < 3:
        return _MIN_NOISE
    second = values[2:] - 2 * values[1:-1] + values[:-2]
    quartile, median = np.quantile(np.abs(second), (0.25, 0.5)) / 6**0.5
    return max(float(min(quartile / 0.3186, median / 0.6745)), _MIN_NOISE)


def find_plateaus(values: Vector, run: Ints, *, rate_hz: float = USUAL_HZ, most_noise: float = np.inf) -> Plateaus:
    """Find the plateaus.

    Args:
        values: Speed scaling, shape (T,), finite, in order of time.
        run: Stretch without gaps of each sample, shape (T,), non-decreasing; nothing is compared across stretches.
        rate_hz: Rate of the samples.
        most_noise: Maximum noise; for known levels, an eighth of their smallest distance.
    """
    if values.size == 0:
        return Plateaus(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), _MIN_NOISE)
    noise = min(noise_of(values), most_noise)
    bounds = samples_in(_NARROWEST_S, rate_hz), samples_in(_WIDEST_S, rate_hz)
    window = int(np.clip(np.ceil((_WINDOW_S * rate_hz * noise) ** (2 / 3)), *bounds))
    begin, stop = _bounds(run)
    slopes = find_slopes(values, begin, stop, rate_hz, noise)
    if slopes.on_ramp.any():  # a ramp is no plateau, and no plateau extends across it
        run = np.cumsum(np.diff(run, prepend=run[0]) + np.abs(np.diff(slopes.on_ramp, prepend=False)) != 0)
        begin, stop = _bounds(run)
    first, end = _cores(_steady(values, begin, stop, window, noise), run)
    if noise > _HINGE_NOISE:
        first, end = _by_hinges(values, first, end, stop, window)
    else:
        first, end = _by_samples(values, first, end, begin, stop, window, noise)
    keep = (
        ~slopes.on_ramp[first]
        & (end - first >= samples_in(_SHORTEST_S, rate_hz, least=2))
        & _is_flat(values, first, end, noise)
    )
    first, end = first[keep], end[keep]
    if noise > _HINGE_NOISE:
        needed = _needed(values, first, end, begin, 4 * window, noise)
        first, end = first[needed], end[needed]
    counts = int(slopes.on_ramp.sum()), int(slopes.varied.sum())
    return Plateaus(first, end, _robust_mean(values, first, end, noise), noise, *counts)


def _bounds(run: Ints) -> tuple[Ints, Ints]:
    """Return the first sample and one past the last of each sample's run, shape (T,) each."""
    starts = np.flatnonzero(np.diff(run, prepend=run[0] - 1))
    ends = np.append(starts[1:], run.size)
    return np.repeat(starts, ends - starts), np.repeat(ends, ends - starts)


def _steady(values: Vector, begin: Ints, stop: Ints, window: int, noise: float) -> Bools:
    """Return the samples at which the means of the windows before and after, and the sample itself, agree."""
    at = np.arange(values.size)
    low, high = np.maximum(at - window, begin), np.minimum(at + window + 1, stop)
    total = np.concatenate([[0.0], np.cumsum(values)])
    before, after = at - low, high - at - 1
    left = np.where(before > 0, (total[at] - total[low]) / np.maximum(before, 1), values)
    right = np.where(after > 0, (total[high] - total[at + 1]) / np.maximum(after, 1), values)
    deviation = noise * np.sqrt(1 / np.maximum(before, 1) + 1 / np.maximum(after, 1))
    agree = np.abs(right - left) <= np.maximum(_SIGMAS * deviation, _MIN_STEP)
    itself = np.abs(values - 0.5 * (left + right)) <= np.maximum(1.3 * _SIGMAS * noise, _MIN_STEP)
    return np.asarray(agree & itself & (high - low > 1))


def _cores(steady: Bools, run: Ints) -> tuple[Ints, Ints]:
    """Return first sample and one past the last of every sequence of steady samples."""
    new = steady & ~np.concatenate([[False], steady[:-1] & (np.diff(run) == 0)])
    over = steady & ~np.concatenate([steady[1:] & (np.diff(run) == 0), [False]])
    return np.flatnonzero(new), np.flatnonzero(over) + 1


def _by_samples(
    values: Vector, first: Ints, end: Ints, begin: Ints, stop: Ints, window: int, noise: float
) -> tuple[Ints, Ints]:
    """Extend every core over neighbouring samples of its value; where two meet, the earlier one ends."""
    near = max(3.0 * noise, 0.2 * _MIN_STEP)
    mean = _means(values, first, end)
    first, end = first.copy(), end.copy()
    for _ in range(window + 1):
        grows = (end < stop[end - 1]) & (np.abs(values[np.minimum(end, values.size - 1)] - mean) <= near)
        end = end + grows
        grows = (first > begin[first]) & (np.abs(values[np.maximum(first - 1, 0)] - mean) <= near)
        first = first - grows
    end[:-1] = np.minimum(end[:-1], first[1:])
    return first, np.maximum(end, first)


def _by_hinges(values: Vector, first: Ints, end: Ints, stop: Ints, window: int) -> tuple[Ints, Ints]:
    """Fit the times at which each core is left and the next one reached: value, straight line, value.

    Cores too far apart for a hinge are not extended.
    """
    mean = _means(values, first, end)
    first, end = first.copy(), end.copy()
    for k in range(first.size - 1):
        a, b = int(end[k]), int(first[k + 1])
        if stop[a - 1] <= b or b - a > 12 * window:
            continue
        leave, reach, _ = _hinge(values[a:b], mean[k], mean[k + 1])
        end[k], first[k + 1] = a + leave, a + reach
    return first, end


def _needed(values: Vector, first: Ints, end: Ints, begin: Ints, short: int, noise: float) -> Bools:
    """Return which plateaus are more than a piece of the ramp between their neighbours, shape (K,).

    Args:
        values: Shape (T,).
        first: First samples, shape (K,).
        end: One past the last samples, shape (K,).
        begin: First sample of the run of every sample, shape (T,).
        short: Number of samples from which a plateau is always kept.
        noise: Standard deviation of the noise.
    """
    needed = np.ones(first.size, np.bool_)
    mean, before = _means(values, first, end), 0
    for k in range(1, first.size - 1):
        a, b = int(end[before]), int(first[k + 1])
        if end[k] - first[k] < short and begin[a - 1] == begin[b] and b - a < 3 * short:
            straight = _hinge(values[a:b], mean[before], mean[k + 1])[2]
            to, on = values[a : first[k]], values[end[k] : b]
            held = float(((values[first[k] : end[k]] - mean[k]) ** 2).sum())
            held += _hinge(to, mean[before], mean[k])[2] + _hinge(on, mean[k], mean[k + 1])[2]
            needed[k] = straight - held > _EVIDENCE * noise**2
        before = k if needed[k] else before
    return needed


def _hinge(values: Vector, before: float, after: float) -> tuple[int, int, float]:
    """Return the best hinge: number of values still at `before`, first value at `after`, and the squared error."""
    count = values.size
    if count == 0:
        return 0, 0, 0.0
    places = np.arange(0, count + 1, -(-count // _HINGE_PLACES))
    leave, reach = (places[index] for index in np.triu_indices(places.size))
    at = np.arange(count)
    share = np.clip((at[None, :] - leave[:, None] + 1) / (reach - leave + 1)[:, None], 0.0, 1.0)
    error = ((before + (after - before) * share - values) ** 2).sum(axis=1)
    best = int(error.argmin())
    return int(leave[best]), int(reach[best]), float(error[best])


def _means(values: Vector, first: Ints, end: Ints) -> Vector:
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray((total[end] - total[first]) / np.maximum(end - first, 1))


def _is_flat(values: Vector, first: Ints, end: Ints, noise: float) -> Bools:
    """Return which plateaus are flat: no slope beyond the noise, and no more spread than the noise, shape (K,)."""
    count = np.maximum(end - first, 1).astype(np.float64)
    total = np.concatenate([[0.0], np.cumsum(values)])
    moment = np.concatenate([[0.0], np.cumsum(values * np.arange(values.size))])
    middle = first + (count - 1) / 2
    spread = np.maximum(count * (count**2 - 1) / 12, 1e-12)
    slope = (moment[end] - moment[first] - middle * (total[end] - total[first])) / spread
    straight = np.abs(slope) * count <= np.maximum(_DRIFT, 3 * noise / np.sqrt(spread) * count)
    squares = np.concatenate([[0.0], np.cumsum(values**2)])
    variance = (squares[end] - squares[first]) / count - ((total[end] - total[first]) / count) ** 2
    return np.asarray(straight & (variance <= max(2 * noise, _MIN_STEP) ** 2))


def _robust_mean(values: Vector, first: Ints, end: Ints, noise: float) -> Vector:
    """Return the mean of each plateau over the samples within four standard deviations of its plain mean."""
    count = end - first
    owner = np.repeat(np.arange(first.size), count)
    rows = np.arange(int(count.sum())) + np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
    mean = _means(values, first, end)
    near = np.abs(values[rows] - mean[owner]) <= max(4 * noise, _MIN_STEP)
    total = np.bincount(owner[near], weights=values[rows][near], minlength=first.size)
    kept = np.bincount(owner[near], minlength=first.size)
    return np.where(kept > 0, total / np.maximum(kept, 1), mean)
