"""Signals that the operator gives in a visit to a place, and the time that a plan knows: that of the visit.

Who presses the button and then has to wait at it has done his work there long before he leaves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.coupling.conditions.candidates import since_event, times_of
from cyclekit.learning.coupling.conditions.conditions import KEPT, MIN_DECIDED, decided_by
from cyclekit.learning.coupling.events.givers import WITHIN_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.conditions.departures import Condition, Departures
    from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits
    from cyclekit.schema import Vector


Waited = dict[tuple[int, float], float]
"""When the event came, s, with which each visit that ended with a wait ended: by number of the execution and departure,
s."""


def waited_visits(operator: Sequence[Departures]) -> Waited:
    """Return the operator's visits that he left when a condition was met, and not when his work had ended."""
    found: Waited = {}
    for each in operator:
        since_s = np.array([each.left_s - each.own_s, *each.since_s.values()])
        step = -(-len(each.left_s) // KEPT)
        for some in (slice(n, None, step) for n in range(step if each.since_s else 0)):
            cause, left_s = decided_by(since_s[:, some]), each.left_s[some]
            came_s = left_s - since_s[:, some][cause, np.arange(len(cause))]
            keys = zip(each.course[some].tolist(), left_s.tolist(), strict=True)
            found |= {key: at for key, at, by in zip(keys, came_s.tolist(), cause.tolist(), strict=True) if by}
    return found


def since_given(courses: Sequence[ExecutionVisits], found: Departures, condition: Condition, waited: Waited) -> Vector:
    """Return the time since the operator left (or reached) his place in the visit in which he gave a signal.

    Visits without a signal are not counted: in them he looked at the place, or the signal came in another one. From
    visits that ended with a wait after the signal he would have gone as long after it as he usually does.

    Args:
        courses: The executions.
        found: Departures that need the signal.
        condition: The condition.
        waited: Visits that ended with a wait, as `waited_visits` returns.

    Returns:
        Time from that departure or arrival to each of `found`, shape (N,), s; NaN where it needs no signal, or where
        the signal came during no visit.
    """
    event = condition.event
    if not any(visit.place == event.place for course in courses for visit in course.visits["operator"]):
        return found.since_s[found.gate, condition]  # all his visits there count as trips
    when_s = [_in_visits(course, event) for course in courses]
    if event.event == "leaves":
        given_s = [course.events.get(event, np.empty(0)) for course in courses]
        came_s = [[waited.get((n, at), -np.inf) for at in some.tolist()] for n, some in enumerate(when_s)]
        stayed = [np.array(came) > given for came, given in zip(came_s, given_s, strict=True)]
        left_s = np.concatenate([(w - g)[~s] for w, g, s in zip(when_s, given_s, stayed, strict=True)])
        left_s = left_s[np.isfinite(left_s)]
        usual_s = float(np.median(left_s)) if len(left_s) >= MIN_DECIDED else 0.0
        both = zip(when_s, given_s, stayed, strict=True)
        when_s = [np.where(late, np.minimum(when, given + usual_s), when) for when, given, late in both]
    given = [replace(course, events={event: at}) for course, at in zip(courses, when_s, strict=True)]
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
