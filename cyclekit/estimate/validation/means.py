"""The mean of a sequence's cycles, corrected by the validation and combined with logged task durations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.estimate.robot.safety import OnStates
from cyclekit.estimate.statistics.resample import RESAMPLES, TOGETHER, interval_of_mean, resampled_alike
from cyclekit.estimate.validation.history import Combined, TaskTimes, history_share
from cyclekit.estimate.validation.order_effect import SHARE, order_effect
from cyclekit.estimate.validation.visit_effect import SHARE as OF_VISITS
from cyclekit.estimate.validation.visit_effect import visit_effect

if TYPE_CHECKING:
    from cyclekit.config.sequences import TaskSequence
    from cyclekit.estimate.cycle.walk import Rolled
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.validation.check import Check
    from cyclekit.estimate.validation.order_effect import OrderEffect
    from cyclekit.estimate.validation.question import Question
    from cyclekit.estimate.validation.visit_effect import VisitEffect
    from cyclekit.schema import Floats, Vector


@dataclass(frozen=True)
class History:
    """Logged task durations, and the weight of each execution in each resample, shape (resamples, executions)."""

    times: TaskTimes
    weights: Floats


class BesideRollout(NamedTuple):
    """What the logs of all operators tell beside the rollout; each None where it does not apply.

    Attributes:
        history: Logged durations of tasks.
        effect: Result of `order_effect_for`.
        visits: Result of `visit_effect_for`.
    """

    history: History | None
    effect: OrderEffect | None
    visits: VisitEffect | None


@dataclass(frozen=True)
class Means:
    """The mean of K cycles.

    Attributes:
        factor: Factor on every cycle of the rollout.
        resampled_s: The mean in each resample of the logs, shape (resamples,), s.
        error: Standard deviation that resampling does not show, as a share of the mean.
        judged: Number of executions from which `error` is known.
        combined: The two numbers whose weighted mean it is; None if it is the rollout alone.
    """

    factor: float
    resampled_s: Vector
    error: float
    judged: int
    combined: Combined | None = None

    def interval(self, *, bias_s: float, seed: int) -> tuple[float, float]:
        """Return the 95 % interval of the mean, s; `bias_s` as in `interval_of_mean`."""
        return interval_of_mean(self.resampled_s, model_error=self.error, judged=self.judged, bias_s=bias_s, seed=seed)


def history_of(ask: Question, tracks: OperatorTracks | None) -> History | None:
    """Return logged task durations and their resamples; None if they do not apply to the question.

    A rollout with the level of the logs (`log_level`) is not combined with them. Both then have the mean of the same
    logged executions, and differ by the scatter of rarely logged tasks. Resamples cannot show which is better: a weight
    from them costs more than it gains, as often with weights that are estimated (Smith and Wallis, A simple explanation
    of the forecast combination puzzle, Oxford Bulletin of Economics and Statistics 71, 2009).
    """
    if tracks is None or ask.estimator != "rollout" or ask.altered is not None:
        return None
    if ask.check is None or ask.check.order_error is None:
        return None
    times = TaskTimes(ask.dataset)
    together = TOGETHER if tracks.runs_on else 1
    return History(times, resampled_alike(tracks.executions, times.executions, ask.seed, together=together))


def level_of(ask: Question, tracks: OperatorTracks | None) -> Vector | None:
    """Return the factor of the level of the logs in each resample, relative to its value; None without one."""
    level = ask.check.level if ask.check else None
    return None if level is None or tracks is None else level.resampled(tracks, ask.seed)


def order_effect_for(ask: Question) -> OrderEffect | None:
    """Return the effect of the tasks before each task, if no log shows people and the logs show such an effect."""
    if ask.altered is not None or ask.check is None or ask.check.level is None:
        return None
    return order_effect(ask.dataset)


def visit_effect_for(ask: Question) -> VisitEffect | None:
    """Return the effect of visits that follow a place, if signals show people and the logs show such visits."""
    if ask.altered is not None or ask.check is None or ask.check.level is not None:
        return None
    if not isinstance(ask.model, OnStates) or not ask.model.card.operator_signals:
        return None
    return visit_effect(ask.dataset)


def means_of(
    ask: Question,
    sequence: TaskSequence,
    cycles: Rolled,
    weights: Floats,
    level: Vector | None = None,
    others: BesideRollout | None = None,
) -> Means:
    """Return the mean of the cycles of one sequence, with its allowance.

    Args:
        ask: The question.
        sequence: The sequence.
        cycles: K cycles of it, as simulated.
        weights: Weights of the cycles in each resample of the logs, shape (resamples, K).
        level: Result of `level_of`, shape (resamples,).
        others: What may be weighed in; None if nothing applies to this sequence.
    """
    found, by = _mean_of(ask, sequence, cycles, weights, level, others), sequence.allowance
    return found if by == 1.0 else replace(found, factor=found.factor * by, resampled_s=found.resampled_s * by)


def _mean_of(
    ask: Question,
    sequence: TaskSequence,
    cycles: Rolled,
    weights: Floats,
    level: Vector | None,
    others: BesideRollout | None,
) -> Means:
    check = ask.check
    resampled_s = cycles.resampled_means(weights)
    if check is None:
        return Means(1.0, resampled_s, 0.0, 2)
    if level is not None:
        resampled_s = resampled_s * level
    factor = check.factor * (ask.altered.moved.get(sequence.name, 1.0) if ask.altered else 1.0)
    alone = Means(factor, resampled_s * factor, check.model_error, len(check.residuals))
    if others is None:
        return alone
    history, effect, visits = others
    if effect is not None and effect.covers(sequence.tasks):
        return _by_order(alone, float(cycles.duration_s.mean()) * factor, sequence, effect)
    if visits is not None:
        return _by_visits(alone, cycles, factor, sequence, visits)
    if history is None or check.order_error is None or not history.times.knows(sequence.tasks):
        return alone
    return _combined(alone, float(cycles.duration_s.mean()) * factor, sequence, history, check)


def _by_order(alone: Means, rollout_s: float, sequence: TaskSequence, effect: OrderEffect) -> Means:
    """Return the mean of the rollout `alone`, whose mean is `rollout_s`, and of the tasks after those before them."""
    both = Combined(rollout_s, effect.expected_s(sequence.tasks), SHARE, by_order=True)
    other = both.history_s / rollout_s * effect.uncertain(sequence.tasks)
    resampled_s = alone.resampled_s * (1.0 - SHARE + SHARE * other)
    return Means(alone.factor * both.expected_s / rollout_s, resampled_s, alone.error, alone.judged, both)


def _by_visits(alone: Means, cycles: Rolled, factor: float, sequence: TaskSequence, visits: VisitEffect) -> Means:
    """Return the mean of the rollout `alone` and of one with visits that follow a place."""
    usual_s, places = float(cycles.duration_s.mean()), sequence.places[1:]
    free_s, rollout_s = usual_s - float(cycles.safety_s.sum(axis=1).mean()), usual_s * factor
    lost_s = max(rollout_s - free_s, 0.0)
    others_s = rollout_s + (visits.factor(places, free_s) - 1.0) * lost_s
    both = Combined(rollout_s, others_s, OF_VISITS, visits_after=visits.place)
    draws = (visits.uncertain(places, free_s, RESAMPLES) - 1.0) * lost_s / rollout_s
    resampled_s = alone.resampled_s * (1.0 + OF_VISITS * draws)
    return Means(alone.factor * both.expected_s / rollout_s, resampled_s, alone.error, alone.judged, both)


def _combined(alone: Means, rollout_s: float, sequence: TaskSequence, history: History, check: Check) -> Means:
    """Return the weighted mean of the rollout `alone`, whose mean is `rollout_s`, and history."""
    history_s = history.times.sum_s(sequence.tasks)
    resampled_s = history.times.resampled_s(sequence.tasks, history.weights)
    order = (check.order_error or 0.0) / np.sqrt(len(sequence.tasks))
    apart = history_s / rollout_s - 1.0  # effect of this order, if the rollout is right
    share = history_share(
        alone.resampled_s / alone.resampled_s.mean(),
        resampled_s / resampled_s.mean(),
        model_error=check.network_error,
        order_error=float(np.hypot(order, apart)),
    )
    both = Combined(rollout_s, history_s, share)
    mean_s = (1.0 - share) * alone.resampled_s + share * resampled_s
    error = float(np.hypot((1.0 - share) * check.network_error, share * order))
    return Means(alone.factor * both.expected_s / rollout_s, mean_s, error, alone.judged, both)
