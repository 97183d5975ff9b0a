"""A hidden Markov chain of the operator's states, seen only through the level of the speed scaling.

Which level a state gives may depend on the region in which the robot is: an operator on one side slows the robot on
that side alone. The chain is fitted by expectation and maximisation (Baum and others, 1970; the levels given the region
as in Bengio and Frasconi's input-output hidden Markov models, 1995), all executions side by side.
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
"""Probability that a state is kept from one step to the next, before the first turn."""
TURNS = 40
"""Most turns of expectation and maximisation,"""
ENOUGH = 1e-4
"""... and the gain in log-likelihood per step below which they end."""
BEGUN = 3
"""Beginnings that are tried,"""
FIRST_TURNS = 8
"""... for so many turns each; the best of them goes on."""
STEPS_OF_REGION = 10.0
"""Of a region with so many steps in a state the levels are half its own, half those of the state's other regions."""
STEPS_OF_STATE = 1.0
"""Every level and every change of state counts as seen so often at least."""


@dataclass(frozen=True)
class LevelCourses:
    """What E executions of at most T steps show.

    Attributes:
        level: Index of the level, shape (E, T); -1 = unknown, also behind the end of an execution.
        region: Where the robot is, shape (E, T).
        steps: Length of each, shape (E,).
    """

    level: Ints
    region: Ints
    steps: Ints

    def of(self, executions: Ints) -> LevelCourses:
        """Return some of the executions."""
        return LevelCourses(self.level[executions], self.region[executions], self.steps[executions])


@dataclass(frozen=True)
class Chain:
    """A hidden chain of H states, R regions and P levels.

    Attributes:
        start: Probability of each state at the beginning of an execution, shape (H,).
        follows: Probability of each state (column) a step after another (row), shape (H, H).
        levels: Probability of each level, shape (H, R, P).
        steps: Steps that were seen in each state and region, shape (H, R).
    """

    start: Vector
    follows: Floats
    levels: Probabilities
    steps: Floats


def of_levels(seen: LevelCourses, levels: int) -> Chain:
    """Return the chain whose states are the levels themselves, wherever the robot is."""
    return _maximised(seen, np.eye(levels)[np.maximum(seen.level, 0)] * (seen.level >= 0)[..., None], None, 1, levels)


def fit(seen: LevelCourses, states: int, regions: int, levels: int, *, seed: int = 0) -> Chain:
    """Return the chain under which the levels are likeliest, from the best of BEGUN random beginnings."""
    begun = [_random(seen, states, regions, levels, np.random.default_rng([seed, number])) for number in range(BEGUN)]
    tried = [_turned(seen, chain, FIRST_TURNS) for chain in begun]
    return _turned(seen, max(tried, key=lambda pair: pair[1])[0], TURNS)[0]


def log_likelihoods(seen: LevelCourses, chain: Chain) -> Vector:
    """Return the logarithm of the probability of each execution's levels, shape (E,)."""
    return np.asarray(_forward(seen, chain)[1].sum(axis=1))


def draw_states(seen: LevelCourses, chain: Chain, *, seed: int = 0) -> Ints:
    """Return the states of each execution, one draw given all of its levels, shape (E, T)."""
    ahead, _ = _forward(seen, chain)
    luck = np.random.default_rng(seed).random(seen.level.shape)
    drawn = np.zeros(seen.level.shape, np.int64)
    here = ahead[:, -1]
    for step in range(seen.level.shape[1] - 1, -1, -1):
        if step < seen.level.shape[1] - 1:
            here = ahead[:, step] * chain.follows[:, drawn[:, step + 1]].T
        until = np.cumsum(here, axis=1)
        drawn[:, step] = (until < luck[:, step, None] * until[:, -1:]).sum(axis=1)
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


def _turned(seen: LevelCourses, chain: Chain, turns: int) -> tuple[Chain, float]:
    """Return the chain after some turns, and the log-likelihood per step before the last of them."""
    before, count = -np.inf, max(int((seen.level >= 0).sum()), 1)
    for _ in range(turns):
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
        if now - before < ENOUGH:
            break
        before = now
    return chain, now


def _normed(ahead: Floats, later: Floats, chain: Chain) -> Floats:
    """Return what follows over the probability of what was seen of each step, shape (E, T - 1, H)."""
    total = ((ahead @ chain.follows) * later).sum(axis=2, keepdims=True)
    return np.asarray(later / np.maximum(total, 1e-300))


def _maximised(seen: LevelCourses, share: Floats, both: Floats | None, regions: int, levels: int) -> Chain:
    """Return the chain of these probabilities of states: `share` (E, T, H), and of pairs `both` (H, H)."""
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
    """Return the probability of the level of each step in each state, shape (E, T, H); 1 where it is unknown."""
    region = seen.region if chain.levels.shape[1] > 1 else np.zeros_like(seen.region)
    found = chain.levels.transpose(1, 2, 0)[region, seen.level]
    found[seen.level < 0] = 1.0
    return np.asarray(found)


def _forward(seen: LevelCourses, chain: Chain) -> tuple[Floats, Floats]:
    """Return the probability of each state given the levels so far (E, T, H), and the logs of their steps (E, T)."""
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
    """Return what the later levels say of each state (E, T, H), up to a factor per step."""
    emitted = _emitted(seen, chain)
    behind = np.ones_like(emitted)
    for step in range(seen.level.shape[1] - 2, -1, -1):
        here = (emitted[:, step + 1] * behind[:, step + 1]) @ chain.follows.T
        behind[:, step] = here / here.sum(axis=1, keepdims=True)
    return behind
