"""How far predictions are from the logged scaling: the few numbers that every model and baseline is judged by."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.learning.networks.calibration import reliability

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.learning.windows import Samples

MUCH_UNEXPLAINED = 0.25
"""A model that leaves more than this part of the variance of the scaling unexplained has a large error."""


@dataclass(frozen=True)
class Metrics:
    """Errors against the logged scaling over N rows; scaling is a fraction, so all are fractions.

    Attributes:
        rows: N.
        mse_mean: Mean squared error of the best estimate (`predict`).
        mse_argmax: The same of the level of the most likely step; None where there are no levels to name.
        mae: Mean absolute error of the best estimate.
        bias: Mean of predicted - true.
        accuracy: Part of the rows on a level whose step is named rightly; None where there is none.
        calibration_error: Expected calibration error of a classifier's probabilities; None for the others.
        mse_constant: Mean squared error of always predicting the mean of these rows; None where it was not measured.
    """

    rows: int
    mse_mean: float
    mse_argmax: float | None
    mae: float
    bias: float
    accuracy: float | None
    calibration_error: float | None = None
    mse_constant: float | None = None

    def to_json(self) -> dict[str, float | int | None]:
        """Return the numbers as JSON values."""
        return asdict(self)


def measure(model: TrainedModel, samples: Samples) -> Metrics:
    """Judge `model` by rows that it has not seen; `samples` must be of its problem and not empty."""
    X, on_level = samples.model_inputs, samples.step >= 0
    error = model.predict(X) - samples.scaling
    mse_argmax = accuracy = calibration = None
    if model.levels and model.problem != "average":
        step = model.steps(X)
        mse_argmax = float(np.mean((np.array(model.levels)[step] - samples.scaling) ** 2))
        if on_level.any():
            accuracy = float(np.mean(step[on_level] == samples.step[on_level]))
            if model.network == "classifier":
                calibration = reliability(model.probabilities(X)[on_level], samples.step[on_level]).error
    return Metrics(
        rows=len(samples),
        mse_mean=float(np.mean(error**2)),
        mse_argmax=mse_argmax,
        mae=float(np.mean(np.abs(error))),
        bias=float(np.mean(error)),
        accuracy=accuracy,
        calibration_error=calibration,
        mse_constant=float(np.var(samples.scaling)),
    )


def large_error(metrics: Mapping[str, Any], levels: Sequence[float]) -> str:
    """Say why the error of a model is large, in a sentence; empty where it is not.

    Args:
        metrics: `mae`, `mse_mean` and, where it was measured, `mse_constant`.
        levels: Of the model, ascending; fewer than two where it has none.
    """
    mae, constant = float(metrics["mae"]), metrics.get("mse_constant")
    half = (levels[-1] - levels[0]) / (len(levels) - 1) / 2 if len(levels) > 1 else float("inf")
    if mae > half:
        return f"mean absolute error {mae:.3f}, more than half a step between its levels ({half:.3f})"
    left = float(metrics["mse_mean"]) / constant if constant else 0.0
    if left > MUCH_UNEXPLAINED:
        return f"{left:.0%} of the variance of the speed scaling unexplained (always predicting the mean: 100%)"
    return ""
