"""The visits of robot and operator to their places and the changes of signals: the events of an execution."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.schema import Vector


class Event(NamedTuple):
    """A kind of event, as in `ConditionCard`."""

    agent: str
    place: str
    event: str
    signal: str | None = None


class PlaceVisit(NamedTuple):
    """A visit of one agent to one place; session seconds, NaN = unknown.

    Attributes:
        place: Name of the place.
        arrived_s, left_s: Arrival and departure.
        reached_s, went_on_s: Arrival at and departure from the waiting point short of the place.
        away_s: Duration of a trip of the operator within the visit (`trips`), s.
        task: Number of the operator's task in his execution (table TASKS); -1 = unknown.
    """

    place: str
    arrived_s: float
    left_s: float
    reached_s: float = np.nan
    went_on_s: float = np.nan
    away_s: float = 0.0
    task: int = -1


@dataclass(frozen=True)
class ExecutionVisits:
    """The visits and events of one execution.

    Attributes:
        name: Name of the execution.
        visits: Visits of each agent in order; the first has the start of the execution as arrival.
        events: Times of each kind of event, ascending, s.
        session, pace: Name of its session; duration of the operator's own work relative to the last execution.
        number: Number among all logged executions, ordered by time; -1 = unknown.
        later: Changes of signals after its end and before the next execution of its session, in logs without operators.
    """

    name: str
    visits: Mapping[Agent, Sequence[PlaceVisit]]
    events: Mapping[Event, Vector] = field(default_factory=dict)
    session: str = ""
    pace: float = 1.0
    number: int = -1
    later: Mapping[Event, Vector] = field(default_factory=dict)

    def with_operator(self, visits: Sequence[PlaceVisit]) -> ExecutionVisits:
        """Return the execution with other visits of the operator; the signals that he gives stay."""
        others = {key: at for key, at in self.events.items() if key.agent != "operator" or key.signal is not None}
        events = events_of({"operator": visits}) | others
        return replace(self, visits={**self.visits, "operator": visits}, events=events)


def events_of(visits: Mapping[Agent, Sequence[PlaceVisit]]) -> dict[Event, Vector]:
    """Return the arrivals at and departures from each place, ascending, s."""
    found: dict[Event, list[float]] = {}
    for agent, some in visits.items():
        for visit in some:
            found.setdefault(Event(agent, visit.place, "arrives"), []).append(visit.arrived_s)
            found.setdefault(Event(agent, visit.place, "leaves"), []).append(visit.left_s)
    return {key: np.array(times) for key, times in found.items()}
