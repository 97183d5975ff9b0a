"""Plateaus of a speed scaling: the stretches of time over which one value is held, and that value.

The order in time is what tells a level from a ramp: a level that is in force for two seconds a day and the ramps that
pass its value a hundred times look the same in a histogram. A sample is *steady* where the means of the windows before
and after it agree; a run of steady samples is the core of a plateau, a core with a slope is none, and between two
plateaus the point where one is left and the other reached is fitted by least squares (a hinge), so that a short plateau
is averaged over all of its samples. Which plateaus share a level is the business of `staircase`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.time_grid import USUAL_HZ, samples_in
from cyclekit.scaling.levels.slopes import find_slopes

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Ints, Vector


_LEAST_NOISE = 1e-4
_WINDOW_S = 50.0
"""A window of (50 s x rate x noise)^(2/3) samples tells a ramp of 0.2 a second (full range in 5 s) from a plateau."""
_SIGMAS = 3.5
_LEAST_STEP = 0.01
"""Windows whose means differ by less than this agree, even without noise."""
_DRIFT = 0.03
"""A plateau whose fitted line rises or falls by more than this is a slow ramp."""
_NARROWEST_S, _WIDEST_S = 0.1, 1.0
"""Bounds of the window: with shorter ones a slow ramp of many samples looks steady from one to the next."""
_SHORTEST_S = 0.2
"""A value held for a shorter time is not a plateau; nor is a single sample."""
_EVIDENCE = 30.0
"""A short plateau must lower the squared error of a straight way past it by this many noise variances (3 ln T)."""
_HINGE_PLACES = 120
"""Where a plateau may be left and reached: at no more places than this between two cores, evenly spread."""
_HINGE_NOISE = 0.008
"""With less noise than this the ends of a plateau are seen sample by sample; with more they are fitted."""


@dataclass(frozen=True)
class Plateaus:
    """K plateaus in the order of time.

    Attributes:
        first: First sample of each, shape (K,).
        end: One past its last sample, shape (K,).
        value: Its mean without outliers, shape (K,).
        noise: Standard deviation of the noise of one sample.
        on_ramp: How many samples lie on slow ramps, and so on no plateau.
        varied: How many lie on slopes of many rates.
    """

    first: Ints
    end: Ints
    value: Vector
    noise: float
    on_ramp: int = 0
    varied: int = 0

    @property
    def samples(self) -> Ints:
        """How many samples each one lasts, shape (K,)."""
        return self.end - self.first


def noise_of(values: Vector) -> float:
    """Return the noise of a signal of plateaus and ramps: second differences vanish on both.

    The median leaves the jumps out as long as they are fewer than the rest, the lower quartile longer; the lesser of
    the two estimates counts.

    Args:
        values: Shape (T,), finite.
    """
    if values.size < 3:
        return _LEAST_NOISE
    second = values[2:] - 2 * values[1:-1] + values[:-2]
    quartile, median = np.quantile(np.abs(second), (0.25, 0.5)) / 6**0.5
    return max(float(min(quartile / 0.3186, median / 0.6745)), _LEAST_NOISE)


def find_plateaus(values: Vector, run: Ints, *, rate_hz: float = USUAL_HZ, most_noise: float = np.inf) -> Plateaus:
    """Find the plateaus.

    Args:
        values: Speed scaling, shape (T,), finite, in the order of time.
        run: Number of the unbroken stretch that each sample belongs to, shape (T,), not falling; nothing is compared
            across a change of it.
        rate_hz: Rate of the samples.
        most_noise: More than this is not noise but change: of known levels, an eighth of their least distance.
    """
    if values.size == 0:
        return Plateaus(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), _LEAST_NOISE)
    noise = min(noise_of(values), most_noise)
    bounds = samples_in(_NARROWEST_S, rate_hz), samples_in(_WIDEST_S, rate_hz)
    window = int(np.clip(np.ceil((_WINDOW_S * rate_hz * noise) ** (2 / 3)), *bounds))
    begin, stop = _bounds(run)
    slopes = find_slopes(values, begin, stop, rate_hz, noise)
    if slopes.on_ramp.any():  # what is on a ramp is no plateau, and none reaches across it
        run = np.cumsum(np.diff(run, prepend=run[0]) + np.abs(np.diff(slopes.on_ramp, prepend=False)) != 0)
        begin, stop = _bounds(run)
    first, end = _cores(_steady(values, begin, stop, window, noise), run)
    reach = _by_hinges if noise > _HINGE_NOISE else _by_samples
    first, end = reach(values, first, end, begin, stop, window, noise)
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
    """Return the first sample and one past the last of the run of every sample, shape (T,) each."""
    starts = np.flatnonzero(np.diff(run, prepend=run[0] - 1))
    ends = np.append(starts[1:], run.size)
    return np.repeat(starts, ends - starts), np.repeat(ends, ends - starts)


def _steady(values: Vector, begin: Ints, stop: Ints, window: int, noise: float) -> Bools:
    """Tell at which samples the means of the windows before and after, and the sample itself, agree."""
    at = np.arange(values.size)
    low, high = np.maximum(at - window, begin), np.minimum(at + window + 1, stop)
    total = np.concatenate([[0.0], np.cumsum(values)])
    before, after = at - low, high - at - 1
    left = np.where(before > 0, (total[at] - total[low]) / np.maximum(before, 1), values)
    right = np.where(after > 0, (total[high] - total[at + 1]) / np.maximum(after, 1), values)
    deviation = noise * np.sqrt(1 / np.maximum(before, 1) + 1 / np.maximum(after, 1))
    agree = np.abs(right - left) <= np.maximum(_SIGMAS * deviation, _LEAST_STEP)
    itself = np.abs(values - 0.5 * (left + right)) <= np.maximum(1.3 * _SIGMAS * noise, _LEAST_STEP)
    return np.asarray(agree & itself & (high - low > 1))


def _cores(steady: Bools, run: Ints) -> tuple[Ints, Ints]:
    """Return first sample and one past the last of every run of steady samples."""
    new = steady & ~np.concatenate([[False], steady[:-1] & (np.diff(run) == 0)])
    over = steady & ~np.concatenate([steady[1:] & (np.diff(run) == 0), [False]])
    return np.flatnonzero(new), np.flatnonzero(over) + 1


def _by_samples(
    values: Vector, first: Ints, end: Ints, begin: Ints, stop: Ints, window: int, noise: float
) -> tuple[Ints, Ints]:
    """Extend every core over the neighbouring samples of its value; where two meet, the earlier one ends."""
    near = max(3.0 * noise, 0.2 * _LEAST_STEP)
    mean = _means(values, first, end)
    first, end = first.copy(), end.copy()
    for _ in range(window + 1):
        grows = (end < stop[end - 1]) & (np.abs(values[np.minimum(end, values.size - 1)] - mean) <= near)
        end = end + grows
        grows = (first > begin[first]) & (np.abs(values[np.maximum(first - 1, 0)] - mean) <= near)
        first = first - grows
    end[:-1] = np.minimum(end[:-1], np.maximum(first[1:], end[:-1] * 0))
    return first, np.maximum(end, first)


def _by_hinges(
    values: Vector, first: Ints, end: Ints, begin: Ints, stop: Ints, window: int, noise: float
) -> tuple[Ints, Ints]:
    """Fit where every core is left and the next one reached: value, straight line, value.

    Cores that lie further apart than any hinge needs only reach as far as a window does.
    """
    del noise
    mean = _means(values, first, end)
    first, end = first.copy(), end.copy()
    for k in range(first.size - 1):
        a, b = int(end[k]), int(first[k + 1])
        if stop[a - 1] <= b or b - a > 12 * window:
            continue
        leave, reach, _ = _hinge(values[a:b], mean[k], mean[k + 1])
        end[k], first[k + 1] = a + leave, a + reach
    del begin
    return first, end


def _needed(values: Vector, first: Ints, end: Ints, begin: Ints, short: int, noise: float) -> Bools:
    """Tell which plateaus are more than a piece of the ramp between their neighbours.

    Args:
        values: Shape (T,).
        first: First samples, shape (K,).
        end: One past the last samples, shape (K,).
        begin: First sample of the run of every sample, shape (T,).
        short: Plateaus of at least this many samples are not questioned.
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
    """Return how many values still are `before`, from which on they are `after`, and the squared error: the least."""
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
    """Tell which plateaus are flat: no slope that matters beyond the noise, and no more spread than the noise has."""
    count = np.maximum(end - first, 1).astype(np.float64)
    total = np.concatenate([[0.0], np.cumsum(values)])
    moment = np.concatenate([[0.0], np.cumsum(values * np.arange(values.size))])
    middle = first + (count - 1) / 2
    spread = np.maximum(count * (count**2 - 1) / 12, 1e-12)
    slope = (moment[end] - moment[first] - middle * (total[end] - total[first])) / spread
    straight = np.abs(slope) * count <= np.maximum(_DRIFT, 3 * noise / np.sqrt(spread) * count)
    squares = np.concatenate([[0.0], np.cumsum(values**2)])
    variance = (squares[end] - squares[first]) / count - ((total[end] - total[first]) / count) ** 2
    return np.asarray(straight & (variance <= max(2 * noise, _LEAST_STEP) ** 2))


def _robust_mean(values: Vector, first: Ints, end: Ints, noise: float) -> Vector:
    """Return the mean of each plateau over the samples within four deviations of its plain mean."""
    count = end - first
    owner = np.repeat(np.arange(first.size), count)
    rows = np.arange(int(count.sum())) + np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
    mean = _means(values, first, end)
    near = np.abs(values[rows] - mean[owner]) <= max(4 * noise, _LEAST_STEP)
    total = np.bincount(owner[near], weights=values[rows][near], minlength=first.size)
    kept = np.bincount(owner[near], minlength=first.size)
    return np.where(kept > 0, total / np.maximum(kept, 1), mean)
