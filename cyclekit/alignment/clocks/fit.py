"""What a clock fit is, and the simple fits: a shared log, the cell file, epoch time, a common start, two stamps a row.

A fit carries how it was found and how well: a report can then refuse a weak one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from cyclekit.adapter.clock_line import EXPLAINED, MAX_DRIFT, MAX_RATE, least_delays, slope_under
from cyclekit.dataset.cards import ClockCard, ClockMethod, Note, note
from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from cyclekit.adapter import ClockKind
    from cyclekit.config import Source
    from cyclekit.schema import Vector

ASSUMED: Final = "assumed-common-start"
"""Nothing says how the clocks relate: the recordings are taken to start together."""
Method = ClockMethod


@dataclass(frozen=True)
class ClockStart:
    """What is known of one log's clock: its kind and the time of its first row, seconds."""

    kind: ClockKind
    first_s: float


@dataclass(frozen=True)
class ClockFit:
    """t_other = rate * t_log + offset_s, and how that was found.

    Attributes:
        method: How; see docs/clocks.md.
        offset_s, rate: The line; of a fit made for a session t_other is session time, else the other log's time.
        warnings: What a person must know before trusting it.
        residual_s: What the fit leaves unexplained, typically, seconds; None where nothing was left to check it by.
        events: Event pairs (or windows of motion) that the fit rests on.
        events_rejected: Events of the log that found no partner, or contradicted the others.
        correlation: Peak of the correlation, -1 to 1.
        second_best: Height of the second peak over that of the first; near 1 the fit is ambiguous.
        second_best_s: How far the second peak lies from the first, seconds.
        same_as: Recording whose clock this log shares.
    """

    method: Method
    offset_s: float
    rate: float = 1.0
    warnings: tuple[Note, ...] = ()
    residual_s: float | None = None
    events: int | None = None
    events_rejected: int | None = None
    correlation: float | None = None
    second_best: float | None = None
    second_best_s: float | None = None
    same_as: str | None = None

    def since(self, start_s: float) -> ClockFit:
        """Return the fit onto the time that counts from `start_s` of the other log."""
        return replace(self, offset_s=self.offset_s - start_s)

    def card(self, kind: ClockKind) -> ClockCard:
        """Return the card of a log whose clock is of that kind."""
        return ClockCard(kind=kind, **vars(self))

    @classmethod
    def of(cls, card: ClockCard) -> ClockFit:
        """Return the fit that a card holds."""
        return cls(**{one.name: getattr(card, one.name) for one in fields(cls)})


def fit_clock(log: ClockStart, master: ClockStart, source: Source | None, *, same_log: bool = False) -> ClockFit:
    """Map the time of `log` to the time of its session, whose clock is `master`'s, without looking into the logs.

    Args:
        log: The log to be placed.
        master: The session's robot log (or the only log there is).
        source: What the cell file says about `log`.
        same_log: `log` and `master` are tables of one file, so they share a clock by construction.
    """
    if same_log:
        return ClockFit("same-log", -master.first_s)
    if source is not None and source.clock_offset_s is not None:
        return ClockFit("cell-file", source.clock_offset_s - master.first_s, source.clock_rate)
    if log.kind == "epoch" and master.kind == "epoch":
        return ClockFit("epoch", -master.first_s)
    return ClockFit(ASSUMED, -log.first_s, 1.0, (note("clock-assumed"),))


SHORT_S = 20.0
"""Minimum span of a log, s, for a rate to be fitted."""
_SAME_S = 1e-9
"""Stamps closer than this count as one: no clock resolves them."""
_EXACT, _PARTS = 50_000, 4096
"""Above the first number of stamps, the hull is that of the least delays in the second number of parts."""


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

    A rate at MAX_DRIFT is no drift: then rates up to MAX_RATE are tried, and a note says so.

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
