"""Slow ramps of a speed scaling: time between levels, and never a level.

A ramp of 5 % a second looks level from one sample to the next. Seen over a second or more it is a straight line, and
its slope is one that the others have as well: a safety system has a rate for rising and one for falling. A scaling
that follows a distance has many slopes; then nothing is a ramp here, and whoever looks for levels sees that few are
held.
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
"""Values that deviate so much from a straight line lie on it, even without noise: whole percents deviate by .003."""
_OFF_NOISE = 1.3
_CLIMBS, _CLIMBS_NOISE = 0.05, 6.0
"""By how much a ramp rises or falls in a window at least; a step hidden in so much noise looks like less."""
_ALIKE = 1.25
"""Slopes that differ by less than this factor are one rate."""
_MOSTLY = 0.6
"""So much of the time on straight slopes must be spent at one rate."""
_NOISY = 0.025
"""In more noise than this two levels with a short ramp between them look like a long ramp: nothing is told."""
_LEAST_S = 3.0
"""Less time on ramps does not tell their rate."""


@dataclass(frozen=True)
class Slopes:
    """What of a scaling lies on straight slopes.

    Attributes:
        on_ramp: Which samples lie on slow ramps of the usual rate, shape (T,).
        varied: Which lie on slopes of no usual rate, shape (T,).
    """

    on_ramp: Bools
    varied: Bools


def find_slopes(values: Vector, begin: Rows, stop: Rows, rate_hz: float, noise: float) -> Slopes:
    """Find the slow ramps.

    Args:
        values: Speed scaling, shape (T,), finite, in the order of time.
        begin: First sample of the unbroken stretch of every sample, shape (T,).
        stop: One past its last sample, shape (T,).
        rate_hz: Rate of the samples.
        noise: Standard deviation of the noise of one sample.
    """
    on_ramp, varied = np.zeros(values.size, np.bool_), np.zeros(values.size, np.bool_)
    for half in sorted({samples_in(window_s / 2, rate_hz, least=2) for window_s in _WINDOWS_S}):
        if 2 * half + 1 > values.size or noise > _NOISY:
            break
        slope, straight = _lines(values, begin, stop, half, noise)
        for way in (straight & (slope > 0), straight & (slope < 0)):
            usual = _usual(np.abs(slope[way]), samples_in(_LEAST_S, rate_hz))
            alike = way & _is_alike(np.abs(slope), usual)
            on_ramp |= _spread(alike, half)
            varied |= _spread(way & ~alike, half)
    return Slopes(on_ramp, varied & ~on_ramp)


def _lines(values: Vector, begin: Rows, stop: Rows, half: int, noise: float) -> tuple[Vector, Bools]:
    """Return the slope per sample of the window around each sample, and where it is a straight line that climbs."""
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
    """Return the slope that most have, None where there is none."""
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
    """Return which samples lie in the window of a flagged one."""
    total = np.concatenate([[0], np.cumsum(flags)])
    at = np.arange(flags.size)
    return np.asarray(total[np.minimum(at + half + 1, flags.size)] > total[np.maximum(at - half, 0)])
