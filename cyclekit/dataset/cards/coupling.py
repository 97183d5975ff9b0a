"""Wait conditions of a cell: what robot and operator wait for before departure, learned or given by the cell file.

An agent *visits* places: it arrives, works, and leaves for the next one. A visit of the robot is the dwell at a place;
one of the operator a standstill at one of his places. A *gate* is a point where an agent may not go on before its
conditions hold: when leaving a place, or before the place it goes to. It goes on at the latest of the end of its own
work and, for each condition, the event plus the lag of that condition.
"""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta
from msgspec.structs import replace

from cyclekit.dataset.cards.quantities import Card, Count, Fraction, Lag, Name
from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cyclekit.schema import Ints, Vector

Agent = Literal["robot", "operator"]
Quantiles = Annotated[tuple[Lag, ...], Meta(min_length=1, max_length=1001)]
"""A distribution: its quantiles at evenly spaced levels from 0 to 1, s, ascending; one value = constant."""
MAX_TRIPS = 400
"""Maximum number of logged trips in a card."""
Turn = Annotated[int, Meta(ge=0, le=100)]


class Turns(NamedTuple):
    """Mapping from passages of a gate to events, if one of them occurs more often than the other.

    A robot that brings a part to a fixture and later takes it away comes twice for each press of the button: every 2nd
    passage needs an event, starting with passage 1.

    Attributes:
        every, first: Passages first, first + every, ... need an event; the others need none.
        event_every, event_first: Events event_first, event_first + event_every, ... are counted.
    """

    every: Annotated[int, Meta(ge=1, le=100)] = 1
    first: Turn = 0
    event_every: Annotated[int, Meta(ge=1, le=100)] = 1
    event_first: Turn = 0

    def event(self, passage: int, back: int) -> int | None:
        """Return the number of the event that a passage needs, both from 0; None = it needs none."""
        turn, rest = divmod(passage, self.every)
        return (turn - back) * self.event_every + self.event_first if rest == self.first and turn >= back else None


class _InOrder(Card, frozen=True, kw_only=True):
    """A card whose distributions are ascending."""

    def __post_init__(self) -> None:
        """Refuse quantiles that are not ascending.

        Raises:
            ValueError: They are not.
        """
        for name in ("lag_s", "own_s", "gap_s", "first_s", "late_s"):
            values = getattr(self, name, ())
            if any(a > b for a, b in pairwise(values)):
                msg = f"{name} must be ascending, as quantiles are"
                raise ValueError(msg)


class ConditionCard(_InOrder, frozen=True, kw_only=True):
    """An event that must have occurred.

    Attributes:
        agent: Agent of the event; `signal` = a signal that neither agent sets, such as the arrival of a part.
        place: A place of the robot or of the operator, or the name of the signal.
        event: `arrives` at the place, `leaves` it, or the signal is `set` or `cleared`; a part without a signal
            `arrives`.
        back: The k-th passage of the gate (from 0, per execution) needs the (k - back)-th event; nothing is needed if
            that number is negative or the event is not in the plan.
        turns: Passages and events that are counted.
        needed: Share of the passages that need the event; the others go on without it.
        together: Group: conditions of one group are needed in the same passages, that is, the k-th passage of one gate
            needs its event if the k-th of the other does. 0 = independent.
        lag_s: Time from the event to departure, if nothing else decides.
        held: Share of the logged passages that came after the event.
        decided: Number of logged passages decided by the event: everything else had occurred before.
        alike: The same number at all places of one kind, if their conditions and lags were learned together; 0: alone.
        common: Correlation of the lag with what the durations of the operator's work share in an execution.
        signal: Signal from which the event was read, set by the agent at the place; None = from positions.
    """

    agent: Literal["robot", "operator", "signal"]
    place: Name
    event: Literal["arrives", "leaves", "set", "cleared"]
    back: Turn = 0
    turns: Turns = Turns()
    needed: Fraction = 1.0
    together: Count = 0
    lag_s: Quantiles
    held: Fraction = 1.0
    decided: Count = 0
    alike: Count = 0
    common: Fraction = 0.0
    signal: str | None = None


