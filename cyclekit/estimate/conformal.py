"""Conformal quantiles: what one more value lies below as often as it says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Vector


def conformal(values: Vector, level: float) -> float:
    """Return the value that one more is at or below with probability `level`: rank (K + 1) level of K, interpolated.

    Rounding the ranks outwards instead would never cover too little, and at 45 executions far too much.
    """
    return float(np.quantile(values, level, method="weibull"))


def holds(logged_s: float, cycles_s: Vector, outer: float) -> bool:
    """Tell whether a duration lies between the outer conformal quantiles of K cycles, (K,), s."""
    return conformal(cycles_s, outer) <= logged_s <= conformal(cycles_s, 1 - outer)
