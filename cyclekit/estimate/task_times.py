"""Cycle times of plans for robot and operator from learned task times, without positions or a safety function."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri, stdtrit

from cyclekit.errors import CyclekitError, EstimateError
from cyclekit.estimate.interludes import with_interludes
from cyclekit.estimate.result import OWN_TASK, CycleEstimate, PlannedShare, TaskShare
from cyclekit.estimate.statistics.conformal import conformal, with_expected
from cyclekit.estimate.statistics.distribution import CycleDistribution
from cyclekit.estimate.statistics.resample import RESAMPLES, Z95
from cyclekit.estimate.statistics.same_work import by_work
from cyclekit.estimate.task_doubts import findings_of_plan, never_in_a_row, planned_starts_not_kept
from cyclekit.learning.task_times.prepared import agent_of
from cyclekit.learning.task_times.roll import BY_PART, BY_PLAN, OWN, SimulatedPlan, roll_plan
from cyclekit.learning.task_times.runs import FAILED
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.config.sequences import PlannedTask, TaskSequence
    from cyclekit.dataset.cards.task_model import HeldOutCard, TaskModelCard
    from cyclekit.schema import Progress, Vector

CYCLES, FEW_CYCLES = 2000, 500
"""Number of cycles rolled out per plan, and at a slower pace to see what that changes."""
SURE_BIAS = 3.0
"""Minimum bias on held-out orders that is corrected, in standard errors: orders are few, and some errors large."""
WHY = "tasks of both agents rolled out side by side from logged task lists"
NOT_KNOWN = "task lists hold no positions: nothing is known of zones, distances or what the safety system did"
AT_MEAN_PACE = "at the mean pace of the logged executions {s} s: compare past executions with that"
LOG_IT = "Log executions with it and train again, or leave it out."


def estimate_plans(
    model: TaskModelCard,
    sequences: Sequence[TaskSequence],
    *,
    quantiles: Sequence[float] = (0.05, 0.5, 0.95),
    takt_s: float | None = None,
    seed: int = 0,
    refused: Callable[[TaskSequence, EstimateError], None],
    progress: Progress | None = None,
) -> list[CycleEstimate]:
    """Return the expected cycle time of each plan, grouped by work, shortest first.

    Args:
        model: Task times learned from task lists.
        sequences: Plans for both agents.
        quantiles: Levels in (0, 1) of single cycles.
        takt_s: Takt time, s: also estimate the probability that a cycle takes no longer.
        seed: Seed of the draws.
        refused: Called with each plan that has no answer, and the reason.
        progress: Called with the fraction done.
    """
    found = []
    for number, sequence in enumerate(sequences):
        try:
            entry = _estimated(model, sequence, quantiles, takt_s, seed)
            found.append(with_interludes(entry, model.interludes, _orders(model, sequence)))
        except EstimateError as error:
            refused(sequence, error)
        except CyclekitError as error:
            cure = " ".join(each for each in (error.cure, LOG_IT) if each)
            refused(sequence, EstimateError(error.seen, nearest=error.nearest, cure=cure))
        if progress:
            progress((number + 1) / len(sequences), sequence.name)
    groups = (sorted(some, key=lambda each: each.expected_s) for some in by_work(found).values())
    return [each for some in groups for each in _compared(some)]


def _orders(model: TaskModelCard, sequence: TaskSequence) -> dict[str, list[str]]:
    """Return the tasks of each agent in a plan."""
    found: dict[str, list[str]] = {}
    for task in sequence.plan:
        found.setdefault(agent_of(model, task, sequence.shown), []).append(task.name)
    return found


def _estimated(
    model: TaskModelCard, sequence: TaskSequence, quantiles: Sequence[float], takt_s: float | None, seed: int
) -> CycleEstimate:
    if not sequence.plan:
        msg = f"{sequence.shown}: names places, and this model knows the tasks of task lists"
        raise EstimateError(msg, cure="Name the tasks of both agents: [[sequence.task]] agent = ..., name = ...")
    rolled = roll_plan(model, sequence.plan, cycles=CYCLES, seed=seed, where=sequence.shown)
    judged = model.held_out
    durations = rolled.duration_s
    of_pace, at_mean_pace = _paces(model, sequence, seed)
    expected, low, high = _mean(durations, judged, model.executions, of_pace)
    corrected = expected / float(durations.mean())
    durations = durations * corrected
    single = _single(durations, judged, of_pace)
    shares, planned = _shares(model, rolled, sequence, corrected, quantiles, of_pace)
    robot = _last_robot(model, rolled, sequence)
    mine = [share for share, task in zip(shares, planned, strict=True) if task.agent == robot]
    parts = ("nominal_s", "safety_loss_s", "wait_s")
    nominal, beside, waited = (sum(getattr(share, part) for share in mine) for part in parts)
    errors = ndtri((np.arange(RESAMPLES) + 0.5) / RESAMPLES) * (high - low) / (2 * Z95 * expected)
    return CycleEstimate(
        name=sequence.name,
        places=sequence.places,
        expected_s=expected,
        expected_low_s=low,
        expected_high_s=high,
        distribution=CycleDistribution(single, errors=errors, executions=model.executions),
        levels=tuple(quantiles),
        nominal_s=nominal,
        safety_loss_s=beside,
        dwell_s=0.0,
        wait_s=waited,
        support=float("nan"),
        tracks=0,
        findings=findings_of_plan(model, sequence),
        limits=(
            NOT_KNOWN,
            *model.notices,
            *([AT_MEAN_PACE.format(s=fixed(at_mean_pace * expected, 1))] if model.pace else []),
            *_left_out(model),
            *never_in_a_row(model, sequence),
            *planned_starts_not_kept(model, sequence),
        ),
        tasks=shares,
        safety_by_activity_s={},
        durations_s=tuple(single.tolist()),
        estimator="task times",
        why=WHY,
        executions=model.executions,
        calibrated=judged is not None,
        takt_s=takt_s,
        plan=planned,
        asked=sequence.plan,
        pace=tuple(model.pace.values()),
        mean_pace_s=at_mean_pace * expected if model.pace else None,
        idle_s=max(expected - nominal - beside - waited, 0.0),
    )


def _left_out(model: TaskModelCard) -> list[str]:
    without = "times are those of cycles without failures"
    found = []
    if model.failed:
        found.append(f"{model.failed} logged executions with a failed task are left out: {without}")
    if any(card.task.endswith(FAILED) for card in model.tasks):
        found.append(f"most logged executions have a failed task; failed attempts are tasks of their own: {without}")
    if model.at_once:
        many = f"{model.at_once} logged executions in which an agent does two tasks at once are left out"
        found.append(f"{many}: two executions may have one name")
    return found


def _last_robot(model: TaskModelCard, rolled: SimulatedPlan, sequence: TaskSequence) -> str | None:
    """Return the name in the plan of the robot that ends last: only one robot's times add up to the cycle."""
    ends = rolled.end_s.mean(axis=0)
    robots = {task.agent: end for task, end in zip(rolled.tasks, ends, strict=True) if _is_robot(model, task, sequence)}
    return max(robots, key=lambda name: robots[name], default=None)