def refuse_circles(needs: Mapping[tuple[str, ...], Iterable[tuple[str, ...]]]) -> None:
    """Refuse conditions that need each other in a circle.

    Args:
        needs: What each needs first.

    Raises:
        ValueError: There is a circle.
    """
    try:
        TopologicalSorter(needs).prepare()
    except CycleError as error:
        circle = " needs ".join(" ".join(name) for name in reversed(error.args[1]))
        msg = f"conditions in a circle: {circle}"
        raise ValueError(msg) from None


class OwnWorkCard(_InOrder, frozen=True, kw_only=True):
    """Own work of the operator at a place, where it depends on the place that he goes to next or came from.

    Attributes:
        side: Whether `place` is the next one or the one before.
        place: See `side`; empty before him: he began the execution here, with the rest of his own work.
        own_s: Time from arrival to the end of the own work then.
    """

    side: Literal["next", "before"]
    place: str
    own_s: Quantiles


class TripCard(_InOrder, frozen=True, kw_only=True):
    """Trips that the operator makes from a gate, mostly while he waits there, such as to fetch material.

    He goes on when the conditions of the gate hold and he is back. If they hold before he is, he may turn round or come
    straight, so how long a trip takes depends on when they do.

    Attributes:
        places: Where they lead.
        waiting: Share of the passages with a wait that have one.
        free: Share of the other passages that have one.
        took_s: How long each logged trip took from the end of own work on, with `after_s`.
        late_s: How long after its begin the conditions of each would have let him go on, s, ascending.
        after_s: How long he waits before he goes.
        seen: Number of logged ones.
    """

    places: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=4)]
    waiting: Fraction
    free: Fraction = 0.0
    took_s: Annotated[tuple[Lag, ...], Meta(min_length=1, max_length=MAX_TRIPS)]
    late_s: Annotated[tuple[Lag, ...], Meta(min_length=1, max_length=MAX_TRIPS)]
    after_s: Lag = 0.0
    seen: Count = 0


class GateCard(_InOrder, frozen=True, kw_only=True):
    """A point where an agent may have to wait.

    Attributes:
        agent: The agent that waits.
        at: `leave`: it may not leave `place`; `approach`: it may not go on to `place`. An operator waits where he is; a
            robot at `phase` of its motion, or at its start if that is 0.
        place: See `at`.
        phase: Share of the nominal motion before the standstill, for `approach` of a robot.
        own_s: For a `leave` gate: time from arrival to the end of the agent's own work.
        own_by: The same by the operator's next place, or by the one before, where it differs.
        conditions: Conditions, which must all hold. Without any, the gate only has the agent's own work.
        told: Whether it is from the cell file.
        passages: Number of logged passages.
        trip: Trips of the operator from here.
        wait_at: Place where the operator stands if he has to wait before he goes on to `place`; None = where he is.
        wait_from: Places from which he goes to `wait_at`; from others he waits where he is. Empty = from everywhere.
    """

    agent: Agent
    at: Literal["leave", "approach"]
    place: Name
    phase: Fraction = 0.0
    own_s: Quantiles = (0.0,)
    own_by: tuple[OwnWorkCard, ...] = ()
    conditions: Annotated[tuple[ConditionCard, ...], Meta(max_length=4)] = ()
    told: bool = False
    passages: Count = 0
    trip: TripCard | None = None
    wait_at: Name | None = None
    wait_from: tuple[Name, ...] = ()

    def waits_at(self, here: str) -> str | None:
        """Return where the operator goes from a place if he has to wait; None = he stays there."""
        over = self.wait_at if not self.wait_from or here in self.wait_from else None
        return None if over == here else over

    def at_pace(self, pace: float) -> GateCard:
        """Return the gate with own work of the operator that takes `pace` times as long; one of the robot as it is."""
        if self.agent == "robot":
            return self
        by = tuple(replace(one, own_s=tuple(pace * seconds for seconds in one.own_s)) for one in self.own_by)
        return replace(self, own_s=tuple(pace * seconds for seconds in self.own_s), own_by=by)


