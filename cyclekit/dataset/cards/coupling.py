"""Who waits for whom in a cell: what each departure of robot and operator waits for, learned from logs or told.

An agent *visits* places: it arrives, works, and leaves for its next one. Of the robot a visit is the dwell at a place;
of the operator the standstill at one of his. A *gate* is where an agent may not go on before its conditions hold: on
leaving a place, or short of the place it goes to. It goes on at the latest of its own work's end and each condition's
event plus that condition's lag.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

from msgspec import Meta

from cyclekit.dataset.cards.quantities import Card, Count, Fraction, Name, Seconds

Agent = Literal["robot", "operator"]
Quantiles = Annotated[tuple[Seconds, ...], Meta(min_length=1, max_length=1001)]
"""A distribution: its quantiles at evenly spaced levels from 0 to 1, s, not descending; one value = always that."""
Turn = Annotated[int, Meta(ge=0, le=100)]


class Turns(NamedTuple):
    """Which passages of a gate an event belongs to, where one of both comes more often than the other.

    A robot that brings a part to a fixture and takes it from there again comes twice for each press of the button:
    every 2nd passage needs one, the first of them that number 1.

    Attributes:
        every, first: Passages number first, first + every, ... need an event; the others need none.
        event_every, event_first: Of the events, those of these numbers.
    """

    every: int = 1
    first: int = 0
    event_every: int = 1
    event_first: int = 0

    def event(self, passage: int, back: int) -> int | None:
        """Return the number of the event that a passage needs, both from 0; None = it needs none."""
        turn, rest = divmod(passage, self.every)
        return (turn - back) * self.event_every + self.event_first if rest == self.first and turn >= back else None


class ConditionCard(Card, frozen=True, kw_only=True):
    """An event that must have come.

    Attributes:
        agent: Whose event; `signal` = a signal that neither of them gives, such as a part that comes.
        place: Where: a place of the robot, one of the operator, or the name of the signal.
        event: `arrives` at it, `leaves` it, or the signal is `set` or `cleared`; a part without a signal `arrives`.
        back: The k-th passage of the gate (from 0, in one execution) needs the (k - back)-th such event; a negative
            number, or one that never comes in the plan, needs nothing.
        turns: Of passages and events these are counted.
        needed: Part of the passages that need the event at all; the others go on without it.
        together: Conditions of the same number are needed in the same passages: the k-th of one gate needs its event if
            the k-th of the other does. 0 = needed by itself.
        lag_s: From the event to going on, if nothing else decides.
        held: Part of the logged passages that came after the event.
        decided: Logged passages that it decided: everything else was there earlier.
        signal: The event was read from this signal, which the agent gives there; None = from positions.
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
    signal: str | None = None


class GateCard(Card, frozen=True, kw_only=True):
    """Where an agent may have to wait.

    Attributes:
        agent: Who waits.
        at: `leave`: it may not leave `place`; `approach`: it may not go on to `place`. An operator who may not approach
            waits where he is; a robot at `phase` of its motion, or where it starts from if that is 0.
        place: See `at`.
        phase: Part of the nominal motion before the standstill, of a robot's `approach`.
        own_s: Of a `leave` gate: from the arrival to the end of the agent's own work.
        conditions: All must hold. None is a gate too: the agent's own work alone.
        told: By the cell file.
        passages: Logged passages.
    """

    agent: Agent
    at: Literal["leave", "approach"]
    place: Name
    phase: Fraction = 0.0
    own_s: Quantiles = (0.0,)
    conditions: Annotated[tuple[ConditionCard, ...], Meta(max_length=4)] = ()
    told: bool = False
    passages: Count = 0


class SourceCard(Card, frozen=True, kw_only=True):
    """A signal that neither agent gives, such as parts that come on a conveyor.

    Attributes:
        signal: Its name.
        gap_s: From one `set` to the next, as long as there is room.
        first_s: From the start of the execution to the first.
        buffer: So many may wait; the next then comes after one is taken.
        taken_by: The robot's place at which one is taken.
        inferred: No signal tells of it: it was learned from the standstills of the robot there.
    """

    signal: Name
    gap_s: Quantiles
    first_s: Quantiles = (0.0,)
    buffer: Annotated[int, Meta(ge=1, le=1000)] = 1
    taken_by: Name
    inferred: bool = False


class CouplingCard(Card, frozen=True, kw_only=True):
    """Who waits for whom. Nobody, where no gate has a condition: operators are then tracks that do not react.

    Attributes:
        gates: Of both agents, those with conditions and those of the agents' own work.
        sources: Of parts.
        executions: It was learned from.
    """

    gates: tuple[GateCard, ...] = ()
    sources: tuple[SourceCard, ...] = ()
    executions: Count = 0

    @property
    def coupled(self) -> bool:
        """Whether anybody waits for anybody or anything."""
        return any(gate.conditions for gate in self.gates)
