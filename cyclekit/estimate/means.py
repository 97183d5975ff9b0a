"""The mean of a sequence's cycles, corrected by what logged executions show and combined with what its tasks took."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.history import Combined, TaskTimes, history_share
from cyclekit.estimate.resample import TOGETHER, interval_of_mean, resampled_alike

if TYPE_CHECKING:
    from cyclekit.config.sequences import TaskSequence
    from cyclekit.estimate.check import Check
    from cyclekit.estimate.question import Question
    from cyclekit.estimate.tracks import OperatorTracks
    from cyclekit.estimate.walk import Rolled
    from cyclekit.schema import Floats, Vector


@dataclass(frozen=True)
class History:
    """What tasks took in the logs, and how often each execution is drawn: weights, shape (resamples, executions)."""

    times: TaskTimes
    weights: Floats


@dataclass(frozen=True)
class Means:
    """The mean of K cycles.

    Attributes:
        factor: What every cycle of the rollout is multiplied by.
        resampled_s: The mean in each resample of the logs, shape (resamples,), s.
        error: Standard deviation that no resampling shows, as part of the mean.
        judged: From how many executions that is known.
        combined: What it is made of, where it is made of two.
    """

    factor: float
    resampled_s: Vector
    error: float
    judged: int
    combined: Combined | None = None

    def interval(self, *, bias_s: float, seed: int) -> tuple[float, float]:
        """Return the 95 % interval of the mean, s; `bias_s` as of `interval_of_mean`."""
        return interval_of_mean(self.resampled_s, model_error=self.error, judged=self.judged, bias_s=bias_s, seed=seed)


def history_of(ask: Question, tracks: OperatorTracks | None) -> History | None:
    """Return what tasks took in the logs and in each resample of them; None where it says nothing of what is asked."""
    if tracks is None or ask.estimator != "rollout" or ask.altered is not None:
        return None
    if ask.check is None or ask.check.order_error is None:
        return None
    times = TaskTimes(ask.dataset)
    together = TOGETHER if tracks.runs_on else 1
    return History(times, resampled_alike(tracks.executions, times.executions, ask.seed, together=together))


def means_of(ask: Question, sequence: TaskSequence, cycles: Rolled, weights: Floats, history: History | None) -> Means:
    """Return the mean of the cycles of one sequence.

    Args:
        ask: The question.
        sequence: What was asked for.
        cycles: K cycles of it, as walked.
        weights: Of the cycles in each resample of the logs, shape (resamples, K).
        history: What its tasks took; None where that says nothing.
    """
    check = ask.check
    resampled_s = cycles.resampled_means(weights)
    if check is None:
        return Means(1.0, resampled_s, 0.0, 2)
    factor = check.factor * (ask.altered.moved.get(sequence.name, 1.0) if ask.altered else 1.0)
    alone = Means(factor, resampled_s * factor, check.model_error, len(check.residuals))
    if history is None or check.order_error is None or not history.times.knows(sequence.tasks):
        return alone
    return _combined(alone, float(cycles.duration_s.mean()) * factor, sequence, history, check)


def _combined(alone: Means, rollout_s: float, sequence: TaskSequence, history: History, check: Check) -> Means:
    """Weigh the rollout `alone`, of that mean, with history."""
    history_s = history.times.sum_s(sequence.tasks)
    resampled_s = history.times.resampled_s(sequence.tasks, history.weights)
    order = (check.order_error or 0.0) / np.sqrt(len(sequence.tasks))
    apart = history_s / rollout_s - 1.0  # what the order does here, if the rollout is right
    share = history_share(
        alone.resampled_s / alone.resampled_s.mean(),
        resampled_s / resampled_s.mean(),
        model_error=check.network_error,  # what nobody saw of people is unknown to both alike
        order_error=float(np.hypot(order, apart)),
    )
    both = Combined(rollout_s, history_s, share)
    mean_s = (1.0 - share) * alone.resampled_s + share * resampled_s
    error = float(np.hypot(np.hypot((1.0 - share) * check.network_error, share * order), check.unseen_error))
    return Means(alone.factor * both.expected_s / rollout_s, mean_s, error, alone.judged, both)
