"""Simulates many cycles of one plan from event to event.

Each start, half and end of a task changes the rates of the other tasks.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import EstimateError
from cyclekit.learning.task_times.prepared import PreparedPlan, own_before, prepared

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config.sequences import PlannedTask
    from cyclekit.dataset.cards.task_model import TaskModelCard, TaskTimesCard
    from cyclekit.schema import Bools, Floats, Vector


OWN, BY_PLAN, BY_PART = -1, -2, -3
"""What decided a start, if no other task did: the agent's previous task, the planned start, a part."""


@dataclass(frozen=True)
class SimulatedPlan:
    """Simulated cycles of one plan.

    Attributes:
        tasks: Tasks of all agents, in order for each agent.
        start_s, end_s: Start and end of each task, shape (cycles, tasks), s.
        mean_s: Mean logged duration of each task, shape (tasks,), s.
        decides: Last cause of each start, shape (cycles, tasks): `OWN`, `BY_PLAN`, `BY_PART`, or the number of another
            task.
    """

    tasks: tuple[PlannedTask, ...]
    start_s: Floats
    end_s: Floats
    mean_s: Vector
    decides: Floats

    @property
    def duration_s(self) -> Vector:
        """Time from the first start to the last end, shape (cycles,), s."""
        return np.asarray(self.end_s.max(axis=1) - self.start_s.min(axis=1))

    @property
    def before(self) -> list[int]:
        """Number of the agent's previous task for each task; -1 = it is the first."""
        return own_before(self.tasks)

    @property
    def wait_s(self) -> Floats:
        """Wait before each task since the agent's previous task, or since the first start, shape (cycles, tasks), s.

        It is 0 where the agent's previous task decided the start: the time it then takes between two tasks is no wait.
        """
        ends = np.concatenate([self.end_s, self.start_s.min(axis=1)[:, None]], axis=1)
        return np.where(self.decides == OWN, 0.0, self.start_s - ends[:, self.before])


def roll_plan(
    model: TaskModelCard,
    tasks: Sequence[PlannedTask],
    *,
    cycles: int = 1000,
    seed: int = 0,
    where: str = "",
    pace: Mapping[str, float] = MappingProxyType({}),
) -> SimulatedPlan:
    """Return simulated cycles of a plan.

    Args:
        model: Learned task times.
        tasks: Tasks of all agents, in order for each agent.
        cycles: Number of cycles.
        seed: Seed of the draws of work and lag from logged repetitions.
        where: Name of the plan in messages.
        pace: Factor on durations relative to the latest pace, by the agent's name in the logs.

    Raises:
        UnknownName: A task or an agent was never logged.
        EstimateError: Tasks wait for each other and none can start.
    """
    plan = prepared(model, tasks, where)
    rng = np.random.default_rng(seed)
    work, lag, need_lag, gap = _drawn(plan, cycles, rng)
    since_s = _since_s(plan, cycles, rng)
    work *= np.array([pace.get(card.agent, 1.0) for card in plan.cards])[:, None]
    start, end = np.full(work.shape, np.inf), np.full(work.shape, np.inf)
    t = np.zeros(cycles)
    halves, at_start = bool(plan.log_later.any()), bool(plan.log_at_start.any())
    half, late = 0.5 * work, np.full(work.shape, not halves)  # halves are no events where none matters
    held = np.zeros(work.shape, dtype=bool)  # done, but its joint task is not
    for _ in range(3 * len(tasks) + 2):
        begun, ended = np.isfinite(start), np.isfinite(end)
        running = begun & ~ended
        rate = np.exp(_rates(plan, begun, ended, late))
        own_s = np.maximum(_own_s(plan, end), _parts_s(plan, gap, start)) + lag
        ready = np.maximum(own_s, _needed_s(end, since_s) + need_lag)
        left_s = np.maximum(work - np.where(late, 0.0, half) if halves else work, 0.0) / rate
        due = np.where(running, left_s, np.maximum(_together(plan, ready) - t, 0.0))
        due[held | ended] = np.inf
        step = due.min(axis=0)
        live = np.isfinite(step)
        if not live.any():
            break
        now = live & (due <= step + 1e-9)
        step = np.where(live, step, 0.0)
        t = t + step
        work = np.where(running, work - rate * step, work)
        held |= now & running & late
        end = np.where(held & held[plan.mate] & running, t, end)
        begins = now & ~begun
        start = np.where(begins, t, start)
        if at_start:
            factor = np.where(begins, np.exp(plan.log_at_start @ (begun & np.isinf(end))), 1.0)
            work, half = work * factor, half * factor
        late |= now & running
    usual = np.array([card.usual_s for card in plan.cards])
    if np.isinf(end).any():
        stuck = int(np.isinf(end).any(axis=1).argmax())
        never = "starts" if np.isinf(start[stuck]).any() else "ends"
        msg = f"{where}: {tasks[stuck].shown} never {never}: it waits for a task that waits for it"
        raise EstimateError(msg, cure="Change the order or the 'after' entries.")
    decides = _decides(plan, end, since_s, _parts_s(plan, gap, start), lag, need_lag)
    start, end = np.ascontiguousarray(start.T), np.ascontiguousarray(end.T)
    return SimulatedPlan(tuple(tasks), start, end, usual, decides.T)


