"""Estimates the rate of a task during each task of the other agents.

A repetition ends when its work is done. Work is done at rate 1 on average, and at a separate rate during each task of
another agent: work = integral of the rate over time. The work of a task's repetitions is log-normal; rates and mean are
maximum-a-posteriori estimates with a prior of rates around 1, because few overlaps carry little information. How far
rates spread around 1 is estimated from all tasks together (marginal likelihood in Laplace's approximation, updates of
MacKay 1992, "Bayesian interpolation"), so that what changes nothing in a cell is shrunk to nothing. The
density of the end time contains the rate at the end as a factor; without it, a task that overlaps more only because it
lasted longer would seem slowed. Such coefficients are published for pairs of tasks (arXiv 2503.07238, one factor of the
whole duration per pair); rates over time need no pair to overlap fully.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import minimize

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cyclekit.learning.task_times.runs import DoneTask, Run
    from cyclekit.schema import Floats, Ints, Vector

SPREADS = {"rates": 0.7, "alone": 0.7, "later": 0.4, "waiting": 0.3, "previous": 0.1, "turn": 0.1}
"""Prior standard deviations of what changes the logarithm of a rate or of the work, before the logs are seen:

rates     a simultaneous task: between half and double with probability of about two thirds
alone     no simultaneous task
later     ratio of the rates in the second and the first half of a simultaneous task
waiting   another agent waits after one of his tasks
previous  the agent's previous task: the way to a task
turn      the first, second ... time in an execution: the slot of a part
"""
SPREADS_COUNT = 0.1
"""Weight of these in the estimated spreads, as a number of effects."""
MOST_SPREAD = 2.0
"""Maximum estimated spread, as a multiple of these: tasks that always run alike determine none."""
ROUNDS = 5
"""Number of times that rates and spreads are estimated in turn."""
STEPS = 40
"""Number of updates of the spreads each time."""
MOST = 4.0
"""Maximum absolute effect on the logarithm of a rate or of the work."""
LIKE_OTHERS = 4.0
"""Weight of all tasks' scatter in that of one, as a number of repetitions."""
_FREE = 1e-6
_MIN_SPREAD = 1e-3
ALONE = ""


@dataclass(frozen=True)
class TaskRates:
    """Estimates for one task.

    Attributes:
        rates: Rate by the name of a simultaneous task, `agent: task`; "" = alone. Geometric mean of its two halves.
        later: Rate in the second half of a simultaneous task divided by the rate in its first half.
        waiting: Factor of the rate alone while another agent, who has ended this task, waits for his next one.
        after: Factor of the work by the agent's previous task; "" = it is the first.
        turns: Factor of the work at the first, second ... occurrence of the task in an execution.
        usual_s: Mean logged duration, s.
        work: Work of each repetition divided by these factors, s at rate 1; shape (N,).
        number: Number of the execution of each repetition, shape (N,).
    """

    rates: Mapping[str, float]
    later: Mapping[str, float]
    waiting: Mapping[str, float]
    after: Mapping[str, float]
    turns: tuple[float, ...]
    usual_s: float
    work: Vector
    number: Ints


class _Column(NamedTuple):
    """What changes a rate: `rates`, `alone`, `later` or `waiting`, and the name of the simultaneous or last task."""

    kind: str
    name: str


_Part = tuple[float, dict[_Column, float]]
"""Length, s, and how much of each column it has."""


@dataclass(frozen=True)
class _Parts:
    """Repetitions of one task, cut where a simultaneous task starts, is half over, or ends.

    Attributes:
        columns: What changes the rate.
        before: Names of the agent's previous tasks.
        number: Number of the execution of each repetition, shape (N,).
        of: Repetition of each part, shape (M,).
        dt_s: Length of each part, shape (M,), s.
        beside: What changes the rate in each part, and how much, shape (M, columns).
        last: Index of the last part of each repetition, shape (N,).
        factors: Which factors of the work apply to each repetition, shape (N, factors): of `before`, then of the turns.
    """

    columns: list[_Column]
    before: list[str]
    number: Ints
    of: Ints
    dt_s: Vector
    beside: Floats
    last: Ints
    factors: Floats

    @property
    def kinds(self) -> list[str]:
        """Kind of each effect: on the rate, then on the work."""
        turns = self.factors.shape[1] - len(self.before)
        return [*(each.kind for each in self.columns), *["previous"] * len(self.before), *["turn"] * turns]

    def work(self, log_rate: Vector) -> Vector:
        """Return the work of each repetition, shape (N,), s at rate 1."""
        return np.asarray(np.bincount(self.of, np.exp(self.beside @ log_rate) * self.dt_s, len(self.last)), float)


def beside(agent: str, task: str) -> str:
    """Return the key of a simultaneous task in a table of rates."""
    return f"{agent}: {task}"


