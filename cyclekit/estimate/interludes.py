"""What interludes of the logs (picks done again, tool changes) add to an order that has none of them.

The rollout does not draw them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.estimate.finding import Finding
from cyclekit.estimate.statistics.resample import Z95
from cyclekit.learning.interludes import AGAIN, find_interludes
from cyclekit.text.numbers import signed_percent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards.task_model import InterludeCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.result import CycleEstimate


def robot_interludes(dataset: Dataset) -> list[InterludeCard]:
    """Return the interludes of the robot in whole executions."""
    whole = [one.execution for one in dataset.card.executions if one.whole and not one.reference]
    tasks = dataset.tasks().filter(pl.col("execution").is_in(whole)).sort("execution", "index")
    wait = pl.col("wait_s").fill_null(0.0)
    took = (pl.col("end_s") - pl.col("start_s") - wait).alias("took_s")
    every = tasks.select("execution", "goal_place", took, wait).partition_by("execution", maintain_order=True)
    return find_interludes("robot", (one.select("goal_place", "took_s", "wait_s").rows() for one in every))


def robot_order(entry: CycleEstimate) -> dict[str, Sequence[str]]:
    """Return the places that the robot drives to in an estimate, by the robot's name."""
    asked = [task.name.rpartition("->")[2] for task in entry.asked if task.agent == "robot"]
    return {"robot": asked if entry.asked else entry.places[1:]}


def most_s(one: InterludeCard) -> float:
    """Return by how much an interlude makes the way to a task longer at most, s: its count is one of chance."""
    return (one.times + Z95 * math.sqrt(one.times)) / one.visits * one.took_s


def with_interludes(
    entry: CycleEstimate, interludes: Sequence[InterludeCard], orders: Mapping[str, Sequence[str]]
) -> CycleEstimate:
    """Return an estimate whose intervals cover the interludes that its order lacks, with a finding on each.

    Args:
        entry: The estimate.
        interludes: Those of the logs.
        orders: Tasks or places of the asked order, by agent.
    """
    more_s, findings = 0.0, []
    for one in interludes:
        order = list(orders.get(one.agent, ()))
        again = one.before == (one.task,)
        asked = (one.task, one.task) in pairwise(order) if again else one.task in order
        ways = sum(order.count(task) for task in one.before)
        part_s = ways * one.times / one.visits * one.took_s
        if not asked and part_s > 0.0:
            text = (
                f"the logs repeat `{one.task}` {one.times} times in {one.visits} visits"
                if again
                else f"the logs have `{one.task}` {one.times} times before {one.visits} tasks such as `{one.before[0]}`"
            )
            if one.task.endswith(AGAIN):
                text = f"rework: {one.times} of {one.visits} executions do {one.task}"
            told = f"{text}; this order has none: {signed_percent(part_s / entry.expected_s, 1)}"
            findings.append(Finding("interludes", "amber", told))
            more_s += ways * most_s(one)
    if not findings:
        return entry
    return replace(
        entry,
        expected_high_s=entry.expected_high_s + more_s,
        distribution=entry.distribution and entry.distribution.shifted(0.0, more_s),
        findings=(*findings, *entry.findings),
    )
