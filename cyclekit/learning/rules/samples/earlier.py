"""Interpolates samples at an earlier time, within unbroken stretches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Vector

_OFFSET_S = 1e7
"""Offset between the times of stretches, s, so that one search covers all."""
_ROUNDING_S, _SAME = 1e-9, 1e-6


def earlier(
    values: NDArray[np.float64], t_s: Vector, run: NDArray[np.int64], by_s: float
) -> tuple[NDArray[np.float64], Bools]:
    """Return values as they were `by_s` earlier, and which of these times lie before the start of the stretch.

    Args:
        values: Shape (N,) or (N, K); interpolated linearly, NaN between samples one of which is NaN.
        t_s: Time, ascending within each stretch, shape (N,), s.
        run: Number of the unbroken stretch, ascending, shape (N,).
        by_s: Not negative.

    Returns:
        Values of the same shape, those of the first sample before the start; and the flags, shape (N,).
    """
    then_s, time = t_s - by_s, t_s + _OFFSET_S * run
    after = np.searchsorted(time, time - by_s)
    before = np.maximum(after - 1, 0)
    before = np.where(run[before] == run, before, after)
    part = (then_s - t_s[before]) / np.maximum(t_s[after] - t_s[before], _ROUNDING_S)
    part = np.clip(part, 0.0, 1.0)
    moved = values[before] + part.reshape(-1, *[1] * (values.ndim - 1)) * (values[after] - values[before])
    at_sample = np.abs(part - np.rint(part)) < _SAME  # the other sample may be NaN
    moved[at_sample] = values[np.where(part < 0.5, before, after)[at_sample]]
    return moved, then_s < t_s[np.searchsorted(run, run)] - _ROUNDING_S
