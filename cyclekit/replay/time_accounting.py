"""Cumulates the time accounting of one execution over time; the final values equal the sums of the task table.

Motion at full speed and safety loss come from the scaling of each sample; dwell and wait from the tasks, whose totals
are distributed over time. Time without information is a separate account.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.replay.execution import ReplayedExecution

ACCOUNTS = ("nominal", "safety", "dwell", "wait", "unknown")


def time_accounting(run: ReplayedExecution) -> dict[str, NDArray[np.float64]]:
    """Return the cumulated seconds of each account, shape (T,) each; their sum is the time since `t_s[0]`."""
    count = len(run.t_s)
    step_s = np.diff(run.t_s, append=run.t_s[-1:])
    standstill = np.array([moving is False for moving in run.moving], dtype=np.bool_)
    known = np.isfinite(run.scaling) & ~_in_gap(run)
    part = {name: np.zeros(count) for name in ACCOUNTS}
    moving = known & ~standstill
    part["nominal"][moving] = run.scaling[moving]
    part["safety"][moving] = 1.0 - run.scaling[moving]
    dwell = np.zeros(count, dtype=np.bool_)
    for task in run.tasks.iter_rows(named=True):
        dwell |= (run.t_s >= task["arrival_s"]) & (run.t_s < task["arrival_s"] + (task["dwell_s"] or 0.0))
    part["dwell"][standstill & dwell] = 1.0
    part["wait"][standstill & ~dwell] = 1.0
    part["unknown"][~moving & ~standstill] = 1.0
    return {name: np.concatenate([[0.0], np.cumsum(share * step_s)[:-1]]) for name, share in part.items()}


def _in_gap(run: ReplayedExecution) -> NDArray[np.bool_]:
    inside = np.zeros(len(run.t_s), dtype=np.bool_)
    for start_s, end_s in run.gaps:
        inside |= (run.t_s > start_s) & (run.t_s < end_s)
    return inside