def fit_rates(runs: Sequence[Run], pairs: Iterable[tuple[str, str]]) -> dict[tuple[str, str], TaskRates]:
    """Return the rates of tasks.

    Args:
        runs: Executions.
        pairs: Agent and task; at least one execution contains it.
    """
    every = {pair: _parts(runs, *pair) for pair in pairs}
    spreads, best = SPREADS, {pair: _begin(parts) for pair, parts in every.items()}
    least = dict.fromkeys(every, -8.0)
    for _ in range(ROUNDS):
        best = {pair: _best(parts, spreads, best[pair], least[pair]) for pair, parts in every.items()}
        fits = [(parts, best[pair]) for pair, parts in every.items()]
        spreads, scatter = _spreads(fits, spreads)
        least = dict(zip(every, scatter, strict=True))
    return {pair: _rates(parts, best[pair]) for pair, parts in every.items()}


def _begin(parts: _Parts) -> Vector:
    usual = np.log(np.maximum(np.bincount(parts.of, parts.dt_s), 1e-6))
    return np.concatenate([[np.median(usual), np.log(usual.std() + 0.05)], np.zeros(len(parts.kinds))])


def _best(parts: _Parts, spreads: Mapping[str, float], begin: Vector, least: float) -> Vector:
    """Return mean and log spread of the log work, and all effects, at the maximum of the posterior density.

    The log spread is at least `least`: effects fitted to few repetitions leave too little of it.
    """
    spread = np.array([spreads[kind] for kind in parts.kinds])
    bounds = [(None, None), (least, 3.0), *[(-MOST, MOST)] * len(spread)]
    begin = np.concatenate([begin[:1], [max(begin[1], least)], begin[2:]])
    best = minimize(_density, begin, args=(parts, spread), jac=True, method="L-BFGS-B", bounds=bounds).x
    return np.asarray(best)


def _density(at: Vector, parts: _Parts, prior: Vector) -> tuple[float, Vector]:
    """Return the negative log posterior density, and its gradient."""
    k, count = parts.beside.shape[1], len(parts.last)
    mean, spread, log_rate, factor = at[0], np.exp(at[1]) + _MIN_SPREAD, at[2 : 2 + k], at[2 + k :]
    work, ends = parts.work(log_rate), parts.beside[parts.last]
    z = (np.log(work) - mean - parts.factors @ factor) / spread
    value = 0.5 * z @ z + count * np.log(spread) + np.log(work).sum() - (ends @ log_rate).sum()
    value += 0.5 * ((at[2:] / prior) ** 2).sum()
    pull = z / spread
    done = np.exp(parts.beside @ log_rate) * parts.dt_s
    of_rate = parts.beside.T @ (done * ((pull + 1.0) / work)[parts.of]) - ends.sum(axis=0)
    of_spread = (count - z @ z) * np.exp(at[1]) / spread
    of_effects = np.concatenate([of_rate, -parts.factors.T @ pull]) + at[2:] / prior**2
    return float(value), np.concatenate([[-pull.sum(), of_spread], of_effects])


class _Quadratic:
    """The likelihood of one task around its best effects.

    Attributes:
        kinds: Kind of each effect.
        squares: Sum of the squared residuals of the log work.
        left: Number of repetitions that the effects have not used up.
        scatter: Variance of the log work.
        most: That without any effect.
    """

    def __init__(self, parts: _Parts, at: Vector) -> None:
        k, self.kinds = parts.beside.shape[1], parts.kinds
        done = np.exp(parts.beside @ at[2 : 2 + k]) * parts.dt_s
        work = np.bincount(parts.of, done)
        of_rate = np.zeros((len(parts.last), k))
        np.add.at(of_rate, parts.of, parts.beside * (done / work[parts.of])[:, None])
        slope = np.hstack([np.ones((len(of_rate), 1)), -of_rate, parts.factors])
        off = np.log(work) - at[0] - parts.factors @ at[2 + k :]
        self._squares, self._gram, self.squares = at[2:] ** 2, slope.T @ slope, float(off @ off)
        self.scatter, self.left = (np.exp(at[1]) + _MIN_SPREAD) ** 2, float(len(off))
        self.most = float(np.exp(2.0 * _begin(parts)[1]))

    def squared(self, spreads: Mapping[str, float]) -> Vector:
        """Return the expected square of each effect, given the spreads; updates `left`."""
        known = np.append(_FREE, [spreads[kind] ** -2 for kind in self.kinds])
        variance = np.linalg.inv(self._gram / self.scatter + np.diag(known))
        determined = np.trace(self._gram @ variance) / self.scatter
        self.left = max(float(self._gram[0, 0] - determined), 0.0)
        return np.asarray(self._squares + np.diag(variance)[1:])


