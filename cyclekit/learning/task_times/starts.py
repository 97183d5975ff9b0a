"""What a task waits for before it starts: its agent's own task before it, its planned start, a task of another agent.

A condition is believed if the starts hold to it, if it was what decided several of them, and if the lag from "may
start" to the start becomes so much more regular by it that chance among all candidates cannot have done that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.task_model import NeedCard

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.learning.task_times.runs import Run
    from cyclekit.schema import Vector

HELD = 0.98
"""Part of the starts that must come after a condition's end."""
EARLY_S = 0.15
"""A start may come so much before it: rounding, and clocks of two agents."""
LEAST_DECIDED = 5
"""So many starts must have been decided by it alone."""
DECIDED_S = 0.3
"""It decided a start if everything else was there so much earlier."""
REGULAR_S = 0.05
"""Lags are not told apart below this."""
GAIN_PER_START, GAIN = 0.1, 6.0
"""By so much the logarithm of the mean deviation of the lags must fall, for each start and in all."""
MOST = 3


class _Start(NamedTuple):
    """One logged start: in which run, the how-many-th of this task there, and when."""

    run: Run
    nth: int
    start_s: float
    own_s: float
    planned_s: float


@dataclass(frozen=True)
class Starts:
    """What the starts of one task wait for.

    Attributes:
        needs: Tasks of other agents.
        planned: It waits for its planned start.
        lags_s: From when it may start to its start, of each logged start, shape (N,).
    """

    needs: tuple[NeedCard, ...]
    planned: bool
    lags_s: Vector


def learn_starts(runs: Sequence[Run], agent: str, task: str) -> Starts:
    """Return what one task of one agent waits for.

    Args:
        runs: At least one of them holds the task.
        agent: Whose task.
        task: Which.
    """
    seen = list(_starts(runs, agent, task))
    start = np.array([each.start_s for each in seen])
    ready = np.array([each.own_s for each in seen])
    planned = np.array([each.planned_s for each in seen])
    open_to: dict[NeedCard | None, Vector] = {None: planned}
    open_to |= {need: _ends(seen, need) for need in _candidates(runs, agent)}
    chosen: list[NeedCard | None] = []
    while len(chosen) < MOST:
        tried = {need: _gain(start, ready, ends) for need, ends in open_to.items() if need not in chosen}
        best = max(tried, key=lambda need: tried[need], default=None)
        least = GAIN + np.log(len(open_to)) + GAIN_PER_START * len(seen)
        if not tried or tried[best] < least:
            break
        chosen.append(best)
        ready = np.fmax(ready, open_to[best])
    needs = [_told(need, start, ready, open_to) for need in chosen if need is not None]
    return Starts(tuple(needs), None in chosen, start - ready)


def _starts(runs: Iterable[Run], agent: str, task: str) -> Iterable[_Start]:
    for run in runs:
        own_s, nth = 0.0, 0
        for done in run.tasks.get(agent, ()):
            if done.task == task:
                yield _Start(run, nth, done.start_s, own_s, done.planned_s)
                nth += 1
            own_s = done.end_s


def _candidates(runs: Sequence[Run], agent: str) -> list[NeedCard]:
    pairs = {(name, done.task) for run in runs for name, some in run.tasks.items() if name != agent for done in some}
    return [NeedCard(agent=name, task=task, back=back) for name, task in sorted(pairs) for back in (0, 1)]


def _ends(seen: Sequence[_Start], need: NeedCard) -> Vector:
    """Return the end of what a need names for each start, shape (N,), s; NaN where there is none."""
    found = np.full(len(seen), np.nan)
    for row, each in enumerate(seen):
        ends = [done.end_s for done in each.run.tasks.get(need.agent, ()) if done.task == need.task]
        if 0 <= each.nth - need.back < len(ends):
            found[row] = ends[each.nth - need.back]
    return found


def _gain(start: Vector, ready: Vector, ends: Vector) -> float:
    """Return by how much the starts become more regular with a condition; minus infinity where it does not hold."""
    known = np.isfinite(ends)
    held = start >= ends - EARLY_S
    decided = known & held & (ends > ready + DECIDED_S)
    if not known.any() or held[known].mean() < HELD or decided.sum() < LEAST_DECIDED:
        return -np.inf
    with_it = np.where(held, np.fmax(ready, ends), ready)
    return len(start) * float(np.log(_deviation(start - ready) / _deviation(start - with_it)))


def _deviation(lags_s: Vector) -> float:
    return float(np.abs(lags_s - np.median(lags_s)).mean()) + REGULAR_S


def _told(need: NeedCard, start: Vector, ready: Vector, open_to: dict[NeedCard | None, Vector]) -> NeedCard:
    """Return a need with how often it held, and how many starts it decided."""
    ends = open_to[need]
    known = np.isfinite(ends)
    decided = known & (ends >= ready - 1e-9)
    held = float((start[known] >= ends[known] - EARLY_S).mean())
    return structs.replace(need, held=held, decided=int(decided.sum()))
