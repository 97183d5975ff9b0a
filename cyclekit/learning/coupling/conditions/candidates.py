"""The events that the departures of a gate may wait for, and the time from each to the departures.

One side may come n times as often as the other, and a rack between the agents may have room for several parts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards.coupling import Turns
from cyclekit.learning.coupling.conditions.departures import Condition, Departures
from cyclekit.learning.coupling.conditions.machines import after_own
from cyclekit.learning.coupling.events.visits import Event

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.schema import Floats, Vector

HELD = 0.98
"""Minimum share of departures after the event, for a condition that all departures need."""
EARLY_S, EARLY_LEAVING_S = 0.25, 1.0
"""Tolerance, s: a departure may precede its event by this much (clock error); the second value is for an operator who
leaves, because he finishes before his motion is visible."""
PAIRED, MAX_TURNS = 0.9, 6
"""Minimum share of executions with exactly n departures per event, or n events per departure; maximum n."""
MAX_ROOM = 5
"""Maximum number of parts for which there is room between the agents."""
Times = dict[Event, "Floats"]
"""Times of each kind of event per execution, s; see `times_of`."""


def candidates_of(times: Times, gate: Departures, agent: Agent) -> list[Condition]:
    """Return the possible conditions of a gate; if one side is n times as frequent, also those of every n-th one.

    The operator who fills a bin with three parts is needed by every third visit of the robot to it.
    """
    found = []
    departures = np.zeros(len(next(iter(times.values()), ())), np.int64)
    np.maximum.at(departures, gate.course, gate.occurrence + 1)
    for event, at in times.items():
        if event.agent == agent:
            found += after_own(event, gate)
            continue
        some, events = departures > 0, np.isfinite(at).sum(axis=1)
        pairs = [Turns()]
        for each in range(2, MAX_TURNS + 1):
            if np.mean(departures[some] == each * events[some]) >= PAIRED:
                pairs += [Turns(every=each, first=first) for first in range(each)]
            elif np.mean(events[some] == each * departures[some]) >= PAIRED:
                pairs += [Turns(event_every=each, event_first=first) for first in range(each)]
        found += [Condition(event, back, turns) for turns in pairs for back in (0, 1)]
        found += with_room(times, gate, event)
    return found


def with_room(times: Times, gate: Departures, event: Event) -> list[Condition]:
    """Return the condition that there is room again; none if there is room for one part only.

    With room for n parts, part k needs that part k - n has gone, and some come before part k - n + 1 has.

    Args:
        times: Of all events.
        gate: The departures of who brings the parts.
        event: How a part goes.
    """
    if event.agent != "signal" and event.event != "arrives":
        for room in range(1, MAX_ROOM + 1):
            condition = Condition(event, room)
            since = since_event(times, gate, condition)
            early = np.count_nonzero(since < -early_s(condition))
            if early <= (1.0 - HELD) * np.count_nonzero(np.isfinite(since)):
                return [condition] if room > 1 else []
    return []


def times_of(courses: Sequence[ExecutionVisits]) -> Times:
    """Return the times of each kind of event per execution, s, shape (executions, at least 1), padded with NaN."""
    found: Times = {}
    for event in sorted({event for course in courses for event in course.events}, key=str):
        every = [course.events.get(event, np.empty(0)) for course in courses]
        found[event] = np.full((len(courses), max(1, *map(len, every))), np.nan)
        for row, mine in zip(found[event], every, strict=True):
            row[: len(mine)] = mine
    return found


def since_event(times: Times, gate: Departures, condition: Condition) -> Vector:
    """Return the time from a condition's event to each departure, shape (N,), s; NaN if the departure needs none."""
    at, turns = times[condition.event], condition.turns
    turn, rest = np.divmod(gate.occurrence, turns.every)
    number = (turn - condition.back) * turns.event_every + turns.event_first
    there = (rest == turns.first) & (turn >= condition.back) & (number < at.shape[1])
    return np.asarray(np.where(there, gate.left_s - at[gate.course, np.where(there, number, 0)], np.nan))


def early_s(condition: Condition) -> float:
    """Return the time by which a departure may precede a condition's event, s."""
    of_leaving = condition.event[::2] == ("operator", "leaves") and condition.event.signal is None
    return EARLY_LEAVING_S if of_leaving else EARLY_S
