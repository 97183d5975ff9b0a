"""Finds joint tasks: a task of one agent and one of another that end together, such as both sides of a handover.

Such a task ends when both sides are done, so the side that began first also waits for the other within its task. Joint
tasks may start together as well, when both agents are free. The k-th of one belongs to the k-th of the other.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.task_model import JointCard

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.learning.task_times.runs import DoneTask, Run
    from cyclekit.schema import Bools

HELD = 0.98
"""Minimum share of joint tasks that end (start) together."""
TOUCH_S = 0.15
"""Maximum time between ends (starts) of joint tasks, s: rounding, clock error."""
MIN_SEEN = 5
"""Minimum number of joint tasks."""
ROUNDS = 5
"""Number of times that times and deciding sides are determined in turn."""

Name = tuple[str, str]
"""Agent and task."""


@dataclass(frozen=True)
class _Side:
    """The k-th time of a task in one execution: number of the execution, position, start and end, s, and free time.

    Attributes:
        free_s: End of the agent's previous task, s.
    """

    run: int
    at: int
    start_s: float
    end_s: float
    free_s: float


_Pairs = list[tuple[_Side, _Side]]


def joint_tasks(runs: Sequence[Run]) -> dict[Name, JointCard]:
    """Return for each joint task the task that it ends with.

    Args:
        runs: Executions.
    """
    seen = _sides(runs)
    names = sorted(seen)
    found: dict[Name, tuple[int, Name, JointCard]] = {}
    for one in names:
        for other in names:
            pairs = _pairs(seen[one], seen[other])
            if one[0] == other[0] or len(pairs) < MIN_SEEN or not _together([(a.end_s, b.end_s) for a, b in pairs]):
                continue
            starts = _together([(a.start_s, b.start_s) for a, b in pairs])
            card = JointCard(agent=other[0], task=other[1], starts=starts, times=len(pairs))
            if one not in found or found[one][0] < len(pairs):
                found[one] = len(pairs), other, card
    return {one: card for one, (_, other, card) in found.items() if other in found and found[other][1] == one}


def marked(runs: Sequence[Run], joint: Mapping[Name, JointCard]) -> list[Run]:
    """Return the executions with the sides of joint tasks that waited for the other side, which tell no own time.

    Which side decided follows from the times of both, and these from the sides that decided.

    Args:
        runs: Executions.
        joint: Their joint tasks.
    """
    seen = _sides(runs)
    changed: dict[tuple[int, str, int], dict[str, object]] = defaultdict(dict)
    for one, card in joint.items():
        other = (card.agent, card.task)
        if one > other:
            continue
        pairs = _pairs(seen[one], seen[other])
        first = _decided(pairs)
        for (a, b), by_first in zip(pairs, first.tolist(), strict=True):
            for (agent, _), side, name, mate, counts in (
                (one, a, other, b, by_first),
                (other, b, one, a, not by_first),
            ):
                joined = mate.free_s if card.starts else float("nan")
                told = {"counts": counts or card.starts, "mate": name, "joined_s": joined}
                changed[side.run, agent, side.at] = told
    if not changed:
        return list(runs)
    return [
        replace(
            run,
            tasks={
                agent: tuple(replace(done, **changed.get((number, agent, at), {})) for at, done in enumerate(some))  # type: ignore[arg-type]  # of these two
                for agent, some in run.tasks.items()
            },
        )
        for number, run in enumerate(runs)
    ]


def _decided(pairs: _Pairs) -> Bools:
    """Return for each joint task whether its first side decided the end, shape (N,)."""
    start = np.array([(a.start_s, b.start_s) for a, b in pairs])
    took = np.array([(a.end_s, b.end_s) for a, b in pairs]).max(axis=1)[:, None] - start
    first: Bools = start[:, 0] >= start[:, 1]
    for _ in range(ROUNDS):
        # a side that never decides takes at most its shortest time
        own = [np.median(took[by, n]) if by.any() else took[:, n].min() for n, by in enumerate((first, ~first))]
        now = start[:, 0] + own[0] >= start[:, 1] + own[1]
        if (now == first).all():
            break
        first = now
    return np.asarray(first)


def _sides(runs: Sequence[Run]) -> dict[Name, dict[tuple[int, int], _Side]]:
    """Return all repetitions of each task, by number of the execution and occurrence in it."""
    found: dict[Name, dict[tuple[int, int], _Side]] = defaultdict(dict)
    for number, run in enumerate(runs):
        for agent, some in run.tasks.items():
            turns: dict[str, int] = defaultdict(int)
            free_s = 0.0
            for at, done in enumerate(some):
                found[agent, done.task][number, turns[done.task]] = _side(number, at, done, free_s)
                turns[done.task] += 1
                free_s = done.end_s
    return found


def _side(number: int, at: int, done: DoneTask, free_s: float) -> _Side:
    return _Side(number, at, done.start_s, done.end_s, free_s)


def _pairs(one: Mapping[tuple[int, int], _Side], other: Mapping[tuple[int, int], _Side]) -> _Pairs:
    return [(side, other[key]) for key, side in one.items() if key in other]


def _together(times: Sequence[tuple[float, float]]) -> bool:
    both = np.array(times)
    return bool((np.abs(both[:, 0] - both[:, 1]) <= TOUCH_S).mean() >= HELD)
