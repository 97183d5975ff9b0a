"""Joint rollouts of the logged executions' own orders beside what was logged: bias, and the spread of single cycles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import EstimateError
from cyclekit.estimate.check import FEW_EXECUTIONS, LEAST, MOST, Check, compare
from cyclekit.estimate.joint.roll import longest_s
from cyclekit.estimate.logged import logged_durations, logged_sequences

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.joint.plans import Planner
    from cyclekit.estimate.joint.roll import JointCell
    from cyclekit.schema import Vector

DRAWS = 60
"""Cycles rolled out for each logged execution."""


@dataclass(frozen=True)
class JointCheck(Check):
    """How joint rollouts compare with the logs.

    Attributes:
        spread: What the deviations of single cycles from their mean are multiplied by, so that the logged ones scatter
            as they do; 1 where they do not differ beyond chance.
    """

    spread: float = 1.0

    def quantile(self, cycles_s: Vector, level: float) -> float:
        """Return a quantile of corrected cycles (K,), s, spread as the logged ones are."""
        mean = float(np.mean(cycles_s))
        return mean + self.spread * (float(np.quantile(cycles_s, level)) - mean)


def judge_joint(cell: JointCell, planner: Planner, *, levels: Sequence[float], seed: int) -> JointCheck | None:
    """Roll out the logged executions' own orders, and compare; None where fewer than LEAST can be.

    Args:
        cell: The cell.
        planner: Makes their plans.
        levels: Quantile levels that will be asked for.
        seed: Of the draws.
    """
    sequences = [each for each in logged_sequences(cell.dataset, planner.nominal) if each.name in cell.segments.orders]
    if len(sequences) > MOST:
        sequences = [sequences[i] for i in np.linspace(0, len(sequences) - 1, MOST).astype(int)]
    orders = {each.name: tuple(visit.place for visit in cell.segments.orders[each.name]) for each in sequences}
    plans = [planner.plan(replace(each, operator=orders[each.name])) for each in sequences]
    until_s = max((longest_s(plan) for plan in plans), default=0.0)
    rolled = list(cell.roll(plans, cycles=DRAWS, seed=seed, until_s=until_s))
    ended = [
        (sequence, np.resize(cycles.duration_s, DRAWS))
        for sequence, cycles in zip(sequences, rolled, strict=True)
        if not isinstance(cycles, EstimateError) and np.isfinite(cycles.duration_s).all()
    ]
    if len(ended) < LEAST:
        return None
    sequences, crossed = [sequence for sequence, _ in ended], np.array([cycles for _, cycles in ended])
    logged = logged_durations(cell.dataset, sequences)
    unseen = set(cell.model.card.held_out)
    held_out = np.array([each.name in unseen for each in sequences])
    means = crossed.mean(axis=1)
    found = compare(logged, means, crossed, held_out, levels)
    spread = _spread(logged, crossed * found.factor) if len(ended) >= FEW_EXECUTIONS else 1.0
    return JointCheck(**{**vars(found), "spread": spread})


def _spread(logged: Vector, crossed: Vector) -> float:
    """Return how much wider logged cycles scatter than rolled-out ones, as far as it is no chance."""
    off = (logged - crossed.mean(axis=1)) / np.maximum(crossed.std(axis=1, ddof=1), 1e-9)
    ratio = float(np.sqrt(np.mean(np.clip(off, -4.0, 4.0) ** 2)))
    chance = 1.0 / (2.0 * len(off))  # variance of its logarithm
    apart = float(np.log(max(ratio, 1e-3)))
    return float(np.exp(apart * max(0.0, 1.0 - chance / max(apart**2, 1e-12))))
