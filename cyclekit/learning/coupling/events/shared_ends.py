"""Stays of the operator in which the robot shows him several parts, in logs without his button.

He stays until the last of them is done, so that his tasks are one stay. The robot goes on as each of them ends: its
departures part the stay, as presses of a button would.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.coupling.events.givers import GIVEN, parted_at, shares_in_visits
from cyclekit.learning.coupling.events.visits import Event, events_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.events.visits import ExecutionVisits

MIN_LONG = 10
"""Minimum number of tasks by which these departures part more stays than were logged."""
WAITS, WAITS_S = 0.5, 1.5
"""The robot waits where the range of its stays, 10 to 90 %, is at least so much of their median, and so long, s."""


def with_shared_ends(courses: Sequence[ExecutionVisits]) -> list[ExecutionVisits]:
    """Return the courses with such stays parted; `ended_by` then has the robot's departures that parted them."""
    found, given = list(courses), {key.place for one in courses for key in one.events if key.signal is not None}
    for place in sorted({visit.place for one in courses for visit in one.visits["operator"]} - given):
        ends = {
            where: shares_in_visits(courses, Event("robot", where, "leaves"), place) for where in _waits_at(courses)
        }
        best = max(ends, key=lambda where: ends[where][1], default=None)
        if best is None or ends[best][1] < GIVEN:
            continue
        event = Event("robot", best, "leaves")
        visits = [parted_at(one.visits["operator"], place, one.events.get(event, np.empty(0))) for one in found]
        if sum(len(mine) - len(one.visits["operator"]) for mine, one in zip(visits, found, strict=True)) < MIN_LONG:
            continue
        found = [
            replace(
                one,
                visits={**one.visits, "operator": mine},
                events={**one.events, **events_of({"operator": mine})},
                ended_by=one.ended_by | {event},
            )
            for mine, one in zip(visits, found, strict=True)
        ]
    return found


def _waits_at(courses: Sequence[ExecutionVisits]) -> list[str]:
    """Return the places where the robot's stays vary as if it waited there."""
    stays_s: dict[str, list[float]] = {}
    for course in courses:
        for visit in course.visits["robot"][1:]:
            if np.isfinite(visit.left_s):
                stays_s.setdefault(visit.place, []).append(visit.left_s - visit.arrived_s)
    found = []
    for place, times in sorted(stays_s.items()):
        low, middle, high = np.quantile(times, (0.1, 0.5, 0.9)).tolist()
        if high - low >= max(WAITS * middle, WAITS_S):
            found.append(place)
    return found
