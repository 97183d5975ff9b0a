"""Cuts the repetitions of a task where the tasks of the other agents start, are half over, or end."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from cyclekit.learning.task_times.runs import DoneTask, Run
    from cyclekit.schema import Floats, Ints, Vector

ALONE = ""


class Effect(NamedTuple):
    """What changes a rate or the work: its kind, the name of another task, and a number of earlier tasks.

    These are earlier occurrences of that task, or all earlier tasks of its agent, or of the task's own agent.
    """

    kind: str
    name: str = ""
    turn: int = 0


_Part = tuple[float, dict[Effect, float]]
"""Length, s, and how much of each effect it has."""


@dataclass(frozen=True)
class Parts:
    """Repetitions of one task, cut where a simultaneous task starts, is half over, or ends.

    Attributes:
        on_rate, on_work: What changes the rate, and the work.
        number: Number of the execution of each repetition, shape (N,).
        of: Repetition of each part, shape (M,).
        dt_s: Length of each part, shape (M,), s.
        beside: What changes the rate in each part, and how much, shape (M, on_rate).
        last: Index of the last part of each repetition, shape (N,).
        factors: What changes the work of each repetition, shape (N, on_work).
    """

    on_rate: list[Effect]
    on_work: list[Effect]
    number: Ints
    of: Ints
    dt_s: Vector
    beside: Floats
    last: Ints
    factors: Floats

    @property
    def effects(self) -> list[Effect]:
        """All effects: on the rate, then on the work."""
        return [*self.on_rate, *self.on_work]

    @property
    def kinds(self) -> list[str]:
        """Kind of each effect."""
        return [each.kind for each in self.effects]

    def without(self, kinds: Collection[str]) -> Parts:
        """Return these without some kinds of effects."""
        rate, work = (
            [number for number, each in enumerate(some) if each.kind not in kinds]
            for some in (self.on_rate, self.on_work)
        )
        return replace(
            self,
            on_rate=[self.on_rate[number] for number in rate],
            on_work=[self.on_work[number] for number in work],
            beside=self.beside[:, rate],
            factors=self.factors[:, work],
        )

    @cached_property
    def log_duration(self) -> Vector:
        """Log duration of each repetition, shape (N,)."""
        return np.asarray(np.log(np.maximum(np.bincount(self.of, self.dt_s), 1e-6)))

    @cached_property
    def at_end(self) -> Floats:
        """Effects on the rate in the last part of each repetition, shape (N, effects)."""
        return self.beside[self.last]

    @cached_property
    def ends(self) -> Vector:
        """Sum of these over the repetitions, shape (effects,)."""
        return np.asarray(self.at_end.sum(axis=0))

    def done(self, log_rate: Vector) -> Vector:
        """Return the work done in each part, shape (parts,), s at rate 1."""
        return np.asarray(np.exp(self.beside @ log_rate) * self.dt_s)

    def work(self, done: Vector) -> Vector:
        """Return the work of each repetition, shape (N,), s at rate 1, given that done in each part."""
        return np.asarray(np.bincount(self.of, done, len(self.last)), float)


def beside(agent: str, task: str) -> str:
    """Return the key of a simultaneous task in a table of rates."""
    return f"{agent}: {task}"


def task_parts(runs: Sequence[Run], agent: str, task: str) -> Parts:
    """Return the repetitions of one task, at least one, cut into parts."""
    done = [(run, *each) for run in runs for each in _done(run, agent, task)]
    told = [each for each in done if each[-1].counts] or [min(done, key=lambda each: each[-1].took_s)]
    cut = [_cut(run, agent, done) for run, *_, done in told]
    every = [part for some in cut for part in some]
    on_rate = sorted({effect for _, group in every for effect in group})
    at = {effect: number for number, effect in enumerate(on_rate)}
    grid = np.zeros((len(every), len(on_rate)))
    for row, (_, group) in enumerate(every):
        grid[row, [at[effect] for effect in group]] = list(group.values())
    works = [
        [
            Effect("previous", previous),
            Effect("turn", turn=turn),
            Effect("own position", turn=run.tasks[agent].index(done)),
            *_at_start(some[0]),
        ]
        for (run, turn, previous, done), some in zip(told, cut, strict=True)
    ]
    on_work = sorted({effect for some in works for effect in some})
    factors = np.array([[float(effect in some) for effect in on_work] for some in works])
    return Parts(
        on_rate,
        on_work,
        np.array([run.number for run, *_ in told], dtype=np.int64),
        np.array([number for number, some in enumerate(cut) for _ in some], dtype=np.int64),
        np.array([length_s for length_s, _ in every]),
        grid,
        np.cumsum([len(some) for some in cut]) - 1,
        factors,
    )


def _at_start(first: _Part) -> list[Effect]:
    return [Effect("at start", effect.name) for effect in first[1] if effect.kind == "rates"]


def _done(run: Run, agent: str, task: str) -> list[tuple[int, str, DoneTask]]:
    """Return the repetitions of a task in an execution, each with its turn and the agent's previous task."""
    mine = [done for done in run.tasks.get(agent, ()) if done.task != task or done.took_s > 0.0]
    before = ["", *(done.task for done in mine)]
    found = [(one, done) for one, done in zip(before, mine, strict=False) if done.task == task]
    return [(turn, *each) for turn, each in enumerate(found)]


