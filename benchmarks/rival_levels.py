"""Level finders of the literature that cyclekit does not offer: K-means with the elbow, HDBSCAN, mixtures.

The last two are from scikit-learn and need far more than linear time or memory. They use at most 4000 values, evenly
spaced in the sorted ones, which preserves the distribution and is deterministic; the other values get the label of the
nearest used one (HDBSCAN) or of the most probable component (mixture). Unlike the exact methods, they can miss a level
held for less than 1/4000 of the time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.scaling.levels.clusters import FINDERS
from cyclekit.scaling.levels.kmeans import Weighted, condense, kmeans_1d

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    Rows = NDArray[np.int64]

SEEN = 4000
MOST = 10
_SMALLEST = 0.01
"""Minimum cluster of HDBSCAN, as a share of the values; with the default of 5 samples it found dozens of levels."""


def thinned(values: Vector, most: int = SEEN) -> Vector:
    """Return at most `most` values, evenly spaced in the sorted ones, shape (<= most,)."""
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
    """Return the most probable component of every value in the Gaussian mixture with the lowest BIC, shape (T,)."""
    from sklearn.mixture import GaussianMixture
    from threadpoolctl import threadpool_limits

    seen = thinned(values)
    most = min(MOST, np.unique(seen).size)
    with threadpool_limits(1):  # libraries of scikit-learn, whose k-means splits sums by the number of threads
        fits: list[Any] = [GaussianMixture(k, random_state=0).fit(seen[:, None]) for k in range(1, most + 1)]
        best = min(fits, key=lambda fit: fit.bic(seen[:, None]))
        blocks = np.array_split(values, max(values.size // 100_000, 1))
        return np.concatenate([best.predict(block[:, None]) for block in blocks]).astype(np.int64)


def by_elbow(points: Weighted, most: int = MOST) -> Rows:
    """Return the cluster of every point for the number of clusters at the elbow of the squared error.

    The elbow is the k farthest below the line from first to last error (Satopaa et al. 2011, "Kneedle").
    """
    divisions = kmeans_1d(points, most)
    error = np.array([error for _, error in divisions])
    if error.size < 3 or error[0] <= error[-1]:
        return divisions[-1][0] if error[0] > error[-1] else divisions[0][0]
    fallen = (error - error[-1]) / (error[0] - error[-1])
    return divisions[int(np.argmax(1 - np.linspace(0, 1, error.size) - fallen))][0]


def register() -> None:
    """Register the three methods by name for `find_staircase`."""
    FINDERS["kmeans-elbow"] = lambda values, _eps, _least: by_elbow(points := condense(values))[points.of]
    FINDERS["hdbscan"] = lambda values, _eps, _least: by_hdbscan(values)
    FINDERS["gmm-bic"] = lambda values, _eps, _least: by_mixture(values)
