"""Fits mean, scatter and effects of the log work of one task to its repetitions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.learning.task_times.parts import Parts
    from cyclekit.schema import Floats, Vector

SPREADS = {
    "rates": 0.7,
    "alone": 0.7,
    "later": 0.4,
    "waiting": 0.3,
    "previous": 0.1,
    "turn": 0.1,
    "nth": 0.2,
    "nth waiting": 0.2,
    "at start": 0.2,
    "position": 0.2,
    "position waiting": 0.2,
    "own position": 0.1,
}
"""Prior standard deviations of what changes the logarithm of a rate or of the work, before the logs are seen:

rates     a simultaneous task: between half and double with probability of about two thirds
alone     no simultaneous task
later     ratio of the rates in the second and the first half of a simultaneous task
waiting   another agent waits after one of his tasks
previous  the agent's previous task: the way to a task
turn      the first, second ... time in an execution: the slot of a part
nth, nth waiting
          the first, second ... time of the simultaneous task, or of the one after which its agent waits
at start  the simultaneous task at the start, on the work
position, position waiting
          the position of the simultaneous task in its agent's order, or of the one after which its agent waits
own position
          the task's own position in its agent's order, on the work: the slot of a part
"""
_NUMBER = {kind: number for number, kind in enumerate(SPREADS)}
MOST = 4.0
"""Maximum absolute effect on the logarithm of a rate or of the work."""
MOST_LOG_SPREAD = 3.0
"""Maximum log spread of the log work."""
LIKE_OTHERS = 4.0
"""Weight of all tasks' scatter in that of one, as a number of repetitions."""
_FREE = 1e-6
_MIN_SPREAD = 1e-3


def begin_at(parts: Parts) -> Vector:
    """Return median and log spread of the log durations, and no effects: where `best_at` begins."""
    log_s = parts.log_duration
    return np.concatenate([[np.median(log_s), np.log(log_s.std() + 0.05)], np.zeros(len(parts.kinds))])


def best_at(
    parts: Parts, spreads: Mapping[str, float], begin: Vector, least: float, there: Quadratic | None = None
) -> Vector:
    """Return mean and log spread of the log work, and all effects, at the maximum of the posterior density.

    Args:
        parts: Repetitions of a task.
        spreads: Prior standard deviation by kind of effect.
        begin: Where the search begins.
        least: Minimum log spread: effects fitted to few repetitions leave too little of it.
        there: The likelihood around the effects in `begin`, if it is known.
    """
    from scipy.optimize import fmin_l_bfgs_b  # slow to import, and only needed for task lists

    prior = np.array([spreads[kind] for kind in parts.kinds])
    begin = np.concatenate([begin[:1], [max(begin[1], least)], begin[2:]])
    steps = _steps(Quadratic(parts, begin) if there is None else there, prior, begin)
    free: tuple[float | None, float | None] = (None, None)
    low, high = ((end - begin[1]) / steps[1, 1] for end in (least, MOST_LOG_SPREAD))
    bounds = [free, (low, high), *[free] * len(prior)]

    def density(along: Vector) -> tuple[float, Vector]:
        value, slope = _density(begin + steps @ along, parts, prior)
        return value, steps.T @ slope

    best = begin + steps @ fmin_l_bfgs_b(density, np.zeros(len(begin)), bounds=bounds)[0]
    if np.abs(best[2:]).max() <= MOST:
        return np.asarray(best)
    bounds = [free, (least, MOST_LOG_SPREAD), *[(-MOST, MOST)] * len(prior)]
    return np.asarray(fmin_l_bfgs_b(_density, begin, args=(parts, prior), bounds=bounds)[0])


def _steps(around: Quadratic, prior: Vector, at: Vector) -> Floats:
    """Return directions along which the density curves alike, as columns: a tenth of the evaluations to its maximum."""
    rest = np.linalg.cholesky(np.linalg.inv(around.hessian(prior, at[1])))
    found = np.zeros((len(at), len(at)))
    found[0, 0], found[2:, 0], found[2:, 2:] = rest[0, 0], rest[1:, 0], rest[1:, 1:]
    found[1, 1] = 1.0 / np.sqrt(2.0 * around.count)
    return found


