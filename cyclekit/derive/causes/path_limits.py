"""Limits of the path: places where the robot is slow in every pass, such as by stopping or joint limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.derive.causes.cause_samples import HALTED, SAME, STEP_M, Rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.schema import Bools, Ints, Points, Vector

POOL_M = 0.12
"""Diameter, m, within which samples without people are pooled to test a limit."""
PASSES, FREE_PASSES = 5, 3
ALWAYS_SHARE = 0.9


class Limit(NamedTuple):
    """Places of a path, shape (K, 3), m, and the maximum scaling at each, shape (K,); 1 = no limit."""

    at_m: Points
    cap: Vector


def _cells(rows: Rows) -> Ints:
    """Return task and grid cell (STEP_M) of each sample as integers, shape (N, 4)."""
    return np.column_stack([rows.task, np.floor(np.nan_to_num(rows.robot_m) / STEP_M).astype(np.int64)])


def always_slow(rows: Rows, free: Bools, fast: Bools) -> Bools:
    """Return which samples are at places of a path where nearly every pass is slow, shape (N,)."""
    slow = np.zeros(len(rows.t_s), np.bool_)
    usable = np.flatnonzero(free & (rows.task >= 0) & np.isfinite(rows.robot_m[:, 0]))
    if not len(usable):
        return slow
    _, cell = np.unique(_cells(rows)[usable], axis=0, return_inverse=True)
    rows_in, fast_in = np.bincount(cell), np.bincount(cell, fast[usable])
    passes = np.bincount(np.unique(np.column_stack([cell, rows.execution[usable]]), axis=0)[:, 0])
    slow[usable] = ((passes >= PASSES) & (fast_in <= (1.0 - ALWAYS_SHARE) * rows_in))[cell]
    return slow


def find_limits(rows: Rows, slow: Bools, alone: Bools, fast: Bools, top: float) -> dict[str, Limit]:
    """Return the limits of each task: where every pass is slow, also those that no operator and no input slows."""
    from scipy.spatial import cKDTree

    found = {}
    for number, task in enumerate(rows.tasks):
        here = slow & (rows.task == number)
        free = np.flatnonzero(alone & (rows.task == number) & (rows.scaling > HALTED) & np.isfinite(rows.robot_m[:, 0]))
        if not here.any() or not len(free):
            continue
        _, first = np.unique(_cells(rows)[here], axis=0, return_index=True)
        at_m = rows.robot_m[here][np.sort(first)]
        told = [
            _cap(rows.scaling[mine], rows.execution[mine], top)
            for mine in (free[near] for near in cKDTree(rows.robot_m[free]).query_ball_point(at_m, POOL_M / 2))
        ]
        if (sure := np.flatnonzero(np.isfinite(told))).size:
            around = here | ((fast | alone) & (rows.task == number))
            limit = _edges(rows, around, Limit(at_m[sure], np.array(told)[sure]), top)
            if len(limit.cap):  # else no pass respects it
                found[task] = limit
    return found


def _edges(rows: Rows, seen: Bools, limit: Limit, top: float) -> Limit:
    """Return a limit refined by the samples around it: no limit at full speed or where no pass was slow."""
    from scipy.spatial import cKDTree

    at_m = rows.robot_m[seen]
    apart, nearest = cKDTree(limit.at_m).query(at_m)
    scaling, cap = rows.scaling[seen], limit.cap[nearest]
    slow = (apart <= POOL_M / 2) & (np.abs(scaling - cap) <= SAME)
    near = (apart <= POOL_M) & (slow | (scaling >= top - SAME))
    return Limit(at_m[near], np.where(slow, cap, 1.0)[near])


def _cap(scaling: Vector, execution: Ints, top: float) -> float:
    """Return the limit seen in passes without people; NaN = none."""
    slow = scaling < top - SAME
    if len(np.unique(execution[slow])) < FREE_PASSES or slow.mean() < 0.5:
        return np.nan
    return float(np.median(scaling[slow]))


def limit_at(rows: Rows, limits: Mapping[str, Limit]) -> Vector:
    """Return the limit at each sample, shape (N,); 1 = none."""
    from scipy.spatial import cKDTree

    cap = np.ones(len(rows.t_s))
    for number, task in enumerate(rows.tasks):
        limit = limits.get(task)
        mine = np.flatnonzero((rows.task == number) & np.isfinite(rows.robot_m[:, 0]))
        if limit is not None and len(mine):
            apart, nearest = cKDTree(limit.at_m).query(rows.robot_m[mine])
            cap[mine] = np.where(apart <= STEP_M, limit.cap[np.minimum(nearest, len(limit.cap) - 1)], 1.0)
    return cap
