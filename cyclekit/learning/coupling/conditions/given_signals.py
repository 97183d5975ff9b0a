"""Signals that the operator gives in a visit to a place, and the time that a plan knows: that of the visit."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.coupling.conditions.candidates import since_event, times_of
from cyclekit.learning.coupling.events.givers import WITHIN_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.conditions.departures import Condition, Departures
    from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits
    from cyclekit.schema import Vector


def since_given(courses: Sequence[ExecutionVisits], found: Departures, condition: Condition) -> Vector:
    """Return the time since the operator left (or reached) his place in the visit in which he gave a signal.

    Visits without a signal are not counted: in them he looked at the place, or the signal came in another one.

    Args:
        courses: The executions.
        found: Departures that need the signal.
        condition: The condition.

    Returns:
        Time from that departure or arrival to each of `found`, shape (N,), s; NaN where it needs no signal, or where
        the signal came during no visit.
    """
    event = condition.event
    if not any(visit.place == event.place for course in courses for visit in course.visits["operator"]):
        return found.since_s[found.gate, condition]  # all his visits there count as trips
    given = [replace(course, events={event: _in_visits(course, event)}) for course in courses]
    return since_event(times_of(given), found, condition)


def _in_visits(course: ExecutionVisits, event: Event) -> Vector:
    """Return the departure (or arrival) of the visit in which each change of a signal came, s; NaN where in none."""
    visits = [visit for visit in course.visits["operator"] if visit.place == event.place]
    at = course.events.get(event, np.empty(0))
    if not visits:
        return np.full(len(at), np.nan)
    arrived_s, left_s = np.array([(visit.arrived_s, visit.left_s) for visit in visits]).T
    end_s = np.where(np.isnan(left_s), np.inf, left_s)
    inside = (at[:, None] >= arrived_s) & (at[:, None] <= end_s + WITHIN_S)
    far = np.where(inside, np.abs(np.minimum(end_s, 1e9) - at[:, None]), np.inf)  # of two, the one that ends then
    mine = far.argmin(axis=1)
    when_s = left_s if event.event == "leaves" else arrived_s
    return np.asarray(np.where(inside.any(axis=1), when_s[mine], np.nan))
