"""HDBSCAN and Gaussian mixtures, from scikit-learn, on a part of the values that they can manage.

Both need far more than linear time or memory. They see at most 4000 of the values: every so-manieth of the sorted ones,
so that the distribution is kept and the same log always gives the same part; the other values get the label of the
nearest one seen (HDBSCAN) or of the likeliest component (mixture). Other than the exact methods, a level held for less
than one part in 4000 of the time can be lost here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    Rows = NDArray[np.int64]

SEEN = 4000
MOST = 10
_SMALLEST = 0.01
"""Smallest cluster of HDBSCAN, as a part of the values; with the usual 5 samples it found dozens of levels."""


def thinned(values: Vector, most: int = SEEN) -> Vector:
    """Return at most `most` of the values, evenly from the sorted ones, shape (<= most,)."""
    line = np.sort(values)
    return line if line.size <= most else line[np.linspace(0, line.size - 1, most).round().astype(np.int64)]


def by_hdbscan(values: Vector) -> Rows:
    """Return the cluster of every value by HDBSCAN, shape (T,); -1 = noise."""
    from sklearn.cluster import HDBSCAN
    from threadpoolctl import threadpool_limits

    seen = thinned(values)
    smallest = max(5, int(_SMALLEST * seen.size))
    if seen.size < 2 * smallest:
        return np.full(values.size, -1, np.int64)
    with threadpool_limits(1):  # of the libraries that came with it
        found = HDBSCAN(min_cluster_size=smallest, copy=True).fit_predict(seen[:, None])
    nearest = np.clip(np.searchsorted((seen[1:] + seen[:-1]) / 2, values), 0, seen.size - 1)
    return np.asarray(found[nearest], np.int64)


def by_mixture(values: Vector) -> Rows:
    """Return the likeliest component of every value in the Gaussian mixture with the least BIC, shape (T,)."""
    from sklearn.mixture import GaussianMixture
    from threadpoolctl import threadpool_limits

    seen = thinned(values)
    most = min(MOST, np.unique(seen).size)
    with threadpool_limits(1):  # of the libraries that came with it: its k-means shares sums out by their number
        fits: list[Any] = [GaussianMixture(k, random_state=0).fit(seen[:, None]) for k in range(1, most + 1)]
        best = min(fits, key=lambda fit: fit.bic(seen[:, None]))
        blocks = np.array_split(values, max(values.size // 100_000, 1))
        return np.concatenate([best.predict(block[:, None]) for block in blocks]).astype(np.int64)
