"""Finds agents whose times are from a clock that is off, such as robot and operator logged by two computers.

By a clock that is behind, an agent starts before the task of the other agent ends that it waits for. How far it is off
is not known: conditions are searched with the clock put right by several amounts. It is off if they explain the starts
clearly better so. Then no lag is negative; of all amounts for which this is so, the smallest counts. A clock that
drifts is followed from execution to execution by the lags of the conditions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.task_model import ClockErrorCard
from cyclekit.learning.task_times.alike import find_with_alike
from cyclekit.learning.task_times.joint import joint_tasks
from cyclekit.learning.task_times.partly import find_partly
from cyclekit.learning.task_times.starts import (
    EARLY_S,
    GAIN,
    Waiting,
    candidates,
    deviation,
    find_alone,
    least_gain,
    waiting_tasks,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cyclekit.config import Wait
    from cyclekit.learning.task_times.runs import DoneTask, Run
    from cyclekit.schema import Bools, Vector

MOST_S, STEP_S = 6.0, 0.3
"""Maximum amount of a clock, s, and step of the amounts tried: below the range in which a condition is found."""
LEAST_S = 0.1
"""Minimum amount, s."""
EARLIEST = 0.02
"""Quantile of the lags of a condition that is not negative."""
EARLY_CHANGING_S = 1.0
"""Tolerance, s, of conditions by a clock that changes: a start may precede its condition by this much."""
NEAR, ROUNDS = 5, 3
"""Number of neighbouring executions that tell a changing clock, and number of times that it is followed."""
GAIN_PER_EXECUTION = 0.5
"""Minimum gain in regularity by following a clock, per execution."""


@dataclass(frozen=True)
class _Searched:
    """The conditions found with a clock put right by amounts, shape (runs,), s: their gain, and the tasks with them."""

    amount_s: Vector
    gain: float
    every: list[Waiting]


def in_one_clock(
    runs: Sequence[Run], agents: Mapping[str, str], given: Mapping[str, Sequence[Wait]] = MappingProxyType({})
) -> tuple[list[Run], dict[str, ClockErrorCard]]:
    """Return the executions in the clock of a robot, and the clocks of other agents that were off.

    Args:
        runs: Executions.
        agents: `robot` or `operator` by agent name.
        given: What tasks do not wait for, as the cell file tells, by agent.
    """
    found, clocks = list(runs), {}
    first, *rest = sorted(agents, key=lambda name: (agents[name] != "robot", name))
    right = {agent for agent, _ in joint_tasks(runs)}  # their tasks end together by their clocks
    for agent in sorted(set(rest) - right):
        amount_s = _Tasks(found, given).amount_s(agent)
        if amount_s.any():
            found = [_put_right(run, agent, by) for run, by in zip(found, amount_s.tolist(), strict=True)]
            clocks[agent] = ClockErrorCard(of=first, least_s=float(amount_s.min()), most_s=float(amount_s.max()))
    return found, clocks


def _put_right(run: Run, agent: str, by_s: float) -> Run:
    """Return an execution with an amount added to the times of an agent, s."""
    tasks = {name: [_later(done, by_s if name == agent else 0.0) for done in some] for name, some in run.tasks.items()}
    begin_s = min(done.start_s for some in tasks.values() for done in some)
    since = {agent: tuple(_later(done, -begin_s) for done in some) for agent, some in tasks.items()}
    return replace(run, tasks=since, begin_s=run.begin_s + begin_s)


def _later(done: DoneTask, by_s: float) -> DoneTask:
    return replace(done, start_s=done.start_s + by_s, end_s=done.end_s + by_s, planned_s=done.planned_s + by_s)


class _Tasks:
    """The starts of all tasks, and what they may wait for."""

    def __init__(self, runs: Sequence[Run], given: Mapping[str, Sequence[Wait]]) -> None:
        agents = sorted({name for run in runs for name in run.tasks})
        self.others = {agent: candidates(runs, agent) for agent in agents}
        self.every = [
            one for name in agents for one in waiting_tasks(runs, name, given.get(name, ()), self.others[name])
        ]
        for one in self.every:
            for need in self.others[one.agent]:
                one.ends_s(need)
        self._count = len(runs)
        number = {run.name: number for number, run in enumerate(runs)}
        self._row = {
            (one.agent, one.task): np.array([number[each.run.name] for each in one.seen]) for one in self.every
        }

    def amount_s(self, agent: str) -> Vector:
        """Return what puts the clock of an agent right in each execution, shape (runs,), s."""
        none = np.zeros(self._count)
        best = self._constant(agent, none, EARLY_S)
        changing = self._followed(agent, self._constant(agent, none, EARLY_CHANGING_S))
        if changing.gain > best.gain + GAIN + GAIN_PER_EXECUTION * len(none):
            best = changing
        low, high = (best.amount_s.mean() + each for each in _range_s(agent, best))
        mean_s = 0.5 * (low + high) if low > high else min(max(0.0, low), high)
        amount_s = np.round(best.amount_s - best.amount_s.mean() + mean_s, 3)
        return amount_s if np.abs(amount_s).max() >= LEAST_S else none

    def _constant(self, agent: str, none: Vector, early_s: float) -> _Searched:
        """Return the conditions with the clock put right by the same amount in all executions, `none` or another."""
        amounts = np.arange(1, round(MOST_S / STEP_S) + 1) * STEP_S
        best = self._searched(agent, none, early_s)
        least = best.gain + GAIN + float(np.log(2 * len(amounts)))
        for amount in np.stack([amounts, -amounts], axis=1).ravel().tolist():
            tried = self._searched(agent, np.full(len(none), amount), early_s)
            if tried.gain > max(least, best.gain + GAIN):
                best = tried
        return best

    def _searched(self, agent: str, amount_s: Vector, early_s: float = EARLY_S) -> _Searched:
        gain, every = 0.0, []
        for name, others in self.others.items():
            mine = [self._moved(one, agent, amount_s, early_s) for one in self.every if one.agent == name]
            for one in mine:
                find_alone(one, others)
            find_with_alike(mine, others)
            for one in mine:
                find_partly(one, others)
            gain += sum(_gain(one, len(others)) for one in mine)
            every += mine
        return _Searched(amount_s, gain, every)

    def _moved(self, one: Waiting, agent: str, amount_s: Vector, early_s: float) -> Waiting:
        """Return the starts of a task, without conditions, with amounts added to the times of an agent."""
        by_s = amount_s[self._row[one.agent, one.task]]
        ends = {
            key: ends_s + by_s * (int(key[0] == agent) - int(one.agent == agent)) for key, ends_s in one.ends.items()
        }
        return replace(one, found=[], ends=ends, early_s=early_s)

    def _followed(self, agent: str, found: _Searched) -> _Searched:
        """Return the conditions with the clock put right by what the lags of those found tell in each execution."""
        from scipy.ndimage import median_filter  # slow to import, and most clocks are right

        for _ in range(ROUNDS):
            off: list[list[float]] = [[] for _ in found.amount_s]
            for one, lag_s, decided in _lags(agent, found):
                late = (lag_s - np.median(lag_s)) * (1.0 if one.agent == agent else -1.0)
                for row, by in zip(self._row[one.agent, one.task][decided].tolist(), late.tolist(), strict=True):
                    off[row].append(by)
            seen = np.array([row for row, some in enumerate(off) if some])
            if len(seen) < NEAR:
                return found
            each = median_filter(np.array([np.median(off[row]) for row in seen]), NEAR, mode="nearest")
            amount_s = found.amount_s - np.interp(np.arange(len(off)), seen, each)
            found = self._searched(agent, amount_s, EARLY_CHANGING_S)
        return self._searched(agent, found.amount_s)


def _gain(one: Waiting, others: int) -> float:
    plan = replace(one, found=[each for each in one.found if each is None])
    less = deviation([one.start_s - plan.ready_s()]) / deviation([one.start_s - one.ready_s()])
    needs = len(one.found) - len(plan.found)
    return len(one.seen) * float(np.log(less)) - needs * least_gain(others, len(one.seen))


def _lags(agent: str, searched: _Searched) -> Iterator[tuple[Waiting, Vector, Bools]]:
    """Yield for each condition between an agent and others its task, the lags of starts it decided, s, and which."""
    for one in searched.every:
        for need in one.found:
            if need is not None and agent in (one.agent, need.agent):
                ends = one.ends_s(need)
                decided = ends > one.ready_s(need)
                if decided.any():
                    yield one, (one.start_s - ends)[decided], decided


def _range_s(agent: str, searched: _Searched) -> tuple[float, float]:
    """Return the least and the greatest further amount with which no lag is negative, s."""
    low, high = -np.inf, np.inf
    for one, lag_s, _ in _lags(agent, searched):
        least_s = float(np.quantile(lag_s, EARLIEST))
        low, high = (max(low, -least_s), high) if one.agent == agent else (low, min(high, least_s))
    return low, high
