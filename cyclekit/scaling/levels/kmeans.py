"""Exact K-means of scalars, with the number of clusters chosen by the silhouette.

A cluster of scalars is contiguous in the sorted values, so dynamic programming finds the global optimum that Lloyd's
iterations only approach, and prefix sums give the exact silhouette without a distance matrix. Up to 2048 different
values, everything is exact; more are first put into 2048 bins of equal width (each a weighted point at its mean), so
that ten million samples take seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector


BINS = 2048
MAX_CLUSTERS = 10
"""Maximum number of clusters."""


@dataclass(frozen=True)
class Weighted:
    """M sorted points, each weighted by its number of samples."""

    value: Vector
    weight: Vector
    of: Ints
    """Index of the point of every sample, shape (T,)."""


def condense(values: Vector, *, bins: int = BINS) -> Weighted:
    """Return the values as at most `bins` weighted points, ascending.

    Args:
        values: Shape (T,), finite.
        bins: Maximum number of points; up to this many different values are kept unchanged.
    """
    point, of = np.unique(values, return_inverse=True)
    if point.size > bins:
        low, high = float(point[0]), float(point[-1])
        bin_of = np.minimum(((values - low) / (high - low) * bins).astype(np.int64), bins - 1)
        _, of = np.unique(bin_of, return_inverse=True)
        weight = np.bincount(of).astype(np.float64)
        return Weighted(np.bincount(of, weights=values) / weight, weight, of.astype(np.int64))
    return Weighted(point, np.bincount(of, minlength=point.size).astype(np.float64), of.astype(np.int64))


def kmeans_1d(points: Weighted, most: int = MAX_CLUSTERS) -> list[tuple[Ints, float]]:
    """Return the optimal clusters and their squared error for k = 1 to `most` (or to the number of points).

    Returns:
        For each k, the cluster of every point, shape (M,), ascending, and the sum of squared distances to the means.
    """
    x, w = points.value, points.weight
    count = x.size
    weight, first, second = (np.concatenate([[0.0], np.cumsum(w * x**power)]) for power in (0, 1, 2))
    start, end = np.arange(count)[:, None], np.arange(1, count + 1)[None, :]
    mass = weight[end] - weight[start]
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = second[end] - second[start] - (first[end] - first[start]) ** 2 / mass
    cost = np.where(end > start, np.maximum(cost, 0.0), np.inf)  # cost[i, j]: points i..j as one cluster
    best, cuts, found = cost[0], [np.zeros(count, np.int64)], []
    found.append((np.zeros(count, np.int64), float(best[-1])))
    for _ in range(2, min(most, count) + 1):
        total = np.concatenate([[np.inf], best[:-1]])[:, None] + cost
        cut = total.argmin(axis=0)
        best = total[cut, np.arange(count)]
        cuts.append(cut)
        found.append((_trace(cuts, count), float(best[-1])))
    return found


def _trace(cuts: list[Ints], count: int) -> Ints:
    """Return the cluster of every point by tracing back through the cuts."""
    label, stop = np.zeros(count, np.int64), count
    for k in range(len(cuts) - 1, 0, -1):
        start = int(cuts[k][stop - 1])
        label[start:stop] = k
        stop = start
    return label


def silhouette_1d(points: Weighted, cluster: Ints) -> float:
    """Return the exact mean silhouette of all samples; -1 with fewer than two clusters.

    Equal to `sklearn.metrics.silhouette_score` on the samples behind the points.

    Args:
        points: M points, ascending.
        cluster: Cluster of each point, shape (M,), non-decreasing.
    """
    x, w = points.value, points.weight
    edges = np.concatenate([[0], np.flatnonzero(np.diff(cluster)) + 1, [x.size]])
    count = edges.size - 1
    if count < 2:
        return -1.0
    mass, moment = np.concatenate([[0.0], np.cumsum(w)]), np.concatenate([[0.0], np.cumsum(w * x)])
    at, distance = np.arange(x.size), np.empty((count, x.size))
    for j in range(count):
        a, b = edges[j], edges[j + 1]
        m = np.clip(at, a, b)  # members below x: a..m, above: m..b
        distance[j] = x * (2 * mass[m] - mass[a] - mass[b]) - 2 * moment[m] + moment[a] + moment[b]
    size = mass[edges[1:]] - mass[edges[:-1]]
    own = np.repeat(np.arange(count), np.diff(edges))
    inside = distance[own, at] / np.maximum(size[own] - 1, 1.0)
    to_others = distance / size[:, None]
    to_others[own, at] = np.inf
    outside = to_others.min(axis=0)
    score = (outside - inside) / np.maximum(np.maximum(inside, outside), 1e-300)
    score[size[own] <= 1] = 0.0
    return float((score * w).sum() / w.sum())


def by_silhouette(points: Weighted, most: int = MAX_CLUSTERS) -> Ints:
    """Return the cluster of every point for the number of clusters with the best silhouette (1 if all are equal)."""
    if points.value.size < 2:
        return np.zeros(points.value.size, np.int64)
    return max((labels for labels, _ in kmeans_1d(points, most)[1:]), key=lambda labels: silhouette_1d(points, labels))
