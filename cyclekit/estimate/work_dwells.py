"""Standstills that depend on the work of the execution: products with different process times at the same place.

A cell may run several programs over the same places, each with its own process times. The standstills of all executions
together then fit none of them. So each place is tested: do they differ between executions of different work by more
than chance (`rank_test`), and by enough to matter? Where they do, an order takes the standstills of executions of its
own work; elsewhere nothing changes.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.estimate.same_work import Work, work_of
from cyclekit.segmentation.rank_test import by_chance

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Vector

Group = Work | frozenset[str] | tuple[str, ...]
"""What executions are grouped by: their work; their different places, if more have these in common; or their order of
places, if all have the same work."""

MIN_EXECUTIONS = 5
"""Minimum number of executions of a group, and of repetitions of a task in it."""
CHANCE = 0.01
"""Maximum probability that chance makes any place differ."""
APART_S, APART = 0.2, 0.1
"""Minimum difference between medians of groups, s and as a share of the standstill."""


@dataclass(frozen=True)
class Standstills:
    """Standstills at a goal in one group: mean process time and wait, s; dwell + wait, ascending, shape (N,), s."""

    dwell_s: float
    wait_s: float
    standstill_s: Vector

    @property
    def mean_s(self) -> float:
        """Mean standstill, s."""
        return self.dwell_s + self.wait_s


def groups_of(places: Sequence[str]) -> tuple[Group, ...]:
    """Return the groups to which a cycle through these places may belong: its work, its places, and its order."""
    return work_of(places), frozenset(places), tuple(places)


def key_of(group: Group) -> str:
    """Return a text that differs between groups and does not depend on the hash of a name."""
    return repr(sorted(group)) if isinstance(group, frozenset) else repr(group)


def standstills_by_work(dataset: Dataset) -> dict[str, dict[Group, Standstills]]:
    """Return the standstills per group of each task whose goal has other ones in other groups, by task name.

    A task with fewer than MIN_EXECUTIONS repetitions in a group has the group's standstills at its goal.
    """
    rows, groups = _grouped(dataset)
    found: dict[str, dict[Group, Standstills]] = {}
    for place in _differing(rows):
        there = rows.filter(pl.col("goal_place") == place)
        for (number,), mine in there.group_by(["group"], maintain_order=True):
            if mine["execution"].n_unique() < MIN_EXECUTIONS:
                continue
            for task in there["task"].unique(maintain_order=True):
                own = mine.filter(pl.col("task") == task)
                stands = _standstills(own if own.height >= MIN_EXECUTIONS else mine)
                found.setdefault(task, {})[groups[int(str(number))]] = stands
    return found


def said_of_places(by_work: Mapping[str, Mapping[Group, Standstills]]) -> list[str]:
    """Return one sentence per place whose standstills differ: shortest and longest mean, and the work of these."""
    found: dict[str, str] = {}
    for task, stands in by_work.items():
        place = task.rpartition("->")[2]
        ends = (choose(stands, key=lambda group: stands[group].mean_s) for choose in (min, max))
        said = (f"{stands[group].mean_s:.1f} s in {_shown(group)}" for group in ends)
        found.setdefault(place, f"standstill at {place} depends on the work: {', '.join(said)}")
    return list(found.values())


def _shown(group: Group) -> str:
    if isinstance(group, Work):
        return str(group)
    if isinstance(group, frozenset):
        return f"cycles through {', '.join(sorted(group))}"
    return f"cycles in the order {', '.join(group)}"


def _grouped(dataset: Dataset) -> tuple[pl.DataFrame, list[Group]]:
    """Return the tasks of complete executions with the number of their group, and the groups."""
    rows = dataset.tasks().filter(pl.col("nominal_s").is_not_null() & pl.col("dwell_s").is_not_null())
    logged = set(rows["execution"])
    went = [one for one in dataset.card.executions if one.complete and len(one.places) > 1 and one.execution in logged]
    levels = list(zip(*(groups_of(one.places) for one in went), strict=True)) or [()]
    mine = max(levels, key=_repeated)
    groups = list(dict.fromkeys(mine))
    number = {one.execution: groups.index(group) for one, group in zip(went, mine, strict=True)}
    rows = rows.with_columns(group=pl.col("execution").replace_strict(number, default=None, return_dtype=pl.Int64))
    return rows.drop_nulls("group"), groups


def _repeated(groups: Sequence[Group]) -> int:
    """Return the number of executions in groups of at least MIN_EXECUTIONS; 0 if there is only one such group."""
    counts = [count for count in Counter(groups).values() if count >= MIN_EXECUTIONS]
    return sum(counts) if len(counts) > 1 else 0


def _differing(rows: pl.DataFrame) -> list[str]:
    """Return the places whose standstills differ between groups, one value per execution, beyond chance.

    The median of the task is subtracted: a place that is only reached from elsewhere has no other process.
    """
    stand = pl.col("dwell_s") + pl.col("wait_s").fill_null(0.0)
    each = rows.with_columns(stand=stand).with_columns(off=pl.col("stand") - pl.col("stand").median().over("task"))
    per = each.group_by("goal_place", "group", "execution", maintain_order=True).agg(pl.col("stand", "off").median())
    per = per.filter(pl.len().over("goal_place", "group") >= MIN_EXECUTIONS)
    per = per.filter(pl.col("group").n_unique().over("goal_place") > 1)
    places = per.partition_by("goal_place", maintain_order=True)
    found = []
    for mine in places:
        medians = mine.group_by("group").agg(pl.col("off").median())["off"].to_numpy()
        apart = max(APART_S, APART * float(np.median(mine["stand"].to_numpy())))
        if np.ptp(medians) <= apart:
            continue
        if by_chance(mine["off"].to_numpy(), mine["group"].to_numpy()) * len(places) < CHANCE:
            found.append(str(mine["goal_place"][0]))
    return found


def _standstills(rows: pl.DataFrame) -> Standstills:
    dwell_s, wait_s = rows["dwell_s"].to_numpy(), rows["wait_s"].fill_null(0.0).to_numpy()
    return Standstills(float(dwell_s.mean()), float(wait_s.mean()), np.sort(dwell_s + wait_s))
