"""Durations that the end of a log cuts: they lasted at least so long.

Leaving them out makes long ones rare, as a log ends within a long task more often than within a short one; counting
them as whole makes long ones short. The product-limit estimate (Kaplan and Meier, Journal of the American Statistical
Association 53, 1958) does neither. Of what began before a log nothing is known but its end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Bools, Ints, Vector


def as_whole(lasted: Vector, cut: Bools) -> Vector:
    """Return as many durations as given, ascending, with the distribution of whole ones.

    Args:
        lasted: Durations, shape (N,); of a cut one the known part.
        cut: Which are cut, shape (N,). The longest counts as whole in any case (Efron, Proceedings of the Fifth
            Berkeley Symposium 4, 1967).
    """
    return np.asarray(lasted[whole_rows(lasted, cut)])


def whole_rows(lasted: Vector, cut: Bools) -> Ints:
    """Return the rows of `as_whole`, shape (N,): for a cut duration those of whole ones that lasted longer."""
    order = np.lexsort((cut, lasted))
    left = 1.0 - ~cut[order] / np.arange(len(order), 0, -1)
    left[-1:] = 0.0
    ended = 1.0 - np.cumprod(left)
    levels = (np.arange(len(order)) + 0.5) / len(order)
    return np.asarray(order[np.searchsorted(ended, levels)])
