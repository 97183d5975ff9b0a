"""Trips that the operator makes while he waits, such as to fetch material: parted from the tasks of his order.

He makes them in some waits only, so no plan names them. A place is one of trips if he goes there more or less often in
executions of the same work, while without it all his other visits are as many as usual. A visit then goes on over the
trip, and its own work does not count the trip.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.coupling import MAX_TRIPS, CouplingCard, GateCard, TripCard
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence


MIN_TRIPS = 10
"""Minimum number of trips to learn from."""
EXPLAINED = 0.5
"""Minimum share of the differences between counts of visits that trips to a place explain."""
MAX_PLACES = 2
"""Maximum number of places of trips."""
MOST = 0.5
"""Maximum share of the operator's time that trips take: what he does most of the time is his work, whose visits vary in
number because several tasks in one stay are one visit."""
MIN_OWN = 5
"""Minimum number of passages with a trip, and of those without a wait, to compare how long he stays before."""
ABOUT_S = 0.5
"""A passage that could go on within this time of the end of own work is neither with nor without a wait, s: he decides
on a trip before he is seen to go."""
ANY_S = 1000.0
"""Conditions that hold so long before or after count as always or never, s."""
SOONEST = 0.05
"""He could go on this level of the quantiles of the lag after his event."""
LONG, LONG_S = 1.5, 1.0
"""A walk longer than so many times the usual one plus so many seconds was a trip on which no stop is seen."""
SHRINK = 10.0
"""Number of passages by which the share of one gate is drawn to that of all."""


class Trip(NamedTuple):
    """A trip within a visit: where to, when he went, and when he was back or could go on as if he were."""

    place: str
    left_s: float
    back_s: float


class Parted(NamedTuple):
    """Visits without trips, and the trip of each visit that has one, by its number."""

    visits: list[PlaceVisit]
    trips: dict[int, Trip]


def part_trips(
    visits: Sequence[PlaceVisit],
    places: Collection[str],
    walks_s: Mapping[tuple[str, str], float],
    gates: Collection[tuple[str, str]] | None = None,
    after_s: float = 0.0,
) -> Parted:
    """Return visits with those to places of trips within the visits from which they began.

    Args:
        visits: Visits of the operator in one execution.
        places: Places of trips.
        walks_s: Usual time from one place to another, s: who comes from a trip and does not stop where he began it
            could have gone on from there so long before he arrives.
        gates: (`approach` or `leave`, place) of the gates at which trips begin; None: any.
        after_s: How long he waits before he goes on a trip, s; that is part of the trip.
    """
    if not places:
        return Parted(list(visits), {})
    found, trips, number = list[PlaceVisit](), dict[int, Trip](), _begins(visits, places)
    while number < len(visits):
        here, last = visits[number], number
        while last + 1 < len(visits) and here.place not in places and _goes_on(visits[number : last + 2], places):
            last += 1
        next_ = visits[last + 1] if last + 1 < len(visits) else None
        home = last > number and visits[last].place == here.place
        went = next_ is not None and here.place not in places and (last > number or _is_long(here, next_, walks_s))
        if went and next_ is not None and _at_gate(here.place, next_.place, gates, home=home):
            trip, left_s = _trip(visits[number : last + 1], next_, walks_s, places)
            trip = trip._replace(left_s=max(trip.left_s - after_s, here.arrived_s))
            trips[len(found)] = trip
            found.append(here._replace(left_s=left_s, away_s=trip.back_s - trip.left_s))
        elif next_ is None and last > number:  # the execution ends during a trip or after it
            away_s = visits[last].arrived_s - here.left_s if home else 0.0
            found.append(here._replace(left_s=visits[last].left_s if home else here.left_s, away_s=away_s))
        else:
            last = number
            found.append(here)
        number = last + 1
    return Parted(found, trips)


def _begins(visits: Sequence[PlaceVisit], places: Collection[str]) -> int:
    """Return the number of the first visit that is not of a trip that began before the execution; 0 if all are."""
    return next((number for number, visit in enumerate(visits) if visit.place not in places), 0)


def _goes_on(visits: Sequence[PlaceVisit], places: Collection[str]) -> bool:
    """Return whether the last of some visits belongs to a trip from the first: it is of a trip, or back there."""
    return visits[-1].place in places or visits[-1].place == visits[0].place


def _is_long(here: PlaceVisit, next_: PlaceVisit, walks_s: Mapping[tuple[str, str], float]) -> bool:
    usual_s = walks_s.get((here.place, next_.place), np.inf)
    return next_.arrived_s - here.left_s > LONG * usual_s + LONG_S


def _at_gate(here: str, goal: str, gates: Collection[tuple[str, str]] | None, *, home: bool) -> bool:
    return gates is None or ("approach", goal) in gates or (home and ("leave", here) in gates)


def _trip(
    visits: Sequence[PlaceVisit],
    next_: PlaceVisit,
    walks_s: Mapping[tuple[str, str], float],
    places: Collection[str],
) -> tuple[Trip, float]:
    """Return the trip in visits from one place on, and when he went on from there."""
    here, last = visits[0], visits[-1]
    place = next((visit.place for visit in visits if visit.place in places), min(places))
    if len(visits) > 1 and last.place == here.place:
        return Trip(place, here.left_s, last.arrived_s), last.left_s
    went_s = next_.arrived_s - walks_s.get((here.place, next_.place), np.inf)
    back_s = max(last.left_s, went_s)
    return Trip(place, here.left_s, back_s), back_s


def usual_walks_s(visits: Sequence[Sequence[PlaceVisit]]) -> dict[tuple[str, str], float]:
    """Return the median time from each place to each other one, s."""
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    for mine in visits:
        for before, after in pairwise(mine):
            found[before.place, after.place].append(after.arrived_s - before.left_s)
    return {way: float(np.median(times)) for way, times in found.items()}


def trip_places(courses: Sequence[ExecutionVisits]) -> tuple[str, ...]:
    """Return the places to which trips are made; empty if all visits are as many as the work wants.

    None of them is a place where the operator gives a signal: that is work of his order.
    """
    places: tuple[str, ...] = ()
    left = _differences(courses, places)
    others = {visit.place for course in courses for visit in course.visits["operator"]}
    others -= {key.place for course in courses for key in course.events if key.agent == "operator" and key.signal}
    while left >= MIN_TRIPS and len(places) < MAX_PLACES:
        tried = {other: _differences(courses, (*places, other)) for other in sorted(others - set(places))}
        best = min(tried, key=lambda other: tried[other], default=None)
        if best is None or tried[best] > (1.0 - EXPLAINED) * left:
            break
        places, left = (*places, best), tried[best]
    return places


def _differences(courses: Sequence[ExecutionVisits], places: Collection[str]) -> int:
    """Return by how many the counts of visits differ from those usual in executions with the same work of the robot."""
    alike: dict[frozenset[tuple[str, int]], list[Counter[str]]] = defaultdict(list)
    for course in courses:
        work = Counter(visit.place for visit in course.visits["robot"])
        mine = part_trips(course.visits["operator"], places, {}).visits
        alike[frozenset(work.items())].append(Counter(visit.place for visit in mine))
    total = 0
    for counts in alike.values():
        for place in set().union(*counts):
            some = np.array([each[place] for each in counts])
            total += int(np.abs(some - np.bincount(some).argmax()).sum())
    return total


def parted_courses(
    courses: Sequence[ExecutionVisits],
    places: Collection[str],
    gates: Collection[tuple[str, str]] | None = None,
    after_s: float = 0.0,
) -> tuple[list[ExecutionVisits], list[dict[int, Trip]]]:
    """Return executions with the trips at some gates parted from the operator's visits, and these trips."""
    walks_s = usual_walks_s([course.visits["operator"] for course in courses])
    found, trips = [], []
    for course in courses:
        parted = part_trips(course.visits["operator"], places, walks_s, gates, after_s)
        found.append(course.with_operator(parted.visits))
        trips.append(parted.trips)
    return found, trips


