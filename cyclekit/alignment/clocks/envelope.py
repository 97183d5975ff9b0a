"""A clock out of two stamps per row: when the device says it happened, and when the host received it (`clock_line`)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.adapter.clock_line import EXPLAINED, MAX_DRIFT, MAX_RATE, least_delays, slope_under
from cyclekit.alignment.clocks.fit import ClockFit
from cyclekit.dataset.cards import note
from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from cyclekit.schema import Vector


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
    few = np.arange(len(x)) if len(x) <= _EXACT else least_delays(y - x, _PARTS)
    rate = float(np.clip(slope_under(x[few], y[few], same_s=_SAME_S), 1 - max_drift, 1 + max_drift))
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
