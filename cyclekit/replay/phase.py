"""Computes the path phase: the robot's progress on its path, by which executions are compared at the same place.

Each task counts 100, whatever its duration. Within a task the phase is the share of its path that is done; it is
constant during the process. The n-th repetition of a task has the same phase in every execution, so that executions
with different orders of the same tasks can be compared.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.replay.execution import ReplayedExecution

TASK = 100
"""Phase per task: 425 is a quarter of the fifth task."""

Order = dict[tuple[str, int], int]


def common_order(runs: Sequence[ReplayedExecution]) -> Order:
    """Return the index of each task and repetition: in the order of the first execution, then those of later ones."""
    order: Order = {}
    for run in runs:
        for key in repetitions(run):
            order.setdefault(key, len(order))
    return order


def path_phase(run: ReplayedExecution, order: Mapping[tuple[str, int], int]) -> NDArray[np.int64] | None:
    """Return the phase at `run.t_s`, shape (T,), hundredths of a task; None without known tasks."""
    if run.tasks.is_empty() or not len(run.t_s):
        return None
    phase = np.full(len(run.t_s), -1, dtype=np.int64)
    for key, task in zip(repetitions(run), run.tasks.iter_rows(named=True), strict=True):
        first, arrived, last = np.searchsorted(run.t_s, [task["start_s"], task["arrival_s"], task["end_s"]]).tolist()
        done = np.ones(last - first)
        done[: arrived - first] = _part_of_the_way(run, first, arrived)
        phase[first:last] = order[key] * TASK + np.rint(done * (TASK - 1)).astype(np.int64)
    known = np.flatnonzero(phase >= 0)
    if not len(known):
        return None
    return phase[known[np.clip(np.searchsorted(known, np.arange(len(phase)), side="right") - 1, 0, None)]]


def repetitions(run: ReplayedExecution) -> list[tuple[str, int]]:
    """Return each task of the execution with the number of its repetition."""
    seen: dict[str, int] = {}
    keys = []
    for task in run.tasks["task"].to_list():
        seen[task] = seen.get(task, 0) + 1
        keys.append((task, seen[task]))
    return keys


def _part_of_the_way(run: ReplayedExecution, first: int, arrived: int) -> NDArray[np.float64]:
    """Return the share of the path done at each sample, by length; by time if the robot's position is unknown."""
    if arrived <= first:
        return np.empty(0)
    points = run.robot_m[first : arrived + 1]
    seen = bool(np.isfinite(points).all())
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1) if seen else np.ones(len(points) - 1)
    way = np.concatenate([[0.0], np.cumsum(steps)])[: arrived - first]
    whole = float(steps.sum())
    return way / whole if whole > 0 else np.zeros(arrived - first)
