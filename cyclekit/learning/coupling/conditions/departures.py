"""Gates of an agent and their logged departures: when it was free to go, when it went, and after which events."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from cyclekit.dataset.cards.coupling import Turns
from cyclekit.learning.coupling.conditions.lags import Causes, deciding_causes

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.coupling import Agent
    from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit
    from cyclekit.schema import Bools, Floats, Ints, Vector

    Names = NDArray[np.str_]

SEEN = 120
"""Maximum number of departures by which conditions are compared."""
GAIN, GAIN_PER_DEPARTURE = 8.0, 0.05
"""Minimum gain in log-likelihood: the first value, plus the second per departure."""
USUAL = 0.1
"""Level of the quantile of stays at which own work usually ends: longer ones may be waits."""


@dataclass(frozen=True)
class Gate:
    """Where an agent may have to wait, as in `GateCard`; `short`: short of the place, otherwise where it comes from."""

    agent: Agent
    at: Literal["leave", "approach"]
    place: str
    short: bool = False


class Condition(NamedTuple):
    """An event and the occurrence of it that a departure needs (`ConditionCard`); `partly`: only some need it."""

    event: Event
    back: int
    turns: Turns = Turns()
    partly: bool = False


@dataclass
class Departures:
    """All logged departures of one gate.

    Attributes:
        gate: The gate.
        rows: Number of each one among all departures of the agent, shape (N,).
        course, occurrence: Number of the execution, and of the departure within it from 0, shape (N,).
        own_s, left_s: When the agent was free to go or arrived, and when it went on, shape (N,).
        came_s: When it arrived at the next place, shape (N,).
        since_s: Time from the event of each condition to the departure, shape (N,), s; NaN = no event needed, -inf =
            the event came later.
        alike: Departures from all places of the kind that need a condition, where these were learned together.
        goal: Next place of each, shape (N,).
        more_s: How much longer the operator's own work usually is before going to that place, shape (N,) or (1,), s:
            `own_s` is that much later, so that own work is comparable between next places.
        stayed_s: How long the operator had been at the gate's place when an execution ended, at his latest pace, shape
            (M,), s.
    """

    gate: Gate
    rows: Ints
    course: Ints
    occurrence: Ints
    own_s: Vector
    left_s: Vector
    came_s: Vector
    since_s: dict[tuple[Gate, Condition], Vector] = field(default_factory=dict)
    alike: dict[Condition, Alike] = field(default_factory=dict)
    goal: Names = field(default_factory=lambda: np.empty(0, np.str_))
    more_s: Vector = field(default_factory=lambda: np.zeros(1))
    stayed_s: Vector = field(default_factory=lambda: np.empty(0))

    @property
    def found(self) -> list[Condition]:
        """Conditions of this gate."""
        return [condition for gate, condition in self.since_s if gate == self.gate]

    @property
    def seen(self) -> Ints:
        """Numbers of the departures by which conditions are compared: evenly spread, but of all occurrences."""
        return _spread_over(len(self.left_s))

    @property
    def weight(self) -> float:
        """How many departures each of these stands for."""
        return max(1.0, len(self.left_s) / SEEN)

    def causes(self, more: Vector | None = None) -> Causes:
        """Return which cause decided each departure (at most SEEN): own work first, then conditions as in `since_s`."""
        return deciding_causes(self._since(more))

    def waits(self, more: Vector) -> Causes:
        """Return the same as `causes` if own work never decides."""
        return deciding_causes(self._since(more)[1:])

    def _since(self, more: Vector | None) -> Floats:
        columns = [self.left_s - self.own_s, *self.since_s.values(), *([] if more is None else [more])]
        return np.array([column[self.seen] for column in columns])


@cache
def _spread_over(count: int) -> Ints:
    """Return at most SEEN of so many numbers; to be read, not changed."""
    if count <= SEEN:
        return np.arange(count)
    within = np.random.default_rng(0).random(SEEN)
    return np.asarray((np.arange(SEEN) + within) * count / SEEN, dtype=np.int64)


class Alike(NamedTuple):
    """Departures from all places of one kind that need a condition.

    Attributes:
        joined: The departures, as those of one gate.
        condition: The condition, as one of that gate.
        seen_s: Time from the event as a plan knows it to each departure, shape (N,), s.
        mine: Which departures are of this gate, shape (N,).
    """

    joined: Departures
    condition: Condition
    seen_s: Vector
    mine: Bools


def departures_of(courses: Sequence[ExecutionVisits], agent: Agent) -> list[Departures]:
    """Return the departures of every possible gate of an agent, with own work comparable between places."""
    rows: dict[Gate, list[tuple[int, int, int, float, float, float]]] = {}
    goals: dict[Gate, list[str]] = {}
    stayed: dict[Gate, list[float]] = {}
    number = 0
    for index, course in enumerate(courses):
        counts: dict[Gate, int] = {}
        visits = course.visits[agent]
        for before, after in zip([None, *visits], [*visits, None], strict=True):
            for gate, own_s, left_s in _passed(agent, before, after):
                occurrence = counts.get(gate, 0)
                counts[gate] = occurrence + 1
                began = agent == "robot" and not gate.short and left_s <= own_s  # at this place from the start
                if np.isfinite(own_s) and np.isfinite(left_s) and not began:
                    came_s = np.nan if after is None else after.arrived_s
                    rows.setdefault(gate, []).append((number, index, occurrence, own_s, left_s, came_s))
                    goals.setdefault(gate, []).append("" if after is None else after.place)
            number += 1
        if agent == "operator" and len(visits) > 1 and course.visits["robot"]:
            stayed_s = course.visits["robot"][-1].arrived_s - visits[-1].arrived_s - visits[-1].away_s
            stayed.setdefault(Gate(agent, "leave", visits[-1].place), []).append(stayed_s / course.pace)
    found = [_departures(gate, some, goals[gate]) for gate, some in rows.items()]
    for each in found:
        each.stayed_s = np.array([s for s in stayed.get(each.gate, ()) if s > 0.0])
    return _comparable(found)


def _passed(agent: Agent, before: PlaceVisit | None, after: PlaceVisit | None) -> Iterator[tuple[Gate, float, float]]:
    if after is not None:
        yield Gate(agent, "approach", after.place, short=True), after.reached_s, after.went_on_s
    if before is not None and after is not None:  # without a known destination another gate may have decided
        free_s = before.arrived_s + before.away_s  # a trip is no own work
        yield Gate(agent, "leave", before.place), free_s, before.left_s
    if after is not None:  # who begins there, or is there already, does not go there, but it is one of the visits
        goes = before is not None and (before.place != after.place or before.left_s < after.arrived_s)
        free_s, left_s = (free_s, before.left_s) if before is not None and goes else (np.nan, np.nan)
        yield Gate(agent, "approach", after.place), free_s, left_s


def _departures(gate: Gate, some: list[tuple[int, int, int, float, float, float]], goals: list[str]) -> Departures:
    rows, course, occurrence = np.array([each[:3] for each in some], np.int64).T
    own_s, left_s, came_s = np.array([each[3:] for each in some]).T
    return Departures(gate, rows, course, occurrence, own_s, left_s, came_s, goal=np.array(goals))


def _comparable(found: list[Departures]) -> list[Departures]:
    """Return the departures with own work comparable between next places, and approaches also between places left.

    Approaches from several places count own work from its typical end at each place.
    """
    usual = np.full(1 + max((int(each.rows.max()) for each in found), default=0), 0.0)
    for each in found:
        if each.gate.at == "leave":
            each.more_s = _more_work_s(each) if each.gate.agent == "operator" else each.more_s
            each.own_s = each.own_s + each.more_s
            usual[each.rows] = np.quantile(each.left_s - each.own_s, USUAL) + each.more_s
    for each in found:
        if each.gate.at == "approach" and not each.gate.short:
            each.own_s = each.own_s + usual[each.rows]
    short = {each.gate.place for each in found if each.gate.short}
    return [each for each in found if each.gate.short or each.gate.at == "leave" or each.gate.place not in short]


def _more_work_s(leaving: Departures) -> Vector:
    """Return by how much longer than to the first one own work before each next place is, s; 0 if not clearly."""
    names, group, counts = np.unique(leaving.goal, return_inverse=True, return_counts=True)
    stays_s, more_s = leaving.left_s - leaving.own_s, np.zeros(len(group))
    if len(names) < 2 or counts.max() == len(group):
        return more_s
    some = leaving.seen
    split = np.where(group[some] == np.arange(len(names))[:, None], stays_s[some], np.nan)
    apart, together = (float(deciding_causes(each).log_likelihood.sum()) for each in (split, stays_s[some][None]))
    if apart - together < least_gain(len(some)):
        return more_s
    ends_s = np.array([np.quantile(stays_s[group == n], USUAL) for n in range(len(names))])
    return np.asarray((ends_s - ends_s.min())[group])


def least_gain(departures: int) -> float:
    """Return the minimum gain in log-likelihood at which a cause is accepted, for a number of departures."""
    return GAIN + GAIN_PER_DEPARTURE * departures


def condition_gain(gate: Departures, condition: Condition) -> float:
    """Return the gain in log-likelihood of a gate's departures from one of its conditions."""
    without = replace(gate, since_s={key: at for key, at in gate.since_s.items() if key != (gate.gate, condition)})
    return float((gate.causes().log_likelihood - without.causes().log_likelihood).sum()) * gate.weight
