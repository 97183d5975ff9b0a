"""The time grid of samples: durations as numbers of samples, and stretches without gaps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

USUAL_HZ = 10.0
"""Default rate of a dataset, Hz, as in the paper."""
_GAP = 1.5
"""Maximum step between two samples, in periods; a longer one is a gap."""


def samples_in(seconds: float, rate_hz: float, *, least: int = 1) -> int:
    """Return the number of samples at `rate_hz` in `seconds`, at least `least`."""
    return max(least, round(seconds * rate_hz))


def stretches(frame: pl.DataFrame, rate_hz: float) -> NDArray[np.int64]:
    """Return the number of the stretch without a gap (within one execution) of every row of SAMPLES, shape (N,)."""
    step = pl.col("t_s").diff()
    new = (pl.col("execution") != pl.col("execution").shift()) | (step > _GAP / rate_hz) | (step <= 0)
    return frame.select(new.fill_null(value=True).cum_sum().cast(pl.Int64)).to_series().to_numpy()
