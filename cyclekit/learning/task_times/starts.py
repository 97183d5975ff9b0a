"""Finds the conditions of a task's start: its agent's previous task, its planned start, tasks of other agents.

A condition is accepted if the starts respect it, if it decides several of them, and if the lags between being ready and
starting become more regular than chance among all candidates can explain. `alike` adds what only tasks of one kind show
together, `partly` what only some starts need, `process` a process time since an earlier task of the agent itself,
`unseen_parts` parts that come by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.task_model import NeedCard

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cyclekit.config import Wait
    from cyclekit.dataset.cards.task_model import PartsCard
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
EARLY_PART = 0.05
"""The same for a process time, as a share of it, in addition: processes vary."""
REGULAR_S = 0.05
"""Resolution of lags, s."""
GAIN_PER_START, GAIN = 0.1, 6.0
"""Minimum gain in regularity (`_gain`): the first value per start, plus the second."""
MAJORITY = 0.5
"""Minimum share of most starts."""
MOSTLY_PLANNED = 0.1
"""Maximum loss in regularity per start by a planned start that decides most starts."""
MAX_CONDITIONS = 3
"""Maximum number of conditions per task."""


class _Start(NamedTuple):
    """One logged start: execution, occurrence of the task in it, the agent's task before ("" = none), and times, s."""

    run: Run
    nth: int
    before: str
    start_s: float
    own_s: float
    planned_s: float


@dataclass(frozen=True)
class Starts:
    """Conditions of the starts of one task.

    Attributes:
        needs: Tasks that must have ended.
        planned: Whether it waits for its planned start.
        lags_s: Lag of each logged start after its conditions, where all are known, s.
        need_lags_s: Those after needed tasks, if they are clearly different; then `lags_s` has the others.
        lag_after_s: How much longer these are after each task of the agent, s; taken out of them.
        parts: Parts that it waits for.
        needed: For each of `needs` that only some starts need, whether a start needed it, by the number of the
            execution and the occurrence of the task, where that is seen.
    """

    needs: tuple[NeedCard, ...]
    planned: bool
    lags_s: Vector
    need_lags_s: Vector
    lag_after_s: Mapping[str, float]
    parts: PartsCard | None = None
    needed: tuple[Mapping[tuple[int, int], bool], ...] = ()


@dataclass
class Waiting:
    """The logged starts of one task, and the conditions found so far.

    Attributes:
        agent, task: The waiting task.
        seen: Its starts, N of them.
        start_s: Their times, shape (N,), s.
        free_s: End of the agent's previous task, shape (N,), s.
        planned_s: Planned starts, shape (N,), s; NaN if not logged.
        found: Conditions, None = the planned start.
        barred: Tasks that it does not wait for.
        ends: For each start, the end of the task that a condition names, (N,), s, by agent, task and `back`: kept, as
            many process times are tried after the same ends.
        early_s: A start may precede the end of another agent's task by this much, s.
    """

    agent: str
    task: str
    seen: list[_Start]
    start_s: Vector
    free_s: Vector
    planned_s: Vector
    found: list[NeedCard | None]
    barred: frozenset[str] = frozenset()
    ends: dict[tuple[str, str, int], Vector] = field(default_factory=dict)
    early_s: float = EARLY_S

    def ends_s(self, need: NeedCard | None) -> Vector:
        """Return for each start when a condition allows it, shape (N,), s; NaN where there is none."""
        if need is None:
            return self.planned_s
        named = need.agent, need.task, need.back
        if named not in self.ends:
            self.ends[named] = _ends(self, need)
        ends = self.ends[named] + need.after_s
        return ends if need.needed == 1.0 else np.where(self.start_s >= ends - self.early_s, ends, np.nan)

    def ready_s(self, but: NeedCard | None = None) -> Vector:
        """Return for each start when all conditions found allow it, shape (N,), s; without one of them if given."""
        ready = self.free_s
        for each in self.found:
            if but is None or each is None or (each.agent, each.task) != (but.agent, but.task):
                ready = np.fmax(ready, self.ends_s(each))
        return ready


