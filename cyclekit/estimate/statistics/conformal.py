"""Conformal quantiles: a new value lies below one with the probability of its level."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Vector


def conformal(values: Vector, level: float) -> float:
    """Return the value that a new one does not exceed with probability `level`: rank (K + 1) * level, interpolated.

    Rounding the ranks outwards would guarantee the coverage, but at 45 executions give far wider intervals.
    """
    return float(np.quantile(values, level, method="weibull"))


def holds(logged_s: float, cycles_s: Vector, outer: float) -> bool:
    """Return whether a duration lies between the outer conformal quantiles of K cycles, shape (K,), s."""
    return conformal(cycles_s, outer) <= logged_s <= conformal(cycles_s, 1 - outer)
