"""Estimates the rate of a task during each task of the other agents.

A repetition ends when its work is done. Work is done at rate 1 on average, and at a separate rate during each task of
another agent: work = integral of the rate over time. The work of a task's repetitions is log-normal; rates and mean are
maximum-a-posteriori estimates with a prior of rates around 1, because few overlaps carry little information. The
density of the end time contains the rate at the end as a factor; without it, a task that overlaps more only because it
lasted longer would seem slowed. Such coefficients are published for pairs of tasks (arXiv 2503.07238, one factor of the
whole duration per pair); rates over time need no pair to overlap fully.
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
"""Prior standard deviation of a log rate: between half and double with probability of about two thirds."""
FACTOR_SPREAD = 0.1
"""Prior standard deviation of the log factors of the previous task and of the occurrence: the way to a task, and the
slot of a part, change the work only slightly."""
_MIN_SPREAD = 1e-3
ALONE = ""


@dataclass(frozen=True)
class TaskRates:
    """Estimates for one task.

    Attributes:
        rates: Rate by the name of a simultaneous task, `agent: task`; "" = alone.
        after: Factor of the work by the agent's previous task; "" = it is the first.
        turns: Factor of the work at the first, second ... occurrence of the task in an execution.
        usual_s: Mean logged duration, s.
        work: Work of each repetition divided by these factors, s at rate 1; shape (N,).
        number: Number of the execution of each repetition, shape (N,).
    """

    rates: Mapping[str, float]
    after: Mapping[str, float]
    turns: tuple[float, ...]
    usual_s: float
    work: Vector
    number: Ints


@dataclass(frozen=True)
class _Parts:
    """Repetitions of one task, cut where a simultaneous task starts or ends.

    Attributes:
        of: Repetition of each part, shape (M,).
        dt_s: Length of each part, shape (M,), s.
        beside: Which simultaneous tasks each part has, shape (M, names).
        last: Index of the last part of each repetition, shape (N,).
        factors: Which factors apply to each repetition, shape (N, factors).
    """

    of: Ints
    dt_s: Vector
    beside: Floats
    last: Ints
    factors: Floats

    def work(self, log_rate: Vector) -> Vector:
        """Return the work of each repetition, shape (N,), s at rate 1."""
        return np.asarray(np.bincount(self.of, np.exp(self.beside @ log_rate) * self.dt_s, len(self.last)), float)


def beside(agent: str, task: str) -> str:
    """Return the key of a simultaneous task in a table of rates."""
    return f"{agent}: {task}"


def fit_rates(runs: Sequence[Run], agent: str, task: str) -> TaskRates:
    """Return the rates of one agent's task.

    Args:
        runs: Executions; at least one contains the task.
        agent: Name of the agent.
        task: Name of the task.
    """
    names, before, parts = _parts(runs, agent, task)
    k = len(names)
    usual = np.log(np.maximum(np.bincount(parts.of, parts.dt_s), 1e-6))
    begin = np.concatenate([[np.median(usual), np.log(usual.std() + 0.05)], np.zeros(k + parts.factors.shape[1])])
    bounds = [(None, None), (-8.0, 3.0), *[(-4.0, 4.0)] * (len(begin) - 2)]
    best = minimize(_density, begin, args=(parts,), jac=True, method="L-BFGS-B", bounds=bounds).x
    log_rate, factor = best[2 : 2 + k], best[2 + k :]
    factors = np.exp(factor).tolist()
    return TaskRates(
        dict(zip(names, np.exp(log_rate).tolist(), strict=True)),
        dict(zip(before, factors, strict=False)),
        tuple(factors[len(before) :]),
        float(parts.dt_s.sum() / len(parts.last)),
        parts.work(log_rate) / np.exp(parts.factors @ factor),
        np.array([run.number for run in runs for _ in _done(run, agent, task)], dtype=np.int64),
    )


def _density(at: Vector, parts: _Parts) -> tuple[float, Vector]:
    """Return the negative log posterior density, and its gradient."""
    k, count = parts.beside.shape[1], len(parts.last)
    mean, spread, log_rate, factor = at[0], np.exp(at[1]) + _MIN_SPREAD, at[2 : 2 + k], at[2 + k :]
    work, ends = parts.work(log_rate), parts.beside[parts.last]
    z = (np.log(work) - mean - parts.factors @ factor) / spread
    value = 0.5 * z @ z + count * np.log(spread) + np.log(work).sum() - (ends @ log_rate).sum()
    value += 0.5 * ((log_rate / RATES_SPREAD) ** 2).sum() + 0.5 * ((factor / FACTOR_SPREAD) ** 2).sum()
    pull = z / spread
    done = np.exp(parts.beside @ log_rate) * parts.dt_s
    of_rate = parts.beside.T @ (done * ((pull + 1.0) / work)[parts.of]) - ends.sum(axis=0)
    of_spread = (count - z @ z) * np.exp(at[1]) / spread
    of_factor = factor / FACTOR_SPREAD**2 - parts.factors.T @ pull
    return float(value), np.concatenate([[-pull.sum(), of_spread], of_rate + log_rate / RATES_SPREAD**2, of_factor])


def _parts(runs: Sequence[Run], agent: str, task: str) -> tuple[list[str], list[str], _Parts]:
    """Return the names of simultaneous tasks, the names of the agent's previous tasks, and the parts."""
    cut: list[tuple[str, int, list[tuple[float, frozenset[str]]]]] = []
    for run in runs:
        for turn, (previous, done) in enumerate(_done(run, agent, task)):
            cut.append((previous, turn, _cut(run, agent, done)))
    names = sorted({name for *_, some in cut for _, group in some for name in group})
    before = sorted({previous for previous, *_ in cut})
    column = {name: number for number, name in enumerate(names)}
    of = np.array([number for number, (*_, some) in enumerate(cut) for _ in some], dtype=np.int64)
    every = [part for *_, some in cut for part in some]
    grid = np.zeros((len(every), len(names)))
    for row, (_, group) in enumerate(every):
        grid[row, [column[name] for name in group]] = 1.0
    last = np.cumsum([len(some) for *_, some in cut]) - 1
    factors = np.zeros((len(cut), len(before) + max(turn for _, turn, _ in cut) + 1))
    for row, (previous, turn, _) in enumerate(cut):
        factors[row, [before.index(previous), len(before) + turn]] = 1.0
    return names, before, _Parts(of, np.array([length_s for length_s, _ in every]), grid, last, factors)


def _done(run: Run, agent: str, task: str) -> list[tuple[str, DoneTask]]:
    """Return the repetitions of a task in an execution, each with the name of the agent's previous task."""
    mine = run.tasks.get(agent, ())
    before = ["", *(done.task for done in mine)]
    return [
        (one, done) for one, done in zip(before, mine, strict=False) if done.task == task and done.end_s > done.start_s
    ]


def _cut(run: Run, agent: str, done: DoneTask) -> list[tuple[float, frozenset[str]]]:
    """Return length, s, and simultaneous tasks of each part of one repetition, ordered by time."""
    others = [(name, other) for name, some in run.tasks.items() if name != agent for other in some]
    at = {t for _, other in others for t in (other.start_s, other.end_s) if done.start_s < t < done.end_s}
    found = []
    for start_s, end_s in pairwise(sorted({done.start_s, done.end_s, *at})):
        middle = 0.5 * (start_s + end_s)
        group = frozenset(beside(name, other.task) for name, other in others if other.start_s <= middle < other.end_s)
        found.append((end_s - start_s, group or frozenset((ALONE,))))
    return found
