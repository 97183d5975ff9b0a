"""Which signals the operator gives: changes in his visits to one place, one for each task."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.coupling.events.errands import errand_places, with_errands
from cyclekit.learning.coupling.events.visits import Event, events_of

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit
    from cyclekit.schema import Vector

WITHIN_S = 1.0
"""Tolerance, s: a signal given at a place may change this long after the operator is seen to leave, as the clock of a
PLC may be late."""
GIVEN, OTHER = 0.8, 0.6
"""Minimum share of a signal's changes to one state during visits to one place, if the agent gives the signal there, as
some presses are forgotten or logged late. The second value holds for the other state of the same signal."""
MOST, SOON = 1.5, 0.25
"""Maximum mean number of changes in a visit with any: more come from something that does not heed his visits, unless he
leaves soon after the last one: usually within so much (second value) of the usual time between two of them."""
MIN_LEFT = 5
"""Minimum number of departures that show this."""


def with_givers(courses: Sequence[ExecutionVisits], doubtful: Collection[Event]) -> list[ExecutionVisits]:
    """Return the courses; a signal that the operator gives at one place becomes his arrival or departure there.

    On an errand in the middle of his work he gives none. Where he gives several in one stay, these are so many visits:
    he has done several tasks there without a step aside.

    Args:
        courses: The executions.
        doubtful: Signals to drop if the operator does not give them.
    """
    whole = with_errands(courses, errand_places(courses))
    kinds = sorted({key for course in courses for key in course.events if key.agent == "signal"})
    best = {kind: where for kind in kinds if (where := _best_place(whole, kind)) is not None}
    sure = {(kind.place, event.place) for kind, (share, event) in best.items() if share >= GIVEN}
    given = {
        kind: event
        for kind, (share, event) in best.items()
        if share >= (OTHER if (kind.place, event.place) in sure else GIVEN)
    }
    ends = _task_ends(courses, given)
    found = []
    for one in courses:
        events = {given.get(key, key): at for key, at in one.events.items() if key in given or key not in doubtful}
        visits = list(one.visits["operator"])
        for signal in events:
            if signal in ends:
                visits = parted_at(visits, signal.place, events[signal])
        if len(visits) > len(one.visits["operator"]):
            events |= events_of({"operator": visits})
        found.append(replace(one, visits={**one.visits, "operator": visits}, events=events))
    return found


def _best_place(courses: Sequence[ExecutionVisits], kind: Event) -> tuple[float, Event] | None:
    """Return the place whose visits explain most changes of a signal, as the event of the operator, and their share."""
    places = sorted({visit.place for course in courses for visit in course.visits["operator"]})
    shares = {place: shares_in_visits(courses, kind, place) for place in places}
    place = max(shares, key=lambda name: sum(shares[name]), default=None)
    if place is None:
        return None
    event = "arrives" if shares[place][0] > shares[place][1] else "leaves"
    return sum(shares[place]), Event("operator", place, event, f"{kind.place} {kind.event}")


def _task_ends(courses: Sequence[ExecutionVisits], given: Mapping[Event, Event]) -> set[Event]:
    """Return the events that end the operator's tasks: of a pulse, the change that usually comes first."""
    ends = {kind: event for kind, event in given.items() if event.event == "leaves"}
    first = Counter[Event]()
    for course in courses:
        begins: dict[str, tuple[float, Event]] = {}
        for kind in ends:
            at = course.events.get(kind, np.empty(0))
            if len(at):
                begins[kind.place] = min(begins.get(kind.place, (np.inf, kind)), (float(at[0]), kind))
        first.update(kind for _, kind in begins.values())
    return {
        event
        for kind, event in ends.items()
        if first[kind] >= max(first[one] for one in ends if one.place == kind.place)
    }


def parted_at(visits: Sequence[PlaceVisit], place: str, at: Vector) -> list[PlaceVisit]:
    """Return visits with those to a place in which the operator gives a signal several times parted there."""
    found = []
    for visit in visits:
        ends = _within(visit, at)[:-1].tolist() if visit.place == place else []
        for end_s in ends:
            found.append(visit._replace(left_s=end_s))
            visit = visit._replace(arrived_s=end_s)
        found.append(visit)
    return found


def _within(visit: PlaceVisit, at: Vector) -> Vector:
    """Return the changes of a signal in a visit."""
    end = np.inf if np.isnan(visit.left_s) else visit.left_s
    return at[(at >= visit.arrived_s) & (at <= end + WITHIN_S)]


def shares_in_visits(courses: Sequence[ExecutionVisits], kind: Event, place: str) -> tuple[float, float]:
    """Return the shares of a signal's changes explained by the operator's visits to a place.

    First value: changes nearer to his arrival; second value: changes nearer to his departure. Changes at no visit and
    visits without a change count against it. Several in a visit are all as near as the first or the last one of them;
    where they are more than MOST on average, he has to leave soon after the last one.
    """
    early, late, total, seen = 0, 0, 0, 0
    between_s, after_s = list[float](), list[float]()
    for course in courses:
        at = course.events.get(kind, np.empty(0))
        mine = [_within(visit, at) for visit in course.visits["operator"] if visit.place == place]
        visits = [visit for visit in course.visits["operator"] if visit.place == place]
        for visit, within in zip(visits, mine, strict=True):
            if not len(within):
                continue
            before_s, left_s = float(within[0] - visit.arrived_s), float(visit.left_s - within[-1])
            early, late = (early + len(within), late) if before_s < left_s else (early, late + len(within))
            seen += 1
            between_s += np.diff(within).tolist()
            after_s += [abs(left_s)] if np.isfinite(left_s) else []
        ended = [np.isfinite(visit.left_s) for visit in visits]  # in the last visit of an execution it may come later
        missed = sum(end and not len(within) for end, within in zip(ended, mine, strict=True))
        total += max(len(at), sum(map(len, mine))) + missed
    total = max(total, early + late)
    if not total or (early + late > MOST * seen and not _soon(after_s, between_s)):
        return 0.0, 0.0
    return early / total, late / total


def _soon(after_s: Sequence[float], between_s: Sequence[float]) -> bool:
    """Return whether the operator usually leaves soon after the last change in a visit, relative to those between."""
    return len(after_s) >= MIN_LEFT and bool(np.median(after_s) <= SOON * np.median(between_s))
