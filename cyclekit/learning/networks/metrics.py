"""Errors of predictions against the logged scaling, and calibration of a classifier's probabilities.

Of rows predicted with probability 0.8, 80 % should be on that level (Guo et al., ICML 2017). Dividing the logits by one
number, the temperature, fitted on rows not used in training, corrects over- or underconfident probabilities; the most
likely level does not change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from cyclekit.dataset.cards import MetricsCard
from cyclekit.learning.networks.kinds import is_classifier
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.text.numbers import fixed, percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.learning.windows import Samples
    from cyclekit.schema import Floats, Ints, Singles

MUCH_UNEXPLAINED = 0.25
"""Share of unexplained variance of the scaling above which a model's error counts as large."""


class Predictor(Protocol):
    """What is measured: a network, or a rule in its place."""

    @property
    def problem(self) -> str:
        """Problem that it answers."""
        ...

    @property
    def network(self) -> str:
        """Name of the network, or `rule`."""
        ...

    @property
    def levels(self) -> tuple[float, ...]:
        """Levels of the speed scaling, ascending."""
        ...

    def predict(self, X: NDArray[np.floating], /) -> Floats:
        """Scaling (N,) of the model's inputs."""
        ...

    def steps(self, X: NDArray[np.floating], /) -> Ints:
        """Number of the level (N,) of the model's inputs."""
        ...


def measure(model: Predictor, samples: Samples) -> MetricsCard:
    """Return the metrics of a predictor on held-out rows; `samples` must be of its problem and not empty."""
    X, on_level = samples.model_inputs, samples.step >= 0
    error = model.predict(X) - samples.scaling
    mse_argmax = accuracy = calibration = None
    if model.levels and model.problem != "average":
        step = model.steps(X)
        mse_argmax = float(np.mean((np.array(model.levels)[step] - samples.scaling) ** 2))
        if on_level.any():
            accuracy = float(np.mean(step[on_level] == samples.step[on_level]))
            if isinstance(model, TrainedModel) and is_classifier(model.network):
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
    """Return one sentence on why a model's error is large; empty if it is not.

    Args:
        metrics: Errors of the model.
        levels: Levels of the model, ascending; fewer than two if it has none.
    """
    mae, constant = metrics.mae, metrics.mse_constant
    half = (levels[-1] - levels[0]) / (len(levels) - 1) / 2 if len(levels) > 1 else float("inf")
    if mae > half:
        return f"mean absolute error {fixed(mae, 3)}, more than half a step between its levels ({fixed(half, 3)})"
    left = metrics.mse_mean / constant if constant else 0.0
    if left > MUCH_UNEXPLAINED:
        return f"{percent(left)} of the variance of the speed scaling unexplained (always predicting the mean: 100 %)"
    return ""


BINS = 15
"""Number of bins of a reliability diagram."""


@dataclass(frozen=True)
class Reliability:
    """Reliability of a classifier: rows binned by the probability of the most likely level, in bins of equal width.

    Attributes:
        confidence: Mean probability of the most likely level in each non-empty bin.
        accuracy: Share of correct rows in each bin.
        rows: Number of rows in each bin.
    """

    confidence: tuple[float, ...]
    accuracy: tuple[float, ...]
    rows: tuple[int, ...]

    @property
    def error(self) -> float:
        """Expected calibration error: mean absolute difference of confidence and accuracy, weighted by rows."""
        off = np.abs(np.subtract(self.confidence, self.accuracy))
        return float(np.average(off, weights=self.rows)) if self.rows else 0.0


def reliability(probabilities: NDArray[np.floating], step: NDArray[np.integer]) -> Reliability:
    """Return the reliability of a classifier.

    Args:
        probabilities: Shape (N, P).
        step: True level, shape (N,), all 0 or more.
    """
    likeliest = probabilities.argmax(axis=1)
    sure = probabilities[np.arange(len(step)), likeliest].astype(np.float64)
    at = np.minimum((sure * BINS).astype(np.int64), BINS - 1)
    rows = np.bincount(at, minlength=BINS)
    used = np.flatnonzero(rows)
    confidence = np.bincount(at, weights=sure, minlength=BINS)[used] / rows[used]
    accuracy = np.bincount(at, weights=likeliest == step, minlength=BINS)[used] / rows[used]
    return Reliability(tuple(confidence.tolist()), tuple(accuracy.tolist()), tuple(rows[used].tolist()))


def best_temperature(logits: Singles, step: NDArray[np.integer]) -> float:
    """Return the temperature that maximises the likelihood of the true levels, between 0.2 and 5.

    Args:
        logits: Shape (N, P), N > 0.
        step: True level, shape (N,), all 0 or more.
    """
    low, high = np.log(0.2), np.log(5.0)
    golden = (5**0.5 - 1) / 2
    for _ in range(30):  # the loss has one minimum in the inverse temperature
        a, b = high - golden * (high - low), low + golden * (high - low)
        if _loss(logits, step, np.exp(a)) <= _loss(logits, step, np.exp(b)):
            high = b
        else:
            low = a
    return float(np.exp((low + high) / 2))


def _loss(logits: Singles, step: NDArray[np.integer], temperature: float) -> float:
    scaled = logits / temperature
    scaled = scaled - scaled.max(axis=1, keepdims=True)
    return float(np.mean(np.log(np.exp(scaled).sum(axis=1)) - scaled[np.arange(len(step)), step]))
