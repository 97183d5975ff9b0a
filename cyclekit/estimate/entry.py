"""The cycles of one sequence as a `CycleEstimate`: mean, quantiles, takt, and where the time goes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.cycle.estimators import ESTIMATORS
from cyclekit.estimate.result import AWAY, ELSEWHERE, PARTS, CycleEstimate, TaskShare
from cyclekit.estimate.robot.safety import OnStates
from cyclekit.estimate.soundness import MIN_SUPPORT
from cyclekit.estimate.statistics.distribution import CycleDistribution
from cyclekit.estimate.statistics.resample import drawn_errors
from cyclekit.text.numbers import fixed, percent

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.estimate.cycle.walk import Rolled
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.robot.program import Program
    from cyclekit.estimate.validation.history import Combined
    from cyclekit.estimate.validation.means import Means
    from cyclekit.estimate.validation.question import Question
    from cyclekit.schema import Floats

TOLD = 0.005
"""Minimum weight of logged task durations that the text mentions."""


def entry_of(
    ask: Question,
    sequence: TaskSequence,
    program: Program,
    cycles: Rolled,
    tracks: OperatorTracks | None,
    weights: Floats,
    means: Means,
) -> CycleEstimate:
    """Return the estimate from the cycles of one sequence.

    Args:
        ask: The question.
        sequence: The sequence.
        program: Its program.
        cycles: K cycles of it.
        tracks: The operator tracks of the cycles; None without any.
        weights: Weights of the cycles in each resample of the logs, shape (resamples, K).
        means: Their corrected mean.
    """
    check = ask.check
    cycles, slower = _corrected(cycles, means.factor)
    durations = cycles.duration_s
    split = zip(_shares(program, cycles), _ends(ask, program, cycles), strict=True)
    shares = tuple(replace(share, end_low_s=first, end_high_s=last) for share, (first, last) in split)
    expected = float(durations.mean())
    bias = check.doubted_bias if check else 0.0
    low, high = means.interval(bias_s=bias * expected, seed=ask.seed)
    less_s, more_s = (part * expected for part in cycles.beyond)
    activities = [*tracks.activities, "unknown"] if tracks else []
    by_activity = zip(activities, (cycles.by_activity_s * slower).tolist(), strict=False)
    logged = len(set(tracks.executions if tracks else ask.dataset.executions["execution"]))
    single = CycleDistribution(
        check.single(durations) if check else durations,
        weights,
        drawn_errors(means.error, means.judged, ask.seed, count=len(weights)),
        bias,
        executions=logged,
    ).shifted(less_s, more_s)
    return CycleEstimate(
        name=sequence.name,
        places=sequence.places,
        expected_s=expected,
        expected_low_s=low + less_s,
        expected_high_s=high + more_s,
        distribution=single,
        levels=ask.quantiles,
        nominal_s=sum(share.nominal_s for share in shares),
        safety_loss_s=sum(share.safety_loss_s for share in shares),
        dwell_s=sum(share.dwell_s for share in shares),
        wait_s=sum(share.wait_s for share in shares),
        support=cycles.support,
        tracks=len(durations) if tracks else 0,
        limits=(),
        tasks=shares,
        safety_by_activity_s={name: lost for name, lost in by_activity if lost > 0.0},
        durations_s=tuple(durations.tolist()),
        estimator=ask.estimator,
        why=_why(ask, means.combined),
        executions=logged,
        calibrated=check is not None and check.coverage is not None,
        takt_s=ask.takt_s,
        extrapolated=cycles.support < MIN_SUPPORT,
        operator=sequence.operator,
        check=check,
        combined=means.combined,
        operator_at=operator_at(tracks, expected) if tracks else {},
        allowance=sequence.allowance,
    )


def operator_at(tracks: OperatorTracks, cycle_s: float) -> dict[str, tuple[float, ...]]:
    """Return the share of tracks with the operator at each of his tasks, in PARTS equal parts of a cycle."""
    middle_s = (np.arange(PARTS) + 0.5) / PARTS * cycle_s
    sample = np.minimum((middle_s / tracks.step_s).astype(np.int64), tracks.activity.shape[1] - 1)
    doing = tracks.activity[:, sample]
    names = [*tracks.activities, ELSEWHERE, AWAY]
    doing = np.where(doing < 0, len(tracks.activities), doing)
    if tracks.state is None:
        doing = np.where(np.isnan(tracks.xyz_m[:, sample, 0]), len(names) - 1, doing)
    parts = ((name, (doing == number).mean(axis=0)) for number, name in enumerate(names))
    return {name: tuple(np.round(part, 4).tolist()) for name, part in parts if part.any()}


def _ends(ask: Question, program: Program, cycles: Rolled) -> list[tuple[float, float] | tuple[None, None]]:
    """Return the interval in which each task ends in single cycles, s, for the lowest and highest quantile level."""
    if not cycles.simulated or len(cycles.duration_s) < 2 or len(ask.quantiles) < 2:
        return [(None, None)] * len(program.tasks)
    motion = np.array([task.nominal_s for task in program.tasks])
    ends = np.cumsum(motion + cycles.safety_s + cycles.standstill_s, axis=1)
    ends *= (cycles.duration_s / ends[:, -1])[:, None]
    low, high = min(ask.quantiles), max(ask.quantiles)
    single = [CycleDistribution(ask.check.single(end) if ask.check else end) for end in ends.T]
    return [(end.quantile(low), end.quantile(high)) for end in single]


def _why(ask: Question, combined: Combined | None) -> str:
    model = ask.model if ask.estimator == "rollout" else None
    why = model.why if isinstance(model, OnStates) else ESTIMATORS[ask.estimator].why
    if combined is None or combined.history_share < TOLD:
        return why
    if combined.visits_after is not None:
        return (
            f"{why} ({fixed(combined.rollout_s, 1)} s), weighted {percent(combined.history_share)} with the "
            "visits of people that "
            f"follow {ask.dataset.label(combined.visits_after)} ({fixed(combined.history_s, 1)} s)"
        )
    durations = "the logged durations of the same tasks"
    if combined.by_order:
        durations += " after the places before them"
    return (
        f"{why} ({fixed(combined.rollout_s, 1)} s), weighted {percent(combined.history_share)} with {durations} "
        f"({fixed(combined.history_s, 1)} s)"
    )


def _corrected(cycles: Rolled, factor: float) -> tuple[Rolled, float]:
    """Return the cycles with durations times `factor`, and the factor on the safety loss, which absorbs the change."""
    if factor == 1.0:
        return cycles, 1.0
    lost = float(cycles.safety_s.mean(axis=0).sum())
    more = (factor - 1) * float(cycles.duration_s.mean())
    slower = max(1 + more / lost, 0.0) if lost > 0 else 1.0
    return replace(cycles, duration_s=cycles.duration_s * factor, safety_s=cycles.safety_s * slower), slower


def _shares(program: Program, cycles: Rolled) -> Iterator[TaskShare]:
    """Yield the mean time of each task, split; what the time steps leave over is divided among the standstills."""
    safety, stands = cycles.safety_s.mean(axis=0), cycles.standstill_s.mean(axis=0)
    motion = sum(task.nominal_s for task in program.tasks) + float(safety.sum())
    stands *= (float(cycles.duration_s.mean()) - motion) / float(stands.sum())
    for task, lost, stand in zip(program.tasks, safety.tolist(), stands.tolist(), strict=True):
        usual = task.dwell_s + task.wait_s
        dwell, wait = (stand * part / usual for part in (task.dwell_s, task.wait_s)) if usual > 0.0 else (stand, 0.0)
        yield TaskShare(task.task, task.nominal_s + lost + stand, task.nominal_s, lost, dwell, wait)
