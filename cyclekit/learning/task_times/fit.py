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
"""
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
    usual = np.log(np.maximum(np.bincount(parts.of, parts.dt_s), 1e-6))
    return np.concatenate([[np.median(usual), np.log(usual.std() + 0.05)], np.zeros(len(parts.kinds))])


def best_at(parts: Parts, spreads: Mapping[str, float], begin: Vector, least: float) -> Vector:
    """Return mean and log spread of the log work, and all effects, at the maximum of the posterior density.

    The log spread is at least `least`: effects fitted to few repetitions leave too little of it.
    """
    from scipy.optimize import minimize  # slow to import, and only needed for task lists

    prior = np.array([spreads[kind] for kind in parts.kinds])
    begin = np.concatenate([begin[:1], [max(begin[1], least)], begin[2:]])
    steps = _steps(parts, spreads, begin)
    free: tuple[float | None, float | None] = (None, None)
    low, high = ((end - begin[1]) / steps[1, 1] for end in (least, MOST_LOG_SPREAD))
    bounds = [free, (low, high), *[free] * len(prior)]

    def density(along: Vector) -> tuple[float, Vector]:
        value, slope = _density(begin + steps @ along, parts, prior)
        return value, steps.T @ slope

    best = begin + steps @ minimize(density, np.zeros(len(begin)), jac=True, method="L-BFGS-B", bounds=bounds).x
    if np.abs(best[2:]).max() <= MOST:
        return np.asarray(best)
    bounds = [free, (least, MOST_LOG_SPREAD), *[(-MOST, MOST)] * len(prior)]
    return np.asarray(minimize(_density, begin, args=(parts, prior), jac=True, method="L-BFGS-B", bounds=bounds).x)


def _steps(parts: Parts, spreads: Mapping[str, float], at: Vector) -> Floats:
    """Return directions along which the density curves alike, as columns: a tenth of the evaluations to its maximum."""
    rest = np.array([0, *range(2, len(at))])
    found = np.zeros((len(at), len(at)))
    found[np.ix_(rest, rest)] = np.linalg.cholesky(np.linalg.inv(Quadratic(parts, at).hessian(spreads)))
    found[1, 1] = 1.0 / np.sqrt(2.0 * len(parts.last))
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
        kinds: Kind of each effect.
        squares: Sum of the squared residuals of the log work.
        left: Number of repetitions that the effects have not used up.
        scatter: Variance of the log work.
        most: That without any effect.
    """

    def __init__(self, parts: Parts, at: Vector) -> None:
        k, self.kinds = parts.beside.shape[1], parts.kinds
        done = parts.done(at[2 : 2 + k])
        work, first = np.bincount(parts.of, done), np.concatenate([[0], parts.last[:-1] + 1])
        of_rate = np.add.reduceat(parts.beside * (done / work[parts.of])[:, None], first)
        slope = np.hstack([np.ones((len(of_rate), 1)), -of_rate, parts.factors])
        off = np.log(work) - at[0] - parts.factors @ at[2 + k :]
        self._squares, self._gram, self.squares = at[2:] ** 2, slope.T @ slope, float(off @ off)
        self.scatter, self.left = (np.exp(at[1]) + _MIN_SPREAD) ** 2, float(len(off))
        self.most = float(np.exp(2.0 * begin_at(parts)[1]))

    def hessian(self, spreads: Mapping[str, float]) -> Floats:
        """Return the Hessian of the negative log posterior density by the mean and the effects."""
        found = self._gram / self.scatter
        found.flat[:: len(found) + 1] += [_FREE, *(spreads[kind] ** -2 for kind in self.kinds)]
        return np.asarray(found)

    def updated(self, usual: float) -> None:
        """Set the scatter to that of the residuals by the repetitions left; with few, close to the usual variance."""
        found = (self.squares + LIKE_OTHERS * usual) / (self.left + LIKE_OTHERS) + _MIN_SPREAD**2
        self.scatter = min(found, self.most)

    def squared(self, spreads: Mapping[str, float]) -> Vector:
        """Return the expected square of each effect, given the spreads; updates `left`."""
        variance = np.linalg.inv(self.hessian(spreads))
        determined = np.trace(self._gram @ variance) / self.scatter
        self.left = max(float(self._gram[0, 0] - determined), 0.0)
        return np.asarray(self._squares + np.diag(variance)[1:])


def evidence(parts: Parts, at: Vector, spreads: Mapping[str, float]) -> float:
    """Return the log marginal likelihood of the repetitions by Laplace's approximation, up to a constant.

    Args:
        parts: Repetitions of a task.
        at: Mean, log spread and effects at the maximum of the posterior density, shape (2 + effects,).
        spreads: Prior standard deviation by kind of effect.
    """
    prior = np.array([spreads[kind] for kind in parts.kinds])
    value, _ = _density(at, parts, prior)
    return float(-value - np.log(prior).sum() - 0.5 * np.linalg.slogdet(Quadratic(parts, at).hessian(spreads))[1])
