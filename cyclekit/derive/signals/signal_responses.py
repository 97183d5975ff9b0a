"""Delays between a signal and the changes of level that follow it, or between two signals."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from cyclekit.dataset.signals import SignalChanges
    from cyclekit.schema import Vector

MAX_DELAY_S, MAX_RESTART_S, BIN_S = 1.0, 3.0, 0.02
"""Maximum delay, s, from a signal to the level, and of its rise after a signal is free (scanners restart after a set
time, often 2 s); bin width, s, of the histogram of delays."""
MIN_SAME_DELAY, MIN_RESPONSES, CHANCE = 2, 3, 4.0
"""Minimum number of falls (or of rises) with the same delay; of both together; minimum excess over chance, in standard
deviations."""
SAME_S = 0.04
"""Tolerance for equal delays, s."""
MIRRORS = 0.9
"""Minimum share of an input's changes that follow an output within MIRROR_S for it to count as a mirror."""
MIRROR_S = 0.5


class Responses(NamedTuple):
    """Most frequent delay of responses to a cause, s (negative = before it, None = none), and how many have it."""

    delay_s: float | None = None
    number: int = 0


def responses_to(cause_s: Vector, answer_s: Vector, max_delay_s: float = MAX_DELAY_S) -> Responses:
    """Return the delay of responses to a cause; none if no delay is more frequent than by chance."""
    if not len(cause_s) or not len(answer_s):
        return Responses()
    first = np.searchsorted(cause_s, answer_s - max_delay_s)
    count = np.searchsorted(cause_s, answer_s + MAX_DELAY_S) - first
    number = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    lags = np.repeat(answer_s, count) - cause_s[np.repeat(first, count) + number]
    if not len(lags := lags[lags >= -MAX_DELAY_S]):
        return Responses()
    edges = np.arange(-MAX_DELAY_S, max_delay_s + BIN_S / 2, BIN_S)
    near = np.convolve(np.histogram(lags, edges)[0], np.ones(3), "same")
    chance = 3 * len(lags) / (len(edges) - 1)
    peak = int(near.argmax())
    if near[peak] < max(MIN_SAME_DELAY, chance + CHANCE * np.sqrt(chance)):
        return Responses()
    middle = float(edges[peak]) + BIN_S / 2
    alike = lags[np.abs(lags - middle) <= 1.5 * BIN_S]
    return Responses(float(np.median(alike)), len(alike))


def left_s(changes: SignalChanges, value: str) -> Vector:
    """Return the times at which a signal changes from a value to another one, shape (K,), s."""
    return np.asarray(changes.t_s[1:][(changes.value[:-1] == value) & (changes.value[1:] != value)])


def flips_s_of(changes: SignalChanges) -> Vector:
    """Return the times at which a signal changes its value, shape (K,), s."""
    return np.asarray(changes.t_s[1:][changes.value[1:] != changes.value[:-1]])


def mirrors(flips_s: Vector, own_s: Vector) -> bool:
    """Return whether a signal changes with a constant delay after signals that the robot sets."""
    if not len(flips_s) or not len(own_s):
        return False
    before = np.searchsorted(own_s, flips_s + 1e-6) - 1
    after_s = np.where(before >= 0, flips_s - own_s[np.maximum(before, 0)], np.inf)
    usual = np.median(after_s)
    return bool(usual < MIRROR_S and (np.abs(after_s - usual) <= SAME_S).mean() >= MIRRORS)