def learn_starts(runs: Sequence[Run], agent: str, given: Sequence[Wait] = ()) -> dict[str, Starts]:
    """Return the conditions of one agent's tasks, by task.

    Args:
        runs: Executions; at least one contains the agent.
        agent: Name of the agent.
        given: What tasks of such agents do not wait for, as the cell file tells.
    """
    from cyclekit.learning.task_times.alike import find_with_alike
    from cyclekit.learning.task_times.partly import find_partly
    from cyclekit.learning.task_times.process import find_process_time

    others = candidates(runs, agent)
    every = waiting_tasks(runs, agent, given, others)
    tasks = [one.task for one in every]
    known = {*tasks, *(need.task for need in others)}
    for one in every:
        find_alone(one, others)
    find_with_alike(every, others)
    for one in every:
        find_partly(one, others)
        find_process_time(one, tasks)
    return {one.task: _told(one, free=not known <= one.barred) for one in every}


def waiting_tasks(runs: Sequence[Run], agent: str, given: Sequence[Wait], others: Sequence[NeedCard]) -> list[Waiting]:
    """Return the starts of each task of an agent, without conditions, sorted by name.

    Args:
        runs: Executions; at least one contains the agent.
        agent: Name of the agent.
        given: See `learn_starts`.
        others: Its `candidates`.
    """
    tasks = sorted({done.task for run in runs for done in run.tasks.get(agent, ())})
    known = {*tasks, *(need.task for need in others)}
    return [_waiting(runs, agent, task, _barred(given, task, known)) for task in tasks]


def find_alone(one: Waiting, others: Sequence[NeedCard]) -> None:
    """Add the conditions that the starts of a task show alone.

    A planned start needs little evidence: a plan that is estimated is kept, so waits for it must not count as lags too.
    """
    known = np.isfinite(one.planned_s)
    times = one.start_s[known], one.ready_s()[known], one.planned_s[known]
    if known.any() and gain([times], EARLY_PLAN_S, decided=1) > _least_of_plan(times):
        one.found.append(None)
    open_to: dict[NeedCard | None, Vector] = {need: one.ends_s(need) for need in others if need.task not in one.barred}
    while len(one.found) < MAX_CONDITIONS:
        ready = one.ready_s()
        tried = {
            need: gain([(one.start_s, ready, ends)], early_s(need, one.early_s))
            for need, ends in open_to.items()
            if need not in one.found
        }
        best = max(tried, key=lambda need: tried[need], default=None)
        if not tried or tried[best] < least_gain(len(open_to), len(one.seen)):
            break
        one.found.append(best)


def _least_of_plan(times: Times) -> float:
    """Return the minimum gain in regularity of the planned start.

    Where it decides most starts, the lags may even be a little less regular: an agent's first task may always be
    planned at the same time.
    """
    _, ready, planned = times
    return -MOSTLY_PLANNED * len(planned) if (planned > ready + DECIDED_S).mean() > MAJORITY else 0.0


def _barred(given: Sequence[Wait], task: str, known: Collection[str]) -> frozenset[str]:
    """Return the tasks, of those known, that a task does not wait for."""
    told = [wait.until for wait in given if wait.task == task]
    return frozenset(known if None in told else (until for until in told if until))


def _waiting(runs: Iterable[Run], agent: str, task: str, barred: frozenset[str]) -> Waiting:
    seen = []
    for run in runs:
        own_s, nth, before = 0.0, 0, ""
        for done in run.tasks.get(agent, ()):
            if done.task == task:
                seen.append(
                    _Start(run, nth, before, done.start_s, float(np.fmax(own_s, done.joined_s)), done.planned_s)
                )
                nth += 1
            own_s, before = done.end_s, done.task
    times = np.array([[each.start_s, each.own_s, each.planned_s] for each in seen])
    return Waiting(agent, task, seen, times[:, 0], times[:, 1], times[:, 2], [], barred)


def candidates(runs: Sequence[Run], agent: str) -> list[NeedCard]:
    """Return the tasks of other agents that a task of an agent may wait for."""
    pairs = {(name, done.task) for run in runs for name, some in run.tasks.items() if name != agent for done in some}
    return [NeedCard(agent=name, task=task, back=back) for name, task in sorted(pairs) for back in (0, 1)]


