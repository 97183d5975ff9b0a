"""What is known of the last second, beside where robot and operator are: further inputs, and features of a window.

A recurrent network finds out by itself how positions change. Trees compare one number with one threshold, so they get
differences and distances as well, made here from the same windows, in training, prediction and every comparison.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Floats, Ints, Singles

PAST = ("robot_goal_age_s", "human_goal_age_s", "scaling", "human_still_s")
"""Further inputs of a sample: for how long each goal has held, s; the speed scaling at that instant; and for how long
the operator has been within `STILL_M` of where he is, s: at most `STILL_S`, and 0 where he is not seen."""
STILL_M, STILL_S = 0.15, 10.0
_SCALING = slice(14, 15)
_ROBOT, _HUMAN, _GOALS = slice(0, 3), slice(3, 6), (slice(6, 9), slice(9, 12))


def past_inputs(X: Singles, scaling: Floats, run: Ints, rate_hz: float) -> Singles:
    """Return the inputs of `PAST`, shape (T, 4).

    Args:
        X: Positions and goals, shape (T, 12), in order of time; the goals may be unknown (NaN).
        scaling: Speed scaling, shape (T,), NaN where it is unknown.
        run: Unbroken stretch of each row, shape (T,). A goal is as old as its stretch at most.
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
    """Return for how many rows, `most` at most, each of the places (T, 3) has been the place of its stretch."""
    count, stays = np.zeros(len(places), np.int64), np.ones(len(places), np.bool_)
    for back in range(1, min(most, len(places) - 1) + 1):
        near = np.linalg.norm(places[back:] - places[:-back], axis=1) < STILL_M
        stays[:back] = False
        stays[back:] &= near & (run[back:] == run[:-back])
        count += stays
    return count


def window_features(windows: NDArray[np.floating]) -> Singles:
    """Return what trees see of windows, shape (N, D); unknown inputs stay NaN.

    The last sample; the positions before it, from it; the distance of robot and operator in each sample, and how it
    changed; the distances between places and goals; the past scalings.

    Args:
        windows: Inputs, shape (N, K, F), the oldest sample first, or (N, F) for one sample each.
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
    """Return D of `window_features` for windows of so many samples and inputs."""
    return int(window_features(np.zeros((1, samples, inputs))).shape[1])


def _distance(a: Singles, b: Singles) -> Singles:
    return np.asarray(np.linalg.norm(a - b, axis=-1), np.float32)
