"""The clock fit, and the simple methods: shared log, cell file, epoch time, common start, two stamps per row.

A fit includes its method and its quality, so that a report can reject a weak one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from cyclekit.adapter.clock_line import EXPLAINED, MAX_DRIFT, MAX_RATE, least_delays, slope_under
from cyclekit.dataset.cards import ClockCard, ClockMethod, ClockTest, Note, note
from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from cyclekit.adapter import ClockKind
    from cyclekit.config import Source
    from cyclekit.schema import Vector

ASSUMED: Final = "assumed-common-start"
"""Method for unrelated clocks: a common start of the recordings is assumed."""
Method = ClockMethod


@dataclass(frozen=True)
class ClockStart:
    """Kind of one log's clock, and the time of its first row, s."""

    kind: ClockKind
    first_s: float


@dataclass(frozen=True)
class ClockFit:
    """Clock fit t_other = rate * t_log + offset_s, with its method and quality.

    Attributes:
        method: Method; see docs/clocks.md.
        offset_s, rate: The line; t_other is session time for a fit made for a session, else the other log's time.
        warnings: Doubts about the fit.
        residual_s: Typical residual, s; None if there are no data to check it.
        events: Number of event pairs (or windows of motion) in the fit.
        events_rejected: Number of events of the log without a match, or in contradiction to the others.
        correlation: Peak of the correlation, -1 to 1.
        second_best: Height of the second peak divided by that of the first; near 1, the fit is ambiguous.
        second_best_s: Distance of the second peak from the first, s.
        same_as: Recording whose clock this log shares.
        test: What the logs themselves say about it.
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
    test: ClockTest | None = None

    def since(self, start_s: float) -> ClockFit:
        """Return the fit to the other log's time counted from `start_s`."""
        return replace(self, offset_s=self.offset_s - start_s)

    def card(self, kind: ClockKind) -> ClockCard:
        """Return the clock card of a log whose clock is of that kind."""
        return ClockCard(kind=kind, **vars(self))

    @classmethod
    def of(cls, card: ClockCard) -> ClockFit:
        """Return the fit that a card holds."""
        return cls(**{one.name: getattr(card, one.name) for one in fields(cls)})


def fit_clock(log: ClockStart, master: ClockStart, source: Source | None, *, same_log: bool = False) -> ClockFit:
    """Map the time of `log` to the time of its session, whose clock is `master`'s, without reading the logs.

    Args:
        log: The log to align.
        master: The session's robot log (or the only log).
        source: Section of the cell file for `log`.
        same_log: Whether `log` and `master` are tables of one file, so that they share a clock.
    """
    if same_log:
        return ClockFit("same-log", -master.first_s)
    if source is not None and source.clock_offset_s is not None:
        return ClockFit("cell-file", source.clock_offset_s - master.first_s, source.clock_rate)
    if log.kind == "epoch" and master.kind == "epoch":
        return ClockFit("epoch", -master.first_s)
    return ClockFit(ASSUMED, -log.first_s, 1.0, (note("clock-assumed"),))


SHORT_S = 20.0
"""Minimum span of a log to fit a rate, s."""
_SAME_S = 1e-9
"""Tolerance for equal stamps, s: no clock resolves less."""
_EXACT, _PARTS = 50_000, 4096
"""Maximum number of stamps for the exact hull; above, number of parts from each of which the minimum delay is used."""


def lower_envelope(device_s: Vector, host_s: Vector, *, max_drift: float = 1e-3) -> ClockFit:
    """Return host time as a line of device time, with transmission delays removed except their minimum.

    Args:
        device_s: Stamps of the device, shape (N,), N >= 2, s.
        host_s: Times at which the host received them, shape (N,), s.
        max_drift: Maximum difference of the rate from 1: steeper data are growing delays.

    Returns:
        The fit; `residual_s` is the median delay above the line.

    Raises:
        ShapeError: The arrays differ in length, are shorter than two, or contain values that are not finite.
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
    """Return host time as a line of device time, for any rate of the device; None if no line fits.

    If the rate reaches MAX_DRIFT, it is more than drift: rates up to MAX_RATE are tried, and a note is added.

    Args:
        device_s: Stamps of the device, shape (N,), N >= 2, s.
        host_s: Times at which the host received them, shape (N,), s.

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
