"""Which level a sample is on, once the levels are known; samples in transition between levels are on none."""

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
"""Farthest distance from a level (fraction of full speed) at which a value still counts as being on it."""
_SHARP = (0.003, 0.01)
"""A sample on no plateau (one on its way, or a level crossed in a tenth of a second) must hit its level to within four
deviations of the noise, and these bounds."""


def unbroken(run: NDArray[np.generic], known: Bools) -> Ints:
    """Return the number of the stretch of every sample: a new one begins with a new run and after an unknown value.

    Args:
        run: Run of every sample, shape (T,).
        known: Whether its scaling is known, shape (T,).
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


def label_in_time(
    values: Floats, levels: ArrayLike, run: Ints, *, rate_hz: float = USUAL_HZ, plateaus: Plateaus | None = None
) -> NDArray[np.int32]:
    """Return the level of every sample by the plateau it lies on, so that a ramp that passes a level is not on it.

    A sample on no plateau is labelled only where its value, almost free of noise, is a level's.

    Args:
        values: Speed scaling, shape (T,), in the order of time; NaN = unknown.
        levels: Level values, shape (P,), ascending.
        run: Unbroken stretch of every sample, shape (T,), not falling.
        rate_hz: Rate of the samples.
        plateaus: Where they were found before, in the known values (perhaps times a slider); None: found here.

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
