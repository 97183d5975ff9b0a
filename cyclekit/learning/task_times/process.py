"""Finds waits for a process that an agent started itself, such as a machine that it loaded.

Nothing in a task list tells when such a process ends. The task starts a process time after the end of an earlier task
of its agent: the later the agent comes, the shorter it waits. Its waits vary while the time since that task does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.task_model import NeedCard
from cyclekit.learning.task_times.starts import DECIDED_S, MIN_DECIDED, early_s, gain, least_gain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.task_times.starts import Waiting
    from cyclekit.schema import Vector

STEADY = 0.5
"""Maximum spread of the time since the earlier task, as a share of the spread of the waits."""
LEVELS = np.linspace(0.01, 0.8, 40)
"""Quantiles of the time since the earlier task that are tried as the process time."""


def find_process_time(one: Waiting, tasks: Sequence[str]) -> None:
    """Add a wait for the process that an earlier task of the same agent started, if there is one.

    Args:
        one: The starts of a task.
        tasks: All tasks of its agent.
    """
    open_to = [
        NeedCard(agent=one.agent, task=task, back=back)
        for task in tasks
        for back in (0, 1)
        if (back or task != one.task) and task not in one.barred
    ]
    best, found = least_gain(len(LEVELS) * max(len(open_to), 1), len(one.seen)), None
    ready = one.ready_s()
    for need in open_to:
        for after_s in _process_times(one.start_s - one.ends_s(need)):
            told = structs.replace(need, after_s=after_s)
            by = gain([(one.start_s, ready, one.ends_s(told))], early_s(told))
            if by > best and _is_steady(one, told):
                best, found = by, told
    if found:
        one.found.append(found)


def _process_times(since_s: Vector) -> list[float]:
    known = since_s[np.isfinite(since_s)]
    return np.unique(np.round(np.quantile(known, LEVELS), 3)).tolist() if len(known) >= MIN_DECIDED else []


def _is_steady(one: Waiting, need: NeedCard) -> bool:
    """Return whether the time since the earlier task varies less than the waits, where it decided."""
    ready, ends = one.ready_s(), one.ends_s(need)
    decided = ends > ready + DECIDED_S
    if decided.sum() < MIN_DECIDED:
        return False
    since, wait = (np.quantile((one.start_s - each)[decided], (0.1, 0.9)) for each in (ends, ready))
    return bool(since[1] - since[0] < STEADY * (wait[1] - wait[0]))
