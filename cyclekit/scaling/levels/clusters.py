"""From plateaus (or single values) to levels: clusters, standard errors of their means, sliders, rounding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.time_grid import samples_in
from cyclekit.scaling.levels.dbscan import dbscan_1d
from cyclekit.scaling.levels.kmeans import by_silhouette, condense

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from cyclekit.scaling.levels.plateaus import Plateaus
    from cyclekit.schema import Ints, Vector


_MIN_EPS = 0.01
_USUAL_HOLD_S = 1.5
"""Duration of a short plateau, s; eps must cover the error of its mean."""
_GRIDS = (0.05, 0.01)
"""Usual steps between speed levels."""
_SIGMAS = 2.5
END = 1e-4
"""Maximum distance of a level from 0 or 1 for it to be a stop or full speed."""
_SLIDERS_DIFFER = 0.02
_LOWEST_SLIDER = 0.1


def by_density(values: Vector, eps: float, min_samples: int) -> Ints:
    """Return the cluster of every value by DBSCAN, shape (T,); -1 = none.

    Args:
        values: Shape (T,), finite.
        eps: Neighbourhood radius.
        min_samples: Minimum number of samples of a level.
    """
    return dbscan_1d(values, eps=eps, min_samples=min_samples)


def by_kmeans(values: Vector, _eps: float, _min_samples: int) -> Ints:
    """Return the cluster of every value by K-means with the best silhouette, shape (T,); arguments as `by_density`."""
    points = condense(values)
    return by_silhouette(points)[points.of]


FINDERS: dict[str, Callable[[Vector, float, int], Ints]] = {"dbscan": by_density, "kmeans-silhouette": by_kmeans}
"""Methods that find levels in values without their order in time, by name, for `--method`."""
RAMPS = 0.1
"""Minimum time on slow ramps, as share of the time on plateaus, for pieces of ramps to be removed."""


@dataclass(frozen=True)
class Cluster:
    """P levels, ascending.

    Attributes:
        value: Mean of the samples of each level, shape (P,).
        deviation: Standard error of that mean, shape (P,); None if unknown (then nothing is rounded).
        spread: Width of the middle 90 % of the clustered values, in eps, shape (P,); 0 if not computed.
    """

    value: Vector
    deviation: Vector | None
    spread: Vector

    @classmethod
    def fixed(cls, levels: Sequence[float]) -> Cluster:
        """Return levels given by the caller."""
        value = np.unique(np.asarray(levels, np.float64))
        return cls(value, None, np.zeros(value.size))


def usual_eps(noise: float, rate_hz: float) -> float:
    """Return the spread of the means of short plateaus of one level, for the noise of one sample."""
    return float(max(_MIN_EPS, 3.5 * noise / samples_in(_USUAL_HOLD_S, rate_hz) ** 0.5))


def of_plateaus(plateaus: Plateaus, value: Vector, eps: float, min_samples: int) -> Cluster:
    """Cluster the values of plateaus by density, weighted by their numbers of samples.

    Args:
        plateaus: K plateaus.
        value: Their values, shape (K,): `plateaus.value`, or these without the operator's slider.
        eps: Neighbourhood radius; see `usual_eps`.
        min_samples: Minimum number of samples of a level, over all plateaus; if there are slow ramps, in one plateau.
    """
    weight = plateaus.samples.astype(np.float64)
    cluster = dbscan_1d(value, eps=eps, min_samples=min_samples, weight=weight)
    if plateaus.on_ramp > RAMPS * weight.sum():
        cluster = _held_at_once(value, cluster, weight, min_samples)
    return _clusters(value, cluster, weight, eps, plateaus.noise)


def _held_at_once(value: Vector, cluster: Ints, weight: Vector, least: int) -> Ints:
    """Return clusters of plateaus, shape (K,), without intermediate ones that have no plateau of `least` samples.

    If there are slow ramps, these are pieces of ramps: an inferred scaling may be constant for a moment on a ramp.
    """
    ends = value[cluster >= 0].min(initial=np.inf), value[cluster >= 0].max(initial=-np.inf)
    kept = cluster.copy()
    for one in np.unique(cluster[cluster >= 0]):
        mine = cluster == one
        if weight[mine].max() < least and not np.isin(ends, value[mine]).any():
            kept[mine] = -1
    return kept


def cluster_values(values: Vector, method: str, eps: float | None, min_samples: int, noise: float) -> Cluster:
    """Cluster single values by one of the literature's methods.

    Args:
        values: Shape (T,), finite.
        method: One of `FINDERS`.
        eps: Neighbourhood radius of DBSCAN; None: 3.5 standard deviations of the noise, at least 0.01.
        min_samples: Minimum number of neighbours of DBSCAN.
        noise: Standard deviation of one value.
    """
    eps = max(_MIN_EPS, 3.5 * noise) if eps is None else eps
    if values.size == 0:
        return Cluster(np.empty(0), None, np.empty(0))
    cluster = FINDERS[method](values, eps, min_samples)
    found = _clusters(values, cluster, np.ones(values.size), eps, noise)
    return Cluster(found.value, None, found.spread)


def _clusters(value: Vector, cluster: Ints, weight: Vector, eps: float, noise: float) -> Cluster:
    """Return mean, standard error and spread of every non-empty cluster, ascending by mean."""
    member = cluster >= 0
    names, index = np.unique(cluster[member], return_inverse=True)
    x, w = value[member], weight[member]
    mass = np.bincount(index, weights=w, minlength=names.size)
    mean = np.bincount(index, weights=w * x, minlength=names.size) / np.maximum(mass, 1e-300)
    order = np.argsort(mean)
    line = np.lexsort((x, index))
    parts = np.split(x[line], np.cumsum(np.bincount(index, minlength=names.size))[:-1]) if names.size else []
    width = np.array([float(np.diff(np.quantile(part, (0.05, 0.95)))[0]) for part in parts]) / eps
    return Cluster(mean[order], (noise / np.sqrt(np.maximum(mass, 1)))[order], width[order])


def rounded(value: Vector, deviation: Vector) -> Vector:
    """Return the levels rounded to steps of 5 % or 1 % if the data support it, else unchanged.

    People choose levels in such steps. The levels are rounded if at least two of them inside (0, 1) are known to a
    fifth of a step and every level is within 2.5 standard errors of a multiple. A level that was held for two seconds
    in noise then becomes much more accurate than its own samples. Otherwise, only a level within END of a stop or of
    full speed is set to that.

    Args:
        value: Means, shape (P,), ascending.
        deviation: Their standard errors, shape (P,).
    """
    for grid in _GRIDS:
        near = np.round(value / grid) * grid
        inside = (near > grid / 2) & (near < 1 - grid / 2) & (_SIGMAS * deviation < grid / 5)
        allowed = np.minimum(np.maximum(_SIGMAS * deviation, 0.0005), grid / 2)
        if inside.sum() >= 2 and (np.abs(value - near) <= allowed).all() and np.unique(near).size == near.size:
            return np.round(near, 6)
    return np.where(np.abs(value - np.round(value)) <= END, np.round(value), value)


def operator_sliders(
    plateaus: Plateaus, run: NDArray[np.generic], found: Cluster, eps: float, min_samples: int
) -> tuple[Vector | None, Cluster]:
    """Find out whether the values are levels times an operator's slider that differs between runs.

    The slider of a run is its highest held value (full speed). It is accepted only if division by it leaves fewer
    levels, at least two, with the highest at full speed.

    Args:
        plateaus: K plateaus.
        run: Run of every known sample, shape (T,).
        found: The levels without a slider.
        eps: As in `of_plateaus`.
        min_samples: As in `of_plateaus`.

    Returns:
        The slider of every known sample, shape (T,), or None; and the levels, divided by the slider if there is one.
    """
    names, at = np.unique(run, return_inverse=True)
    owner = at[plateaus.first] if plateaus.first.size else np.empty(0, np.int64)
    long = plateaus.samples >= min(min_samples, int(plateaus.samples.max(initial=0)))
    top = np.zeros(names.size)
    np.maximum.at(top, owner[long], plateaus.value[long])
    if names.size < 2 or found.value.size < 3 or (top < _LOWEST_SLIDER).any() or np.ptp(top) < _SLIDERS_DIFFER:
        return None, found
    without = of_plateaus(plateaus, plateaus.value / top[owner], eps, min_samples)
    if not 2 <= without.value.size < found.value.size or without.value[-1] < 0.95:
        return None, found
    return top[at], without
