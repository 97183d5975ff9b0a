"""A level that is commanded, and the scaling that follows it late and in ramps."""

from __future__ import annotations

import numpy as np

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)


def commanded(rate_hz: float, *, seconds: float, shortest_s: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return times and the index of the level that is commanded there."""
    random, count = np.random.default_rng(seed), int(seconds * rate_hz)
    level, step, row = np.empty(count, int), len(LEVELS) - 1, 0
    while row < count:
        rows = max(1, int(random.uniform(shortest_s, 3 * shortest_s) * rate_hz))
        level[row : row + rows], row = step, row + rows
        step = int(random.choice([one for one in range(len(LEVELS)) if 0 < abs(one - step) <= 2]))
    return np.arange(count) / rate_hz, level


def followed(
    level: np.ndarray, rate_hz: float, latency_s: float = 0.0, down: float | None = None, up: float | None = None
) -> np.ndarray:
    """Return the scaling that heads for a level, late and no faster than its ramps."""
    late = np.concatenate([np.full(round(latency_s * rate_hz), level[0]), level])[: len(level)]
    result, now = np.empty(len(level)), LEVELS[level[0]]
    for row, wanted in enumerate(np.asarray(LEVELS)[late].tolist()):
        lowest = -np.inf if down is None else now - down / rate_hz
        highest = np.inf if up is None else now + up / rate_hz
        result[row] = now = min(max(wanted, lowest), highest)
    return result