def _drawn(plan: PreparedPlan, cycles: int, rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats]:
    """Return work at rate 1, lag, lag after needed tasks, and gap before its part of each task.

    Each has the shape (tasks, cycles), s. The draws do not depend on the order.
    """
    work, lag, need_lag, gap = np.zeros((4, len(plan.cards), cycles))
    names = [(card.agent, card.task, turn) for card, turn in zip(plan.cards, plan.turn, strict=True)]
    ordered = sorted(range(len(names)), key=lambda each: names[each])
    for number in ordered:
        card, before, turn = plan.cards[number], plan.before[number], plan.turn[number]
        last = "" if before < 0 else plan.cards[before].task
        factor = card.after.get(last, 1.0)
        for factors, at in ((card.turns, turn), (card.own_position, plan.position[number])):
            factor *= factors[at] if at < len(factors) else 1.0
        work[number] = factor * _evenly(card.work_s, cycles, rng)
        own_lag = _evenly(card.lags_s, cycles, rng) + card.lag_after_s.get(last, 0.0)
        lag[number] = np.maximum(own_lag, least_lag_s(card))
        if plan.joined[number] and plan.mate[number] < number:
            work[number] = 0.0  # one side tells the time of both
    for number in ordered:  # at last, so that a wait that is removed changes no other draw
        if parts := plan.cards[number].parts:
            gap[number] = _evenly(parts.gap_s if plan.turn[number] else parts.first_s, cycles, rng)
    for number in ordered:
        card, need_lag[number] = plan.cards[number], lag[number]
        if card.need_lags_s:
            need_lag[number] = np.maximum(_evenly(card.need_lags_s, cycles, rng), least_lag_s(card))
    return work, lag, need_lag, gap


