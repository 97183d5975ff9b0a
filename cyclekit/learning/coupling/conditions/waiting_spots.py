"""Waiting spots: where the operator stands until he may go on to his next place, and where he has no work of his own.

He goes there only if he has to wait, so no plan names them. The visit is then his wait on the way to the next place, as
the robot waits short of a place.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.errors import UnknownName
from cyclekit.learning.coupling.conditions.candidates import EARLY_S
from cyclekit.learning.coupling.conditions.departures import USUAL
from cyclekit.learning.coupling.events.trips import usual_walks_s
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.cards.coupling import GateCard
    from cyclekit.schema import Vector

NEXT = 0.9
"""Minimum share of the visits to a waiting spot after which he goes to the same place."""
MIN_VISITS, MIN_DIRECT = 10, 5
"""Minimum number of visits to a waiting spot, and of ways to the same place without one: he can go there directly."""
DECIDED = 0.7
"""Minimum ratio of the departures that an event decides to the visits to a waiting spot, and minimum share of those."""
MAX_WORK_S = 3.0
"""If no stay at a place is as short, s, it may be work: then he must react to the event nearly each time."""
REACTS_S, REACTS = 2.5, 0.9
"""A stay ends with an event if it ends within this time of it, s; minimum share of these, if all stays are long."""
FROM, MIN_FROM = 0.1, 3
"""Minimum share and number of the ways from a place that lead over the spot; from other places he does not go there."""

ON_THE_WAY_S, MIN_TURNED = 0.5, 2
"""The event came while he was on his way if it came so long after he left, s; minimum number of such ways."""


class Spot(NamedTuple):
    """A waiting spot.

    Attributes:
        goal: Place to which he then goes.
        origins: Places from which he comes to the spot.
    """

    goal: str
    origins: tuple[str, ...]


def possible_spots(
    courses: Sequence[ExecutionVisits], gates: Iterable[GateCard], none: Collection[str] = ()
) -> dict[str, Spot]:
    """Return the places where the operator may only wait.

    Args:
        courses: The executions.
        gates: Gates learned with the spots as places.
        none: Places where he works, as the cell file tells.

    Raises:
        UnknownName: He goes to no such place.
    """
    mine = [gate for gate in gates if gate.agent == "operator" and gate.conditions]
    waits = {(gate.at, gate.place): gate for gate in mine}
    pairs = [each for course in courses for each in pairwise(course.visits["operator"])]
    found = {}
    places = {visit.place for course in courses for visit in course.visits["operator"]}
    for place in set(none) - places:
        raise UnknownName("cell.toml [[waits]] of the operator", "spot", place, sorted(places))
    for place in sorted({before.place for before, _ in pairs} - set(none)):
        after = [(after.place, before.left_s - before.arrived_s) for before, after in pairs if before.place == place]
        goals = [goal for goal, _ in after]
        goal = max(set(goals), key=lambda name: (goals.count(name), name))
        direct = sum(after.place == goal and before.place not in (place, goal) for before, after in pairs)
        gate = waits.get(("leave", place)) or waits.get(("approach", goal)) or waits.get(("leave", goal))
        if (
            gate is not None
            and len(after) >= MIN_VISITS
            and goals.count(goal) >= NEXT * len(after)
            and direct >= MIN_DIRECT
            and _reacts(courses, place, gate) >= (DECIDED if min(stood for _, stood in after) <= MAX_WORK_S else REACTS)
        ):
            found[place] = Spot(goal, _origins(courses, place, goal, gate))
    return {place: spot for place, spot in found.items() if spot.goal not in found}


def _origins(courses: Sequence[ExecutionVisits], place: str, goal: str, gate: GateCard) -> tuple[str, ...]:
    """Return the places from which he goes to a spot on the way to the goal.

    Where the event came while he was on his way to the goal, he did not wait for it at the place that he came from: he
    turned off before he reached the spot. A place that he leaves more often just after the event is one where he waits;
    who came to the goal before the event waits there.
    """
    over, direct, turned, stayed = Counter[str](), Counter[str](), Counter[str](), Counter[str]()
    for course in courses:
        at = _times_of(course, gate)
        for before, after in pairwise(course.visits["operator"]):
            over[before.place] += after.place == place
            direct[before.place] += after.place == goal
            on_the_way = (at > before.left_s + ON_THE_WAY_S) & (at < after.arrived_s)
            straight = before.place != goal == after.place
            turned[before.place] += straight and bool(on_the_way.any())
            stayed[before.place] += straight * _left_with(at[at > before.arrived_s], before.left_s + ON_THE_WAY_S)
            came_first = (at > after.arrived_s + ON_THE_WAY_S) & (at < after.left_s)
            stayed[before.place] += straight and bool(came_first.any())
    enough = {name: max(FROM * (over[name] + direct[name]), MIN_FROM) for name in (*over, *direct)}
    found = {name for name in enough if over[name] >= enough[name] or turned[name] >= MIN_TURNED}
    return tuple(sorted(name for name in found - {place} if over[name] + turned[name] >= stayed[name]))


def _left_with(at: Vector, left_s: float) -> int:
    """Return 1 if an event came within REACTS_S before he left, and -1 if so long before that: as often by chance."""
    ago = left_s - at
    return int(((ago >= 0.0) & (ago < REACTS_S)).any()) - int(((ago >= REACTS_S) & (ago < 2.0 * REACTS_S)).any())


def _times_of(course: ExecutionVisits, gate: GateCard) -> Vector:
    """Return when events that a gate needs came in an execution, ascending, s."""
    keys = [Event(one.agent, one.place, one.event, one.signal) for one in gate.conditions]
    return np.sort(np.concatenate([np.empty(0), *(course.events[key] for key in keys if key in course.events)]))


def _reacts(courses: Sequence[ExecutionVisits], place: str, gate: GateCard) -> float:
    """Return the share of the stays at a place that end just after an event that the gate needs, or after arrival."""
    quick = []
    for course in courses:
        at = _times_of(course, gate)
        for visit in course.visits["operator"][:-1]:
            if visit.place == place:
                last = np.searchsorted(at, visit.left_s + EARLY_S, side="right") - 1
                quick.append(last >= 0 and visit.left_s - max(at[last], visit.arrived_s) <= REACTS_S)
    return float(np.mean(quick))


def is_spot(courses: Sequence[ExecutionVisits], place: str, gate: GateCard | None) -> bool:
    """Return whether most stays at a place end with an event; `gate`: learned as if the operator only waited there.

    A stay at the end of an execution ends with none.
    """
    visits = sum(visit.place == place for course in courses for visit in course.visits["operator"][:-1])
    return gate is not None and max((one.decided for one in gate.conditions), default=0) >= DECIDED * visits


def spots_of(card: CouplingCard) -> dict[str, Spot]:
    """Return the waiting spots of a card."""
    return {gate.wait_at: Spot(gate.place, gate.wait_from) for gate in card.gates if gate.wait_at is not None}


def with_spots(courses: Sequence[ExecutionVisits], spots: Mapping[str, Spot]) -> list[ExecutionVisits]:
    """Return executions in which a visit to a waiting spot is a wait on the way to the next place."""
    every = [course.visits["operator"] for course in courses]
    walks_s = usual_walks_s(every)
    from_spot_s = {spot.goal: walks_s.get((place, spot.goal), np.inf) for place, spot in spots.items()}
    stays_s = defaultdict[str, list[float]](list)
    for visit in (visit for visits in every for visit in visits[:-1]):
        stays_s[visit.place].append(visit.left_s - visit.arrived_s)
    work_s = {place: float(np.quantile(stays, USUAL)) for place, stays in stays_s.items()}
    return [course.with_operator(_waited(course.visits["operator"], spots, from_spot_s, work_s)) for course in courses]


def _waited(
    visits: Sequence[PlaceVisit],
    spots: Mapping[str, Spot],
    from_spot_s: Mapping[str, float],
    work_s: Mapping[str, float],
) -> list[PlaceVisit]:
    """Return the visits without those to waiting spots.

    Who is not seen to stop there may have turned off on the way, as his event came: he went on at the latest when the
    walk from the spot takes as long as he still took. From places from which he never goes to a spot he waits there,
    once his own work is done.
    """
    found: list[PlaceVisit] = []
    waits: PlaceVisit | None = None
    over = {spot.goal: spot.origins for spot in spots.values()}
    for visit in visits:
        if visit.place in spots:
            waits = visit if waits is None else waits._replace(left_s=visit.left_s)
            continue
        if visit.place in over:
            before = found[-1] if found else None
            if waits is not None and spots[waits.place].goal == visit.place:
                visit = visit._replace(reached_s=waits.arrived_s, went_on_s=waits.left_s)
            elif before is not None and before.place in over[visit.place]:
                went_on_s = max(before.left_s, visit.arrived_s - from_spot_s[visit.place])
                visit = visit._replace(reached_s=before.left_s, went_on_s=went_on_s)
            elif before is not None:
                ready_s = min(before.arrived_s + work_s[before.place], before.left_s)
                visit = visit._replace(reached_s=ready_s, went_on_s=before.left_s)
        waits = None
        found.append(visit)
    return found


__all__ = ["Spot", "is_spot", "possible_spots", "spots_of", "with_spots"]