class SourceCard(_InOrder, frozen=True, kw_only=True):
    """A signal that neither agent sets, such as the arrival of parts on a conveyor.

    Attributes:
        signal: Name of the signal.
        gap_s: Time from one `set` to the next, while there is room.
        first_s: Time from the start of the execution to the first one; negative = it came before, as the conveyor
            runs on between executions.
        buffer: Number of parts that may wait; the next one then comes after one is taken.
        taken_by: Place of the robot where a part is taken, or at or before which it waits for the signal.
        inferred: Whether it was learned from standstills of the robot there, without a signal.
        event: Which change of the signal is waited for.
        after: Events of the robot that must have come, such as the part that it has brought: whoever gives the signal
            then does so a lag later. There is no buffer then.
    """

    signal: Name
    gap_s: Quantiles
    first_s: Quantiles = (0.0,)
    buffer: Annotated[int, Meta(ge=1, le=1000)] = 1
    taken_by: Name
    inferred: bool = False
    event: Literal["set", "cleared"] = "set"
    after: Annotated[tuple[ConditionCard, ...], Meta(max_length=4)] = ()

    @property
    def comes_on(self) -> bool:
        """Whether parts come between executions too."""
        return self.first_s[0] < 0.0 and not self.after

    @property
    def brings(self) -> Literal["set", "cleared", "arrives"]:
        """What comes, as conditions name it."""
        return "arrives" if self.inferred else self.event


class InTurnCard(_InOrder, frozen=True, kw_only=True):
    """Several signals that one operator gives, one after the other: he serves the places where the robot brings parts.

    The k-th signal of a place comes after the robot has brought the k-th part there (`SourceCard.after`), and after
    his own work since the signal that he gave before it, at whatever place.

    Attributes:
        signals: Names of the signals.
        gap_s: His own work from one signal to the next, as `SourceCard.gap_s`.
        first_s: Time from the start of the execution to his first signal, if he does not have to wait.
        orders: In which order he served the parts in each logged execution; a part is its number in the order in which
            the robot brought them, from 0.
    """

    signals: Annotated[tuple[Name, ...], Meta(min_length=2, max_length=64)]
    gap_s: Quantiles
    first_s: Quantiles = (0.0,)
    orders: Annotated[tuple[Annotated[tuple[Turn, ...], Meta(min_length=1)], ...], Meta(min_length=1, max_length=400)]


class TrendCard(Card, frozen=True, kw_only=True):
    """How the operator's work, or his walks, become quicker or slower over the executions.

    Attributes:
        change: Change of the logarithm of durations from the first execution to the last.
        settles: Number of executions in which 63 % of the lasting change has happened; None: it is linear.
        count: Number of executions.
        error: Standard error of the logarithm of durations at the last execution.
        chance: Probability that the pace does not change steadily.
    """

    change: Annotated[float, Meta(ge=-5.0, le=5.0)]
    settles: Annotated[float, Meta(ge=1e-3, le=1e9)] | None = None
    count: Count
    error: Annotated[float, Meta(ge=0.0, le=1e3)] = 0.0
    chance: Fraction = 0.0

    def passed(self, number: Ints) -> Vector:
        """Return the share of the change that has happened at executions, given by number from 0, shape (N,)."""
        last = max(self.count - 1, 1)
        if self.settles is None:
            return np.asarray(number / last)
        return np.asarray(np.expm1(-number / self.settles) / np.expm1(-last / self.settles))

    def factor(self, number: Ints) -> Vector:
        """Return durations at executions relative to those at the last one, shape (N,)."""
        return np.asarray(np.exp(self.change * (self.passed(number) - 1.0)))


