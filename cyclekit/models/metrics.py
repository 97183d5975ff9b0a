"""How far predictions are from the logged scaling: the few numbers that every model and baseline is judged by."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.models.saved import TrainedModel
    from cyclekit.samples import Samples


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
    """

    rows: int
    mse_mean: float
    mse_argmax: float | None
    mae: float
    bias: float
    accuracy: float | None

    def to_json(self) -> dict[str, float | int | None]:
        """Return the numbers as JSON values."""
        return asdict(self)


def measure(model: TrainedModel, samples: Samples) -> Metrics:
    """Judge `model` by rows that it has not seen; `samples` must be of its problem and not empty."""
    error = model.predict(samples.X) - samples.scaling
    names_steps = bool(model.levels) and model.problem != "average"
    argmax: NDArray[np.int64] | None = model.steps(samples.X) if names_steps else None
    on_level = samples.step >= 0
    return Metrics(
        rows=len(samples),
        mse_mean=float(np.mean(error**2)),
        mse_argmax=None if argmax is None else float(np.mean((np.array(model.levels)[argmax] - samples.scaling) ** 2)),
        mae=float(np.mean(np.abs(error))),
        bias=float(np.mean(error)),
        accuracy=None
        if argmax is None or not on_level.any()
        else float(np.mean(argmax[on_level] == samples.step[on_level])),
    )
