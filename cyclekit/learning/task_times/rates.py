"""How fast a task goes on beside each task of the other agents, and while another agent waits.

A repetition ends when its work is done; work is done at rate 1 on average, and at a rate of its own beside each task of
another agent: work = sum over the time of rate(beside). The work of the repetitions of one task is taken as log-normal
about a mean, and rates and mean are those of greatest posterior density, with rates drawn towards 1 (few overlaps tell
little). The density of the end time has the rate at the end as a factor: without it a task that lasted longer, and
overlapped more for that reason alone, would look slowed. Coefficients of this kind are published for pairs of tasks
(arXiv 2503.07238, where each pair has one factor of the whole duration); rates over time need no pair to overlap fully.

A rate beside a task has a factor of the turn (the second part lies in another slot than the first). An agent between
two tasks is still in the way, where his last task has left him; one whose tasks are all done may have gone: the rate
alone has a factor for either. Few logs bear such detail: whether it is asked for is decided on held-out orders.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

from cyclekit.dataset.cards.task_model import DETAIL

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.learning.task_times.runs import DoneTask, Run
    from cyclekit.schema import Floats, Ints, Vector

RATES_SPREAD = 0.7
"""Standard deviation of the logarithm of a rate, before anything is seen: half to double, two times of three."""
DETAIL_SPREAD = 0.2
"""The same of the factors of a rate: by the turn of the task beside, and by where an agent waits."""
FACTOR_SPREAD = 0.1
"""The same of the factors of the agent's own task before and of the turn: the way to a task, and the slot that a part
comes from, are a small part of it."""
_LEAST_SPREAD = 1e-3
ALONE = ""
_WAITING = f"{DETAIL}waiting"


@dataclass(frozen=True)
class TaskRates:
    """What is learned of one task.

    Attributes:
        rates: By what goes on beside it; see `beside` and `idle`. Those of all names that apply are multiplied.
        after: Factor of the work by the agent's own task before it; "" = it is the first.
        turns: Factor of the work the first, second ... time of the task in one execution.
        usual_s: Mean logged duration, s.
        work: Of each repetition with these factors taken out, s at rate 1; shape (N,).
        number: The how-many-th execution each repetition is of, shape (N,).
    """

    rates: Mapping[str, float]
    after: Mapping[str, float]
    turns: tuple[float, ...]
    usual_s: float
    work: Vector
    number: Ints


@dataclass(frozen=True)
class _Parts:
    """Repetitions of one task cut where a task beside it begins or ends.

    Attributes:
        of: Repetition of each part, shape (M,).
        dt_s: Its length, shape (M,).
        beside: What goes on beside it, shape (M, names).
        last: Index of the last part of each repetition, shape (N,).
        factors: Which factors each repetition has, shape (N, factors).
        spread: Standard deviation of each logarithm of a rate, before anything is seen, shape (names,).
    """

    of: Ints
    dt_s: Vector
    beside: Floats
    last: Ints
    factors: Floats
    spread: Vector

    def work(self, log_rate: Vector) -> Vector:
        """Return the work of each repetition, shape (N,), s at rate 1."""
        return np.asarray(np.bincount(self.of, np.exp(self.beside @ log_rate) * self.dt_s, len(self.last)), float)


def beside(agent: str, task: str, turn: int) -> tuple[str, ...]:
    """Return how a task of another agent is named in a table of rates: the task, and its turn in the execution."""
    return f"{agent}: {task}", f"{agent}: {task}{DETAIL}turn {turn + 1}"


def idle(last: tuple[str, str, int] | None, left: bool) -> tuple[str, ...]:
    """Return how it is named that no other agent is at work.

    Args:
        last: Agent, task and turn of what another agent has ended last; None = none has ended yet.
        left: That agent has tasks left, or all others have.
    """
    where = [f"{name}{DETAIL}ended" for name in beside(*last)] if last else []
    return (ALONE, *([_WAITING] if left else []), *where)


def fit_rates(runs: Sequence[Run], agent: str, task: str, *, detailed: bool = False) -> TaskRates:
    """Return the rates of one task of one agent.

    Args:
        runs: At least one of them holds the task.
        agent: Whose task.
        task: Which.
        detailed: With factors of the rates, by the turn of the task beside and by where an agent waits.
    """
    names, before, parts = _parts(runs, agent, task, detailed=detailed)
    best = _fitted(parts)
    log_rate, factor = best[2 : 2 + len(names)], best[2 + len(names) :]
    factors = np.exp(factor).tolist()
    rates = dict(zip(names, np.exp(log_rate).tolist(), strict=True))
    return TaskRates(
        _centred(rates) if detailed else rates,
        dict(zip(before, factors, strict=False)),
        tuple(factors[len(before) :]),
        float(parts.dt_s.sum() / len(parts.last)),
        parts.work(log_rate) / np.exp(parts.factors @ factor),
        np.array([run.number for run in runs for _ in _done(run, agent, task)], dtype=np.int64),
    )


def _fitted(parts: _Parts) -> Vector:
    """Return where the posterior density is greatest."""
    usual = np.log(np.maximum(np.bincount(parts.of, parts.dt_s), 1e-6))
    more = parts.beside.shape[1] + parts.factors.shape[1]
    begin = np.concatenate([[np.median(usual), np.log(usual.std() + 0.05)], np.zeros(more)])
    bounds = [(None, None), (-8.0, 3.0), *[(-4.0, 4.0)] * more]
    return np.asarray(minimize(_density, begin, args=(parts,), jac=True, method="L-BFGS-B", bounds=bounds).x)


def _centred(rates: dict[str, float]) -> dict[str, float]:
    """Return rates where that beside a task holds what its turns have in common."""
    found = dict(rates)
    for name in rates:
        turns = [each for each in rates if each.startswith(f"{name}{DETAIL}turn ") and each.count(DETAIL) == 1]
        if turns and DETAIL not in name:
            mean = float(np.exp(np.mean(np.log([rates[each] for each in turns]))))
            found |= {name: rates[name] * mean, **{each: rates[each] / mean for each in turns}}
    return found


def _density(at: Vector, parts: _Parts) -> tuple[float, Vector]:
    """Return the negative logarithm of the posterior density, and its slope."""
    k, count = parts.beside.shape[1], len(parts.last)
    mean, spread, log_rate, factor = at[0], np.exp(at[1]) + _LEAST_SPREAD, at[2 : 2 + k], at[2 + k :]
    work, ends = parts.work(log_rate), parts.beside[parts.last]
    z = (np.log(work) - mean - parts.factors @ factor) / spread
    value = 0.5 * z @ z + count * np.log(spread) + np.log(work).sum() - (ends @ log_rate).sum()
    value += 0.5 * ((log_rate / parts.spread) ** 2).sum() + 0.5 * ((factor / FACTOR_SPREAD) ** 2).sum()
    pull = z / spread
    done = np.exp(parts.beside @ log_rate) * parts.dt_s
    of_rate = parts.beside.T @ (done * ((pull + 1.0) / work)[parts.of]) - ends.sum(axis=0)
    of_spread = (count - z @ z) * np.exp(at[1]) / spread
    of_factor = factor / FACTOR_SPREAD**2 - parts.factors.T @ pull
    return float(value), np.concatenate([[-pull.sum(), of_spread], of_rate + log_rate / parts.spread**2, of_factor])


def _parts(
    runs: Sequence[Run], agent: str, task: str, *, detailed: bool = False
) -> tuple[list[str], list[str], _Parts]:
    """Return the names of what goes on beside a task, those of the agent's own tasks before it, and its parts."""
    cut: list[tuple[str, int, list[tuple[float, frozenset[str]]]]] = []
    for run in runs:
        for turn, (previous, done) in enumerate(_done(run, agent, task)):
            cut.append((previous, turn, _cut(run, agent, done, detailed=detailed)))
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
    spread = np.array([DETAIL_SPREAD if DETAIL in name else RATES_SPREAD for name in names])
    return names, before, _Parts(of, np.array([length_s for length_s, _ in every]), grid, last, factors, spread)