def _spreads(
    fits: Sequence[tuple[_Parts, Vector]], spreads: Mapping[str, float]
) -> tuple[dict[str, float], list[float]]:
    """Return the spread of each kind of effect and the log scatter of each task's work that make the logs most likely.

    The effects were fitted to the same repetitions, so the scatter is that of the residuals by the repetitions that are
    left; with few of them, close to that of the other tasks.
    """
    now, tasks = dict(spreads), [_Quadratic(parts, at) for parts, at in fits]
    for _ in range(STEPS):
        total = {kind: SPREADS_COUNT * spread**2 for kind, spread in SPREADS.items()}
        count = dict.fromkeys(SPREADS, SPREADS_COUNT)
        for task in tasks:
            for kind, each in zip(task.kinds, task.squared(now), strict=True):
                total[kind] += float(each)
                count[kind] += 1.0
        now = {kind: min(float(np.sqrt(total[kind] / count[kind])), MOST_SPREAD * SPREADS[kind]) for kind in SPREADS}
        usual = float(np.median([task.squares / max(task.left, 1.0) for task in tasks]))
        for task in tasks:
            found = (task.squares + LIKE_OTHERS * usual) / (task.left + LIKE_OTHERS) + _MIN_SPREAD**2
            task.scatter = min(found, task.most)
    return now, [0.5 * float(np.log(task.scatter)) for task in tasks]


def _rates(parts: _Parts, at: Vector) -> TaskRates:
    k = parts.beside.shape[1]
    effects = np.exp(at[2:]).tolist()
    found: dict[str, dict[str, float]] = {"rates": {}, "later": {}, "waiting": {}}
    for column, effect in zip(parts.columns, effects, strict=False):
        found["rates" if column.kind == "alone" else column.kind][column.name] = effect
    factors = effects[k:]
    return TaskRates(
        **found,
        after=dict(zip(parts.before, factors, strict=False)),
        turns=tuple(factors[len(parts.before) :]),
        usual_s=float(parts.dt_s.sum() / len(parts.last)),
        work=parts.work(at[2 : 2 + k]) / np.exp(parts.factors @ at[2 + k :]),
        number=parts.number,
    )


def _parts(runs: Sequence[Run], agent: str, task: str) -> _Parts:
    done = [(run, *each) for run in runs for each in _done(run, agent, task)]
    told = [each for each in done if each[-1].counts] or [min(done, key=lambda each: each[-1].took_s)]
    cut = [(run.number, previous, turn, _cut(run, agent, done)) for run, turn, previous, done in told]
    every = [part for *_, some in cut for part in some]
    columns = sorted({column for _, group in every for column in group})
    before = sorted({previous for _, previous, *_ in cut})
    at = {column: number for number, column in enumerate(columns)}
    grid = np.zeros((len(every), len(columns)))
    for row, (_, group) in enumerate(every):
        grid[row, [at[column] for column in group]] = list(group.values())
    factors = np.zeros((len(cut), len(before) + max(turn for *_, turn, _ in cut) + 1))
    for row, (_, previous, turn, _) in enumerate(cut):
        factors[row, [before.index(previous), len(before) + turn]] = 1.0
    return _Parts(
        columns,
        before,
        np.array([number for number, *_ in cut], dtype=np.int64),
        np.array([number for number, (*_, some) in enumerate(cut) for _ in some], dtype=np.int64),
        np.array([length_s for length_s, _ in every]),
        grid,
        np.cumsum([len(some) for *_, some in cut]) - 1,
        factors,
    )


def _done(run: Run, agent: str, task: str) -> list[tuple[int, str, DoneTask]]:
    """Return the repetitions of a task in an execution, each with its turn and the agent's previous task."""
    mine = [done for done in run.tasks.get(agent, ()) if done.task != task or done.took_s > 0.0]
    before = ["", *(done.task for done in mine)]
    found = [(one, done) for one, done in zip(before, mine, strict=False) if done.task == task]
    return [(turn, *each) for turn, each in enumerate(found)]


def _cut(run: Run, agent: str, done: DoneTask) -> list[_Part]:
    """Return the parts of one repetition, ordered by time. A joint task ends as its other side does, and is alone."""
    others = [(name, other) for name, some in run.tasks.items() if name != agent for other in some]
    others = [(name, other) for name, other in others if (name, other.task) != done.mate]
    edges = (t for _, other in others for t in (other.start_s, _half_s(other), other.end_s))
    at = {t for t in edges if done.start_s < t < done.end_s}
    found = []
    for start_s, end_s in pairwise(sorted({done.start_s, done.end_s, *at})):
        middle = 0.5 * (start_s + end_s)
        group: dict[_Column, float] = {}
        for name, other in others:
            if other.start_s <= middle < other.end_s:
                group[_Column("rates", beside(name, other.task))] = 1.0
                group[_Column("later", beside(name, other.task))] = 0.5 if middle >= _half_s(other) else -0.5
        if not group:
            group[_Column("alone", ALONE)] = 1.0
            group |= {_Column("waiting", name): 1.0 for name in _waiting(run, agent, middle)}
        found.append((end_s - start_s, group))
    return found


def _half_s(done: DoneTask) -> float:
    return 0.5 * (done.start_s + done.end_s)


def _waiting(run: Run, agent: str, at_s: float) -> list[str]:
    """Return the last task of each other agent who waits at a time when none of them has a task."""
    found = []
    for name, some in run.tasks.items():
        past = [done.task for done in some if done.end_s <= at_s]
        if any(done.start_s <= at_s < done.end_s for done in some):  # the other side of a joint task
            continue
        if name != agent and past and any(done.start_s > at_s for done in some):
            found.append(beside(name, past[-1]))
    return found
