"""The level of the logs: how much longer logged executions took than rollouts of the same orders, if nobody was logged.

A model of unseen people reproduces each log, but where other people meet other parts of the path it has little to rest
on, and its cycles of the logged orders take longer or shorter on average than these did. What the logs show of the mean
is their own mean; what the rollout adds is the difference between orders. So every rollout is multiplied by logged over
rolled-out durations of the logged orders, the ratio estimator of survey sampling (Cochran, Sampling Techniques, 1977,
chapter 6). With positions or signals of people the rollout knows more than that mean, and keeps its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.statistics.resample import TOGETHER, resampled, resampled_alike

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.schema import Floats, Vector


@dataclass(frozen=True)
class LogLevel:
    """Logged and rolled-out durations of E logged executions.

    Attributes:
        executions: Their names.
        logged_s: Logged durations.
        rolled_s: Mean durations of the same orders with the operators of all executions.
        slowness: Mean duration of these orders with the operator of each execution, relative to that with all.
    """

    executions: tuple[str, ...]
    logged_s: tuple[float, ...]
    rolled_s: tuple[float, ...]
    slowness: tuple[float, ...]

    @property
    def factor(self) -> float:
        """Factor on a rolled-out duration."""
        return sum(self.logged_s) / sum(self.rolled_s)

    def resampled(self, tracks: OperatorTracks, seed: int) -> Vector:
        """Return the factor in each resample of the logs relative to `factor`, shape (resamples,): see `resample`."""
        together = TOGETHER if tracks.runs_on else 1
        drawn = resampled_alike(tracks.executions, self.executions, seed, together=together)
        ratio = (drawn @ np.array(self.logged_s)) / np.maximum(drawn @ np.array(self.rolled_s), 1e-9)
        slower = dict(zip(self.executions, self.slowness, strict=True))
        operators = np.array([slower.get(name, 1.0) for name in tracks.executions])
        weights = resampled(tracks.executions, seed, together=together)
        return np.asarray(ratio / self.factor / (weights @ operators))


def log_level(
    executions: Sequence[str], logged_s: Vector, rolled_s: Floats, operators: Sequence[str]
) -> LogLevel | None:
    """Return the level of the logs; None if no rollout ended.

    Args:
        executions: Names of E logged executions.
        logged_s: Their durations, shape (E,), s.
        rolled_s: Durations of their orders with each of K operator tracks, shape (E, K), s; NaN if not simulated.
        operators: Execution of each of the K tracks.
    """
    known = np.isfinite(rolled_s)
    some = np.flatnonzero(known.any(axis=1))
    if not len(some):
        return None
    usual = np.where(known, rolled_s, 0.0).sum(axis=1)[some] / known.sum(axis=1)[some]
    relative = np.where(known, rolled_s, np.nan)[some] / usual[:, None]
    whose = np.array(operators)
    slowness = [float(np.nanmean(relative[:, whose == executions[e]])) if executions[e] in operators else 1.0
                for e in some.tolist()]  # fmt: skip
    names = tuple(executions[e] for e in some.tolist())
    return LogLevel(names, tuple(logged_s[some].tolist()), tuple(usual.tolist()), tuple(slowness))
