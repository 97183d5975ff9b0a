"""A plan prepared for simulation: learned times, conditions and rates of each of its tasks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.config.sequences import NOT_ITSELF
from cyclekit.errors import EstimateError, UnknownName
from cyclekit.learning.task_times.parts import ALONE, beside
from cyclekit.learning.task_times.planned_starts import earliest_s

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config.sequences import PlannedTask
    from cyclekit.dataset.cards.task_model import TaskModelCard, TaskTimesCard
    from cyclekit.schema import Floats, Vector


class NeededTask(NamedTuple):
    """Number of a needed task, the process time since, s, the share of cycles in which it is, and `together`."""

    other: int
    after_s: float = 0.0
    needed: float = 1.0
    together: int = 0


@dataclass(frozen=True)
class PreparedPlan:
    """A plan prepared for simulation.

    Attributes:
        cards: Learned times of each task.
        before: Number of the agent's previous task; -1 = none.
        next: Number of the agent's next task; -1 = none.
        turn: Number of earlier occurrences of the same task.
        position: Number of earlier tasks of the same agent.
        needs: The tasks that must have ended.
        parts: Of tasks that wait for a part, numbers of the one that took the part before it, and of the one whose
            start makes room for it; -1 = none.
        mate: Number of the task that it ends with; its own = none.
        joined: Whether both also start together.
        not_before_s: Earliest start, s.
        log_rate: Log rate of a task during another, shape (tasks, tasks); `alone` without another.
        log_later: Log ratio of that rate in the second and the first half of the other task.
        log_waiting: Log factor of the rate alone while another agent, who has ended that task, waits for his next one.
        log_at_start: Log factor of the work by another task that runs at the start.
    """

    cards: list[TaskTimesCard]
    before: list[int]
    next: list[int]
    turn: list[int]
    position: list[int]
    needs: list[list[NeededTask]]
    parts: dict[int, tuple[int, int]]
    mate: list[int]
    joined: list[bool]
    not_before_s: Vector
    log_rate: Floats
    log_later: Floats
    log_waiting: Floats
    log_at_start: Floats
    alone: Vector


def prepared(model: TaskModelCard, tasks: Sequence[PlannedTask], where: str) -> PreparedPlan:
    """Return a plan prepared for simulation.

    Args:
        model: Learned task times.
        tasks: Tasks of all agents, in order for each agent.
        where: Name of the plan in messages.

    Raises:
        UnknownName: A task or an agent was never logged.
        EstimateError: `after` of a task names the task itself.
    """
    known = {(card.agent, card.task): card for card in model.tasks}
    names = [agent_of(model, task, where) for task in tasks]
    for name, task in zip(names, tasks, strict=True):
        if (name, task.name) not in known:
            there = sorted(each for agent, each in known if agent == name)
            raise UnknownName(where, f"task of {name}", task.name, there)
    cards = [known[name, task.name] for name, task in zip(names, tasks, strict=True)]
    pairs = list(zip(names, (task.name for task in tasks), strict=True))
    turn = [pairs[:number].count(pair) for number, pair in enumerate(pairs)]
    position = [names[:number].count(name) for number, name in enumerate(names)]
    keys = [beside(card.agent, card.task) for card in cards]
    rate, later, waiting, at_start = (
        np.array([[_log(getattr(card, kind), key) for key in keys] for card in cards])
        for kind in ("rates", "later", "waiting", "at_start")
    )
    for onto, kind, place in (
        (rate, "nth", turn), (waiting, "nth_waiting", turn),
        (rate, "position", position), (waiting, "position_waiting", position),
    ):  # fmt: skip
        onto += np.array([[_nth(getattr(card, kind), *at) for at in zip(keys, place, strict=True)] for card in cards])
    alone = np.array([_log(card.rates, ALONE) for card in cards])
    before = own_before(tasks)
    not_before = earliest_s(model, tasks, cards, before)
    after = [before.index(number) if number in before else -1 for number in range(len(tasks))]
    needs = _needs(cards, tasks, names, where)
    parts = _parts(cards, pairs)
    mate = _mates(cards, turn)
    joint = [card.joint for card in cards]
    joined = [
        each is not None and each.starts and other != n for n, (each, other) in enumerate(zip(joint, mate, strict=True))
    ]
    told = (rate, later, waiting, at_start, alone)
    return PreparedPlan(cards, before, after, turn, position, needs, parts, mate, joined, not_before, *told)


def agent_of(model: TaskModelCard, task: PlannedTask, where: str) -> str:
    """Return the name in the logs of a planned task's agent, given as that name, `robot` or `operator`.

    Raises:
        UnknownName: There is no such agent, or more than one.
    """
    if task.agent in model.agents:
        return task.agent
    able = [name for name, kind in model.agents.items() if kind == task.agent]
    if len(able) != 1:
        kinds = list(model.agents.values())
        single = {kind for kind in kinds if kinds.count(kind) == 1}
        raise UnknownName(where, "agent", task.agent, {*model.agents, *single})
    return able[0]


def _nth(factors: Mapping[str, Sequence[float]], name: str, turn: int) -> float:
    """Return the log factor at an occurrence or position of a task; 0 if it was not logged."""
    mine = factors.get(name, ())
    return float(np.log(mine[turn])) if turn < len(mine) else 0.0


def _log(rates: Mapping[str, float], name: str) -> float:
    return float(np.log(rates.get(name, 1.0)))


def own_before(tasks: Sequence[PlannedTask]) -> list[int]:
    """Return the number of the agent's previous task for each task; -1: it is the agent's first."""
    last: dict[str, int] = {}
    found = []
    for number, task in enumerate(tasks):
        found.append(last.get(task.agent, -1))
        last[task.agent] = number
    return found


def _needs(
    cards: Sequence[TaskTimesCard], tasks: Sequence[PlannedTask], names: Sequence[str], where: str
) -> list[list[NeededTask]]:
    """Return the tasks that each task waits for.

    These are the learned ones, and those given in the plan. No agent waits for a later task of its own.
    """
    turns: dict[tuple[str, str], list[int]] = {}
    for number, (name, task) in enumerate(zip(names, tasks, strict=True)):
        turns.setdefault((name, task.name), []).append(number)
    found = []
    for number, (name, task, card) in enumerate(zip(names, tasks, cards, strict=True)):
        nth = turns[name, task.name].index(number)
        mine = [
            NeededTask(turns[need.agent, need.task][nth - need.back], need.after_s, need.needed, need.together)
            for need in card.needs
            if 0 <= nth - need.back < len(turns.get((need.agent, need.task), ()))
        ]
        mine = [each for each in mine if names[each.other] != name or each.other < number]
        for told in task.after:
            able = [each for (_, other), some in turns.items() if other == told for each in some if each != number]
            if not able and told == task.name:
                raise EstimateError(f"{where}: {task.shown}: after names the task itself", cure=NOT_ITSELF)
            if not able:
                raise UnknownName(f"{where}: {task.shown}", "task", told, {each.name for each in tasks})
            mine.append(NeededTask(able[min(nth, len(able) - 1)]))
        found.append(mine)
    return found


def _parts(cards: Sequence[TaskTimesCard], pairs: Sequence[tuple[str, str]]) -> dict[int, tuple[int, int]]:
    """Return for each task that waits for a part which tasks took the one before it, and make room for it."""
    taken: dict[tuple[str, str], list[int]] = {}
    found = {}
    for number, (card, pair) in enumerate(zip(cards, pairs, strict=True)):
        if card.parts:
            mine = taken.setdefault(pair, [])
            room = len(mine) - card.parts.buffer
            found[number] = (mine[-1] if mine else -1, mine[room] if room >= 0 else -1)
            mine.append(number)
    return found


def _mates(cards: Sequence[TaskTimesCard], turn: Sequence[int]) -> list[int]:
    """Return for each task the number of the task that it ends with; its own number if there is none."""
    at = {(card.agent, card.task, nth): number for number, (card, nth) in enumerate(zip(cards, turn, strict=True))}
    return [
        at.get((card.joint.agent, card.joint.task, nth), number) if card.joint else number
        for number, (card, nth) in enumerate(zip(cards, turn, strict=True))
    ]
