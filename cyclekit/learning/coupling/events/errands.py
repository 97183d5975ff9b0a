"""Errands: the operator goes for a tool or a screw in the middle of his work, comes back, and goes on with it.

No plan names them, and he gives no signal when he goes. A place is one of errands if nearly all visits to it are
between two visits to one other place, and if without them the counts of his visits are those usual for the work of the
robot (`trip_places`). The two visits are then one, with the errand in it.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from cyclekit.learning.coupling.events.trips import MIN_TRIPS, trip_places
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cyclekit.schema import Vector

RETURNS = 0.9
"""Minimum share of the visits to a place of errands from which the operator goes back where he came from."""


def errand_places(courses: Sequence[ExecutionVisits]) -> tuple[str, ...]:
    """Return the places to which the operator goes in the middle of his work; empty if there are none."""
    seen, back = Counter[str](), Counter[str]()
    for course in courses:
        places = [visit.place for visit in course.visits["operator"]]
        seen.update(places[1:-1])
        back.update(
            here for before, here, after in zip(places, places[1:], places[2:], strict=False) if before == after
        )
    able = {place for place, count in back.items() if count >= MIN_TRIPS and count >= RETURNS * seen[place]}
    return tuple(place for place in trip_places(courses) if place in able) if able else ()


def with_errands(courses: Sequence[ExecutionVisits], places: Collection[str]) -> list[ExecutionVisits]:
    """Return executions in which an errand to some places is part of the visit that it interrupts."""
    found = []
    for course in courses:
        given: dict[str, list[Vector]] = {}
        for event, at in course.events.items():
            if event.agent == "operator" and event.signal is not None:
                given.setdefault(event.place, []).append(at)
        found.append(course.with_operator(joined(course.visits["operator"], places, given)))
    return found


def joined(
    visits: Sequence[PlaceVisit], places: Collection[str], given: Mapping[str, Sequence[Vector]] | None = None
) -> list[PlaceVisit]:
    """Return the operator's visits, those to one place with nothing but errands to `places` between them as one.

    Args:
        visits: His visits in one execution.
        places: Places of errands; on some he does not stay long enough for a visit.
        given: Times of the signals that he gives at each place: then he has done a task, and the next is another.
    """
    if not places:
        return list(visits)
    found: list[PlaceVisit] = []
    for visit in visits:
        home = next((n for n in range(len(found) - 1, -1, -1) if found[n].place not in places), None)
        if home is not None and found[home].place == visit.place and _goes_on(found[home], visit, given or {}):
            found[home:] = [found[home]._replace(left_s=visit.left_s, task=visit.task)]
        else:
            found.append(visit)
    return found


def _goes_on(before: PlaceVisit, after: PlaceVisit, given: Mapping[str, Sequence[Vector]]) -> bool:
    """Return whether the work of one visit goes on in the next to the same place."""
    ended = any(((at >= before.arrived_s) & (at <= after.arrived_s)).any() for at in given.get(after.place, ()))
    return after.arrived_s > before.left_s and not ended


__all__ = ["errand_places", "joined", "with_errands"]
