"""Whether durations differ between groups, by their ranks.

Kruskal and Wallis, Journal of the American Statistical Association 47, 1952. `scipy.stats.kruskal` gives the same, but
its import takes half a second, in every command.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector


def by_chance(values: Vector, group: Ints) -> float:
    """Return the probability of ranks as different between groups if all were alike (Kruskal-Wallis with ties)."""
    _, tied, times = np.unique(np.round(values, 3), return_inverse=True, return_counts=True)
    rank = (np.cumsum(times) - (times - 1) / 2.0)[tied]
    count = len(values)
    _, of, sizes = np.unique(group, return_inverse=True, return_counts=True)
    sums = np.bincount(of, rank)
    ties = 1.0 - float((times**3 - times).sum()) / (count**3 - count)
    if ties <= 0.0:
        return 1.0
    h = (12.0 / (count * (count + 1)) * float((sums**2 / sizes).sum()) - 3.0 * (count + 1)) / ties
    return float(chdtrc(len(sizes) - 1, max(h, 0.0)))
