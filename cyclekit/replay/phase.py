"""How far the robot is on its path: the clock by which two executions are compared at the same place.

A task counts 100, whatever time it takes; inside it the phase is the fraction of its way that is done, and it stays at
the end while the robot works there. The n-th time of a task has the same phase in every execution, so that two orders
of the same tasks can still be laid beside each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.replay.execution import ReplayedExecution

TASK = 100
"""Phase of one whole task: 425 is a quarter of the way through the fifth."""

Order = dict[tuple[str, int], int]


def common_order(runs: Sequence[ReplayedExecution]) -> Order:
    """Return the place of each task and repetition: the first execution's order, then what only later ones have."""
    order: Order = {}
    for run in runs:
        for key in repetitions(run):
            order.setdefault(key, len(order))
    return order


def path_phase(run: ReplayedExecution, order: Mapping[tuple[str, int], int]) -> NDArray[np.int64] | None:
    """Return the phase at `run.t_s`, shape (T,), hundredths of a task; None where no task is known."""
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
    """Return each task of the execution with how many times it has come up to then."""
    seen: dict[str, int] = {}
    keys = []
    for task in run.tasks["task"].to_list():
        seen[task] = seen.get(task, 0) + 1
        keys.append((task, seen[task]))
    return keys


def _part_of_the_way(run: ReplayedExecution, first: int, arrived: int) -> NDArray[np.float64]:
    """Fraction of the way done at each sample, by length; by time where the robot's position is unknown."""
    if arrived <= first:
        return np.empty(0)
    points = run.robot_m[first : arrived + 1]
    seen = bool(np.isfinite(points).all())
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1) if seen else np.ones(len(points) - 1)
    way = np.concatenate([[0.0], np.cumsum(steps)])[: arrived - first]
    whole = float(steps.sum())
    return way / whole if whole > 0 else np.zeros(arrived - first)