def are_trips(courses: Sequence[ExecutionVisits], trips: Sequence[Mapping[int, Trip]]) -> bool:
    """Return whether trips are as many as it takes to learn from them, and take no more than MOST of his time.

    Args:
        courses: Executions without trips.
        trips: Trips in each of them, by number of the visit.
    """
    every = [trip for some in trips for trip in some.values()]
    away_s = sum(trip.back_s - trip.left_s for trip in every if trip.back_s > trip.left_s)
    times = [np.array([(one.arrived_s, one.left_s) for one in course.visits["operator"]]) for course in courses]
    seen_s = sum(float(np.nanmax(each) - np.nanmin(each)) for each in times if np.isfinite(each).any())
    return len(every) >= MIN_TRIPS and away_s <= MOST * seen_s


class _Passage(NamedTuple):
    """A passage of a gate.

    Attributes:
        visit: The visit that it ends.
        trip: Its trip, if any.
        late_s: How long after the end of own work the conditions let him go on, s.
    """

    visit: PlaceVisit
    trip: Trip | None
    late_s: float

    @property
    def waits(self) -> bool | None:
        """Whether he had to wait; None: not clear."""
        return self.late_s > 0.0 if abs(self.late_s) > ABOUT_S else None


def waits_before_s(
    card: CouplingCard, courses: Sequence[ExecutionVisits], trips: Sequence[Mapping[int, Trip]]
) -> float:
    """Return how much longer the operator stays before a trip than where he has no reason to wait, s."""
    own_s: dict[str, list[float]] = defaultdict(list)
    passages = [each for gate in card.gates if _may(gate) for each in _passages(card, gate, courses, trips)]
    for each in passages:
        if each.trip is None and not each.waits:
            own_s[each.visit.place].append(each.visit.left_s - each.visit.arrived_s)
    usual_s = {place: float(np.median(times)) for place, times in own_s.items() if len(times) >= MIN_OWN}
    more_s = [
        each.trip.left_s - each.visit.arrived_s - usual_s[each.visit.place]
        for each in passages
        if each.trip is not None and each.visit.place in usual_s
    ]
    return max(float(np.median(more_s)), 0.0) if len(more_s) >= MIN_OWN else 0.0