def _ends(one: Waiting, need: NeedCard) -> Vector:
    """Return for each start the end of the task that a need names, shape (N,), s; NaN if there is none.

    A later task of the same agent is none.
    """
    found = np.full(len(one.seen), np.nan)
    for row, each in enumerate(one.seen):
        ends = [done.end_s for done in each.run.tasks.get(need.agent, ()) if done.task == need.task]
        if 0 <= each.nth - need.back < len(ends):
            end_s = ends[each.nth - need.back]
            found[row] = end_s if need.agent != one.agent or end_s <= each.start_s else np.nan
    return found


def early_s(need: NeedCard | None, early_s: float = EARLY_S) -> float:
    """Return how much a start may precede a condition, s; None = its planned start."""
    return EARLY_PLAN_S if need is None else early_s + EARLY_PART * need.after_s


Times = tuple["Vector", "Vector", "Vector"]
"""Starts of one task, when they were ready, and when a further condition allows them, each of shape (N,), s."""


def least_gain(candidates: int, starts: int) -> float:
    """Return the minimum gain in regularity of a condition that is the best of some candidates."""
    return float(GAIN + np.log(max(candidates, 1)) + GAIN_PER_START * starts)


def gain(some: Sequence[Times], early_s: float, decided: int = MIN_DECIDED) -> float:
    """Return the gain in regularity of the starts of some tasks by a condition; minus infinity if it does not hold.

    It does not hold if too many starts precede it, or if it decided too few.
    """
    start, ready, ends = (np.concatenate(each) for each in zip(*some, strict=True)) if len(some) > 1 else some[0]
    known, held = np.count_nonzero(np.isfinite(ends)), start >= ends - early_s  # false where it is unknown
    if not known or np.count_nonzero(held) / known < HELD:
        return -np.inf
    if np.count_nonzero(held & (ends > ready + DECIDED_S)) < decided:
        return -np.inf
    before = [start - ready for start, ready, _ in some]
    after = [start - np.where(start >= ends - early_s, np.fmax(ready, ends), ready) for start, ready, ends in some]
    return len(start) * float(np.log(deviation(before) / deviation(after)))


def deviation(lags_s: Sequence[Vector]) -> float:
    """Return the mean absolute deviation of lags from the median of each task, s, plus the resolution."""
    return float(np.concatenate([np.abs(each - np.median(each)) for each in lags_s]).mean()) + REGULAR_S


def _told(one: Waiting, *, free: bool) -> Starts:
    """Return the conditions, each need with the share of starts that respect it, and the number that it decided.

    Args:
        one: The starts of a task.
        free: Whether it may wait for parts.
    """
    from cyclekit.learning.task_times.lags import by_cause, by_task_before
    from cyclekit.learning.task_times.unseen_parts import find_unseen_parts

    ready, needs, flags = one.ready_s(), [], []
    for need in one.found:
        if need is not None:
            ends = one.ends_s(need)
            known = np.isfinite(ends)
            decided = known & (ends >= ready - 1e-9)
            held = float((one.start_s[known] >= ends[known] - early_s(need)).mean()) if known.any() else 1.0
            needs.append(structs.replace(need, held=held, decided=int(decided.sum())))
            flags.append(_needed(one, need))
    parts, lags_s = find_unseen_parts(one) if free else (None, one.start_s - ready)
    if parts is None and None in one.found:  # where the plan is not logged, a wait for it looks like a lag
        lags_s = np.where(np.isfinite(one.planned_s), lags_s, np.nan)
    own, needing = by_cause(one, lags_s)
    after_s = by_task_before(one, np.where(own, lags_s, np.nan))
    longer_s = np.array([after_s.get(each.before, 0.0) for each in one.seen])
    return Starts(
        tuple(needs), None in one.found, (lags_s - longer_s)[own], lags_s[needing], after_s, parts, tuple(flags)
    )


def _needed(one: Waiting, need: NeedCard) -> dict[tuple[int, int], bool]:
    """Return whether a start needed a condition that only some need, where the condition would have decided it."""
    if need.needed == 1.0:
        return {}
    ends = one.ends_s(structs.replace(need, needed=1.0))
    late = ends > one.ready_s(need) + DECIDED_S
    held = one.start_s >= ends - one.early_s
    return {(one.seen[row].run.number, one.seen[row].nth): bool(held[row]) for row in np.flatnonzero(late)}
