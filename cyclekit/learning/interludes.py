"""What an agent does now and then beside its work: a pick done again, a tool change, a refill.

An order that is asked for names each task of the work once, so it lacks these interludes until it is known how often
they come. Tasks of the work are bound to each other: what is picked is placed, and a product has all its steps. How
often an interlude comes follows from no other task. A step that only some products have, with all their other tasks,
looks the same.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.task_model import InterludeCard

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.schema import Floats, Vector

HALF = 0.5
"""Minimum share of how often a task is done that no other task explains, for an interlude; and minimum number of visits
more for each time that a task follows itself, for a repetition. It is 0 for work and 1 for what comes by itself, and
this is the middle. A statistical level: in the logs of eleven simulated cells 0.25 finds the same, and 0.9 the same but
for one place, a wait short of a fixture that was taken for a visit."""
AGAIN = " again"
"""Added to the names of tasks that are done over again."""
TINY = 1e-9
"""Sum of squares that is rounding alone: the other tasks tell how often this one is done."""


def find_interludes(agent: str, executions: Iterable[Sequence[tuple[str, float, float]]]) -> list[InterludeCard]:
    """Return the interludes of an agent.

    Args:
        agent: The agent.
        executions: Its tasks in each execution in order: name, duration without waits, and wait, s.
    """
    every = list(executions)
    names = list(dict.fromkeys(name for done in every for name, _, _ in done))
    if not names:
        return []
    count = np.array([[sum(name == other for other, _, _ in done) for name in names] for done in every], np.float64)
    again = np.zeros_like(count)
    for number, done in enumerate(every):
        for (before, _, _), (name, _, _) in pairwise(done):
            again[number, names.index(name)] += name == before
    free = [name for at, name in enumerate(names) if _unexplained(count, again, at) > HALF]
    if 2.0 * count[:, [names.index(name) for name in free]].sum() > count.sum():
        free = []  # executions of any tasks: these are the work
    repeated = [name for at, name in enumerate(names) if again[:, at].any() and _more(count, again, at) >= HALF]
    found = [
        *(_repeated(agent, every, name) for name in repeated),
        *(_visited(agent, every, name, free) for name in free),
    ]
    return [one for one in found if one is not None]


def find_rework(agent: str, executions: Iterable[Sequence[tuple[str, float]]]) -> list[InterludeCard]:
    """Return what an agent does over again after other tasks, as a part that failed its test goes back.

    Only where most executions do each task once: else doing it again is the work.

    Args:
        agent: The agent.
        executions: Its tasks in each execution in order: name and end, s.
    """
    every = [done for done in executions if done]
    found: dict[str, list[tuple[str, float]]] = {}
    once = 0
    for done in every:
        names, again, more_s = list[str](), list[str](), 0.0
        for (before, from_s), (name, end_s) in pairwise([("", 0.0), *done]):
            if name in names and name != before:
                again.append(name)
                more_s += end_s - from_s
            names.append(name)
        once += len(set(names)) == len(names)
        if again:
            found.setdefault(again[0], []).append((", ".join(dict.fromkeys(again)), more_s))
    if 2 * once <= len(every):
        return []
    return [
        InterludeCard(
            agent, f"{some[0][0]}{AGAIN}", (first,), len(every), len(some), float(np.mean([s for _, s in some]))
        )
        for first, some in found.items()
    ]


def _repeated(agent: str, every: Sequence[Sequence[tuple[str, float, float]]], name: str) -> InterludeCard:
    """Return the repetitions of a task."""
    visits = sum(one[0] == name for done in every for one in done)
    took_s = [after[1] for done in every for before, after in pairwise(done) if before[0] == after[0] == name]
    times = len(took_s)
    return InterludeCard(agent, name, (name,), visits - times, times, float(np.mean(took_s)))


def _visited(
    agent: str, every: Sequence[Sequence[tuple[str, float, float]]], name: str, free: Sequence[str]
) -> InterludeCard | None:
    """Return an interlude on the way to other tasks, which it makes longer or shorter; None if no other follows it."""
    own_s, after_s, otherwise_s = list[float](), dict[str, list[float]](), dict[str, list[float]]()
    for done in every:
        spent_s, before = 0.0, ""
        for task, took_s, wait_s in done:
            if task == name:
                spent_s += took_s + wait_s
            elif task not in free:
                if spent_s:
                    own_s.append(spent_s)
                    after_s.setdefault(task, []).append(took_s)
                elif before != task:
                    otherwise_s.setdefault(task, []).append(took_s)
                spent_s = 0.0
            before = task
    if not own_s:
        return None
    more_s = sum(sum(some) - len(some) * np.mean(otherwise_s.get(task, some)) for task, some in after_s.items())
    visits = sum(map(len, after_s.values())) + sum(len(otherwise_s.get(task, ())) for task in after_s)
    took_s = max((sum(own_s) + float(more_s)) / len(own_s), 0.0)
    return InterludeCard(agent, name, tuple(after_s), visits, len(own_s), took_s)


def _unexplained(count: Floats, again: Floats, at: int) -> float:
    """Return the share of the variance of how often task `at` was done that the other tasks do not explain.

    With or without its repetitions, whichever is explained better: two parts in a row look like one.

    Args:
        count: How often each task was done, shape (executions, tasks).
        again: How often right after itself, likewise.
        at: Number of the task.
    """
    others = [np.delete(each, at, axis=1) for each in (count, again)]
    columns = np.column_stack([np.ones(len(count)), *others])
    left = len(count) - int(np.linalg.matrix_rank(columns))
    shares = []
    for often in (count[:, at], count[:, at] - again[:, at]):
        rest = _rest(columns, often)
        known = left > 0 and rest @ rest > TINY
        shares.append(float(rest @ rest) / left / float(often.var(ddof=1)) if known else 0.0)
    return min(shares)


def _more(count: Floats, again: Floats, at: int) -> float:
    """Return how many visits more an execution has for each time that task `at` follows itself; 0 if unknown.

    Tasks that one order puts in a row, and another does not, are no repetitions: the execution has no more of them. Nor
    are those that a product of several needs more often: its executions differ in other tasks too.

    Args:
        count: How often each task was done, shape (executions, tasks).
        again: How often right after itself, likewise.
        at: Number of the task.
    """
    others = np.column_stack([np.ones(len(count)), np.delete(count - again, at, axis=1)])
    rest = _rest(others, again[:, at])
    known = float(rest @ rest)
    return float(rest @ count[:, at]) / known if known > TINY else 0.0


def _rest(others: Floats, values: Vector) -> Vector:
    """Return what a linear combination of columns (N, K) does not explain of values (N,)."""
    return np.asarray(values - others @ np.linalg.lstsq(others, values, rcond=None)[0])