class OperatorPaceCard(Card, frozen=True, kw_only=True):
    """How the operator's pace changes over the executions; durations in a card are then those at the last one.

    Attributes:
        executions: Names of the executions in their order.
        work, walk: The trend of his own work and of his walks; None: no significant one.
        work_share: Share of work in the time of both.
    """

    executions: tuple[Name, ...]
    work: TrendCard | None = None
    walk: TrendCard | None = None
    work_share: Fraction = 1.0

    def factors(self) -> dict[str, tuple[float, float]]:
        """Return the durations of work and walks in each execution relative to those in the last, by its name."""
        number = np.arange(len(self.executions))
        both = [np.ones(len(number)) if one is None else one.factor(number) for one in (self.work, self.walk)]
        return dict(zip(self.executions, zip(*(factor.tolist() for factor in both), strict=True), strict=True))

    @property
    def quicker(self) -> float:
        """Share by which work and walks together became shorter; negative: longer."""
        work, walk = (0.0 if one is None else float(np.expm1(one.change)) for one in (self.work, self.walk))
        return -self.work_share * work - (1.0 - self.work_share) * walk

    @property
    def said(self) -> str:
        """The trend as a sentence."""
        how = "quicker" if self.quicker > 0 else "slower"
        return (
            f"the operator became {percent(abs(self.quicker))} {how} over {len(self.executions)} executions; "
            "the estimate is for his pace in the last of them"
        )


class CommonPaceCard(Card, frozen=True, kw_only=True):
    """What the durations of one execution share, because its operator is slower or quicker than in others.

    Attributes:
        work, walk: Standard deviation of the log duration that all his works, or all his walks, share; 0: none.
        together: Correlation of these two.
        between: Share of the shared variance that is between sessions.
        sessions: Number of sessions.
        once: Share of the sessions with a pace that no other session has: so likely is somebody who was not seen yet.
    """

    work: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.0
    walk: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.0
    together: Fraction = 0.0
    between: Fraction = 0.0
    sessions: Count = 0
    once: Fraction = 0.0


class CouplingCard(Card, frozen=True, kw_only=True):
    """Learned wait conditions of robot and operator. Without any, operator tracks do not react to the robot.

    Attributes:
        gates: Gates of both agents, with conditions or only with the agents' own work.
        sources: Sources of parts.
        in_turn: Sources whose signals one operator gives in turn; their own `gap_s` and `first_s` are not used then.
        executions: Number of executions behind them.
        errands: Places to which the operator goes in the middle of his work; that is part of his work.
        pace: How the operator's pace changes; own work is that at his latest pace. None: no significant change.
        common: What the durations of one execution share. None: nothing significant.
    """

    gates: tuple[GateCard, ...] = ()
    sources: tuple[SourceCard, ...] = ()
    in_turn: InTurnCard | None = None
    executions: Count = 0
    errands: tuple[Name, ...] = ()
    pace: OperatorPaceCard | None = None
    common: CommonPaceCard | None = None

    def __post_init__(self) -> None:
        """Refuse agents that wait for each other in a circle: no execution could go on.

        Raises:
            ValueError: They do.
        """
        refuse_circles(
            {
                (gate.agent, gate.at, gate.place): [
                    (one.agent, at, one.place)
                    for one in gate.conditions
                    if (one.back, one.turns, one.needed) == (0, Turns(), 1.0)
                    for at in (("approach", "leave") if one.event == "leaves" else ("approach",))
                ]
                + ([(gate.agent, "approach", gate.place)] if gate.at == "leave" else [])
                for gate in self.gates
            }
        )

    @property
    def coupled(self) -> bool:
        """Whether any agent waits for anything."""
        return any(gate.conditions for gate in self.gates)
