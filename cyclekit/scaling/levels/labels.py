"""Assign samples to known levels; samples in transition between levels get none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.time_grid import USUAL_HZ
from cyclekit.scaling.levels.dbscan import UNKNOWN
from cyclekit.scaling.levels.plateaus import Plateaus, find_plateaus

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from cyclekit.schema import Bools, Floats, Ints

TOLERANCE = 0.03
"""Maximum distance of a value from its level, as fraction of full speed."""
_SHARP = (0.003, 0.01)
"""Bounds of the tolerance for samples on no plateau (in transition, or on a level for a tenth of a second); between
them, it is four standard deviations of the noise."""


def unbroken(run: NDArray[np.generic], known: Bools) -> Ints:
    """Return the stretch of every sample, shape (T,): a new one starts with a new run and after an unknown value.

    Args:
        run: Run of every sample, shape (T,).
        known: Whether the scaling of each sample is known, shape (T,).
    """
    if run.size == 0:
        return np.empty(0, np.int64)
    new = np.concatenate([[True], (run[1:] != run[:-1]) | (known[1:] & ~known[:-1])])
    return np.cumsum(new).astype(np.int64)


def label(values: ArrayLike, levels: ArrayLike | Sequence[float], *, tolerance: float = TOLERANCE) -> NDArray[np.int32]:
    """Return the index of the level that each value is on.

    Args:
        values: Speed scaling, shape (T,); NaN = unknown.
        levels: Level values, shape (P,), ascending.
        tolerance: Maximum distance of a value from its level; the nearer of two levels counts.

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


def label_in_time(
    values: Floats, levels: ArrayLike, run: Ints, *, rate_hz: float = USUAL_HZ, plateaus: Plateaus | None = None
) -> NDArray[np.int32]:
    """Return the level of every sample by its plateau, so that a ramp that passes a level is not on it.

    A sample on no plateau is labelled only if its value is very close to a level.

    Args:
        values: Speed scaling, shape (T,), in order of time; NaN = unknown.
        levels: Level values, shape (P,), ascending.
        run: Stretch without gaps of every sample, shape (T,), non-decreasing.
        rate_hz: Rate of the samples.
        plateaus: Plateaus of the known values (possibly times a slider); None: they are computed.

    Returns:
        Shape (T,), int32; -1 = unknown or in transition.
    """
    known = np.flatnonzero(np.isfinite(values))
    levels = np.asarray(levels, np.float64)
    apart = float(np.diff(levels).min(initial=1.0))
    if plateaus is None:
        plateaus = find_plateaus(values[known], run[known], rate_hz=rate_hz, most_noise=apart / 8)
    result = label(values, levels, tolerance=float(np.clip(4 * plateaus.noise, *_SHARP)))
    owner = np.repeat(np.arange(plateaus.first.size), plateaus.samples)
    offset = np.concatenate([[0], np.cumsum(plateaus.samples)])[:-1]
    on = known[np.arange(owner.size) - offset[owner] + plateaus.first[owner]]
    mean = np.bincount(owner, weights=values[on], minlength=plateaus.first.size) / np.maximum(plateaus.samples, 1)
    result[on] = label(mean, levels)[owner]
    before, after = np.roll(result, 1), np.roll(result, -1)
    stray = (result == UNKNOWN) & (before == after) & (np.roll(run, 1) == np.roll(run, -1))  # one noisy sample
    near = label(values, levels, tolerance=max(TOLERANCE, 5 * plateaus.noise))
    return np.where(stray & (near == before), near, result)
