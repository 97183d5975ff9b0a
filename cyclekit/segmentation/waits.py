"""Waiting positions: positions short of a place at which the robot sometimes stops although it may move."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.segmentation.motion import lengths
from cyclekit.segmentation.places import EXACT_M, MERGE_M, OFTEN, VARIES, cluster, evenness

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Points
    from cyclekit.segmentation.executions import Execution, Visit
    from cyclekit.segmentation.standstills import Standstill
    from cyclekit.segmentation.stored_run import Run

MIN_COUNT = 3
"""Minimum number of standstills at a waiting position; where none on the way to a place has so many, one is enough."""
EXACT_SHARE = 0.8
"""Share of the standstills at a waiting position that must be within EXACT_M of it where the scaling was not logged."""


def with_waits(executions: Sequence[Execution], stops: Sequence[Standstill], runs: Sequence[Run]) -> list[Execution]:
    """Return the executions with the rows of each visit at the waiting position before it, and of a wait cut there.

    Args:
        executions: Executions of all runs.
        stops: Standstills of all runs, in order within each run.
        runs: All runs.
    """
    by_run: dict[int, list[Standstill]] = {}
    for stop in stops:
        by_run.setdefault(stop.run, []).append(stop)
    firsts = {run: [stop.first for stop in mine] for run, mine in by_run.items()}

    def between(run: int, before: Visit, after: Visit) -> list[Standstill]:
        mine = firsts.get(run, [])
        return by_run.get(run, [])[bisect_left(mine, before.last + 1) : bisect_left(mine, after.first)]

    on_way: dict[str, list[Standstill]] = {}
    for execution in executions:
        for before, after in pairwise(execution.visits):
            on_way.setdefault(after.place, []).extend(between(execution.run, before, after))
    spots = {place: found for place, some in on_way.items() if len(found := _spots(some, runs))}
    if not spots:
        return list(executions)
    ways = {(a.place, b.place) for execution in executions for a, b in pairwise(execution.visits)}
    known = []
    for execution in executions:
        visits = list(execution.visits[:1])
        for before, after in pairwise(execution.visits):
            rows = None
            if after.place in spots:
                some = between(execution.run, before, after)
                rows = _reached(runs[execution.run], before, after, some, spots[after.place])
            visits.append(replace(after, reached=rows))
        last, cut = by_run[execution.run][-1], None
        if execution.cut and last.first > visits[-1].last and last.last == runs[execution.run].rows - 1:
            near = (place for place, some in spots.items() if _is_at(some, last))
            goals = [place for place in near if (visits[-1].place, place) in ways]
            cut = (goals[0], last.first, last.last) if len(goals) == 1 else None
        known.append(replace(execution, visits=tuple(visits), waits=cut))
    return known


def _is_at(spots: Points, stop: Standstill) -> bool:
    return bool(lengths(spots - np.asarray(stop.xyz_m)).min() <= MERGE_M)


def _spots(stops: Sequence[Standstill], runs: Sequence[Run]) -> Points:
    """Return the waiting positions short of one place, shape (S, 3), m: standstills, half of them free to move.

    Where the scaling was not logged, a program that waits stops at exactly one position, for times that vary; the
    safety system stops a robot wherever it is.
    """
    xyz = np.array([stop.xyz_m for stop in stops]).reshape(-1, 3)
    within = np.array([not stop.edge for stop in stops], bool)
    groups = cluster(xyz, np.flatnonzero(within), MERGE_M)
    free = np.array([stop.free is True for stop in stops], bool)
    silent = np.array([stop.free is None for stop in stops], bool)
    able = [group for group in groups if 2 * np.count_nonzero(free[group]) >= len(group)]
    kept = [group for group in able if len(group) >= MIN_COUNT]
    kept += [
        group
        for group in groups
        if len(group) >= OFTEN
        and silent[group].all()
        and _is_exact(xyz[group])
        and evenness(runs, stops, group) < VARIES
    ]
    kept = kept or able
    return np.array([np.median(xyz[group], axis=0) for group in kept]).reshape(-1, 3)


def _is_exact(xyz_m: Points) -> bool:
    """Return whether most positions, shape (N, 3), m, are one as exactly as a robot repeats it."""
    off_m = lengths(xyz_m - np.median(xyz_m, axis=0))
    return bool(np.quantile(off_m, EXACT_SHARE) <= EXACT_M)


def _reached(
    run: Run, before: Visit, after: Visit, stops: Sequence[Standstill], spots: Points
) -> tuple[int, int] | None:
    """Return first and last row at a waiting position between two visits, equal if passed; None if not reached."""
    there = [stop for stop in stops if _is_at(spots, stop)]
    if there:
        return there[0].first, there[-1].last
    xyz = run.window(before.last, after.first).xyz_m
    apart = np.min([lengths(xyz - spot) for spot in spots], axis=0)
    row = int(np.nanargmin(apart)) if np.isfinite(apart).any() else 0
    return (before.last + row,) * 2 if apart[row] <= MERGE_M else None
