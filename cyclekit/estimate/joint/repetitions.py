"""In how many logged executions the parts of a cycle occur: fewer than there are, where orders differ.

A rollout draws each part of a cycle, such as a task of the robot or a walk of the operator, from its repetitions in
the logs. The mean of a part that occurs in a third of the executions is as uncertain as with a third of them.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl
from scipy.special import stdtrit

from cyclekit.estimate.statistics.resample import Z95

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.estimate.joint.roll import JointCell

MIN_REPETITIONS = 3
"""Minimum number of repetitions of a part to estimate its variance; below it, that of the other parts of its kind."""


class RepeatedPart(NamedTuple):
    """A part of cycles.

    Attributes:
        kind: `task` of the robot; `work` or `walk` of the operator.
        times: How often it was logged.
        executions: In how many executions.
        variance: Variance of its duration without waits, s2.
    """

    kind: str
    times: int
    executions: int
    variance: float


def repetitions(cell: JointCell) -> int:
    """Return the mean number of executions in which a part of a cycle was logged, weighted by its variance."""
    parts = _usual_variance([*_tasks(cell), *_work(cell), *_walks(cell)])
    weight = np.array([part.variance * part.times / part.executions for part in parts])
    if not weight.sum() > 0.0:
        return cell.executions
    mean = float(weight @ np.array([part.executions for part in parts]) / weight.sum())
    return min(max(round(mean), 2), cell.executions)


def cycles_per_resample(cell: JointCell) -> int:
    """Return how many cycles a resample draws: the 95 % interval of the mean is then Student's of `repetitions`."""
    count = repetitions(cell)
    return max(round(count * (Z95 / float(stdtrit(count - 1, 0.975))) ** 2), 2)


def _usual_variance(parts: Sequence[RepeatedPart]) -> list[RepeatedPart]:
    """Return the parts, those with few repetitions with the mean variance of the others of their kind."""
    usual: dict[str, list[float]] = defaultdict(list)
    for part in parts:
        if part.times >= MIN_REPETITIONS:
            usual[part.kind].append(part.variance)
    means = {kind: float(np.mean(some)) for kind, some in usual.items()}
    return [
        part if part.times >= MIN_REPETITIONS else part._replace(variance=means.get(part.kind, 0.0)) for part in parts
    ]


def _tasks(cell: JointCell) -> Iterator[RepeatedPart]:
    took = (pl.col("end_s") - pl.col("start_s") - pl.col("wait_s").fill_null(0.0)).var()
    mine = cell.dataset.tasks().filter(pl.col("execution").is_in(list(cell.logged)))
    found = mine.group_by("task", maintain_order=True).agg(pl.len(), pl.col("execution").n_unique(), took.alias("took"))
    for _, times, executions, variance in found.iter_rows():
        yield RepeatedPart("task", times, executions, variance or 0.0)


def _work(cell: JointCell) -> Iterator[RepeatedPart]:
    waits = cell.gates.waits("operator")
    for place, names in _occurrences(cell, 1).items():
        own_s = cell.gates.own_s("operator", *place) if waits else None
        own_s = cell.work_s.get(place[0], np.zeros(1)) if own_s is None else own_s
        yield RepeatedPart("work", len(names), len(set(names)), float(np.var(own_s)))


def _walks(cell: JointCell) -> Iterator[RepeatedPart]:
    for (start, goal), names in _occurrences(cell, 2).items():
        if start != goal:
            took_s = cell.segments.durations_s(cell.segments.walk(start, goal))
            yield RepeatedPart("walk", len(names), len(set(names)), float(np.var(took_s)))


def _occurrences(cell: JointCell, count: int) -> dict[tuple[str, ...], list[str]]:
    """Return the execution of each occurrence of places (count = 1), or pairs of places, in the operator's orders."""
    found: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for name, visits in cell.logged.items():
        places = [visit.place for visit in visits]
        for some in pairwise(places) if count == 2 else ((place,) for place in places):
            found[some].append(name)
    return found
