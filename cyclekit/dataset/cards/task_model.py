"""A model of task times as data: rates during other tasks, wait conditions, and errors on held-out orders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from msgspec import Meta, field

from cyclekit.dataset.cards.coupling import refuse_circles
from cyclekit.dataset.cards.notes import Note
from cyclekit.dataset.cards.quantities import Card, Count, Fraction, Lag, Name, Positive, Seconds, Work
from cyclekit.text.numbers import fixed, percent, span

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector

Rate = Annotated[float, Meta(ge=1e-3, le=1e3)]
"""Work done per second, relative to the mean: 1 is about the mean, 0.5 half as fast."""
Error = Annotated[float, Meta(ge=-1e3, le=1e3)]
"""A relative error."""
FORMAT = "cyclekit-task-times"
"""Format name in the file."""
Times = Annotated[tuple[Lag, ...], Meta(min_length=1, max_length=1000)]
"""Times, s."""
PAST = 10_000
"""Maximum number of repetitions stored per task; of more, an even selection."""


class NeedCard(Card, frozen=True, kw_only=True):
    """A task that must end before another one starts.

    Attributes:
        agent, task: The needed task.
        back: The k-th start of the waiting task needs the (k - back)-th end of this one.
        after_s: Process time from that end until the waiting task may start, of an earlier task of its own agent.
        needed: Share of the starts that need it; the others go on without it.
        together: Number of the conditions of two agents that are needed by the same occurrences; 0 = alone.
        held: Share of the logged starts that came after it.
        decided: Number of logged starts decided by it: everything else had occurred before.
    """

    agent: Name
    task: Name
    back: Annotated[int, Meta(ge=0, le=100)] = 0
    after_s: Work = 0.0
    needed: Fraction = 1.0
    together: Annotated[int, Meta(ge=0, le=1000)] = 0
    held: Fraction = 1.0
    decided: Count = 0


class JointCard(Card, frozen=True, kw_only=True):
    """A task of another agent that ends together with a task: the k-th of one with the k-th of the other.

    Attributes:
        agent, task: That task.
        starts: Whether both also start together.
        times: Number of logged joint tasks.
    """

    agent: Name
    task: Name
    starts: bool = False
    times: Count = 0


class InterludeCard(Card, frozen=True):
    """A task, or a visit of a place, that an agent does now and then beside its work.

    Attributes:
        agent, task: Whose it is, and its name.
        before: The tasks that follow it; itself alone: it is done again right after itself.
        visits: How often these were done in all executions, without repetitions.
        times: How often the interlude came before one of them.
        took_s: By how much it made an execution longer on average, s.
    """

    agent: Name
    task: Name
    before: Annotated[tuple[Name, ...], Meta(min_length=1)]
    visits: Positive
    times: Count
    took_s: Work


class PartsCard(Card, frozen=True, kw_only=True):
    """Parts that a task begins with, such as those of a conveyor; no task list tells when they come.

    Attributes:
        first_s: Time from the start of the execution to the first part; all values are equally probable. Negative = it
            came before, as the conveyor runs on between executions.
        gap_s: The same from one part to the next, while there is room.
        buffer: Number of parts that may wait; the next one then comes when the task starts.
    """

    first_s: Times
    gap_s: Times
    buffer: Annotated[int, Meta(ge=1, le=1000)] = 1

    @property
    def said(self) -> str:
        """How they come, in words."""
        low_s, high_s = np.quantile(self.gap_s, (0.05, 0.95)).tolist()
        return f"a part ({span(low_s, high_s, 1)} s after the one before; at most {self.buffer} wait)"


class TaskTimesCard(Card, frozen=True, kw_only=True):
    """One task of one agent.

    Attributes:
        agent, task: Their names in the logs.
        usual_s: Mean logged duration.
        work_s: Work of each logged repetition, s at rate 1, with the mean effects of the previous task and the turn.
        rates: Rate by concurrent task of the other agent, `agent: task`; "" = alone.
        later: Rate in the second half of a concurrent task divided by the rate in its first half.
        waiting: Factor on the rate alone while the other agent, who has ended this task, waits for his next one.
        nth, nth_waiting: Factors on `rates` and `waiting` at the first, second ... occurrence of that task.
        position, position_waiting: The same at that task's position in its agent's order: first, second ...
        at_start: Factor on the work by the concurrent task at the start.
        after: Factor on the work by the agent's previous task; "" = it is the first.
        needs: Tasks it waits for, in addition to the agent's previous task and its planned start.
        joint: Task of another agent with which it ends; then `work_s` is from repetitions in which the other side was
            done first.
        planned: Whether it waits for its planned start.
        parts: The parts that it waits for: the k-th start for the k-th part of the execution.
        turns: Factor on the work at the first, second ... occurrence in one execution.
        own_position: Factor on the work at its own position in its agent's order: first, second ...
        lags_s: Time from when it might start to its start, in each repetition, without `lag_after_s`.
        lag_after_s: Added to it by the agent's previous task, s, such as the way from there; "" = it is the first.
        need_lags_s: The same where a needed task ended last, if clearly different; then `lags_s` is of the others.
    """

    agent: Name
    task: Name
    usual_s: Work
    work_s: Annotated[tuple[Work, ...], Meta(min_length=1, max_length=PAST)]
    rates: dict[str, Rate]
    later: dict[str, Rate] = field(default_factory=dict)
    waiting: dict[str, Rate] = field(default_factory=dict)
    nth: dict[str, tuple[Rate, ...]] = field(default_factory=dict)
    nth_waiting: dict[str, tuple[Rate, ...]] = field(default_factory=dict)
    position: dict[str, tuple[Rate, ...]] = field(default_factory=dict)
    position_waiting: dict[str, tuple[Rate, ...]] = field(default_factory=dict)
    at_start: dict[str, Rate] = field(default_factory=dict)
    after: dict[str, Rate]
    turns: tuple[Rate, ...] = ()
    own_position: tuple[Rate, ...] = ()
    needs: Annotated[tuple[NeedCard, ...], Meta(max_length=4)] = ()
    joint: JointCard | None = None
    planned: bool = False
    parts: PartsCard | None = None
    lags_s: Annotated[tuple[Lag, ...], Meta(min_length=1, max_length=PAST)]
    need_lags_s: Annotated[tuple[Lag, ...], Meta(max_length=PAST)] = ()
    lag_after_s: dict[str, Lag] = field(default_factory=dict)

    @property
    def waits_for(self) -> list[str]:
        """What its start waits for, in words."""
        turns = ["", " of the turn before"]
        needs = [
            f"{_after(need)}{need.agent}: {need.task}{turns[min(need.back, 1)]}{_part(need)}" for need in self.needs
        ]
        both = [_together(self.joint)] if self.joint else []
        parts = [self.parts.said] if self.parts else []
        return [
            "the agent's own task before it",
            *(["its planned start"] if self.planned else []),
            *needs,
            *parts,
            *both,
        ]


def _together(joint: JointCard) -> str:
    return f"{joint.agent}: {joint.task}, to {'start and ' if joint.starts else ''}end with it"


def _part(need: NeedCard) -> str:
    return f" ({percent(need.needed)} of the times)" if need.needed < 1.0 else ""


def _after(need: NeedCard) -> str:
    return f"{fixed(need.after_s, 1)} s after " if need.after_s else ""


class PaceCard(Card, frozen=True, kw_only=True):
    """Trend of an agent's pace over executions.

    Attributes:
        law: `linear` in the number of the execution, or `learning`: linear in its logarithm.
        change: Change of the logarithm of durations from the first to the last execution.
        first, last: Numbers of these executions.
        error: Standard error of the logarithm of durations at the last execution.
        chance: Probability that the pace does not change steadily.
    """

    law: Literal["linear", "learning"]
    change: Error
    first: Count
    last: Count
    error: Annotated[float, Meta(ge=0.0, le=1e3)] = 0.0
    chance: Fraction = 0.0

    def passed(self, number: Ints | int) -> Vector:
        """Return the share of the change that has happened at an execution."""
        done, whole = np.maximum(np.asarray(number, dtype=float) - self.first, 0.0), max(self.last - self.first, 1)
        return np.asarray(np.log1p(done) / np.log1p(whole) if self.law == "learning" else done / whole)

    def factor(self, number: Ints | int) -> Vector:
        """Return durations at an execution relative to those at the last one."""
        return np.asarray(np.exp(self.change * (self.passed(number) - 1.0)))

    def said(self, agent: str) -> str:
        """Return the trend as a sentence."""
        part = abs(float(np.expm1(self.change)))
        how = "quicker" if self.change < 0 else "slower"
        count = self.last - self.first + 1
        return f"{agent} becomes {percent(part)} {how} over {count} executions; times are those of the latest pace"


class ClockErrorCard(Card, frozen=True, kw_only=True):
    """What an agent's times were put right by, as its clock is off.

    Attributes:
        of: The agent whose clock counts as right.
        least_s, most_s: Least and greatest amount added to times in an execution, s; they differ if the clock changes.
    """

    of: Name
    least_s: Seconds
    most_s: Seconds

    def said(self, agent: str) -> str:
        """Return it as a sentence."""
        low, high = sorted((-self.least_s, -self.most_s))
        by = _ahead(low) if high - low < CHANGES_S else f"{_ahead(low)} to {_ahead(high)}, as it changes,"
        return f"clock of {agent}: {by} of the clock of {self.of}; times are put right"


CHANGES_S = 0.05
"""Minimum difference, s, between the amounts of a clock that is said to change."""


def _ahead(by_s: float) -> str:
    return f"{fixed(abs(by_s), 2)} s {'ahead' if by_s > 0 else 'behind'}"


class HeldOutCard(Card, frozen=True, kw_only=True):
    """Errors on executions whose order of tasks was held out.

    Attributes:
        orders: Number of different orders.
        bias: Estimate / true - 1, with the mean of true / estimate over the orders.
        within: Standard error of the bias.
        order_error: Root mean square of 1 - true / estimate over orders, without the chance of few executions each.
        learning_error: Relative standard error of an estimate due to finite logs: from models that each lack one part
            of the executions (jackknife), widened as Student's t for the few parts.
        deviations: Deviations of executions from their estimates, in standard deviations of the estimated single
            cycles; the same number of each order.
    """

    orders: Count
    bias: Error
    within: Error
    order_error: Error
    learning_error: Error
    deviations: Annotated[tuple[Error, ...], Meta(max_length=PAST)]


class TaskModelCard(Card, frozen=True, kw_only=True):
    """Cycle-time model learned from task lists.

    Attributes:
        agents: `robot` or `operator` by the agent's name in the logs.
        tasks: Tasks of all agents.
        interludes: What agents do now and then beside their work.
        pace: Trends of agents whose pace changes; `work_s` is at the pace of the last execution.
        clocks: Agents whose clock is off, by name.
        before_plan: Agents who do not keep to planned starts, by name: share of the starts before their planned start,
            of those whose agent was free before it.
        executions: Number of training executions.
        failed: Number of other executions, left out as a task failed.
        at_once: Number of other executions, left out as an agent did two tasks at once.
        held_out: Errors on held-out orders; None if too few orders were logged.
    """

    format: Literal["cyclekit-task-times"] = "cyclekit-task-times"
    model_version: Literal[1] = 1
    dataset: str = ""
    agents: dict[str, Literal["robot", "operator"]]
    tasks: Annotated[tuple[TaskTimesCard, ...], Meta(min_length=1)]
    interludes: tuple[InterludeCard, ...] = ()
    pace: dict[str, PaceCard] = field(default_factory=dict)
    clocks: dict[str, ClockErrorCard] = field(default_factory=dict)
    before_plan: dict[str, Fraction] = field(default_factory=dict)
    executions: Count
    failed: Count = 0
    at_once: Count = 0
    held_out: HeldOutCard | None = None
    warnings: tuple[Note, ...] = ()

    def __post_init__(self) -> None:
        """Refuse conditions on tasks that are not in the model, and tasks that wait for each other in a circle.

        Raises:
            ValueError: There are such conditions.
        """
        known = {(one.agent, one.task) for one in self.tasks}
        for one in self.tasks:
            named = [(need.agent, need.task) for need in one.needs]
            named += [(one.joint.agent, one.joint.task)] if one.joint else []
            for agent, task in named:
                if (agent, task) not in known:
                    msg = f"{one.agent}: {one.task} waits for {agent}: {task}, which is no task of the model"
                    raise ValueError(msg)
        needs: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
        for one in self.tasks:  # its start needs the end of others, its end the start of the task that it ends with
            name = (f"{one.agent}:", one.task)
            first = [(f"{need.agent}:", need.task) for need in one.needs if need.back == 0 and need.needed == 1.0]
            needs[name] = [("the end of", *other) for other in first]
            joint = [(f"{one.joint.agent}:", one.joint.task)] if one.joint else []
            needs["the end of", *name] = [name, *joint]
        refuse_circles(needs)

    @property
    def notices(self) -> tuple[str, ...]:
        """What of the agents' clocks and pace a reader of the times has to know, one sentence each."""
        return tuple(each.said(agent) for some in (self.clocks, self.pace) for agent, each in some.items())