def _cut(run: Run, agent: str, done: DoneTask) -> list[_Part]:
    """Return the parts of one repetition, ordered by time. A joint task ends as its other side does, and is alone."""
    others = [
        (beside(name, other.task), turn, position, other)
        for name, some in run.tasks.items()
        if name != agent
        for position, (turn, other) in enumerate(_with_turns(some))
        if (name, other.task) != done.mate
    ]
    edges = (t for *_, other in others for t in (other.start_s, _half_s(other), other.end_s))
    at = {t for t in edges if done.start_s < t < done.end_s}
    found = []
    for start_s, end_s in pairwise(sorted({done.start_s, done.end_s, *at})):
        middle = 0.5 * (start_s + end_s)
        group: dict[Effect, float] = {}
        for name, turn, position, other in others:
            if other.start_s <= middle < other.end_s:
                group |= {Effect("rates", name): 1.0, Effect("nth", name, turn): 1.0}
                group[Effect("position", name, position)] = 1.0
                group[Effect("later", name)] = 0.5 if middle >= _half_s(other) else -0.5
        if not group:
            group[Effect("alone", ALONE)] = 1.0
            for name, turn, position in _waiting(run, agent, middle):
                group |= {Effect("waiting", name): 1.0, Effect("nth waiting", name, turn): 1.0}
                group[Effect("position waiting", name, position)] = 1.0
        found.append((end_s - start_s, group))
    return found


def _with_turns(some: Sequence[DoneTask]) -> list[tuple[int, DoneTask]]:
    """Return the tasks of one agent, each with the number of its earlier occurrences."""
    names = [done.task for done in some]
    return [(names[:number].count(done.task), done) for number, done in enumerate(some)]


def _half_s(done: DoneTask) -> float:
    return 0.5 * (done.start_s + done.end_s)


def _waiting(run: Run, agent: str, at_s: float) -> list[tuple[str, int, int]]:
    """Return the last task of each other agent who waits when none of them has a task, with its turn and position."""
    found = []
    for name, some in run.tasks.items():
        past = [
            (beside(name, done.task), turn, position)
            for position, (turn, done) in enumerate(_with_turns(some))
            if done.end_s <= at_s
        ]
        if any(done.start_s <= at_s < done.end_s for done in some):  # the other side of a joint task
            continue
        if name != agent and past and any(done.start_s > at_s for done in some):
            found.append(past[-1])
    return found
