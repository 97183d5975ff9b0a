"""Finds the conditions of a task's start: its agent's previous task, its planned start, tasks of other agents.

A condition is accepted if the starts respect it, if it decides several of them, and if the lags between being ready and
starting become more regular than chance among all candidates can explain.
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
"""Minimum share of starts after a condition's end."""
EARLY_S = 0.15
"""Tolerance, s: a start may precede its condition by this much (rounding, clock error)."""
EARLY_PLAN_S = 0.6
"""The same for a planned start, s: plans are often written in whole seconds."""
MIN_DECIDED = 5
"""Minimum number of starts that a condition must decide alone."""
DECIDED_S = 0.3
"""Minimum lead, s, of all other causes at a start that a condition decided."""
REGULAR_S = 0.05
"""Resolution of lags, s."""
GAIN_PER_START, GAIN = 0.1, 6.0
"""Minimum gain in regularity (`_gain`): the first value per start, plus the second."""
MAX_CONDITIONS = 3
"""Maximum number of conditions per task."""


class _Start(NamedTuple):
    """One logged start: execution, occurrence of the task in it, and times, s."""

    run: Run
    nth: int
    start_s: float
    own_s: float
    planned_s: float


@dataclass(frozen=True)
class Starts:
    """Conditions of the starts of one task.

    Attributes:
        needs: Tasks of other agents that must have ended.
        planned: Whether it waits for its planned start.
        lags_s: Lag of each logged start after its conditions, shape (N,), s.
    """

    needs: tuple[NeedCard, ...]
    planned: bool
    lags_s: Vector


def learn_starts(runs: Sequence[Run], agent: str, task: str) -> Starts:
    """Return the conditions of one agent's task.

    Args:
        runs: Executions; at least one contains the task.
        agent: Name of the agent.
        task: Name of the task.
    """
    seen = list(_starts(runs, agent, task))
    start = np.array([each.start_s for each in seen])
    ready = np.array([each.own_s for each in seen])
    planned = np.array([each.planned_s for each in seen])
    open_to: dict[NeedCard | None, Vector] = {None: planned}
    open_to |= {need: _ends(seen, need) for need in _candidates(runs, agent)}
    chosen: list[NeedCard | None] = []
    while len(chosen) < MAX_CONDITIONS:
        tried = {
            need: _gain(start, ready, ends, EARLY_PLAN_S if need is None else EARLY_S)
            for need, ends in open_to.items()
            if need not in chosen
        }
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
    """Return for each start the end of the task that a need names, shape (N,), s; NaN if there is none."""
    found = np.full(len(seen), np.nan)
    for row, each in enumerate(seen):
        ends = [done.end_s for done in each.run.tasks.get(need.agent, ()) if done.task == need.task]
        if 0 <= each.nth - need.back < len(ends):
            found[row] = ends[each.nth - need.back]
    return found


def _gain(start: Vector, ready: Vector, ends: Vector, early_s: float) -> float:
    """Return the gain in regularity of the starts by a condition; minus infinity if the condition does not hold."""
    known = np.isfinite(ends)
    held = start >= ends - early_s
    decided = known & held & (ends > ready + DECIDED_S)
    if not known.any() or held[known].mean() < HELD or decided.sum() < MIN_DECIDED:
        return -np.inf
    with_it = np.where(held, np.fmax(ready, ends), ready)
    return len(start) * float(np.log(_deviation(start - ready) / _deviation(start - with_it)))


def _deviation(lags_s: Vector) -> float:
    return float(np.abs(lags_s - np.median(lags_s)).mean()) + REGULAR_S


def _told(need: NeedCard, start: Vector, ready: Vector, open_to: dict[NeedCard | None, Vector]) -> NeedCard:
    """Return a need with the share of starts that respect it, and the number that it decided."""
    ends = open_to[need]
    known = np.isfinite(ends)
    decided = known & (ends >= ready - 1e-9)
    held = float((start[known] >= ends[known] - EARLY_S).mean())
    return structs.replace(need, held=held, decided=int(decided.sum()))
