"""Tasks that are sometimes done again right after themselves: a pick that failed, a screw that did not hold.

An order that is asked for names each task once, so it lacks these repetitions until it is known how often they come.
Tasks that one order puts in a row, and another does not, are no repetitions: the execution has no more of them.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MORE = 0.5
"""Minimum number of visits that executions with a repetition have more than those without; it is 1 for a repetition
and 0 for two parts in a row, and this is the middle."""


class Repeated(NamedTuple):
    """A task, or a place, that some executions repeat.

    Attributes:
        agent, name: Whose it is, and its name.
        visits: How often it was done in all executions, without its repetitions.
        times: How often it was repeated.
        took_s: Mean duration of a repetition, s.
    """

    agent: str
    name: str
    visits: int
    times: int
    took_s: float


def find_repeats(agent: str, executions: Iterable[Sequence[tuple[str, float]]]) -> list[Repeated]:
    """Return what an agent repeats.

    Args:
        agent: The agent.
        executions: Its tasks in each execution in order, with their durations, s.
    """
    visits, again = defaultdict[str, list[int]](list), defaultdict[str, list[list[float]]](list)
    for done in executions:
        repeated = defaultdict[str, list[float]](list)
        for (before, _), (name, took_s) in pairwise(done):
            if name == before:
                repeated[name].append(took_s)
        for name in dict.fromkeys(name for name, _ in done):
            visits[name].append(sum(name == other for other, _ in done))
            again[name].append(repeated[name])
    found = []
    for name, counts in visits.items():
        count, has = np.array(counts), np.array([bool(some) for some in again[name]])
        every_s = [took_s for some in again[name] for took_s in some]
        if has.any() and not has.all() and count[has].mean() - count[~has].mean() >= MORE:
            visited = int(count.sum()) - len(every_s)
            found.append(Repeated(agent, name, visited, len(every_s), float(np.mean(every_s))))
    return found
