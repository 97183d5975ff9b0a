"""Do a classifier's probabilities hold? Its temperature, and the error that is left (Guo et al., ICML 2017).

Where a classifier says 0.8, eight of ten such rows should be on that level. Dividing the logits by one number, the
temperature, found on rows that taught nothing, mends what training leaves too sure or too shy, and names no other step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Singles

BINS = 15


@dataclass(frozen=True)
class Reliability:
    """Confidence against truth: rows by how sure the likeliest step was, in bins of equal width.

    Attributes:
        confidence: Mean probability of the likeliest step in each bin that holds rows.
        accuracy: Part of them that was right.
        rows: How many they are.
    """

    confidence: tuple[float, ...]
    accuracy: tuple[float, ...]
    rows: tuple[int, ...]

    @property
    def error(self) -> float:
        """Expected calibration error: mean distance of confidence and accuracy, weighted by rows."""
        off = np.abs(np.subtract(self.confidence, self.accuracy))
        return float(np.average(off, weights=self.rows)) if self.rows else 0.0


def reliability(probabilities: NDArray[np.floating], step: NDArray[np.integer]) -> Reliability:
    """Return how sure a classifier was and how often it was right.

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
    """Return the temperature under which the true steps are likeliest, between 0.2 and 5.

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
