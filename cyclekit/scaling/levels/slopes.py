"""Slow ramps of a speed scaling: transitions between levels, never levels.

A ramp of 5 % per second looks constant from one sample to the next. Over a second or more, it is a straight line with
the same slope as the other ramps: a safety system has one rate for rising and one for falling. A scaling that follows
a distance has various slopes; then no ramps are found, and few values are held.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.time_grid import samples_in

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Vector

    Rows = NDArray[np.int64]

_WINDOWS_S = (0.6, 1.0, 1.6, 2.5, 4.0, 6.0)
_OFF = 0.006
"""Maximum residual of a straight line without noise: rounding to whole percent gives 0.003."""
_OFF_NOISE = 1.3
_CLIMBS, _CLIMBS_NOISE = 0.05, 6.0
"""Minimum change of a ramp within a window: absolute, and in units of the noise, as a noisy step looks like a slope."""
_ALIKE = 1.25
"""Maximum ratio of slopes of one rate."""
_MOSTLY = 0.6
"""Minimum share of the time on straight slopes that is spent at one rate."""
_NOISY = 0.025
"""Maximum noise: above, two levels with a short ramp between them look like a long ramp."""
_MIN_S = 3.0
"""Minimum time on ramps to determine their rate, s."""


@dataclass(frozen=True)
class Slopes:
    """Samples of a scaling on straight slopes.

    Attributes:
        on_ramp: Whether a sample is on a slow ramp of the usual rate, shape (T,).
        varied: Whether it is on another straight slope, shape (T,).
    """

    on_ramp: Bools
    varied: Bools


def find_slopes(values: Vector, begin: Rows, stop: Rows, rate_hz: float, noise: float) -> Slopes:
    """Find the slow ramps.

    Args:
        values: Speed scaling, shape (T,), finite, in order of time.
        begin: First sample of each sample's stretch without gaps, shape (T,).
        stop: One past the last sample of that stretch, shape (T,).
        rate_hz: Rate of the samples.
        noise: Standard deviation of the noise of one sample.
    """
    on_ramp, varied = np.zeros(values.size, np.bool_), np.zeros(values.size, np.bool_)
    for half in sorted({samples_in(window_s / 2, rate_hz, least=2) for window_s in _WINDOWS_S}):
        if 2 * half + 1 > values.size or noise > _NOISY:
            break
        slope, straight = _lines(values, begin, stop, half, noise)
        for way in (straight & (slope > 0), straight & (slope < 0)):
            usual = _usual(np.abs(slope[way]), samples_in(_MIN_S, rate_hz))
            alike = way & _is_alike(np.abs(slope), usual)
            on_ramp |= _spread(alike, half)
            varied |= _spread(way & ~alike, half)
    return Slopes(on_ramp, varied & ~on_ramp)


def _lines(values: Vector, begin: Rows, stop: Rows, half: int, noise: float) -> tuple[Vector, Bools]:
    """Return the slope per sample of the window around each sample, and whether that is a straight slope."""
    count, at = 2 * half + 1, np.arange(values.size)
    whole = (at - half >= begin) & (at + half < stop)
    middle = at[half : values.size - half]
    centred = values - values.mean()
    sums = [_window_sums(part, count) for part in (centred, centred * at, centred**2)]
    spread = count * (count**2 - 1) / 12
    slope = np.zeros(values.size)
    slope[middle] = (sums[1] - middle * sums[0]) / spread
    squares = sums[2] - sums[0] ** 2 / count - slope[middle] ** 2 * spread
    off = np.full(values.size, np.inf)
    off[middle] = np.sqrt(np.maximum(squares, 0.0) / max(count - 2, 1))
    climbs = np.abs(slope) * count >= max(_CLIMBS, _CLIMBS_NOISE * noise)
    return slope, np.asarray(whole & climbs & (off <= max(_OFF, _OFF_NOISE * noise)))


def _window_sums(values: Vector, count: int) -> Vector:
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[count:] - total[:-count])


def _usual(slopes: Vector, least: int) -> float | None:
    """Return the slope of most samples; None if there is none."""
    ordered = np.sort(slopes)
    if ordered.size < least:
        return None
    most = np.searchsorted(ordered, ordered * _ALIKE, side="right") - np.arange(ordered.size)
    first = int(most.argmax())
    if most[first] < _MOSTLY * ordered.size:
        return None
    return float(np.median(ordered[first : first + most[first]]))


def _is_alike(slopes: Vector, usual: float | None) -> Bools:
    if usual is None:
        return np.zeros(slopes.size, np.bool_)
    return np.asarray((slopes < usual * _ALIKE) & (slopes > usual / _ALIKE))


def _spread(flags: Bools, half: int) -> Bools:
    """Return which samples are in the window of a flagged one."""
    total = np.concatenate([[0], np.cumsum(flags)])
    at = np.arange(flags.size)
    return np.asarray(total[np.minimum(at + half + 1, flags.size)] > total[np.maximum(at - half, 0)])