def with_trips(
    card: CouplingCard,
    courses: Sequence[ExecutionVisits],
    trips: Sequence[Mapping[int, Trip]],
    places: Sequence[str],
    after_s: float,
) -> CouplingCard | None:
    """Return the card with the operator's trips at its gates; None if there are too few.

    Args:
        card: Conditions learned from the courses.
        courses: Executions without trips.
        trips: Trips in each of them, by number of the visit.
        places: Places of trips.
        after_s: How long he waits before he goes, s.
    """
    passages = {gate: list(_passages(card, gate, courses, trips)) for gate in card.gates if _may(gate)}
    every = [each for some in passages.values() for each in some]
    if sum(each.trip is not None for each in every) < MIN_TRIPS:
        return None
    gates = []
    for gate in card.gates:
        mine = passages.get(gate, ())
        seen = sum(each.trip is not None for each in mine)
        if not seen:
            gates.append(gate)
            continue
        waiting, free = (_share(mine, every, waits=waits) for waits in (True, False))
        late_s, took_s = zip(*_logged(mine if seen >= MIN_TRIPS else every), strict=True)
        trip = TripCard(
            places=tuple(places), waiting=waiting, free=free, took_s=took_s, late_s=late_s, after_s=after_s, seen=seen
        )
        gates.append(structs.replace(gate, trip=trip))
    return structs.replace(card, gates=tuple(gates))


def _logged(passages: Sequence[_Passage]) -> list[tuple[float, float]]:
    """Return how late the conditions let him go on after the begin of each trip, and how long it took, s, sorted."""
    found = sorted(
        (float(np.clip(each.late_s, -ANY_S, ANY_S)), round(each.trip.back_s - each.trip.left_s, 4))
        for each in passages
        if each.trip is not None
    )
    step = -(-len(found) // MAX_TRIPS)
    return [(round(late_s, 4), took_s) for late_s, took_s in found[::step]]


def _share(mine: Sequence[_Passage], every: Sequence[_Passage], *, waits: bool) -> float:
    """Return the share of passages with a trip, drawn to that at all gates."""
    (count, goes), (all_count, all_go) = (
        (sum(each.waits is waits for each in some), sum(each.waits is waits and each.trip is not None for each in some))
        for some in (mine, every)
    )
    return round((goes + SHRINK * all_go / (all_count + 1.0)) / (count + SHRINK), 4)


def _may(gate: GateCard) -> bool:
    return gate.agent == "operator" and bool(gate.conditions)


def _passages(
    card: CouplingCard, gate: GateCard, courses: Sequence[ExecutionVisits], trips: Sequence[Mapping[int, Trip]]
) -> Iterator[_Passage]:
    """Yield the logged passages of a gate; those on the way to another gate are its own."""
    leaving = [one for one in card.gates if (one.agent, one.at) == ("operator", "leave")]
    usual_s = {one.place: float(np.median(one.own_s)) for one in leaving}
    held = {one.place for one in card.gates if one.at == "approach" and _may(one)}
    for course, mine in zip(courses, trips, strict=True):
        for number, visit, occurrence in _passed(course, gate):
            if gate.at == "leave" and course.visits["operator"][number + 1].place in held:
                continue
            trip = mine.get(number)
            ready_s = visit.arrived_s + course.pace * usual_s.get(visit.place, 0.0) if trip is None else trip.left_s
            late_s = max((at - ready_s for at in _needed_s(course, gate, occurrence)), default=-np.inf)
            if np.isfinite(ready_s):
                yield _Passage(visit, trip, late_s)


def _passed(course: ExecutionVisits, gate: GateCard) -> Iterator[tuple[int, PlaceVisit, int]]:
    """Yield the visits of the operator that end at a gate: number, visit, number of the passage."""
    visits = course.visits["operator"]
    occurrence = int(gate.at == "approach" and bool(visits) and visits[0].place == gate.place)
    for number, (visit, after) in enumerate(pairwise(visits)):
        if (visit if gate.at == "leave" else after).place == gate.place:
            yield number, visit, occurrence
            occurrence += 1


def _needed_s(course: ExecutionVisits, gate: GateCard, occurrence: int) -> Iterator[float]:
    """Yield when each condition lets a passage go on at the soonest, s."""
    for one in gate.conditions:
        at = course.events.get(Event(one.agent, one.place, one.event), np.empty(0))
        number = one.turns.event(occurrence, one.back)
        if number is not None:
            came = float(at[number]) if number < len(at) and not np.isnan(at[number]) else np.inf
            yield came + soonest_s(one.lag_s)


def soonest_s(lag_s: Sequence[float]) -> float:
    """Return the lag, given by its quantiles, after which somebody who waits goes on at the soonest, s."""
    return float(np.quantile(lag_s, SOONEST))
