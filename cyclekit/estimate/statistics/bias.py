"""The bias of a rollout on logged executions, which executions determine it, and its standard error.

The network was trained on most executions, so these show smaller errors than new ones will. The few held-out ones are
unbiased but few: one unusual cycle shifts their mean by more than the network's error, and their scatter seldom shows
it. So the bias is the mean of all executions, and the distance of the held-out ones from it adds to the standard error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Vector


WORSE = 2.0
"""Threshold, ratio of the median errors of held-out and other executions. Above it, and if the difference is
significant (BY_RANK), the held-out executions alone determine the bias. Otherwise all do: one unusual cycle among nine
held-out ones would count as one in nine."""
BY_RANK = 2.33
"""Threshold, standard deviations of the Mann-Whitney rank sum: one in a hundred by chance."""
MIN_UNSEEN = 3
"""Minimum number of held-out executions to determine the bias alone."""


@dataclass(frozen=True)
class ModelBias:
    """The bias of a rollout, as a share of the duration.

    Attributes:
        off: Rolled / logged - 1 of the executions that determine the bias, shape (N,).
        bias: Mean of `off`.
        error: Standard error of the bias.
    """

    off: Vector
    bias: float
    error: float


def bias_of(off: Vector, unseen: NDArray[np.bool_]) -> ModelBias:
    """Return the bias of a rollout with the own operator tracks.

    Args:
        off: Rolled / logged - 1, shape (E,).
        unseen: Which executions the network was not trained on, shape (E,).
    """
    some = off[unseen] if _unseen_alone(np.abs(off), unseen) else off
    bias, error = float(some.mean()), _standard_error(some)
    if len(some) == len(off) and unseen.any():
        # without a real difference this term is, by chance, as large as the standard error; anything above is new
        error = float(np.hypot(error, (off[unseen].mean() - bias) * np.sqrt(unseen.mean())))
    return ModelBias(some, bias, error)


def _standard_error(values: Vector) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("inf")


def _unseen_alone(size: Vector, unseen: NDArray[np.bool_]) -> bool:
    """Return whether held-out executions are significantly worse than the others: see WORSE."""
    mine, others = size[unseen], size[~unseen]
    if len(mine) < MIN_UNSEEN or not len(others) or np.median(mine) <= WORSE * np.median(others):
        return False
    above = float((mine[:, None] > others).sum()) - len(mine) * len(others) / 2
    return above > BY_RANK * float(np.sqrt(len(mine) * len(others) * (len(size) + 1) / 12))


def half_width_95(error: float, count: int) -> float:
    """Return the half-width of a 95 % interval (Student's t) from the standard error of `count` executions."""
    from scipy.special import stdtrit

    return float(stdtrit(max(count - 1, 1), 0.975)) * error
