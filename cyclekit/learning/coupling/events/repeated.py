"""Signals that are given twice: a button pressed again, a sensor that bounces. The second change tells nothing new.

A robot that waits for a button goes on at the first press. If the second one counted as the next event, the passages
after it would seem to have been released before. Parts and people who come soon after each other by chance are not
taken for that: they come at all intervals, a repeated press comes at once or not at all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.schema import Vector

    Changes = Mapping[str, Mapping[tuple[str, str], Vector]]

WITHIN_S = 3.0
"""Maximum time, s, from a change of a signal to its repetition."""
APART = 3.0
"""Minimum ratio of all other intervals to that time."""
FEW = 0.35
"""Maximum share of the intervals that may be repetitions: a signal always given twice means it so."""
MIN_INTERVALS = 10
"""Minimum number of intervals that show this."""


def without_repeats(by_session: Changes) -> dict[str, dict[tuple[str, str], Vector]]:
    """Return the changes of signals to their states, by session, without those that repeat the one before.

    Args:
        by_session: When each signal was set and cleared, by session, ascending, s.
    """
    intervals: dict[tuple[str, str], list[Vector]] = {}
    for some in by_session.values():
        for key, at in some.items():
            intervals.setdefault(key, []).append(np.diff(at))
    longest_s = {key: _repeats_s(np.concatenate(each)) for key, each in intervals.items()}
    return {
        session: {key: at[np.diff(at, prepend=-np.inf) > longest_s[key]] for key, at in some.items()}
        for session, some in by_session.items()
    }


def _repeats_s(interval_s: Vector) -> float:
    """Return the longest interval that is a repetition, s, of all intervals, shape (N,); -1 = there are none."""
    if len(interval_s) < MIN_INTERVALS:
        return -1.0
    order = np.sort(interval_s)
    short = int(np.searchsorted(order, WITHIN_S, side="right"))
    for count in range(short, 0, -1):
        if count <= FEW * len(order) and order[count] > APART * order[count - 1]:
            return float(order[count - 1])
    return -1.0
