"""The time grid of samples: seconds as counts of samples, and stretches without a gap."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

USUAL_HZ = 10.0
"""Rate of a dataset where no other was asked for, and of the paper."""
_GAP = 1.5
"""Two samples farther apart than this many periods have a gap between them."""


def samples_in(seconds: float, rate_hz: float, *, least: int = 1) -> int:
    """Return how many samples at `rate_hz` last `seconds`, at least `least`."""
    return max(least, round(seconds * rate_hz))


def stretches(frame: pl.DataFrame, rate_hz: float) -> NDArray[np.int64]:
    """Return the number of the unbroken stretch (one execution, no gap) of every row of SAMPLES, shape (N,)."""
    step = pl.col("t_s").diff()
    new = (pl.col("execution") != pl.col("execution").shift()) | (step > _GAP / rate_hz) | (step <= 0)
    return frame.select(new.fill_null(value=True).cum_sum().cast(pl.Int64)).to_series().to_numpy()