def _density(at: Vector, parts: Parts, prior: Vector) -> tuple[float, Vector]:
    """Return the negative log posterior density, and its gradient."""
    k, count = parts.beside.shape[1], len(parts.last)
    mean, grown, log_rate, factor = at[0], np.exp(at[1]), at[2 : 2 + k], at[2 + k :]
    spread, done, ends = grown + _MIN_SPREAD, parts.done(log_rate), parts.at_end
    work = parts.work(done)
    log_work, off, variance = np.log(work), at[2:] / prior, prior**2
    z = (log_work - mean - parts.factors @ factor) / spread
    value = 0.5 * z @ z + count * np.log(spread) + log_work.sum() - (ends @ log_rate).sum()
    value += 0.5 * (off**2).sum()
    pull = z / spread
    slope = np.empty(len(at))
    slope[0] = -pull.sum()
    slope[1] = (count - z @ z) * grown / spread
    slope[2 : 2 + k] = parts.beside.T @ (done * ((pull + 1.0) / work)[parts.of]) - parts.ends
    slope[2 + k :] = -parts.factors.T @ pull
    slope[2:] += at[2:] / variance
    return float(value), slope


class Quadratic:
    """The likelihood of one task around its best effects.

    Attributes:
        kinds: Kind of each effect, as its number in SPREADS.
        squares: Sum of the squared residuals of the log work.
        left: Number of repetitions that the effects have not used up.
        scatter: Variance of the log work.
        count: Number of repetitions.
        most: That without any effect.
    """

    def __init__(self, parts: Parts, at: Vector) -> None:
        k, self.kinds = parts.beside.shape[1], np.array([_NUMBER[kind] for kind in parts.kinds], dtype=np.int64)
        done = parts.done(at[2 : 2 + k])
        work, first = np.bincount(parts.of, done), np.concatenate([[0], parts.last[:-1] + 1])
        of_rate = np.add.reduceat(parts.beside * (done / work[parts.of])[:, None], first)
        slope = np.hstack([np.ones((len(of_rate), 1)), -of_rate, parts.factors])
        off = np.log(work) - at[0] - parts.factors @ at[2 + k :]
        self._squares, self._gram, self.squares = at[2:] ** 2, slope.T @ slope, float(off @ off)
        self.count, self.scatter, self.left = len(off), _scatter(at[1]), float(len(off))
        self.most = float(parts.log_duration.std() + 0.05) ** 2

    def hessian(self, prior: Vector, log_spread: float | None = None) -> Floats:
        """Return the Hessian of the negative log posterior density by the mean and the effects.

        Args:
            prior: Prior standard deviation of each effect, shape (effects,).
            log_spread: Log spread of the log work; None: that of `scatter`.
        """
        found = self._gram / (self.scatter if log_spread is None else _scatter(log_spread))
        diagonal = found.reshape(-1)[:: len(found) + 1]
        diagonal[0] += _FREE
        diagonal[1:] += prior**-2
        return np.asarray(found)

    def updated(self, usual: float) -> None:
        """Set the scatter to that of the residuals by the repetitions left; with few, close to the usual variance."""
        found = (self.squares + LIKE_OTHERS * usual) / (self.left + LIKE_OTHERS) + _MIN_SPREAD**2
        self.scatter = min(found, self.most)

    def squared(self, prior: Vector) -> Vector:
        """Return the expected square of each effect, given their prior standard deviations; updates `left`."""
        variance = np.linalg.inv(self.hessian(prior))
        determined = np.vdot(self._gram, variance) / self.scatter  # trace of the product: both are symmetric
        self.left = max(float(self._gram[0, 0] - determined), 0.0)
        return np.asarray(self._squares + variance.reshape(-1)[len(variance) + 1 :: len(variance) + 1])


def _scatter(log_spread: float) -> float:
    return float((np.exp(log_spread) + _MIN_SPREAD) ** 2)


def evidence(parts: Parts, at: Vector, spreads: Mapping[str, float], there: Quadratic | None = None) -> float:
    """Return the log marginal likelihood of the repetitions by Laplace's approximation, up to a constant.

    Args:
        parts: Repetitions of a task.
        at: Mean, log spread and effects at the maximum of the posterior density, shape (2 + effects,).
        spreads: Prior standard deviation by kind of effect.
        there: The likelihood around `at`, if it is known.
    """
    prior = np.array([spreads[kind] for kind in parts.kinds])
    value, _ = _density(at, parts, prior)
    hessian = (Quadratic(parts, at) if there is None else there).hessian(prior, at[1])
    return float(-value - np.log(prior).sum() - 0.5 * np.linalg.slogdet(hessian)[1])
