"""Which logged executions say how far a rollout is off, how far that is, and how well it is known.

The network learned from most of them, so they come out better than new ones will. The few that it never saw are honest
but few: one cycle that took another turn moves their mean by more than the network is off, and their scatter seldom
shows it. So all executions tell the bias, and how far the unseen ones lie from it widens what is not known of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.schema import Vector


WORSE = 2.0
"""Where the executions that the network never saw come out worse than the others, their median error beyond so many
times that of the others and no chance (BY_RANK), they alone say how far a rollout is off. Otherwise all do: one cycle
that took another turn among nine unseen ones would be taken for one in nine."""
BY_RANK = 2.33
"""Standard deviations of the rank sum of Mann and Whitney: one in a hundred by chance."""
LEAST_UNSEEN = 3
"""Fewer unseen executions do not judge alone."""


@dataclass(frozen=True)
class ModelBias:
    """How far a rollout is off, as part of the duration.

    Attributes:
        off: Rolled / logged - 1 of the executions that judge, shape (N,).
        bias: Their mean.
        error: Its standard error.
    """

    off: Vector
    bias: float
    error: float


def judge(off: Vector, unseen: NDArray[np.bool_]) -> ModelBias:
    """Return how far a rollout beside the own operators is off.

    Args:
        off: Rolled / logged - 1, shape (E,).
        unseen: Which executions the network never saw, shape (E,).
    """
    some = off[unseen] if _unseen_alone(np.abs(off), unseen) else off
    bias, error = float(some.mean()), _standard_error(some)
    if len(some) == len(off) and unseen.any():
        # were they no different, this would be as large as the standard error by chance; what they show beyond is new
        error = float(np.hypot(error, (off[unseen].mean() - bias) * np.sqrt(unseen.mean())))
    return ModelBias(some, bias, error)


def _standard_error(values: Vector) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("inf")


def _unseen_alone(size: Vector, unseen: NDArray[np.bool_]) -> bool:
    """Tell whether unseen executions come out worse than the others beyond chance: see WORSE."""
    mine, others = size[unseen], size[~unseen]
    if len(mine) < LEAST_UNSEEN or not len(others) or np.median(mine) <= WORSE * np.median(others):
        return False
    above = float((mine[:, None] > others).sum()) - len(mine) * len(others) / 2
    return above > BY_RANK * float(np.sqrt(len(mine) * len(others) * (len(size) + 1) / 12))


def within(error: float, count: int) -> float:
    """Return half the width of a 95 % interval by Student's t: `error` a standard error from `count` executions."""
    from scipy.special import stdtrit

    return float(stdtrit(max(count - 1, 1), 0.975)) * error
