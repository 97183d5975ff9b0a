"""Waiting spots: where the operator stands until he may go on to his next place, and where he has no work of his own.

He goes there only if he has to wait, so no plan names them. The visit is then his wait on the way to the next place, as
the robot waits short of a place.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import UnknownName
from cyclekit.learning.coupling.trips import usual_walks_s
from cyclekit.learning.coupling.visits import ExecutionVisits, PlaceVisit

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.cards.coupling import GateCard

NEXT = 0.95
"""Minimum share of the visits to a waiting spot after which he goes to the same place."""
MIN_VISITS, MIN_DIRECT = 10, 5
"""Minimum number of visits to a waiting spot, and of ways to the same place without one: he can go there directly."""
DECIDED = 0.7
"""Minimum ratio of the departures that an event decides to the visits to a waiting spot."""
MAX_WORK_S = 3.0
"""Maximum of the shortest stay at a waiting spot, s."""


def possible_spots(
    courses: Sequence[ExecutionVisits], gates: Iterable[GateCard], none: Collection[str] = ()
) -> dict[str, str]:
    """Return the places where the operator may only wait, each with the place that he then goes to.

    Args:
        courses: The executions.
        gates: Gates learned with the spots as places.
        none: Places where he works, as the cell file tells.

    Raises:
        UnknownName: He goes to no such place.
    """
    mine = [gate for gate in gates if gate.agent == "operator" and gate.conditions]
    waits = {(gate.at, gate.place) for gate in mine}
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
        if (
            {("leave", place), ("approach", goal)} & waits
            and len(after) >= MIN_VISITS
            and goals.count(goal) >= NEXT * len(after)
            and direct >= MIN_DIRECT
            and min(stood_s for _, stood_s in after) <= MAX_WORK_S
        ):
            found[place] = goal
    return {place: goal for place, goal in found.items() if goal not in found}


def is_spot(courses: Sequence[ExecutionVisits], place: str, gate: GateCard | None) -> bool:
    """Return whether most stays at a place end with an event; `gate`: learned as if the operator only waited there."""
    visits = sum(visit.place == place for course in courses for visit in course.visits["operator"])
    return gate is not None and max((one.decided for one in gate.conditions), default=0) >= DECIDED * visits


def spots_of(card: CouplingCard) -> dict[str, str]:
    """Return the waiting spots of a card, each with the place that he waits for."""
    return {gate.wait_at: gate.place for gate in card.gates if gate.wait_at is not None}


def with_spots(courses: Sequence[ExecutionVisits], spots: Mapping[str, str]) -> list[ExecutionVisits]:
    """Return executions in which a visit to a waiting spot is a wait on the way to the next place."""
    walks_s = usual_walks_s([course.visits["operator"] for course in courses])
    from_spot_s = {goal: walks_s.get((place, goal), np.inf) for place, goal in spots.items()}
    return [course.with_operator(_waited(course.visits["operator"], spots, from_spot_s)) for course in courses]


def _waited(
    visits: Sequence[PlaceVisit], spots: Mapping[str, str], from_spot_s: Mapping[str, float]
) -> list[PlaceVisit]:
    """Return the visits without those to waiting spots.

    Who is not seen to stop there may have turned off on the way, as his event came: he went on at the latest when the
    walk from the spot takes as long as he still took.
    """
    found: list[PlaceVisit] = []
    waits: PlaceVisit | None = None
    for visit in visits:
        if visit.place in spots:
            waits = visit if waits is None else waits._replace(left_s=visit.left_s)
            continue
        if visit.place in spots.values():
            if waits is not None and spots[waits.place] == visit.place:
                visit = visit._replace(reached_s=waits.arrived_s, went_on_s=waits.left_s)
            elif found:
                went_on_s = max(found[-1].left_s, visit.arrived_s - from_spot_s[visit.place])
                visit = visit._replace(reached_s=found[-1].left_s, went_on_s=went_on_s)
        waits = None
        found.append(visit)
    return found


__all__ = ["is_spot", "possible_spots", "spots_of", "with_spots"]
