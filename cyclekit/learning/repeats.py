"""Tasks that are sometimes done again right after themselves: a pick that failed, a screw that did not hold.

An order that is asked for names each task once, so it lacks these repetitions until it is known how often they come.
Tasks that one order puts in a row, and another does not, are no repetitions: the execution has no more of them. Nor are
those that a product of several needs more often: its executions differ in other tasks too. A product that differs only
in them looks like a repetition.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.schema import Floats

MORE = 0.5
"""Minimum number of visits more for each time that a task follows itself, among executions of the same other tasks; it
is 1 for a repetition and 0 for two parts in a row, and this is the middle: 0.25 and 0.99 find the same."""


TINY = 1e-9
"""Sum of squares that is rounding alone: the other tasks tell each repetition."""


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
    every = list(executions)
    names = list(dict.fromkeys(name for done in every for name, _ in done))
    count = np.array([[sum(name == other for other, _ in done) for name in names] for done in every], dtype=np.float64)
    again_s = defaultdict[str, list[float]](list)
    again = np.zeros_like(count)
    for number, done in enumerate(every):
        for (before, _), (name, took_s) in pairwise(done):
            if name == before:
                again_s[name].append(took_s)
                again[number, names.index(name)] += 1
    found = []
    for at, name in enumerate(names):
        if again_s[name] and _more(count, again, at) >= MORE:
            visited = int(count[:, at].sum()) - len(again_s[name])
            found.append(Repeated(agent, name, visited, len(again_s[name]), float(np.mean(again_s[name]))))
    return found


def _more(count: Floats, again: Floats, at: int) -> float:
    """Return how many visits more an execution has for each time that task `at` follows itself; 0 if unknown.

    Args:
        count: How often each task was done, shape (executions, tasks).
        again: How often right after itself, likewise.
        at: Number of the task.
    """
    others = np.delete(count - again, at, axis=1)
    others = np.column_stack([np.ones(len(others)), others])
    rest = again[:, at] - others @ np.linalg.lstsq(others, again[:, at], rcond=None)[0]
    known = float(rest @ rest)
    return float(rest @ count[:, at]) / known if known > TINY else 0.0
