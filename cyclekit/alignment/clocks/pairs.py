"""Clock fit from events in both logs: a button, a digital output wired to the tracker, a clap on the robot.

A line through two events is exact but cannot be checked; three or more, spread over the run, are better. Events that
only one log has, or that contradict the others, are rejected and counted. `recording_clocks` selects the events.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.alignment.clocks.fit import ClockFit
from cyclekit.dataset.cards import Note, note
from cyclekit.errors import ConfigError
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector


DRIFT = 0.01
"""Maximum difference of rates between two clocks; the worst published case was 0.003."""
SPREAD_S, SPREAD_OF_TWO_S = 60.0, 600.0
"""Minimum span of events to fit a rate, s: of three or more events, and of two."""
SURE_S = 0.02
"""Residual up to which an event is never rejected, s: a controller cycle plus a tracker cycle."""
WINDOW_S = 0.5
"""Tolerance of the first match, s: 50 ppm over an hour is 0.18 s."""
MAX_TIMES = 2000
"""Maximum number of events used from each log, the first ones."""
AMBIGUOUS = 0.9
"""Minimum ratio of pairs at the second-best offset to those at the best one for a warning."""


def fit_pairs(log_s: Vector, other_s: Vector) -> ClockFit:
    """Return the line through events whose times are known in both logs.

    Args:
        log_s: Times of the events in the log to align, shape (N,), N >= 1, s.
        other_s: Times of the same events in the other log, shape (N,), s.

    Raises:
        ConfigError: The pairs contradict each other.
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
    """Return the line through events in both logs whose pairing is unknown.

    The most frequent offset gives the pairs; these are fitted and matched again with a shrinking window.

    Args:
        log_s: Times of the events in the log to align, shape (N,), s.
        other_s: Times of the events in the other log, shape (M,), s; each may have events that the other lacks.

    Raises:
        ConfigError: One of the lists is empty, or too few events match.
    """
    log_s, other_s = _first_ones(np.sort(log_s)), _first_ones(np.sort(other_s))
    fewer = min(len(log_s), len(other_s))
    if fewer == 0:
        raise ConfigError(
            f"{len(log_s)} events in this log and {len(other_s)} in the robot's", cure="Name other signals."
        )
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
            cure="Name signals that change at the same times, or give the pairs as sync_events.",
        )
    line = _least_squares(log_s[mine], other_s[theirs])
    in_other_s = _at(line, log_s)
    met = (in_other_s > other_s[0] - window) & (in_other_s < other_s[-1] + window)  # a log may be the longer one
    met |= (log_s >= log_s[mine].min()) & (log_s <= log_s[mine].max())
    fit = _fit(line, log_s[mine], other_s[theirs], rejected=int(met.sum()) - len(mine))
    return _with_doubt(fit, len(mine), fewer, second / votes, second_s)


def _first_ones(times_s: Vector) -> Vector:
    return times_s[:MAX_TIMES]  # not every n-th one: that may be another event in the other log


def _first_line(x: Vector, y: Vector) -> tuple[float, float, float]:
    """Return a robust line: the median of the slopes that a clock can have."""
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
    """Return (offset, rate, about) of y = about + offset + rate * (x - about); centred, as epoch times are large."""
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
            f"the events give a clock rate of {fixed(rate, 4)} s of the robot log per second of this log",
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
        warnings = (note("clock-events-unmatched", events=len(x) + rejected, used=len(x)),)
    return ClockFit("event-pairs", about + offset - rate * about, rate, warnings, residual, len(x), rejected)


def _with_doubt(fit: ClockFit, matched: int, fewer: int, second: float, second_s: float) -> ClockFit:
    warnings = fit.warnings
    if second >= AMBIGUOUS and fewer > 1:
        warnings = (note("clock-events-ambiguous", away_s=second_s, pairs=second),)
    elif matched < 0.5 * fewer and not warnings:
        warnings = (note("clock-events-unmatched", used=matched, events=fewer),)
    return replace(fit, warnings=warnings, second_best=second or None, second_best_s=second_s if second else None)


def _vote(log_s: Vector, other_s: Vector) -> tuple[float, int, int, float]:
    """Return the most frequent offset, s, its number of pairs, that of the next best, and the distance of that, s."""
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
    """Return the rows of `a` and `b` (ascending) that are mutual nearest neighbours within the window."""
    to_b, to_a = _nearest(a, b), _nearest(b, a)
    mine = np.flatnonzero((to_a[to_b] == np.arange(len(a))) & (np.abs(b[to_b] - a) <= window_s))
    return mine, to_b[mine]


def _nearest(of: Vector, among: Vector) -> Ints:
    right = np.clip(np.searchsorted(among, of), 0, len(among) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(np.abs(among[left] - of) <= np.abs(among[right] - of), left, right).astype(np.int64)
