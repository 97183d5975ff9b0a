"""What repeated tasks of the logs add to an order that has none of them; the rollout does not draw them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.estimate.finding import Finding
from cyclekit.learning.repeats import Repeated, find_repeats
from cyclekit.text.numbers import signed_percent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.result import CycleEstimate


def robot_repeats(dataset: Dataset) -> list[Repeated]:
    """Return the places that the robot visits again right after itself, in whole executions."""
    whole = [one.execution for one in dataset.card.executions if one.whole and not one.reference]
    tasks = dataset.tasks().filter(pl.col("execution").is_in(whole)).sort("execution", "index")
    took = pl.col("end_s") - pl.col("start_s") - pl.col("wait_s").fill_null(0.0)
    every = tasks.select("execution", "goal_place", took_s=took).partition_by("execution", maintain_order=True)
    return find_repeats("robot", (one.select("goal_place", "took_s").rows() for one in every))


def robot_order(entry: CycleEstimate) -> dict[str, Sequence[str]]:
    """Return the places that the robot drives to in an estimate, by the robot's name."""
    asked = [task.name.rpartition("->")[2] for task in entry.asked if task.agent == "robot"]
    return {"robot": asked if entry.asked else entry.places[1:]}


def with_repeats(
    entry: CycleEstimate, repeats: Sequence[Repeated], orders: Mapping[str, Sequence[str]]
) -> CycleEstimate:
    """Return an estimate whose intervals cover the repetitions that its order lacks, with a finding on each.

    Args:
        entry: The estimate.
        repeats: What the logs repeat.
        orders: Tasks or places of the asked order, by agent.
    """
    more_s, findings = 0.0, []
    for one in repeats:
        order = list(orders.get(one.agent, ()))
        if one.name in order and (one.name, one.name) not in pairwise(order):
            part_s = order.count(one.name) * one.times / one.visits * one.took_s
            text = f"the logs repeat `{one.name}` {one.times} times in {one.visits} visits; this order has none"
            findings.append(Finding("repeats", "amber", f"{text}: {signed_percent(part_s / entry.expected_s, 1)}"))
            more_s += part_s
    if not findings:
        return entry
    return replace(
        entry,
        expected_high_s=entry.expected_high_s + more_s,
        distribution=entry.distribution and entry.distribution.shifted(0.0, more_s),
        findings=(*findings, *entry.findings),
    )
