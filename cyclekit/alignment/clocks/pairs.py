"""A clock out of events that both logs saw: a button, a digital output wired to the tracker, a clap on the robot.

With two events a line is exact but unchecked, so three or more, spread over the run, are asked for. Events that only
one log saw, or that are somewhere else in the two, are left out; a fit says how many. Which rows of a log are events is
a matter for `recording_clocks`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.alignment.clocks.fit import ClockFit
from cyclekit.dataset.cards import Note, note
from cyclekit.errors import ConfigError

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector


DRIFT = 0.01
"""No clock runs faster or slower than another by more than this: the worst published case was 0.003."""
SPREAD_S, SPREAD_OF_TWO_S = 60.0, 600.0
"""A rate is fitted to three events that span at least the first, or to two that span the second."""
SURE_S = 0.02
"""Events this near to the line are never rejected: a controller's and a tracker's cycle together."""
WINDOW_S = 0.5
"""Events whose distances agree this well are taken for the same ones at first sight: 50 ppm over an hour is 0.18 s."""
MOST = 2000
"""Maximum number of events used of each log, the first ones."""
AMBIGUOUS = 0.9
"""A second way to match that has at least this share of the best one's support is warned of."""


def fit_pairs(log_s: Vector, other_s: Vector) -> ClockFit:
    """Return the line through events whose times are known in both logs.

    Args:
        log_s: Times of the events in the log to be placed, shape (N,), N >= 1.
        other_s: Times of the same events in the other log, shape (N,).

    Raises:
        ConfigError: The two lists contradict each other: no clock runs like that.
    """
    if len(log_s) != len(other_s) or len(log_s) == 0:
        raise ConfigError(f"{len(log_s)} and {len(other_s)} times of events", cure="Give each event in both clocks.")
    keep = np.ones(len(log_s), bool)
    line = _first_line(log_s, other_s)
    for _ in range(20):
        apart = np.abs(other_s - _at(line, log_s))
        limit = max(SURE_S, 4.45 * float(np.median(apart[keep])))  # three standard deviations of a normal
        chosen = apart <= limit
        if chosen.sum() < 1 or (chosen == keep).all():
            break
        keep = chosen
        line = _least_squares(log_s[keep], other_s[keep])
    line = _least_squares(log_s[keep], other_s[keep])
    if len(log_s) >= 3 and keep.sum() < 2:
        raise ConfigError(
            f"{len(log_s)} pairs of events contradict each other",
            cure="Check that each pair is one event, in seconds of the two logs, this log's time first.",
        )
    return _fit(line, log_s[keep], other_s[keep], rejected=int((~keep).sum()))


def fit_events(log_s: Vector, other_s: Vector) -> ClockFit:
    """Return the line through events that both logs saw, not knowing which is which.

    The offset on which most distances agree tells the pairs; they are fitted, matched again, and the window shrinks.

    Args:
        log_s: Times of the events in the log to be placed, shape (N,).
        other_s: Times of the events in the other log, shape (M,); either may hold events that the other missed.

    Raises:
        ConfigError: One of the lists is empty, or they have nothing in common.
    """
    log_s, other_s = _first_ones(np.sort(log_s)), _first_ones(np.sort(other_s))
    fewer = min(len(log_s), len(other_s))
    if fewer == 0:
        raise ConfigError(f"{len(log_s)} events in this log and {len(other_s)} in the robot's", cure="Name another.")
    offset, votes, second, second_s = _vote(log_s, other_s)
    line, window = (offset, 1.0, 0.0), WINDOW_S
    mine, theirs = _partners(_at(line, log_s), other_s, window)
    for _ in range(10):
        line = _least_squares(log_s[mine], other_s[theirs])
        apart = np.abs(other_s[theirs] - _at(line, log_s[mine]))
        window = max(SURE_S, min(window, 4.45 * float(np.median(apart))))
        before = len(mine)
        mine, theirs = _partners(_at(line, log_s), other_s, window)
        if len(mine) == before or len(mine) == 0:
            break
    if len(mine) < min(3, fewer):
        raise ConfigError(
            f"{len(log_s)} events in this log and {len(other_s)} in the robot's, and no three of them match",
            cure="Name signals that change at the same instants, or give the pairs as sync_events.",
        )
    line = _least_squares(log_s[mine], other_s[theirs])
    fit = _fit(line, log_s[mine], other_s[theirs], rejected=len(log_s) - len(mine))
    return _with_doubt(fit, len(mine), fewer, second / votes, second_s)


def _first_ones(times_s: Vector) -> Vector:
    return times_s[:MOST]  # not every n-th one: the other log's n-th would be another event


