"""Limits of an estimate: few operators, unlogged positions, inferred clocks and scaling; a model with a bias.

A model with a large bias on the logs themselves predicts no other sequence; usually it was trained on another cell.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.unknown_height import height_notes
from cyclekit.errors import EstimateError, ModelError
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.robot.nominal import turned_otherwise, usual_slider
from cyclekit.estimate.robot.safety import OnStates
from cyclekit.estimate.robot.work_dwells import MIN_EXECUTIONS, of_kinds, said_of_places
from cyclekit.estimate.soundness import MIN_SUPPORT
from cyclekit.estimate.validation.check import Check, check_rollout
from cyclekit.learning.signal_inputs import left_out
from cyclekit.learning.windows import nobody_there
from cyclekit.text.numbers import fixed, percent, signed_percent

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.cycle.walk import Rolled
    from cyclekit.estimate.joint.roll import RolledBoth
    from cyclekit.estimate.result import CycleEstimate, TaskShare
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.estimate.robot.work_dwells import Group
    from cyclekit.estimate.validation.question import Question


CONTINUED = 0.5
"""Share of the time on continued tracks above which the estimate reports it."""
ENDLESS = "The operator keeps the robot at speed 0 %; check the tracker's frame and clock."
"""Cure for cycles that do not end."""
COARSE = "coarse estimate from the table of arrivals, one of many sequences; support and activities are not known"


def no_answer(
    ask: Question, sequence: TaskSequence, cycles: Rolled | RolledBoth, until_s: float
) -> EstimateError | None:
    """Return why these cycles give no answer: they do not end, or they need extrapolation that was not allowed."""
    open_ended = float(np.mean(~np.isfinite(cycles.duration_s)))
    if open_ended:
        part = percent(open_ended) if open_ended >= 0.01 else percent(open_ended, 1)
        seen = f"{sequence.shown}: {part} of the cycles do not end within {fixed(until_s, 0)} s"
        return EstimateError(seen, cure=ENDLESS)
    if cycles.support < MIN_SUPPORT and not ask.extrapolate:
        seen = f"{sequence.shown}: only {percent(cycles.support)} of it runs through logged positions"
        cure = "Log this part of the cell, or estimate with --extrapolate and mark the number."
        return EstimateError(seen, cure=cure)
    return None


def coarse_of(cycles: Rolled, entry: CycleEstimate) -> list[Finding]:
    """Return a finding if a rollout was looked up in the table of arrivals."""
    looked_up = entry.tracks and entry.estimator == "rollout" and not cycles.simulated
    return [Finding("coarse", "amber", COARSE, "estimate it alone", covered=False)] if looked_up else []


def with_work(entry: CycleEstimate, tasks: Sequence[NominalTask]) -> tuple[CycleEstimate, list[Finding], list[str]]:
    """Return the estimate of these tasks, findings and limits, where standstills depend on the work of the cycle.

    If too few executions of its work were logged, the standstills are those of all works: then the intervals are
    widened to the mean standstills of the works with the shortest and with the longest ones.
    """
    chosen = {task.task: task.by_work for task in tasks if task.group is not None}
    limits = [f"{said}; an order takes those of its own work" for said in said_of_places(chosen)]
    pooled = [task for task in tasks if task.by_work and task.group is None]
    if not pooled:
        return entry, [], limits
    off: dict[Group, float] = defaultdict(float)
    less, more = 0.0, 0.0
    ends: list[tuple[float, float]] = []
    for task in tasks:
        for group, stands in task.by_work.items() if task.group is None else ():
            off[group] += stands.mean_s - task.dwell_s - task.wait_s
        less, more = min(0.0, *off.values()), max(0.0, *off.values())
        ends.append((less, more))
    widened = replace(
        entry,
        expected_low_s=entry.expected_low_s + less,
        expected_high_s=entry.expected_high_s + more,
        distribution=entry.distribution and entry.distribution.shifted(less, more),
        tasks=tuple(map(_wider, entry.tasks, ends)) if len(ends) == len(entry.tasks) else entry.tasks,
    )
    doubts = [
        f"{said}; fewer than {MIN_EXECUTIONS} executions of this order's work were logged, so it takes those of all, "
        "and the intervals cover the others: log executions of this work"
        for said in said_of_places({task.task: task.by_work for task in pooled if not of_kinds(task.by_work)})
    ]
    doubts += [
        f"{said} (another product, or a wait): the number is for all of them together, and the intervals cover each; "
        "log executions of this order"
        for said in said_of_places({task.task: task.by_work for task in pooled if of_kinds(task.by_work)})
    ]
    return widened, [Finding("work", "amber", text) for text in doubts], limits


def _wider(task: TaskShare, by: tuple[float, float]) -> TaskShare:
    if task.end_low_s is None or task.end_high_s is None:
        return task
    return replace(task, end_low_s=task.end_low_s + by[0], end_high_s=task.end_high_s + by[1])


def limits_of_cycles(cycles: Rolled) -> list[str]:
    """Return the other limits of one sequence's number, one sentence each."""
    found = []
    less, more = cycles.beyond
    if round(more - less, 2):
        found.append(
            f"{percent(cycles.spliced)} of the time is after the end of each log, and the interval covers that people "
            "then go on as elsewhere in the logs and that they stay as they are at the ends of logs "
            f"({signed_percent(less)} and {signed_percent(more)}): log executions as long as this order"
        )
    elif cycles.spliced > CONTINUED:
        found.append(
            f"{percent(cycles.spliced)} of the time the operator's track is continued with parts of other "
            "executions that begin in the same state"
        )
    return found


