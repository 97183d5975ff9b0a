"""Exact DBSCAN of scalars in O(n log n), with optional weights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from cyclekit.schema import Floats, Ints

UNKNOWN = -1
"""Label of values outside of all clusters."""


def dbscan_1d(values: ArrayLike, *, eps: float, min_samples: float, weight: ArrayLike | None = None) -> Ints:
    """Cluster scalars with exact DBSCAN, in O(n log n) time and O(n) memory.

    The neighbours of a scalar are contiguous in the sorted values, so two binary searches count them, and a cluster is
    a sequence of core values without a gap wider than eps. The labels, including their numbering, are those of
    `sklearn.cluster.DBSCAN`, except where two values are exactly eps apart and rounding decides.

    Args:
        values: Shape (T,), finite.
        eps: Neighbourhood radius, closed; above 0.
        min_samples: Minimum number of neighbours, including itself, of a core value.
        weight: Weight of each value, shape (T,), as scikit-learn's `sample_weight`; None = 1.

    Returns:
        Cluster index, shape (T,); -1 = noise.

    Raises:
        ShapeError: `values` is not one row of finite numbers, or `eps` or `min_samples` is not positive.
    """
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 1 or not np.isfinite(x).all() or not (eps > 0 and min_samples >= 1):
        msg = f"DBSCAN needs finite values (T,), eps > 0 and min_samples >= 1; got {x.shape}, {eps}, {min_samples}"
        raise ShapeError(msg)
    order = np.argsort(x, kind="stable")
    line = x[order]
    low, high = np.searchsorted(line, line - eps, "left"), np.searchsorted(line, line + eps, "right")
    neighbours: Floats | Ints = high - low
    if weight is not None:
        total = np.concatenate([[0.0], np.cumsum(np.asarray(weight, np.float64)[order])])
        neighbours = total[high] - total[low]
    core = np.flatnonzero(neighbours >= min_samples)
    result = np.full(x.size, UNKNOWN, np.int64)
    if core.size == 0:
        return result
    run = np.concatenate([[0], np.cumsum(np.diff(line[core]) > eps)])
    number = _number_by_first(run, order[core])[run]
    labels = np.full(x.size, UNKNOWN, np.int64)
    labels[core] = number
    border = np.flatnonzero(neighbours < min_samples)
    labels[border] = _border(line[border], line[core], number, eps)
    result[order] = labels
    return result


def _number_by_first(run: Ints, position: Ints) -> Ints:
    """Return the number of each run, numbered by the position of its first core value in the data."""
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    first = np.minimum.reduceat(position, starts)
    number = np.empty_like(first)
    number[np.argsort(first)] = np.arange(first.size)
    return number


def _border(value: Floats, core: Floats, number: Ints, eps: float) -> Ints:
    """Return the cluster of border values: that of a core value within eps, the lower number if there are two."""
    nobody = np.iinfo(np.int64).max
    right = np.searchsorted(core, value)
    left, right_in = np.maximum(right - 1, 0), np.minimum(right, core.size - 1)
    from_left = np.where((right > 0) & (value - core[left] <= eps), number[left], nobody)
    from_right = np.where((right < core.size) & (core[right_in] - value <= eps), number[right_in], nobody)
    lowest = np.minimum(from_left, from_right)
    return np.where(lowest == nobody, UNKNOWN, lowest)
