"""A hidden Markov chain of the operator's states, observed only through the level of the speed scaling.

The level of a state may depend on the region of the robot: an operator on one side slows the robot only on that side.
The chain is fitted by expectation maximisation (Baum and others, 1970; levels conditional on the region as in Bengio
and Frasconi's input-output hidden Markov models, 1995), over all executions at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Floats, Ints, Vector

    Probabilities = NDArray[np.float64]

STAY = 0.98
"""Initial probability of staying in a state for a step."""
EM_ITERATIONS = 40
"""Maximum number of EM iterations."""
MIN_GAIN = 1e-4
"""Minimum gain in log-likelihood per step of an EM iteration; below, EM ends."""
STARTS = 3
"""Number of random starts."""
FIRST_ITERATIONS = 8
"""Number of EM iterations per random start, before the best one continues."""
STEPS_OF_REGION = 10.0
"""Prior weight, in steps: a region with this many steps in a state has half its own levels, half those of the state."""
STEPS_OF_STATE = 1.0
"""Prior count of every state's levels, of its transitions, and of the initial states."""


@dataclass(frozen=True)
class LevelCourses:
    """Observations of E executions of at most T steps.

    Attributes:
        level: Index of the level, shape (E, T); -1 = unknown, or after the end of the execution.
        region: Region of the robot, shape (E, T).
        steps: Number of steps of each execution, shape (E,).
    """

    level: Ints
    region: Ints
    steps: Ints

    def of(self, executions: Ints) -> LevelCourses:
        """Return a subset of the executions."""
        return LevelCourses(self.level[executions], self.region[executions], self.steps[executions])


@dataclass(frozen=True)
class Chain:
    """A hidden chain of H states, R regions and P levels.

    Attributes:
        start: Probability of each state at the start of an execution, shape (H,).
        follows: Transition probability from a state (row) to the next (column), shape (H, H).
        levels: Probability of each level, shape (H, R, P).
        steps: Expected number of steps in each state and region, shape (H, R).
    """

    start: Vector
    follows: Floats
    levels: Probabilities
    steps: Floats


def of_levels(seen: LevelCourses, levels: int) -> Chain:
    """Return the chain whose states are the levels themselves, in all regions."""
    return _maximised(seen, np.eye(levels)[np.maximum(seen.level, 0)] * (seen.level >= 0)[..., None], None, 1, levels)


def fit(seen: LevelCourses, states: int, regions: int, levels: int, *, seed: int = 0) -> Chain:
    """Return the chain fitted by EM, from the best of STARTS random starts."""
    starts = [_random(seen, states, regions, levels, np.random.default_rng([seed, number])) for number in range(STARTS)]
    tried = [_em(seen, chain, FIRST_ITERATIONS) for chain in starts]
    return _em(seen, max(tried, key=lambda pair: pair[1])[0], EM_ITERATIONS)[0]


def log_likelihoods(seen: LevelCourses, chain: Chain) -> Vector:
    """Return the log-likelihood of each execution's levels, shape (E,)."""
    return np.asarray(_forward(seen, chain)[1].sum(axis=1))


def draw_states(seen: LevelCourses, chain: Chain, *, seed: int = 0) -> Ints:
    """Return a random draw of the states of each execution given all of its levels, shape (E, T)."""
    ahead, _ = _forward(seen, chain)
    uniform = np.random.default_rng(seed).random(seen.level.shape)
    drawn = np.zeros(seen.level.shape, np.int64)
    here = ahead[:, -1]
    for step in range(seen.level.shape[1] - 1, -1, -1):
        if step < seen.level.shape[1] - 1:
            here = ahead[:, step] * chain.follows[:, drawn[:, step + 1]].T
        until = np.cumsum(here, axis=1)
        drawn[:, step] = (until < uniform[:, step, None] * until[:, -1:]).sum(axis=1)
    return drawn


def _random(seen: LevelCourses, states: int, regions: int, levels: int, rng: np.random.Generator) -> Chain:
    counts = np.full((regions, levels), 0.5)
    known = seen.level >= 0
    np.add.at(counts, (seen.region[known], seen.level[known]), 1.0)
    shares = counts / counts.sum(axis=1, keepdims=True)
    mixed = shares * rng.gamma(1.0, size=(states, regions, levels))
    follows = np.full((states, states), (1.0 - STAY) / max(states - 1, 1))
    np.fill_diagonal(follows, STAY if states > 1 else 1.0)
    return Chain(
        np.full(states, 1.0 / states),
        follows,
        mixed / mixed.sum(axis=2, keepdims=True),
        np.zeros((states, regions)),
    )