def _evenly(values: Sequence[float], cycles: int, rng: np.random.Generator) -> Vector:
    """Return values drawn as often as each other as far as possible, in random order, shape (cycles,).

    With independent draws the mean of few cycles is off by luck, and alike in every plan, as the seed is the same.
    """
    offset, rank = rng.integers(SHARES), rng.permutation(cycles)
    return np.asarray(np.sort(values)[(SHARES * rank + offset) * len(values) // (SHARES * cycles)])


SHARES = 1000
"""Number of levels of draws."""
_Since = dict[tuple[int, int], "Vector | float"]
"""By a task and one that it waits for, the process time since that one; minus infinity where it is not needed."""


def _since_s(plan: PreparedPlan, cycles: int, rng: np.random.Generator) -> _Since:
    names = [(card.agent, card.task, turn) for card, turn in zip(plan.cards, plan.turn, strict=True)]
    found: _Since = {}
    drawn: dict[tuple[int, int], Vector] = {}
    for number in sorted(range(len(names)), key=lambda each: names[each]):
        for other, after_s, needed, together in plan.needs[number]:
            found[number, other] = after_s
            if needed < 1.0:
                key = (-together, plan.turn[number]) if together else (number, other)
                if key not in drawn:
                    drawn[key] = _evenly(range(SHARES), cycles, rng)
                found[number, other] = np.where(drawn[key] < needed * SHARES, after_s, -np.inf)
    return found


def least_lag_s(card: TaskTimesCard) -> float:
    """Return the least lag of a task, s: 0, as less is rounding; after a process time, which varies, any."""
    return -np.inf if any(need.after_s for need in card.needs) else 0.0


def _rates(plan: PreparedPlan, begun: Bools, ended: Bools, late: Bools) -> Floats:
    """Return the log rate of each task, shape (tasks, cycles), given which have begun, ended, and are half over.

    Either side of a joint task is alone beside the other.
    """
    running = begun & ~ended
    others = plan.log_rate @ running
    if plan.log_later.any():
        others = others + plan.log_later @ (running * np.where(late, 0.5, -0.5))
    own = running * np.diag(plan.log_rate)[:, None]
    beside = running.sum(axis=0) - running
    if plan.mate != list(range(len(plan.mate))):
        both = running & (np.array(plan.mate) != np.arange(len(plan.mate)))[:, None]
        beside = beside - (both & running[plan.mate])
    alone = plan.alone[:, None]
    if plan.log_waiting.any():
        waiting = ended & (np.array(plan.next) >= 0)[:, None] & ~begun[plan.next]
        alone = alone + plan.log_waiting @ waiting
    return np.asarray(np.where(beside > 0, others - own, alone))


def _own_s(plan: PreparedPlan, end: Floats) -> Floats:
    """Return when each task may start by its agent and the plan, shape (tasks, cycles), s; infinite = not yet known."""
    ends = np.concatenate([end, np.zeros((1, end.shape[1]))])
    return np.asarray(np.maximum(ends[plan.before], plan.not_before_s[:, None]))


def _needed_s(end: Floats, since_s: _Since) -> Floats:
    """Return when needed tasks allow each task, shape (tasks, cycles), s; infinite while one of them has not ended."""
    ready = np.full(end.shape, -np.inf)
    for (number, need), after_s in since_s.items():
        with np.errstate(invalid="ignore"):  # not needed, and has not ended
            at_s = end[need] + after_s
        ready[number] = np.fmax(ready[number], at_s)
    return ready


def _parts_s(plan: PreparedPlan, gap: Floats, start: Floats) -> Floats:
    """Return when the part of each task comes, shape (tasks, cycles), s; 0 if it waits for none.

    It is infinite while there is no room for it.
    """
    found = np.zeros(gap.shape)
    for number, (last, room) in plan.parts.items():
        found[number] = gap[number] + (found[last] if last >= 0 else 0.0)
        if room >= 0:
            found[number] = np.maximum(found[number], start[room])
    return found


def _together(plan: PreparedPlan, at_s: Floats) -> Floats:
    """Return the starts with joint tasks that start together put to the later one, shape (tasks, cycles), s."""
    return np.where(np.array(plan.joined)[:, None], np.maximum(at_s, at_s[plan.mate]), at_s)


def _decides(
    plan: PreparedPlan, end: Floats, since_s: _Since, parts_s: Floats, lag: Floats, need_lag: Floats
) -> Floats:
    ends = np.concatenate([end, np.zeros((1, end.shape[1]))])
    latest = ends[plan.before]
    found = np.full(end.shape, OWN)
    not_before_s = plan.not_before_s[:, None]
    found[not_before_s > latest] = BY_PLAN
    latest = np.maximum(latest, not_before_s) + lag
    joined = [(n, plan.before[mate]) for n, mate in enumerate(plan.mate) if plan.joined[n] and plan.before[mate] >= 0]
    allowed = {pair: end[pair[1]] + after_s + need_lag[pair[0]] for pair, after_s in since_s.items()}
    for (number, need), at_s in (allowed | {pair: end[pair[1]] + lag[pair[0]] for pair in joined}).items():
        later_here = at_s > latest[number]
        found[number, later_here] = need
        latest[number, later_here] = at_s[later_here]
    found[parts_s + lag > latest] = BY_PART
    return found