def _done(run: Run, agent: str, task: str) -> list[tuple[str, DoneTask]]:
    """Return the repetitions of a task in an execution, each with the name of the agent's own task before it."""
    mine = run.tasks.get(agent, ())
    before = ["", *(done.task for done in mine)]
    return [
        (one, done) for one, done in zip(before, mine, strict=False) if done.task == task and done.end_s > done.start_s
    ]


def _cut(run: Run, agent: str, done: DoneTask, *, detailed: bool) -> list[tuple[float, frozenset[str]]]:
    """Return lengths, s, and what went on beside, of the parts of one repetition, in order of time."""
    agents = [name for name in run.tasks if name != agent]
    others = [(other, (name, other.task, turn)) for name in agents for other, turn in run.turns(name)]
    at = {t for other, _ in others for t in (other.start_s, other.end_s) if done.start_s < t < done.end_s}
    found = []
    for start_s, end_s in pairwise(sorted({done.start_s, done.end_s, *at})):
        middle = 0.5 * (start_s + end_s)
        group = [beside(*named) for other, named in others if other.start_s <= middle < other.end_s]
        if not group:
            last = max(((other.end_s, named) for other, named in others if other.end_s <= middle), default=None)
            named = last[1] if last else None
            left = any(other.end_s > middle and (not named or name == named[0]) for other, (name, *_) in others)
            group = [idle(named, left)]
        told = None if detailed else 1
        found.append((end_s - start_s, frozenset(name for names in group for name in names[:told])))
    return found
