"""Continuation of an operator known by states: a logged course continues with logs that begin in its last state.

This is for operators whose behaviour does not depend on the robot: a log may begin at any instant of their day. A log
ends more often while nobody is in the way, as the robot then finishes; so what follows begins in the same state. All
logs that begin in that state are used equally often: a random draw would repeat a few of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.operator.continuation import Stretch
    from cyclekit.schema import Ints, Points


def continue_courses(
    begun: Sequence[Stretch], logs: Sequence[Stretch], length: int, *, seed: int = 0
) -> tuple[Points, Ints]:
    """Return courses continued to `length` samples, shape (K, length, 3 + D), and their states, (K, length).

    Args:
        begun: K courses of at least one sample; `activity` is the number of the state.
        logs: All logged courses, one per execution, of at least one sample each.
        length: Samples per course; a longer course begins the same way.
        seed: Seed of the order of the logs.
    """
    where = np.empty((len(begun), length, begun[0].where.shape[1]))
    state = np.empty((len(begun), length), np.int64)
    begins = np.array([log.activity[0] for log in logs])
    parts, filled, turn = list(begun), np.zeros(len(begun), np.int64), 0
    while True:
        for k in np.flatnonzero(filled < length).tolist():
            at, end = int(filled[k]), min(int(filled[k]) + len(parts[k].activity), length)
            where[k, at:end], state[k, at:end] = parts[k].where[: end - at], parts[k].activity[: end - at]
            filled[k] = end
        if (filled == length).all():
            return where, state
        rng, turn = np.random.default_rng([seed, turn]), turn + 1
        ended = np.array([part.activity[-1] for part in parts])
        for now in np.unique(ended).tolist():
            mine, alike = np.flatnonzero(ended == now), np.flatnonzero(begins == now)
            alike = alike if len(alike) else np.arange(len(logs))
            order = np.concatenate([rng.permutation(alike) for _ in range(0, len(mine), len(alike))])
            for k, number in zip(mine.tolist(), order.tolist(), strict=False):
                parts[k] = logs[number]
