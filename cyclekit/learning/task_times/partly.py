"""Finds conditions that only some starts of a task need, such as of an operator who often has a part in store.

Starts that need it come just after it, the others come before it, as soon as their agent is free. So it has to explain
nearly all of the time that the task waited, and to make the lags more regular than a condition that all starts respect.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit.learning.coupling.conditions.together import MIN_GAIN, gain_together
from cyclekit.learning.task_times.starts import DECIDED_S, MAX_CONDITIONS, MIN_DECIDED, deviation, least_gain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards.task_model import NeedCard
    from cyclekit.learning.task_times.starts import Starts, Waiting
    from cyclekit.schema import Vector

NEEDED = 0.15
"""Minimum share of the starts before which it could come that need it."""
SURE = 2.0
"""Factor on the gain that a condition needs that all starts respect."""
UNEXPLAINED = 0.3
"""Maximum share of the waits that remains with it."""


def find_partly(one: Waiting, others: Sequence[NeedCard]) -> None:
    """Add the conditions that only some starts of a task need.

    Args:
        one: The starts of a task.
        others: Tasks of other agents that it may wait for.
    """
    open_to = [need for need in others if need.task not in one.barred]
    while len(one.found) < MAX_CONDITIONS:
        known = {(each.agent, each.task) for each in one.found if each}
        ready = one.ready_s()
        tried = [_tried(one, need, ready) for need in open_to if (need.agent, need.task) not in known]
        best, found = max(tried, key=lambda each: each[0], default=(-np.inf, None))
        if found is None or best < SURE * least_gain(len(open_to), len(one.seen)):
            return
        one.found.append(found)


def _tried(one: Waiting, need: NeedCard, ready: Vector) -> tuple[float, NeedCard]:
    """Return the gain in regularity by a condition, and the condition with the share of starts that need it.

    Args:
        one: The starts of a task.
        need: The condition.
        ready: When the conditions found allow each start, shape (N,), s.
    """
    ends = one.ends_s(need)
    late = ends > ready + DECIDED_S
    needed = late & (one.start_s >= ends - one.early_s)
    decided = int(needed.sum())
    share = decided / max(int(late.sum()), 1)
    if decided < MIN_DECIDED or share < NEEDED:
        return -np.inf, need
    lag_s = one.start_s - ready
    rest_s = np.where(needed, one.start_s - ends, lag_s)
    if not _explains(lag_s, rest_s):
        return -np.inf, need
    by = len(lag_s) * float(np.log(deviation([lag_s]) / deviation([rest_s])))
    return by, structs.replace(need, needed=round(float(share), 4))


def needed_together(starts: Mapping[str, Mapping[str, Starts]]) -> dict[str, dict[str, Starts]]:
    """Return the starts of each agent's tasks with the conditions of two agents numbered that are needed together.

    In a handover both wait for each other or neither: the k-th start of one task needs its condition if that of the
    other does.
    """
    found = {agent: dict(some) for agent, some in starts.items()}
    every = [
        (agent, task, number)
        for agent, some in starts.items()
        for task, each in some.items()
        for number, need in enumerate(each.needs)
        if need.needed < 1.0
    ]
    flags = {(agent, task, number): dict(starts[agent][task].needed[number]) for agent, task, number in every}
    pairs = [(gain_together(flags[a], flags[b]), a, b) for a, b in combinations(every, 2) if a[0] != b[0]]
    used: set[tuple[str, str, int]] = set()
    for by, a, b in sorted(pairs, reverse=True):
        if by >= MIN_GAIN and not used & {a, b}:
            both = {key: flags[a].get(key, True) and flags[b].get(key, True) for key in flags[a] | flags[b]}
            needed = round(float(np.mean(list(both.values()))), 4)
            used |= {a, b}
            for agent, task, number in (a, b):
                told = structs.replace(found[agent][task].needs[number], needed=needed, together=len(used) // 2)
                needs = found[agent][task].needs
                found[agent][task] = replace(found[agent][task], needs=(*needs[:number], told, *needs[number + 1 :]))
    return found


def _explains(lag_s: Vector, rest_s: Vector) -> bool:
    waits = lag_s > DECIDED_S
    return bool(np.abs(rest_s[waits]).sum() <= UNEXPLAINED * lag_s[waits].sum())
