"""Find the staircase in a logged speed scaling: which levels the safety system uses, and which one is in force when.

A safety system does not slow a robot by a little; it switches between a few speeds that somebody chose in a risk
assessment. In the log these are values that are held. Held samples are clustered by density (DBSCAN, as the paper
does); a cluster is a level and its mean the level's value. The order in time is data too: a sample that agrees with
neither neighbour belongs to a ramp between levels, and a chain of ramp samples would join two levels into one.
Why a level is in force is not asked here; that is what the networks learn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

UNKNOWN = -1
"""Label of a sample that is on no level: scaling unknown, or in a ramp."""
TOLERANCE = 0.03
"""Farthest distance from a level (fraction of full speed) at which a value still counts as being on it."""
_MANY_LEVELS = 12
"""More levels than any safety configuration offers: then the values are not a staircase."""
_WIDE = 4.0
"""A cluster whose middle 90 % spread over more than this many eps is no single level."""
_MUCH_UNKNOWN = 0.2


@dataclass(frozen=True)
class Staircase:
    """The levels of a speed scaling, and the level of every sample.

    Attributes:
        levels: Level values, shape (P,), ascending, fractions of full speed.
        label: Index into `levels` of every sample, shape (T,), int32; -1 = unknown or in a ramp.
        share: Part of the known samples that is on each level, shape (P,).
        warnings: Why this may be no staircase, one sentence each; empty when all is well.
    """

    levels: NDArray[np.float64]
    label: NDArray[np.int32]
    share: NDArray[np.float64]
    warnings: tuple[str, ...] = ()


def find_staircase(scaling: ArrayLike, *, eps: float = 0.02, min_samples: int = 10) -> Staircase:
    """Find the levels of a speed scaling that was logged, and label every sample.

    Args:
        scaling: Speed scaling, shape (T,), fractions, in the order of time; NaN = unknown.
        eps: Values this near to each other are the same value. The default suits logged scaling, which is almost
            free of noise; levels must lie at least 2.5 eps apart to be told apart.
        min_samples: A level needs this many held samples (the last before a jump and the first after it do not
            count); small, so that a rare level survives.

    Returns:
        The staircase. P = 0 when no value is held often enough; the warnings then say so.
    """
    values = np.asarray(scaling, dtype=np.float64)
    if values.ndim != 1:
        msg = f"scaling must be (T,), not {values.shape}"
        raise ShapeError(msg)
    held = values[_held(values, eps)]
    cluster = dbscan_1d(held, eps=eps, min_samples=min_samples)
    member, count = held[cluster >= 0], int(cluster.max(initial=-1)) + 1
    index = cluster[cluster >= 0]
    sizes = np.bincount(index, minlength=count)
    centres = np.bincount(index, weights=member, minlength=count) / np.maximum(sizes, 1)
    order = np.argsort(centres)
    levels = centres[order]
    labels = label(values, levels)
    known = int(np.isfinite(values).sum())
    share = np.bincount(labels[labels >= 0], minlength=count) / max(known, 1)
    spread = [float(np.diff(np.quantile(member[index == k], (0.05, 0.95)))[0]) for k in order[: _MANY_LEVELS + 1]]
    return Staircase(levels, labels, share, tuple(_doubts(levels, share, spread, known, eps)))


def label(values: ArrayLike, levels: ArrayLike | Sequence[float], *, tolerance: float = TOLERANCE) -> NDArray[np.int32]:
    """Return the index of the level that each value is on.

    Args:
        values: Speed scaling, shape (T,); NaN = unknown.
        levels: Level values, shape (P,), ascending.
        tolerance: A value farther than this from every level is on none; between two levels that are nearer than
            twice the tolerance the nearer one counts.

    Returns:
        Shape (T,), int32; -1 where the value is unknown or on no level.
    """
    values, levels = np.asarray(values, dtype=np.float64), np.asarray(levels, dtype=np.float64)
    if levels.size == 0:
        return np.full(values.shape, UNKNOWN, np.int32)
    between = (levels[1:] + levels[:-1]) / 2
    nearest = np.searchsorted(between, values).astype(np.int32)
    near = np.abs(values - levels[np.minimum(nearest, levels.size - 1)]) <= tolerance  # False for NaN
    return np.where(near, nearest, np.int32(UNKNOWN)).astype(np.int32)


def dbscan_1d(values: ArrayLike, *, eps: float, min_samples: int) -> NDArray[np.int64]:
    """Cluster scalars by density: exactly DBSCAN, in O(n log n) time and O(n) memory.

    On a line, the neighbours of a value are a run of the sorted values, so two binary searches count them, and a
    cluster is a run of core values without a gap wider than eps. The labels are those of `sklearn.cluster.DBSCAN`,
    numbering included, except where two values lie exactly eps apart and rounding decides.

    Args:
        values: Shape (T,), finite.
        eps: Neighbourhood radius, closed; above 0.
        min_samples: Neighbours, itself included, that make a value a core value.

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
    neighbours = np.searchsorted(line, line + eps, "right") - np.searchsorted(line, line - eps, "left")
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


def _number_by_first(run: NDArray[np.int64], position: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of each run: runs are numbered by where their first core value stands in the data."""
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    first = np.minimum.reduceat(position, starts)
    number = np.empty_like(first)
    number[np.argsort(first)] = np.arange(first.size)
    return number


def _border(
    value: NDArray[np.float64], core: NDArray[np.float64], number: NDArray[np.int64], eps: float
) -> NDArray[np.int64]:
    """Return the cluster of values that are no core: that of a core value within eps, the lower number winning."""
    nobody = np.iinfo(np.int64).max
    right = np.searchsorted(core, value)
    left, right_in = np.maximum(right - 1, 0), np.minimum(right, core.size - 1)
    from_left = np.where((right > 0) & (value - core[left] <= eps), number[left], nobody)
    from_right = np.where((right < core.size) & (core[right_in] - value <= eps), number[right_in], nobody)
    lowest = np.minimum(from_left, from_right)
    return np.where(lowest == nobody, UNKNOWN, lowest)


def _held(values: NDArray[np.float64], eps: float) -> NDArray[np.bool_]:
    """Tell which samples agree within eps with every known neighbour in time, of which there is at least one."""
    step = np.abs(np.diff(values))
    before, after = np.concatenate([[np.nan], step]), np.concatenate([step, [np.nan]])
    agrees = (before <= eps) | (after <= eps)
    jumps = (before > eps) | (after > eps)
    return np.isfinite(values) & agrees & ~jumps


def _doubts(
    levels: NDArray[np.float64], share: NDArray[np.float64], spread: Sequence[float], known: int, eps: float
) -> list[str]:
    doubts = []
    if known == 0:
        return ["the scaling is unknown everywhere"]
    if levels.size == 0:
        return ["no value of the scaling is held long enough to be a level"]
    if levels.size == 1:
        doubts.append(f"only one level, {levels[0]:.2f}: the logs show no slow-down, or no full speed")
    if levels.size > _MANY_LEVELS:
        doubts.append(f"{levels.size} levels are too many for a staircase: the scaling may be a continuous function")
    wide = [f"{value:.2f}" for value, width in zip(levels, spread, strict=False) if width > _WIDE * eps]
    if wide:
        doubts.append(f"values around {', '.join(wide)} form no sharp level: the scaling may be a continuous function")
    if (unknown := 1 - float(share.sum())) > _MUCH_UNKNOWN:
        doubts.append(f"{unknown:.0%} of the known samples are on no level: ramps, or no staircase at all")
    return doubts
