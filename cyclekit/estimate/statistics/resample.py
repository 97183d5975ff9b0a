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


def share_within(
    durations_s: Vector, takt_s: float, weights: Floats, *, bias: float = 0.0, errors: Vector | None = None
) -> tuple[float, float, float]:
    """Return the share of K cycles that take at most `takt_s`, and its 95 % interval over the resamples.

    Args:
        durations_s: The cycles, shape (K,), s.
        takt_s: Takt time, s.
        weights: Weights of the cycles in each resample, shape (R, K).
        bias: Possible bias of every cycle to either side, as a share of it; it widens the interval.
        errors: Error of all cycles in each resample, as a share, shape (R,): it widens the interval too.
    """
    meets = float((durations_s <= takt_s).mean())
    if errors is None:
        slower, quicker = (weights @ (durations_s * (1 + off) <= takt_s) for off in (bias, -bias))
    else:
        order = np.argsort(durations_s)
        upto = np.concatenate([np.zeros((len(weights), 1)), np.cumsum(weights[:, order], axis=1)], axis=1)
        longest = (takt_s / ((1 + off) * np.maximum(1 + errors, 1e-9)) for off in (bias, -bias))
        ends = (np.searchsorted(durations_s[order], each, side="right") for each in longest)
        slower, quicker = (upto[np.arange(len(weights)), end] for end in ends)
    return meets, float(np.quantile(slower, 0.025)), float(np.quantile(quicker, 0.975))


def means_below(means: Sequence[Vector], index: int) -> Vector:
    """Return the probability that the mean of sequence `index` is below that of each, shape (N,); ties count half."""
    mine = means[index]
    return np.array([float(np.mean(mine < other) + 0.5 * np.mean(mine == other)) for other in means])


def wilson(share: float, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share that was counted in `count` cases."""
    count = max(count, 1)
    middle = (share + Z95**2 / (2 * count)) / (1 + Z95**2 / count)
    half = Z95 * np.sqrt(share * (1 - share) / count + (Z95 / (2 * count)) ** 2) / (1 + Z95**2 / count)
    return max(float(middle - half), 0.0), min(float(middle + half), 1.0)


def least_wide(within: tuple[float, float, float], executions: int) -> tuple[float, float, float]:
    """Return a share of cycles with its interval, no narrower than Wilson's interval of `executions` cases.

    If all resampled executions are within the takt time, their interval has no width.
    """
    share, low, high = within
    least, most = wilson(share, executions)
    return share, max(min(low, least), 0.0), min(max(high, most), 1.0)
