"""A clock out of two stamps per row: when the device says it happened, and when the host received it.

A message cannot arrive before it was sent, so the true line lies below the cloud of (device, host) stamps and touches
it where the delay was least. This is Olson's passive synchronisation (2010), with one line for the whole log: of all
lines under the cloud the one that is nearest to it on the whole, an edge of its lower convex hull.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.alignment.clocks.fit import ClockFit
from cyclekit.dataset.cards import note
from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector


MAX_DRIFT = 5e-3
"""Clocks were seen to run 0.3 % off; what climbs faster is growing delays."""
MAX_RATE = 0.05
"""Simulated time runs up to this much faster or slower than a host's and is followed, where a line fits it."""
EXPLAINED = 0.1
"""A line at such a rate fits if stamps typically lie above it by less than this share of what the clocks move apart."""
SHORT_S = 20.0
"""From less no rate is told."""
_SAME_S = 1e-9
"""No clock tells stamps apart that are nearer to each other; between those there is no slope."""
_EXACT, _PARTS = 50_000, 4096
"""Beyond so many stamps the hull is taken over the least delay of each of so many consecutive parts."""


def lower_envelope(device_s: Vector, host_s: Vector, *, max_drift: float = 1e-3) -> ClockFit:
    """Return host time as a line of device time, without the delays in between; the least delay stays in the offset.

    Args:
        device_s: Stamps of the device, shape (N,), N >= 2, seconds.
        host_s: When the host received each, shape (N,).
        max_drift: The rate is at most this far from 1: a cloud that climbs faster is one of growing delays.

    Returns:
        The fit; `residual_s` is the median delay above it.

    Raises:
        ShapeError: The arrays differ in length, are shorter than two, or hold values that are not finite.
    """
    if device_s.shape != host_s.shape or device_s.ndim != 1 or len(device_s) < 2:
        raise ShapeError(f"device_s {device_s.shape} and host_s {host_s.shape} must be (N,), N >= 2")
    if not (np.isfinite(device_s).all() and np.isfinite(host_s).all()):
        raise ShapeError("device_s and host_s must be finite")
    x0, y0 = float(device_s[0]), float(host_s[0])
    order = np.lexsort((host_s, device_s))
    x, y = device_s[order] - x0, host_s[order] - y0
    few = np.arange(len(x)) if len(x) <= _EXACT else _lowest(y - x)
    rate = float(np.clip(_slope_under(x[few], y[few]), 1 - max_drift, 1 + max_drift))
    level = float(np.min(y - rate * x))
    delay = float(np.median(y - rate * x - level))
    return ClockFit("lower-envelope", y0 + level - rate * x0, rate, residual_s=delay, events=len(x))


def follow(device_s: Vector, host_s: Vector) -> ClockFit | None:
    """Return host time as a line of device time at whatever rate the device runs; None where no line fits.

    A rate at MAX_DRIFT is none: it is looked for up to MAX_RATE, and said.

    Args:
        device_s: Stamps of the device, shape (N,), N >= 2, seconds.
        host_s: When the host received each, shape (N,).

    Raises:
        ShapeError: As `lower_envelope`.
    """
    fit = lower_envelope(device_s, host_s, max_drift=MAX_DRIFT)
    if abs(fit.rate - 1.0) < MAX_DRIFT * (1.0 - 1e-9):
        return fit
    span_s = float(np.ptp(device_s))
    if span_s < SHORT_S:
        return lower_envelope(device_s, host_s, max_drift=0.0)
    fit = lower_envelope(device_s, host_s, max_drift=MAX_RATE)
    apart = abs(fit.rate - 1.0)
    if apart >= MAX_RATE * (1.0 - 1e-9) or (fit.residual_s or 0.0) > EXPLAINED * apart * span_s:
        return None
    return replace(fit, warnings=(note("clock-of-host-differs", rate=1.0 / fit.rate),))


def _lowest(delay: Vector) -> Ints:
    """Return the row of the least delay in each of the consecutive parts."""
    size = -(-len(delay) // _PARTS)
    return np.array([a + int(delay[a : a + size].argmin()) for a in range(0, len(delay), size)], np.int64)


def _slope_under(x: Vector, y: Vector) -> float:
    """Return the slope of the hull's edge below the mean of the cloud: there the sum of the delays is least."""
    hull: list[tuple[float, float]] = []
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        if hull and px - hull[-1][0] <= _SAME_S:
            continue  # same device time: the first one is the lowest
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-2], hull[-1]
            if (bx - ax) * (py - ay) > (by - ay) * (px - ax):
                break
            hull.pop()
        hull.append((px, py))
    if len(hull) < 2:
        return 1.0
    corners = np.array(hull)
    edge = int(np.clip(np.searchsorted(corners[:, 0], x.mean()), 1, len(corners) - 1))
    rise = corners[edge] - corners[edge - 1]
    return float(rise[1] / rise[0])
