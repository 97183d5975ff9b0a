"""Whether errors of a rollout depend on the order of the work beyond chance: then something that decides is unknown.

A one-way analysis of variance of the executions, grouped by their order. Orders that were logged once tell nothing.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import fdtrc

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from cyclekit.schema import Vector

CHANCE = 0.003
"""Maximum probability that executions of the same order are so much alike by chance."""
MIN_REPEATED = 10
"""Minimum number of executions beyond the first of each order."""


def error_by_order(off: Vector, orders: Sequence[Hashable]) -> float:
    """Return the standard deviation of the error of another order about the mean; 0 without a significant one.

    It is that between orders, and the error of their mean.

    Args:
        off: Error of each execution, shape (E,).
        orders: Order of each execution.
    """
    groups: dict[Hashable, list[float]] = defaultdict(list)
    for error, order in zip(off.tolist(), orders, strict=True):
        groups[order].append(error)
    counts = np.array([len(some) for some in groups.values()])
    between, within = len(groups) - 1, len(off) - len(groups)
    if between < 1 or within < MIN_REPEATED:
        return 0.0
    means = np.array([np.mean(some) for some in groups.values()])
    inside = float(sum(np.var(some) * len(some) for some in groups.values())) / within
    outside = float(counts @ (means - off.mean()) ** 2) / between
    if outside <= inside or fdtrc(between, within, outside / max(inside, 1e-12)) > CHANCE:
        return 0.0
    each = (len(off) - float((counts**2).sum()) / len(off)) / between
    return float(((outside - inside) / each * (1.0 + 1.0 / len(groups))) ** 0.5)