def _em(seen: LevelCourses, chain: Chain, iterations: int) -> tuple[Chain, float]:
    """Return the chain after some EM iterations, and the log-likelihood per step before the last one."""
    before, count = -np.inf, max(int((seen.level >= 0).sum()), 1)
    for _ in range(iterations):
        ahead, logs = _forward(seen, chain)
        now = float(logs.sum()) / count
        behind = _backward(seen, chain)
        share = ahead * behind
        share /= share.sum(axis=2, keepdims=True)
        inside = np.arange(seen.level.shape[1] - 1) < seen.steps[:, None] - 1
        later = _emitted(seen, chain)[:, 1:] * behind[:, 1:]
        both = ahead[:, :-1][inside].T @ _normed(ahead[:, :-1], later, chain)[inside] * chain.follows
        _, regions, levels = chain.levels.shape
        chain = _maximised(seen, share, both, regions, levels)
        if now - before < MIN_GAIN:
            break
        before = now
    return chain, now


def _normed(ahead: Floats, later: Floats, chain: Chain) -> Floats:
    """Return `later` divided by the predictive probability of each step's level, shape (E, T - 1, H)."""
    total = ((ahead @ chain.follows) * later).sum(axis=2, keepdims=True)
    return np.asarray(later / np.maximum(total, 1e-300))


def _maximised(seen: LevelCourses, share: Floats, both: Floats | None, regions: int, levels: int) -> Chain:
    """Return the chain for state probabilities `share` (E, T, H) and expected transitions `both` (H, H)."""
    known = seen.level >= 0
    states = share.shape[2]
    cell = (seen.region[known] if regions > 1 else 0) * levels + seen.level[known]
    counts = np.stack([np.bincount(cell, share[known][:, h], minlength=regions * levels) for h in range(states)])
    counts = counts.reshape(states, regions, levels)
    every = counts.sum(axis=1, keepdims=True) + STEPS_OF_STATE / levels
    every /= every.sum(axis=2, keepdims=True)
    steps = counts.sum(axis=2)
    shares = (counts + STEPS_OF_REGION * every) / (steps[..., None] + STEPS_OF_REGION) if regions > 1 else every
    if both is None:
        pairs = known[:, :-1] & known[:, 1:]
        both = share[:, :-1][pairs].T @ share[:, 1:][pairs]
    follows = both + STEPS_OF_STATE / states
    start = share[:, 0].sum(axis=0) + STEPS_OF_STATE / states
    return Chain(start / start.sum(), follows / follows.sum(axis=1, keepdims=True), shares, steps)


def _emitted(seen: LevelCourses, chain: Chain) -> Floats:
    """Return the probability of each step's level in each state, shape (E, T, H); 1 for an unknown level."""
    region = seen.region if chain.levels.shape[1] > 1 else np.zeros_like(seen.region)
    found = chain.levels.transpose(1, 2, 0)[region, seen.level]
    found[seen.level < 0] = 1.0
    return np.asarray(found)


def _forward(seen: LevelCourses, chain: Chain) -> tuple[Floats, Floats]:
    """Return state probabilities given the levels so far, (E, T, H), and log-likelihoods of the steps, (E, T)."""
    emitted = _emitted(seen, chain)
    ahead, norm = np.empty_like(emitted), np.empty(seen.level.shape)
    here = emitted[:, 0] * chain.start
    for step in range(seen.level.shape[1]):
        if step:
            here = (ahead[:, step - 1] @ chain.follows) * emitted[:, step]
        norm[:, step] = np.maximum(here.sum(axis=1), 1e-300)
        ahead[:, step] = here / norm[:, step, None]
    return ahead, np.log(norm)


def _backward(seen: LevelCourses, chain: Chain) -> Floats:
    """Return the likelihood of later levels given each state, (E, T, H), up to a factor per step."""
    emitted = _emitted(seen, chain)
    behind = np.ones_like(emitted)
    for step in range(seen.level.shape[1] - 2, -1, -1):
        here = (emitted[:, step + 1] * behind[:, step + 1]) @ chain.follows.T
        behind[:, step] = here / here.sum(axis=1, keepdims=True)
    return behind
