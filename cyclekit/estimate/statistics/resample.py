"""Uncertainty due to finite logs: resampled logged executions (bootstrap), the same draw for every sequence.

Tracks of one execution are drawn together. Where logs follow each other without a pause, so are neighbouring
executions: their tracks contain the same stretch of the operator's day.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Ints, Vector


RESAMPLES = 1000
TOGETHER = 3
"""Number of neighbouring executions drawn as one block where logs follow each other without a pause."""
BLOCKS = 4
"""Minimum number of blocks; with fewer executions the blocks are shorter, as a single block would never vary."""
Z95 = 1.96
"""Half-width of a 95 % interval, standard errors."""


def resampled(executions: Sequence[str], seed: int, *, together: int = 1) -> Floats:
    """Return the weight of each track in each resample, shape (RESAMPLES, K); each row sums to 1.

    Args:
        executions: Execution of each of K tracks.
        seed: Seed of the draw.
        together: Maximum number of neighbouring executions drawn as one block (see BLOCKS).
    """
    names, which = np.unique(np.array(executions), return_inverse=True)
    weight = _drawn(len(names), seed, together)[:, which].astype(np.float64)
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def resampled_alike(executions: Sequence[str], others: Sequence[str], seed: int, *, together: int = 1) -> Floats:
    """Return how often each of `others` is drawn in the resamples of `resampled`, shape (RESAMPLES, others).

    Executions that are not among `executions` count once in each resample.
    """
    names = np.unique(np.array(executions))
    times = np.column_stack([_drawn(len(names), seed, together), np.ones(RESAMPLES, dtype=np.int64)])
    number = {name: n for n, name in enumerate(names.tolist())}
    return np.asarray(times[:, [number.get(name, len(names)) for name in others]], dtype=np.float64)


def _drawn(count: int, seed: int, together: int) -> Ints:
    """Return how often each of `count` executions is drawn in each resample, shape (RESAMPLES, count)."""
    rng = np.random.default_rng(seed)
    together = min(together, max(1, count // BLOCKS))
    starts = rng.integers(0, count, (RESAMPLES, -(-count // together)))
    drawn = (starts[:, :, None] + np.arange(together)).reshape(RESAMPLES, -1) % count
    drawn += count * np.arange(RESAMPLES)[:, None]
    return np.asarray(np.bincount(drawn.ravel(), minlength=RESAMPLES * count).reshape(RESAMPLES, -1))


def interval_of_mean(
    means_s: Vector, *, model_error: float, judged: int = 1000, bias_s: float = 0.0, seed: int
) -> tuple[float, float]:
    """Return the 95 % interval of the mean of K cycles.

    Args:
        means_s: The mean in each resample of the logs, shape (resamples,), s.
        model_error: Standard deviation due to the network's error, as a share of the mean.
        judged: Number of executions from which `model_error` is known; few widen the interval (Student's t).
        bias_s: Possible bias to either side, s, which resampling does not show.
        seed: Seed of the draw from Student's t.
    """
    means = means_s * (1.0 + drawn_errors(model_error, judged, seed, count=len(means_s)))
    return float(np.quantile(means, 0.025)) - bias_s, float(np.quantile(means, 0.975)) + bias_s


def drawn_errors(model_error: float, judged: int, seed: int, *, count: int = RESAMPLES) -> Vector:
    """Return the error of the mean in each resample, as a share of it, shape (count,): `interval_of_mean`."""
    return np.asarray(model_error * np.random.default_rng(seed + 1).standard_t(max(judged - 1, 1), count))


def means_below(means: Sequence[Vector], index: int) -> Vector:
    """Return the probability that the mean of sequence `index` is below that of each, shape (N,); ties count half."""
    mine = means[index]
    return np.array([float(np.mean(mine < other) + 0.5 * np.mean(mine == other)) for other in means])
