"""How much errors of a rollout depend on the order of the work: then something that decides is unknown.

A one-way analysis of variance of the executions, grouped by their order. An order that was logged once or twice may be
another one of which a visit was missed, and tells nothing.
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
"""Maximum probability that executions of the same order are so much alike by chance, for it to be said."""
MIN_ALIKE, MIN_REPEATED = 3, 10
"""Minimum number of executions of an order, and of those beyond the first of each order."""


def error_by_order(off: Vector, orders: Sequence[Hashable]) -> tuple[float, bool]:
    """Return the standard deviation of the error of another order about the mean, and whether it is beyond chance.

    It is that between orders, and the error of their mean. What is not beyond chance may be there: few executions show
    little.

    Args:
        off: Error of each execution, shape (E,).
        orders: Order of each execution.
    """
    every: dict[Hashable, list[float]] = defaultdict(list)
    for error, order in zip(off.tolist(), orders, strict=True):
        every[order].append(error)
    groups = [some for some in every.values() if len(some) >= MIN_ALIKE]
    counts = np.array([len(some) for some in groups])
    between, within = len(groups) - 1, int(counts.sum()) - len(groups)
    if between < 1 or within < MIN_REPEATED:
        return 0.0, False
    means = np.array([np.mean(some) for some in groups])
    inside = sum(float(np.var(some)) * len(some) for some in groups) / within
    outside = float(counts @ (means - counts @ means / counts.sum()) ** 2) / between
    if outside <= inside:
        return 0.0, False
    each = float(counts.sum() - (counts**2).sum() / counts.sum()) / between
    shown = bool(fdtrc(between, within, outside / max(inside, 1e-12)) <= CHANCE)
    return float(((outside - inside) / each * (1.0 + 1.0 / len(groups))) ** 0.5), shown