def limits_of_logs(dataset: Dataset, model: SafetyModel, used: Collection[str] | None = None) -> list[str]:
    """Return the limits of every number from these logs, one sentence each.

    Args:
        dataset: Dataset of the logs.
        model: Safety function.
        used: The executions from which the operator is drawn; None: all, those without an operator included.
    """
    found = list(model.limits) if isinstance(model, OnStates) else []
    if model.card.operator_signals or not isinstance(model, OnStates):
        found += left_out(model.card, dataset)
    samples = dataset.samples(columns=["execution", "human_x_m", "human_z_m", "human_gap", "scaling_origin"])
    found += height_notes(samples)
    drawn = samples if used is None else samples.filter(pl.col("execution").is_in(list(used)))
    absent = drawn.filter(nobody_there()).height / max(drawn.height, 1)
    if absent > 0.01 and not isinstance(model, OnStates) and model.card.scaling_without_operator is None:
        found.append(f"in {percent(absent)} of the samples there is no operator: full speed assumed")
    ran = {one.execution for one in dataset.card.executions if one.whole and not one.reference}
    away = samples.group_by("execution").agg(away=(pl.col("human_gap") == "absent").fill_null(value=False).all())
    alone = ran & set(away.filter("away")["execution"].to_list())
    if alone and used is not None:
        found.append(f"in {len(alone)} of {len(ran)} executions no operator was seen: they are not used")
    elif alone:
        counted = (
            f"in {len(alone)} of {len(ran)} executions no operator was seen: they count as cycles without an operator"
        )
        found.append(
            f"{counted} (if the operator was absent on purpose, list the log under reference in the cell file)"
        )
    if samples.filter(pl.col("scaling_origin") == "inferred").height:
        found.append("the speed scaling was not logged but inferred from velocity ratios")
    usual, other = usual_slider(dataset), turned_otherwise(dataset)
    if usual < 1.0 or other:
        said = f"estimates, validation and today's cycle are for the speed slider at {percent(usual)}"
        left = f": it stood elsewhere in {len(other)} executions, which are left out" if other else ", as logged"
        found.append(said + left)
    found += [one.text for one in dataset.card.warnings if one.code == "executions-interrupted"]
    return found


def refuse_unknown_mover(dataset: Dataset) -> None:
    """Refuse logs of a set override that neither people nor a hand is shown to move.

    Raises:
        EstimateError: The logs hold such an override; at full slider the cycle would be too short if people move it.
    """
    for one in dataset.card.warnings:
        if one.code == "override-unknown":
            cure = 'Set set_override = "people", "program" or "hand" in cell.toml and ingest again.'
            raise EstimateError(f"{dataset.path}: {one.text}", cure=cure)


REFUSED_BIAS = 0.1
"""Minimum significant bias on the logged executions at which a model is refused."""


_OWN = (
    "It was trained on them, so it does not see what slows the robot: {look} clocks, frames and unknown causes in "
    "cyclekit inspect DATASET; if the tracker's clock may be off, ingest with --align-clocks logs"
)


def validated(
    model: SafetyModel, dataset: Dataset, *, levels: Sequence[float] = (0.05, 0.5, 0.95), seed: int
) -> tuple[Check | None, str]:
    """Return the validation on logged executions; None, and the reason, if there are too few."""
    try:
        return check_rollout(model, dataset, levels=levels, seed=seed), ""
    except EstimateError as error:
        return None, error.seen


def refuse_biased(check: Check | None, *, own: bool = False) -> None:
    """Refuse a model with a large bias on the logged executions; `own`: it was trained on these logs.

    Raises:
        ModelError: The bias is significant and larger than REFUSED_BIAS.
    """
    if check is not None and check.biased(REFUSED_BIAS):
        seen = (
            f"{signed_percent(check.own_bias, 1)} (± {percent(check.own_within, 1)}) on "
            f"{check.executions} logged executions"
        )
        raise ModelError(
            f"the model does not fit these logs: backtested with their own operators, its bias is {seen}",
            cure=(_OWN.format(look=check.look_at) if own else "Train it on them: cyclekit train DATASET --out MODEL")
            + "; or add --other-cell to estimate anyway (from Python other_cell=True).",
        )
