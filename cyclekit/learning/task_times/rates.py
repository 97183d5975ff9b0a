"""Estimates the rate of a task during each task of the other agents.

A repetition ends when its work is done. Work is done at rate 1 on average, and at a separate rate during each task of
another agent: work = integral of the rate over time. The work of a task's repetitions is log-normal; rates and mean are
maximum-a-posteriori estimates with a prior of rates around 1, because few overlaps carry little information. How far
rates spread around 1 is estimated from all tasks together (marginal likelihood in Laplace's approximation, updates of
MacKay 1992, "Bayesian interpolation"), so that what changes nothing in a cell is shrunk to nothing. Which
occurrence of another task it is, which task runs at the start, and at which position in its agent's order a task is
(the slot of a part), matter to few tasks: such effects are added to a task one kind after the other, each only if it
makes the task's repetitions clearly more likely (marginal likelihood). The
density of the end time contains the rate at the end as a factor; without it, a task that overlaps more only because it
lasted longer would seem slowed. Such coefficients are published for pairs of tasks (arXiv 2503.07238, one factor of the
whole duration per pair); rates over time need no pair to overlap fully.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.learning.task_times.fit import SPREADS, Quadratic, begin_at, best_at, evidence
from cyclekit.learning.task_times.parts import Effect, Parts, task_parts

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cyclekit.learning.task_times.runs import Run
    from cyclekit.schema import Ints, Vector

ROUNDS = 20
"""Number of times that rates and spreads are estimated in turn: with few, effects that do not exist remain."""
MORE_ROUNDS = 6
"""The same for the effects of a single task, whose spreads begin near their end."""
STEPS = 10
"""Number of updates of the spreads each time."""
SPREADS_COUNT = 0.01
"""Weight of these in the estimated spreads, as a number of effects."""
MOST_SPREAD = 2.0
"""Maximum estimated spread, as a multiple of these: tasks that always run alike determine none."""
SPREADS_LIKE = 4.0
"""Weight of all tasks' spread in that of a task with more effects, as a number of effects."""
MORE = {
    ("nth", "nth waiting"): 3.0,
    ("at start",): 3.0,
    ("position", "position waiting"): 5.0,
    ("own position",): 5.0,
}
"""Kinds of effects that are added to single tasks, with the minimum gain in log marginal likelihood.

Positions are more than occurrences, so with few executions they more often seem to matter.
"""


@dataclass(frozen=True)
class TaskRates:
    """Estimates for one task.

    Attributes:
        rates: Rate by the name of a simultaneous task, `agent: task`; "" = alone. Geometric mean of its two halves.
        later: Rate in the second half of a simultaneous task divided by the rate in its first half.
        waiting: Factor of the rate alone while another agent, who has ended this task, waits for his next one.
        nth, nth_waiting: Factors of `rates` and `waiting` at the first, second ... occurrence of that task.
        position, position_waiting: The same at that task's position in its agent's order: first, second ...
        at_start: Factor of the work by the name of the simultaneous task at the start.
        after: Factor of the work by the agent's previous task; "" = it is the first.
        turns: Factor of the work at the first, second ... occurrence of the task in an execution.
        own_position: Factor of the work at the task's own position in its agent's order: first, second ...
        usual_s: Mean logged duration, s.
        work: Work of each repetition divided by these factors, s at rate 1; shape (N,).
        number: Number of the execution of each repetition, shape (N,).
    """

    rates: Mapping[str, float]
    later: Mapping[str, float]
    waiting: Mapping[str, float]
    nth: Mapping[str, tuple[float, ...]]
    nth_waiting: Mapping[str, tuple[float, ...]]
    position: Mapping[str, tuple[float, ...]]
    position_waiting: Mapping[str, tuple[float, ...]]
    at_start: Mapping[str, float]
    after: Mapping[str, float]
    turns: tuple[float, ...]
    own_position: tuple[float, ...]
    usual_s: float
    work: Vector
    number: Ints


class _Fit(NamedTuple):
    """Repetitions of one task; mean, log spread and effects; the spread of each kind of effect; the log scatter.

    Also the likelihood around these effects, if it is known.
    """

    parts: Parts
    at: Vector
    spreads: Mapping[str, float]
    log_scatter: float
    there: Quadratic | None = None


def fit_rates(runs: Sequence[Run], pairs: Iterable[tuple[str, str]]) -> dict[tuple[str, str], TaskRates]:
    """Return the rates of tasks.

    Args:
        runs: Executions.
        pairs: Agent and task; at least one execution contains it.
    """
    every = {pair: task_parts(runs, *pair) for pair in pairs}
    plain = {pair: parts.without({kind for kinds in MORE for kind in kinds}) for pair, parts in every.items()}
    spreads, best = SPREADS, {pair: begin_at(parts) for pair, parts in plain.items()}
    least = dict.fromkeys(every, -8.0)
    there: dict[tuple[str, str], Quadratic] = {}
    for _ in range(ROUNDS):
        best = {
            pair: best_at(parts, spreads, best[pair], least[pair], there.get(pair)) for pair, parts in plain.items()
        }
        there = {pair: Quadratic(parts, best[pair]) for pair, parts in plain.items()}
        spreads, scatter = _spreads(list(there.values()), spreads)
        least = dict(zip(every, scatter, strict=True))
    best = {pair: best_at(parts, spreads, best[pair], least[pair], there[pair]) for pair, parts in plain.items()}
    return {
        pair: _rates(*_with_more(parts, _Fit(plain[pair], best[pair], spreads, least[pair])))
        for pair, parts in every.items()
    }