def _is_robot(model: TaskModelCard, task: PlannedTask, sequence: TaskSequence) -> bool:
    return model.agents[agent_of(model, task, sequence.shown)] == "robot"


def _paces(model: TaskModelCard, sequence: TaskSequence, seed: int) -> tuple[float, float]:
    """Return the standard error of a plan's duration because the latest pace is uncertain, as a share.

    Also return its duration at the mean pace of the logged executions, relative to that at the latest pace.
    """
    if not model.pace:
        return 0.0, 1.0
    uncertain = {agent: float(np.exp(pace.error)) for agent, pace in model.pace.items()}
    logged = {
        agent: float(pace.factor(np.arange(pace.first, pace.last + 1)).mean()) for agent, pace in model.pace.items()
    }
    usual, slower, mean = (
        roll_plan(model, sequence.plan, cycles=FEW_CYCLES, seed=seed, where=sequence.shown, pace=pace).duration_s.mean()
        for pace in ({}, uncertain, logged)
    )
    return abs(float(slower / usual) - 1.0), float(mean / usual)


def _mean(
    durations: Vector, judged: HeldOutCard | None, executions: int, pace_error: float
) -> tuple[float, float, float]:
    """Return the expected duration and its 95 % interval, s.

    A significant bias on held-out orders is corrected. The interval covers the remaining error on held-out orders, the
    standard error of the bias, the error of finite logs, and that of the latest pace.
    """
    mean = float(durations.mean())
    if judged is None:
        chance = float(np.hypot(durations.std(ddof=1) / mean / np.sqrt(executions), pace_error))
        return mean, mean * (1 - Z95 * chance), mean * (1 + Z95 * chance)
    bias = _bias(judged)
    mean /= 1.0 + bias
    rest = max(judged.order_error**2 - bias**2, 0.0)
    error = float(np.sqrt(rest + judged.within**2 + judged.learning_error**2 + pace_error**2))
    return mean, mean * (1 - Z95 * error), mean * (1 + Z95 * error)


