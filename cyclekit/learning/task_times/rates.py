"""How fast a task goes on beside each task of the other agents.

A repetition ends when its work is done; work is done at rate 1 on average, and at a rate of its own beside each task of
another agent: work = sum over the time of rate(beside). The work of the repetitions of one task is taken as log-normal
about a mean, and rates and mean are those of greatest posterior density, with rates drawn towards 1 (few overlaps tell
little). The density of the end time has the rate at the end as a factor: without it a task that lasted longer, and
overlapped more for that reason alone, would look slowed. Coefficients of this kind are published for pairs of tasks
(arXiv 2503.07238, where each pair has one factor of the whole duration); rates over time need no pair to overlap fully.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.learning.task_times.runs import DoneTask, Run
    from cyclekit.schema import Floats, Ints, Vector

RATES_SPREAD = 0.7
"""Standard deviation of the logarithm of a rate, before anything is seen: half to double, two times of three."""
AFTER_SPREAD = 0.1
"""The same of the factor of the agent's own task before: the way to a task is a small part of it."""
_LEAST_SPREAD = 1e-3
ALONE = ""


@dataclass(frozen=True)
class TaskRates:
    """What is learned of one task.

    Attributes:
        rates: By the name of the task beside it, `agent: task`; "" = alone.
        after: Factor of the work by the agent's own task before it; "" = it is the first.
        usual_s: Mean logged duration, s.
        work: Of each repetition with that factor taken out, s at rate 1; shape (N,).
    """

    rates: Mapping[str, float]
    after: Mapping[str, float]
    usual_s: float
    work: Vector


@dataclass(frozen=True)
class _Parts:
    """Repetitions of one task cut where a task beside it begins or ends.

    Attributes:
        of: Repetition of each part, shape (M,).
        dt_s: Its length, shape (M,).
        beside: Which tasks go on beside it, shape (M, names).
        last: Index of the last part of each repetition, shape (N,).
        before: Number of the agent's own task before it, shape (N,).
    """

    of: Ints
    dt_s: Vector
    beside: Floats
    last: Ints
    before: Ints


def beside(agent: str, task: str) -> str:
    """Return how a task of another agent is named in a table of rates."""
    return f"{agent}: {task}"


def fit_rates(runs: Sequence[Run], agent: str, task: str) -> TaskRates:
    """Return the rates of one task of one agent.

    Args:
        runs: At least one of them holds the task.
        agent: Whose task.
        task: Which.
    """
    names, before, parts = _parts(runs, agent, task)
    count, k = len(parts.last), len(names)

    def density(at: Vector) -> tuple[float, Vector]:
        mean, spread, log_rate, after = at[0], np.exp(at[1]) + _LEAST_SPREAD, at[2 : 2 + k], at[2 + k :]
        rate = np.exp(parts.beside @ log_rate)
        done = rate * parts.dt_s
        work = np.bincount(parts.of, done, count)
        z = (np.log(work) - mean - after[parts.before]) / spread
        value = 0.5 * z @ z + count * np.log(spread) + np.log(work).sum() - (parts.beside[parts.last] @ log_rate).sum()
        value += 0.5 * ((log_rate / RATES_SPREAD) ** 2).sum() + 0.5 * ((after / AFTER_SPREAD) ** 2).sum()
        pull = z / spread
        of_rate = parts.beside.T @ (done * ((pull + 1.0) / work)[parts.of]) - parts.beside[parts.last].sum(axis=0)
        of_after = after / AFTER_SPREAD**2 - np.bincount(parts.before, pull, len(before))
        of_spread = (count - z @ z) * np.exp(at[1]) / spread
        slope = np.concatenate([[-pull.sum(), of_spread], of_rate + log_rate / RATES_SPREAD**2, of_after])
        return float(value), slope

    usual = np.log(np.maximum(np.bincount(parts.of, parts.dt_s, count), 1e-6))
    begin = np.concatenate([[np.median(usual), np.log(usual.std() + 0.05)], np.zeros(k + len(before))])
    bounds = [(None, None), (-8.0, 3.0), *[(-4.0, 4.0)] * (k + len(before))]
    best = minimize(density, begin, jac=True, method="L-BFGS-B", bounds=bounds).x
    log_rate, after = best[2 : 2 + k], best[2 + k :]
    work = np.bincount(parts.of, np.exp(parts.beside @ log_rate) * parts.dt_s, count)
    return TaskRates(
        dict(zip(names, np.exp(log_rate).tolist(), strict=True)),
        dict(zip(before, np.exp(after).tolist(), strict=True)),
        float(parts.dt_s.sum() / count),
        work / np.exp(after[parts.before]),
    )


def _parts(runs: Sequence[Run], agent: str, task: str) -> tuple[list[str], list[str], _Parts]:
    """Return the names of what goes on beside a task, those of the agent's own tasks before it, and its parts."""
    cut: list[tuple[str, list[tuple[float, frozenset[str]]]]] = []
    for run in runs:
        previous = ""
        for done in run.tasks.get(agent, ()):
            if done.task == task and done.end_s > done.start_s:
                cut.append((previous, _cut(run, agent, done)))
            previous = done.task
    names = sorted({name for _, some in cut for _, group in some for name in group})
    before = sorted({previous for previous, _ in cut})
    column = {name: number for number, name in enumerate(names)}
    of = np.array([number for number, (_, some) in enumerate(cut) for _ in some], dtype=np.int64)
    every = [part for _, some in cut for part in some]
    grid = np.zeros((len(every), len(names)))
    for row, (_, group) in enumerate(every):
        grid[row, [column[name] for name in group]] = 1.0
    last = np.cumsum([len(some) for _, some in cut]) - 1
    number = np.array([before.index(previous) for previous, _ in cut], dtype=np.int64)
    return names, before, _Parts(of, np.array([dt for dt, _ in every]), grid, last, number)


def _cut(run: Run, agent: str, done: DoneTask) -> list[tuple[float, frozenset[str]]]:
    """Return lengths, s, and what went on beside, of the parts of one repetition, in order of time."""
    others = [
        (beside(name, other.task), other.start_s, other.end_s)
        for name, some in run.tasks.items()
        if name != agent
        for other in some
        if other.start_s < done.end_s and other.end_s > done.start_s
    ]
    times = {done.start_s, done.end_s, *(t for _, *at in others for t in at if done.start_s < t < done.end_s)}
    edges = sorted(times)
    found = []
    for start_s, end_s in pairwise(edges):
        middle = 0.5 * (start_s + end_s)
        group = frozenset(name for name, since, until in others if since <= middle < until)
        found.append((end_s - start_s, group or frozenset((ALONE,))))
    return found
