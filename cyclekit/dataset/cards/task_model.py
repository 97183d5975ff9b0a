"""A model of task times as data: rates beside other tasks, what each start waits for, and errors on held-out orders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from msgspec import Meta, field

from cyclekit.dataset.cards.notes import Note
from cyclekit.dataset.cards.quantities import Card, Count, Duration, Fraction, Name

if TYPE_CHECKING:
    from cyclekit.schema import Ints, Vector

Rate = Annotated[float, Meta(gt=0.0, le=1e3)]
"""Work done per second: 1 is about the mean, half of it is half as fast."""
Lag = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Time from the moment a task may start to its start, s; a little below 0 by rounding of the log."""
Error = Annotated[float, Meta(ge=-1e3, le=1e3)]
"""An error as part of something."""
FORMAT = "cyclekit-task-times"
"""How the file says that it is one."""
PAST = 10_000
"""Repetitions kept of a task; of more, so many spread over all."""


class NeedCard(Card, frozen=True, kw_only=True):
    """What must have ended before a task starts.

    Attributes:
        agent, task: Whose task.
        back: The k-th start of the waiting task needs the (k - back)-th end of this one.
        held: Part of the logged starts that came after it.
        decided: Logged starts that it decided: everything else was there earlier.
    """

    agent: Name
    task: Name
    back: Annotated[int, Meta(ge=0, le=100)] = 0
    held: Fraction = 1.0
    decided: Count = 0


class TaskTimesCard(Card, frozen=True, kw_only=True):
    """One task of one agent.

    Attributes:
        agent, task: Its names in the logs.
        usual_s: Mean logged duration.
        work_s: Of each logged repetition, s at rate 1, the task before it and the turn being as usual.
        rates: By the other agent's task beside it, `agent: task`; "" = alone.
        after: Factor of the work by the agent's own task before it; "" = it is the first.
        needs: What it waits for beside the agent's own task before it and its planned start.
        planned: It waits for its planned start.
        turns: Factor of the work the first, second ... time of the task in one execution.
        lags_s: From when it might start to its start, in each repetition.
    """

    agent: Name
    task: Name
    usual_s: Duration
    work_s: Annotated[tuple[Duration, ...], Meta(min_length=1, max_length=PAST)]
    rates: dict[str, Rate]
    after: dict[str, Rate]
    turns: tuple[Rate, ...] = ()
    needs: Annotated[tuple[NeedCard, ...], Meta(max_length=4)] = ()
    planned: bool = False
    lags_s: Annotated[tuple[Lag, ...], Meta(min_length=1, max_length=PAST)]

    @property
    def waits_for(self) -> list[str]:
        """What its start waits for, as words."""
        turns = ["", " of the turn before"]
        needs = [f"{need.agent}: {need.task}{turns[min(need.back, 1)]}" for need in self.needs]
        return ["the agent's own task before it", *(["its planned start"] if self.planned else []), *needs]


class PaceCard(Card, frozen=True, kw_only=True):
    """How the pace of an agent changes from execution to execution.

    Attributes:
        law: `linear` in the number of the execution, or `learning`: in its logarithm.
        change: Of the logarithm of durations from the first to the last execution.
        first, last: Numbers of these executions.
        chance: Probability of such a trend where there is none.
    """

    law: Literal["linear", "learning"]
    change: Error
    first: Count
    last: Count
    chance: Fraction = 0.0

    def passed(self, number: Ints | int) -> Vector:
        """Return which part of the change has happened at an execution."""
        done, whole = np.maximum(np.asarray(number, dtype=float) - self.first, 0.0), max(self.last - self.first, 1)
        return np.asarray(np.log1p(done) / np.log1p(whole) if self.law == "learning" else done / whole)

    def factor(self, number: Ints | int) -> Vector:
        """Return durations at an execution as part of those at the last one."""
        return np.asarray(np.exp(self.change * (self.passed(number) - 1.0)))

    def said(self, agent: str) -> str:
        """Return it as a sentence."""
        part = abs(float(np.expm1(self.change)))
        how = "quicker" if self.change < 0 else "slower"
        count = self.last - self.first + 1
        return f"{agent} becomes {part:.0%} {how} over {count} executions; times are those of the latest pace"


class HeldOutCard(Card, frozen=True, kw_only=True):
    """Errors on executions whose order of tasks the model had not seen.

    Attributes:
        orders: Different orders.
        bias: Mean of estimate / true - 1 over the orders.
        within: Standard error of that.
        order_error: Standard deviation of it over orders, without the chance of few executions each.
        learning_error: Standard error that finite logs leave in an estimate, as part of it: from models that lack one
            part of the executions each (jackknife), widened as Student's t for so few of them.
        deviations: Of each execution from its estimate, in standard deviations of the estimated single cycles.
    """

    orders: Count
    bias: Error
    within: Error
    order_error: Error
    learning_error: Error
    deviations: Annotated[tuple[Error, ...], Meta(max_length=PAST)]


class TaskModelCard(Card, frozen=True, kw_only=True):
    """What task lists tell of cycle times.

    Attributes:
        agents: `robot` or `operator` by the agent's name in the logs.
        tasks: Of all agents.
        pace: Of agents whose pace drifts; `work_s` is at the pace of the last execution.
        executions: It was learned from.
        held_out: None where too few orders were logged to judge by.
    """

    format: Literal["cyclekit-task-times"] = "cyclekit-task-times"
    model_version: Literal[1] = 1
    dataset: str = ""
    agents: dict[str, Literal["robot", "operator"]]
    tasks: Annotated[tuple[TaskTimesCard, ...], Meta(min_length=1)]
    pace: dict[str, PaceCard] = field(default_factory=dict)
    executions: Count
    held_out: HeldOutCard | None = None
    warnings: tuple[Note, ...] = ()
