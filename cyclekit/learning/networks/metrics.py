"""How far predictions are from the logged scaling: the few numbers that every model and baseline is judged by."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards import MetricsCard
from cyclekit.learning.networks.calibration import reliability
from cyclekit.learning.networks.kinds import names_levels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.learning.windows import Samples

MUCH_UNEXPLAINED = 0.25
"""A model that leaves more than this part of the variance of the scaling unexplained has a large error."""


def measure(model: TrainedModel, samples: Samples) -> MetricsCard:
    """Judge `model` by rows that it has not seen; `samples` must be of its problem and not empty."""
    X, on_level = samples.model_inputs, samples.step >= 0
    error = model.predict(X) - samples.scaling
    mse_argmax = accuracy = calibration = None
    if model.levels and model.problem != "average":
        step = model.steps(X)
        mse_argmax = float(np.mean((np.array(model.levels)[step] - samples.scaling) ** 2))
        if on_level.any():
            accuracy = float(np.mean(step[on_level] == samples.step[on_level]))
            if names_levels(model.network):
                calibration = reliability(model.probabilities(X)[on_level], samples.step[on_level]).error
    return MetricsCard(
        rows=len(samples),
        mse_mean=float(np.mean(error**2)),
        mse_argmax=mse_argmax,
        mae=float(np.mean(np.abs(error))),
        bias=float(np.mean(error)),
        accuracy=accuracy,
        calibration_error=calibration,
        mse_constant=float(np.var(samples.scaling)),
    )


def large_error(metrics: MetricsCard, levels: Sequence[float]) -> str:
    """Say why the error of a model is large, in a sentence; empty where it is not.

    Args:
        metrics: Its errors.
        levels: Of the model, ascending; fewer than two where it has none.
    """
    mae, constant = metrics.mae, metrics.mse_constant
    half = (levels[-1] - levels[0]) / (len(levels) - 1) / 2 if len(levels) > 1 else float("inf")
    if mae > half:
        return f"mean absolute error {mae:.3f}, more than half a step between its levels ({half:.3f})"
    left = metrics.mse_mean / constant if constant else 0.0
    if left > MUCH_UNEXPLAINED:
        return f"{left:.0%} of the variance of the speed scaling unexplained (always predicting the mean: 100%)"
    return ""
