"""Samples of a slow recovery: the scaling rises at the rate of the safety system."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Ints, Vector

MAX_RATE_PER_S = 0.7
"""Rate, 1/s, above which a recovery is over before the robot gets far."""
CHANGE = 0.06
"""Change of the scaling over which its rate is measured: six times the resolution of whole percents."""
MIN_SPAN_S, MAX_SPAN_S = 0.3, 1.5
MAX_GAP_SAMPLES, START_SAMPLES = 5, 3
"""Maximum gap within one recovery, and number of samples at its start at which its cause is looked for."""
TOLERANCE = 0.3
"""Maximum relative difference between the rate of a recovery and that of the safety system."""


def recovering(t_s: Vector, scaling: Vector, breaks: Bools, up_per_s: float | None) -> Bools:
    """Return the samples at which the scaling rises at the safety system's rate, shape (N,).

    Args:
        t_s: Time, shape (N,), s, ascending.
        scaling: Speed scaling, shape (N,), NaN = unknown.
        breaks: Whether there is a gap before the sample, shape (N,).
        up_per_s: Rate of the recovery, 1/s; None = at once or unknown.
    """
    if up_per_s is None or up_per_s > MAX_RATE_PER_S or len(t_s) < 2:
        return np.zeros(len(t_s), np.bool_)
    part = np.cumsum(breaks)
    span_s = min(max(CHANGE / up_per_s, MIN_SPAN_S), MAX_SPAN_S)
    rows: Ints = np.arange(len(t_s))
    rises = np.zeros(len(t_s), np.bool_)
    for first, last in (
        (rows, np.searchsorted(t_s, t_s + span_s)),
        (np.searchsorted(t_s, t_s - span_s, side="right") - 1, rows),
    ):
        a, b = np.maximum(first, 0), np.minimum(last, len(t_s) - 1)
        with np.errstate(invalid="ignore", divide="ignore"):
            rate = (scaling[b] - scaling[a]) / (t_s[b] - t_s[a])
            rises |= (part[a] == part[b]) & (np.abs(rate / up_per_s - 1.0) <= TOLERANCE)
    return np.asarray(rises & np.isfinite(scaling))


def begun_by(rises: Bools, breaks: Bools, cause: Bools) -> Bools:
    """Return the samples of recoveries that begin where a cause slows the robot, or at a gap, shape (N,).

    The robot is still slow there, although nothing slows it any more: a place where every pass recovers from people is
    no limit of the path. A recovery from a limit belongs to the limit.

    Args:
        rises: Whether the scaling recovers at each sample, shape (N,).
        breaks: Whether there is a gap before the sample, shape (N,).
        cause: Whether the cause slows the robot at each sample, shape (N,).
    """
    found = np.zeros(len(rises), np.bool_)
    rows = np.flatnonzero(rises)
    if not len(rows):
        return found
    part = np.cumsum(breaks)[rows]
    new = np.append(True, (np.diff(rows) > MAX_GAP_SAMPLES) | (np.diff(part) > 0))
    for run in np.split(rows, np.flatnonzero(new)[1:]):
        first = int(run[0])
        begins = slice(first, min(first + START_SAMPLES, len(rises)))
        if breaks[first] or cause[begins].any():
            found[first : run[-1] + 1] = True
    return found