def _first_line(x: Vector, y: Vector) -> tuple[float, float, float]:
    """A line that a few wrong pairs do not move: the median of the slopes that a clock can have."""
    if len(x) < 3 or np.ptp(x) < SPREAD_S:
        return float(np.median(y - x)), 1.0, 0.0
    i, j = np.triu_indices(min(len(x), 300), 1)
    far = np.abs(x[j] - x[i]) > 0.1 * np.ptp(x)
    slopes = (y[j] - y[i])[far] / (x[j] - x[i])[far]
    slopes = slopes[np.abs(slopes - 1.0) < DRIFT]
    rate = float(np.median(slopes)) if len(slopes) else 1.0
    about = float(np.median(x))
    return float(np.median(y - about - rate * (x - about))), rate, about


def _at(line: tuple[float, float, float], x: Vector) -> Vector:
    offset, rate, about = line
    return about + offset + rate * (x - about)


def _least_squares(x: Vector, y: Vector) -> tuple[float, float, float]:
    """(offset, rate, about): y = about + offset + rate * (x - about); about the middle, since epoch times are long."""
    about = float(np.mean(x))
    dx, dy = x - about, y - about
    spread = float(np.ptp(x))
    if (len(x) >= 3 and spread >= SPREAD_S) or (len(x) == 2 and spread >= SPREAD_OF_TWO_S):
        rate = float(dx @ (dy - dy.mean()) / (dx @ dx))
    else:
        rate = 1.0
    return float(dy.mean()), rate, about


def _fit(line: tuple[float, float, float], x: Vector, y: Vector, *, rejected: int) -> ClockFit:
    offset, rate, about = line
    if abs(rate - 1.0) > DRIFT:
        raise ConfigError(
            f"the events would have this log's clock run at {rate:.4f} of the robot's",
            cure="Check that both times are seconds, and that each pair is one event.",
        )
    free = len(x) - (2 if rate != 1.0 else 1)
    apart = y - _at(line, x)
    residual = float(np.sqrt(apart @ apart / free)) if free > 0 else None
    warnings: tuple[Note, ...] = ()
    if residual is None:
        warnings = (note("clock-events-few", events=len(x)),)
    elif residual > 0.1:
        warnings = (note("clock-events-disagree", residual_s=residual),)
    elif rejected > len(x):
        warnings = (note("clock-events-alone", events=len(x) + rejected, used=len(x)),)
    return ClockFit("event-pairs", about + offset - rate * about, rate, warnings, residual, len(x), rejected)


def _with_doubt(fit: ClockFit, matched: int, fewer: int, second: float, second_s: float) -> ClockFit:
    warnings = fit.warnings
    if second >= AMBIGUOUS and fewer > 1:
        warnings = (note("clock-events-ambiguous", away_s=second_s, pairs=second),)
    elif matched < 0.5 * fewer and not warnings:
        warnings = (note("clock-events-unmatched", used=matched, events=fewer),)
    return replace(fit, warnings=warnings, second_best=second or None, second_best_s=second_s if second else None)


def _vote(log_s: Vector, other_s: Vector) -> tuple[float, int, int, float]:
    """Return the offset on which most pairs agree, how many do, how many on the next best, how far that is."""
    d = np.sort((other_s[None, :] - log_s[:, None]).ravel())
    votes = np.searchsorted(d, d + WINDOW_S, side="right") - np.arange(len(d))
    best = int(votes.argmax())
    offset = float(np.median(d[best : best + votes[best]]))
    elsewhere = np.flatnonzero(np.abs(d + WINDOW_S / 2 - offset) > WINDOW_S)
    if len(elsewhere) == 0:
        return offset, int(votes[best]), 0, 0.0
    next_best = int(elsewhere[votes[elsewhere].argmax()])
    at = float(np.median(d[next_best : next_best + votes[next_best]]))
    return offset, int(votes[best]), int(votes[next_best]), at - offset


def _partners(a: Vector, b: Vector, window_s: float) -> tuple[Ints, Ints]:
    """Return the rows of `a` and of `b` (ascending) that are each other's nearest, within the window."""
    to_b, to_a = _nearest(a, b), _nearest(b, a)
    mine = np.flatnonzero((to_a[to_b] == np.arange(len(a))) & (np.abs(b[to_b] - a) <= window_s))
    return mine, to_b[mine]


def _nearest(of: Vector, among: Vector) -> Ints:
    right = np.clip(np.searchsorted(among, of), 0, len(among) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(np.abs(among[left] - of) <= np.abs(among[right] - of), left, right).astype(np.int64)