def _bias(judged: HeldOutCard) -> float:
    """Return the bias on held-out orders; 0 if it is not significant."""
    return judged.bias if abs(judged.bias) > SURE_BIAS * judged.within else 0.0


def _single(durations: Vector, judged: HeldOutCard | None, pace_error: float) -> Vector:
    """Return single cycles with quantiles calibrated on held-out executions, shape (cycles,), s.

    Their mean is that of `durations`: a bias on held-out orders is corrected there, or is not significant. Held-out
    executions were estimated at the pace of their time, so the error of the latest pace is added to their deviations.
    """
    mean, sd = float(durations.mean()), float(durations.std(ddof=1))
    if judged is None or len(judged.deviations) < len(LEVELS):
        off = widening(judged) * (durations - mean)
    else:
        deviations = with_expected(np.array(judged.deviations), (durations - mean) / sd if sd else np.zeros(1))
        spread = np.array([conformal(deviations, level) for level in LEVELS])
        off = sd * np.interp(np.linspace(0.0, 1.0, len(durations)), LEVELS, spread)
        off = off - off.mean()
    own = float(off.std())
    return np.asarray(mean + off * (float(np.hypot(1.0, pace_error * mean / own)) if own else 1.0))


def widening(judged: HeldOutCard | None) -> float:
    """Return the factor on the spread of single cycles where held-out executions are too few for their quantiles.

    It is their root mean square deviation, in standard deviations of the rollout, widened as Student's t for the few
    orders; at least 1.
    """
    if judged is None or judged.orders < MIN_ORDERS:
        return 1.0
    few = float(stdtrit(judged.orders - 1, 0.95) / ndtri(0.95))
    return max(few * float(np.sqrt(np.mean(np.square(judged.deviations)))), 1.0)


LEVELS = np.linspace(0.0, 1.0, 41)
MIN_ORDERS = 3
"""Minimum number of held-out orders to widen the spread of single cycles."""


def _shares(
    model: TaskModelCard,
    rolled: SimulatedPlan,
    sequence: TaskSequence,
    corrected: float,
    quantiles: Sequence[float],
    pace_error: float,
) -> tuple[tuple[TaskShare, ...], tuple[PlannedShare, ...]]:
    """Return for each task the split of its time, and its start, its end and what decided its start.

    `corrected` is the factor that corrects the bias on held-out orders; with it the parts add up to the cycle time.
    """
    began = rolled.start_s.min(axis=1)[:, None]
    start, end = (corrected * (at - began).mean(axis=0) for at in (rolled.start_s, rolled.end_s))
    took, wait = end - start, corrected * rolled.wait_s.mean(axis=0)
    usual = corrected * rolled.mean_s
    shares, planned = [], []
    for number, task in enumerate(rolled.tasks):
        shares.append(
            TaskShare(
                task.shown,
                float(took[number] + wait[number]),
                float(usual[number]),
                float(took[number] - usual[number]),
                0.0,
                float(wait[number]),
            )
        )
        kind = "robot" if _is_robot(model, task, sequence) else "operator"
        decided = _decided(rolled, number)
        at = float(start[number]), float(end[number]), float(wait[number])
        ends_s = corrected * (rolled.end_s[:, number] - began[:, 0])
        single = CycleDistribution(_single(ends_s, model.held_out, pace_error))
        band = [single.quantile(level) for level in (min(quantiles), max(quantiles))] if len(quantiles) > 1 else ()
        planned.append(PlannedShare(task.agent, kind, task.name, *at, decided, *band))
    return tuple(shares), tuple(planned)


def _decided(rolled: SimulatedPlan, number: int) -> dict[str, float]:
    """Return the share of the cycles in which each cause decided the start of a task."""
    names = {BY_PART: "a part", BY_PLAN: "planned start", OWN: OWN_TASK}
    which, count = np.unique(rolled.decides[:, number], return_counts=True)
    told = zip(which.tolist(), (count / len(rolled.decides)).tolist(), strict=True)
    return {names.get(key) or rolled.tasks[key].shown: part for key, part in told}


def _compared(some: Sequence[CycleEstimate]) -> list[CycleEstimate]:
    """Return estimates of the same work with the probabilities that the mean of one is below that of another."""
    from scipy.special import ndtr

    error = {each.name: (each.expected_high_s - each.expected_low_s) / (2 * Z95) for each in some}
    found = []
    for each in some:
        others = {
            other.name: float(
                ndtr((other.expected_s - each.expected_s) / np.hypot(error[each.name], error[other.name]))
            )
            for other in some
            if other.name != each.name
        }
        found.append(replace(each, beats=others))
    return found