def _with_more(parts: Parts, plain: _Fit) -> tuple[Parts, Vector]:
    """Return a fit with the further effects that the repetitions of a task show clearly, or the plain one."""
    found, likely = plain, evidence(plain.parts, plain.at, plain.spreads)
    left = {kind for kinds in MORE for kind in kinds}
    for _ in MORE:
        tried = []
        for kinds, gain in MORE.items():
            more = parts.without(left - set(kinds))
            if len(more.effects) > len(found.parts.effects):
                fit = _refitted(more, plain)
                tried.append((evidence(fit.parts, fit.at, fit.spreads, fit.there) - likely - gain, kinds, fit))
        # the first of kinds that say the same, as where a task is always at the same position
        best = max(tried, key=lambda each: round(each[0], 3), default=None)
        if best is None or best[0] <= 0.0:
            break
        likely, found = likely + best[0] + MORE[best[1]], best[2]
        left -= set(best[1])
    return found.parts, found.at


def _refitted(parts: Parts, plain: _Fit) -> _Fit:
    """Return the fit of one task with further effects; its spreads are near those of all tasks."""
    known = dict(zip(plain.parts.effects, plain.at[2:], strict=True))
    at = np.concatenate([plain.at[:2], [known.get(effect, 0.0) for effect in parts.effects]])
    usual, log_scatter = _of_kinds(plain.spreads), plain.log_scatter
    now, task = usual, None
    for _ in range(MORE_ROUNDS):
        at = best_at(parts, _by_kind(now), at, log_scatter, task)
        task = Quadratic(parts, at)
        count = SPREADS_LIKE + np.bincount(task.kinds, minlength=len(now))
        for _ in range(STEPS):
            total = np.bincount(task.kinds, task.squared(now[task.kinds]), len(now))
            now = np.sqrt((SPREADS_LIKE * usual**2 + total) / count)
            task.updated(float(np.exp(2.0 * plain.log_scatter)))
        log_scatter = 0.5 * float(np.log(task.scatter))
    return _Fit(parts, at, _by_kind(now), log_scatter, task)


def _spreads(tasks: Sequence[Quadratic], spreads: Mapping[str, float]) -> tuple[dict[str, float], list[float]]:
    """Return the spread of each kind of effect and the log scatter of each task's work that make the logs most likely.

    The effects were fitted to the same repetitions, so the scatter is that of the residuals by the repetitions that are
    left; with few of them, close to that of the other tasks.
    """
    now, prior = _of_kinds(spreads), _of_kinds(SPREADS)
    count = SPREADS_COUNT + sum(np.bincount(task.kinds, minlength=len(now)) for task in tasks)
    for _ in range(STEPS):
        total = SPREADS_COUNT * prior**2
        for task in tasks:
            total += np.bincount(task.kinds, task.squared(now[task.kinds]), len(now))
        now = np.minimum(np.sqrt(total / count), MOST_SPREAD * prior)
        usual = float(np.median([task.squares / max(task.left, 1.0) for task in tasks]))
        for task in tasks:
            task.updated(usual)
    return _by_kind(now), [0.5 * float(np.log(task.scatter)) for task in tasks]


def _of_kinds(spreads: Mapping[str, float]) -> Vector:
    """Return spreads in the order of SPREADS."""
    return np.array([spreads[kind] for kind in SPREADS])


def _by_kind(spreads: Vector) -> dict[str, float]:
    return dict(zip(SPREADS, spreads.tolist(), strict=True))


def _rates(parts: Parts, at: Vector) -> TaskRates:
    k = len(parts.on_rate)
    effects = dict(zip(parts.effects, np.exp(at[2:]).tolist(), strict=True))
    return TaskRates(
        rates=_named(effects, "rates", "alone"),
        later=_named(effects, "later"),
        waiting=_named(effects, "waiting"),
        nth=_by_turn(effects, "nth"),
        nth_waiting=_by_turn(effects, "nth waiting"),
        position=_by_turn(effects, "position"),
        position_waiting=_by_turn(effects, "position waiting"),
        at_start=_named(effects, "at start"),
        after=_named(effects, "previous"),
        turns=_by_turn(effects, "turn")[""],
        own_position=_by_turn(effects, "own position").get("", ()),
        usual_s=float(parts.dt_s.sum() / len(parts.last)),
        work=parts.work(parts.done(at[2 : 2 + k])) / np.exp(parts.factors @ at[2 + k :]),
        number=parts.number,
    )


def _named(effects: Mapping[Effect, float], *kinds: str) -> dict[str, float]:
    return {each.name: effect for each, effect in effects.items() if each.kind in kinds}


def _by_turn(effects: Mapping[Effect, float], kind: str) -> dict[str, tuple[float, ...]]:
    """Return the effects of one kind by the name of a task, in the order of occurrences; 1 = not logged."""
    turns: dict[str, int] = {}
    for each in effects:
        if each.kind == kind:
            turns[each.name] = max(turns.get(each.name, 0), each.turn + 1)
    return {
        name: tuple(effects.get(Effect(kind, name, turn), 1.0) for turn in range(count))
        for name, count in turns.items()
    }
