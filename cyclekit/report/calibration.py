"""Calibration of the model: mean predicted and mean logged scaling per bin, on the executions it was evaluated on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.unknown_height import HUMAN_Z_IN_PLANE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.report.findings import Predicts

BINS = 10
MIN_SAMPLES = 20
"""A bin with fewer samples is left out."""

MAX_SAMPLES = 50_000
"""Maximum number of samples: enough for ten means, and quick."""


@dataclass(frozen=True)
class PredictionBins:
    """Predictions in bins, shape (B,) each.

    Attributes:
        predicted: Mean prediction of the bin.
        logged: Mean logged scaling of the same samples.
        count: Number of samples.
    """

    predicted: NDArray[np.float64]
    logged: NDArray[np.float64]
    count: NDArray[np.int64]

    @property
    def worst(self) -> float:
        """Largest difference of the two means."""
        return float(np.abs(self.predicted - self.logged).max())


def calibration(samples: pl.DataFrame, executions: Sequence[str], model: Predicts | None) -> PredictionBins | None:
    """Bin the predictions on `executions`; None without a model of problem `now` or without samples.

    Args:
        samples: Samples of all executions.
        executions: Executions that the model was evaluated on.
        model: The model.
    """
    if model is None or model.problem != "now" or not executions:
        return None
    axes = [f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz"]
    rows = samples.filter(pl.col("execution").is_in(list(executions)) & pl.col("robot_moving"))
    rows = rows.with_columns(human_z_m=HUMAN_Z_IN_PLANE).select(*axes, "scaling").drop_nulls()
    rows = rows.gather_every(max(1, -(-rows.height // MAX_SAMPLES)))
    if rows.height < MIN_SAMPLES:
        return None
    predicted = np.asarray(model.predict(rows.select(axes).to_numpy().astype(np.float32)), dtype=np.float64)
    logged = rows["scaling"].to_numpy()
    slot = np.minimum((predicted * BINS).astype(np.int64), BINS - 1)
    count = np.bincount(slot, minlength=BINS)
    used = np.flatnonzero(count >= MIN_SAMPLES)
    if not len(used):
        return None
    means = [np.bincount(slot, weights=values, minlength=BINS)[used] / count[used] for values in (predicted, logged)]
    return PredictionBins(means[0], means[1], count[used])
