"""Additional inputs from the last second, and features of windows for trees.

A recurrent network learns by itself how positions change. Trees compare one number with one threshold, so they also get
differences and distances, computed here from the same windows for training, prediction and comparisons.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Floats, Ints, Singles

PAST = ("robot_goal_age_s", "human_goal_age_s", "scaling", "human_still_s")
"""Additional inputs of a sample: age of each goal, s; present speed scaling; and time, s, for which the operator has
been within `STILL_M` of his position, at most `STILL_S`, 0 if he is not seen."""
STILL_M, STILL_S = 0.15, 10.0
_SCALING = slice(14, 15)
_ROBOT, _HUMAN, _GOALS = slice(0, 3), slice(3, 6), (slice(6, 9), slice(9, 12))


def past_inputs(X: Singles, scaling: Floats, run: Ints, rate_hz: float) -> Singles:
    """Return the inputs of `PAST`, shape (T, 4).

    Args:
        X: Positions and goals, shape (T, 12), ordered by time; the goals may be unknown (NaN).
        scaling: Speed scaling, shape (T,), NaN = unknown.
        run: Number of the unbroken stretch of each row, shape (T,); a goal's age starts with its stretch.
        rate_hz: Rate of the rows.
    """
    at = np.arange(len(X))
    begins = np.concatenate([[True], run[1:] != run[:-1]])
    ages = []
    for goal in (np.nan_to_num(X[:, columns], nan=np.inf) for columns in _GOALS):
        new = begins.copy()
        new[1:] |= (goal[1:] != goal[:-1]).any(axis=1)
        ages.append((at - np.maximum.accumulate(np.where(new, at, 0))) / rate_hz)
    still = _still(X[:, _HUMAN], run, round(STILL_S * rate_hz)) / rate_hz
    return np.stack([*ages, scaling, still], axis=1).astype(np.float32)


def _still(places: Singles, run: Ints, most: int) -> Ints:
    """Return the number of rows, up to `most`, since which each position (T, 3) has not moved in its stretch."""
    count, stays = np.zeros(len(places), np.int64), np.ones(len(places), np.bool_)
    for back in range(1, min(most, len(places) - 1) + 1):
        near = np.linalg.norm(places[back:] - places[:-back], axis=1) < STILL_M
        stays[:back] = False
        stays[back:] &= near & (run[back:] == run[:-back])
        count += stays
    return count


def window_features(windows: NDArray[np.floating]) -> Singles:
    """Return the features of windows for trees, shape (N, D); unknown inputs stay NaN.

    Features: the last sample; earlier positions relative to it; the distance of robot and operator in each sample, and
    its changes; the distances between positions and goals; the past scalings.

    Args:
        windows: Inputs, shape (N, K, F), oldest sample first, or (N, F) for one sample each.
    """
    seen = np.asarray(windows, np.float32)
    seen = seen[:, None] if seen.ndim == 2 else seen
    now, before = seen[:, -1], seen[:, :-1]
    apart = _distance(seen[:, :, _ROBOT], seen[:, :, _HUMAN])
    moved = before[:, :, :6] - now[:, None, :6]
    parts = [now, moved.reshape(len(seen), -1), apart, apart[:, -1:] - apart[:, :-1]]
    if now.shape[1] >= _GOALS[1].stop:
        robot, human, robot_goal, human_goal = (now[:, part] for part in (_ROBOT, _HUMAN, *_GOALS))
        pairs = ((robot, robot_goal), (human, human_goal), (robot_goal, human_goal), (human, robot_goal))
        parts += [_distance(a, b)[:, None] for a, b in (*pairs, (robot, human_goal))]
    parts.append(before[:, :, _SCALING].reshape(len(seen), -1))
    return np.concatenate(parts, axis=1)


def count_features(samples: int, inputs: int) -> int:
    """Return D of `window_features` for a number of samples and inputs."""
    return int(window_features(np.zeros((1, samples, inputs))).shape[1])


def _distance(a: Singles, b: Singles) -> Singles:
    return np.asarray(np.linalg.norm(a - b, axis=-1), np.float32)
