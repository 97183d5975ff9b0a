"""The card of who waits for whom, learned from positions of both agents, or of the robot alone with signals."""

from __future__ import annotations

from dataclasses import replace as dataclass_replace
from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl
from msgspec.structs import replace

from cyclekit.dataset.cards.coupling import (
    Agent,
    ConditionCard,
    CouplingCard,
    GateCard,
    OwnWorkCard,
    SourceCard,
)
from cyclekit.errors import ConfigError, DatasetError
from cyclekit.learning.coupling.conditions.alike import Kinds, find_with_alike, kinds_by_waits
from cyclekit.learning.coupling.conditions.answers import is_own_tool
from cyclekit.learning.coupling.conditions.candidates import early_s, times_of
from cyclekit.learning.coupling.conditions.circles import in_circles
from cyclekit.learning.coupling.conditions.conditions import FEW_DECIDED, KEPT, MIN_DECIDED, decided_by
from cyclekit.learning.coupling.conditions.departures import USUAL, Condition, Departures, Gate
from cyclekit.learning.coupling.conditions.given_signals import Waited, since_given, waited_visits
from cyclekit.learning.coupling.conditions.in_turn import find_in_turn
from cyclekit.learning.coupling.conditions.observed import TIE_S, lag_of, own_work, own_work_decides
from cyclekit.learning.coupling.conditions.together import NeededTogether, needed_together
from cyclekit.learning.coupling.conditions.waiting_spots import is_spot, possible_spots, spots_of, with_spots
from cyclekit.learning.coupling.events.errands import errand_places, with_errands
from cyclekit.learning.coupling.events.logged_visits import courses_of
from cyclekit.learning.coupling.events.part_visits import WAITED_S
from cyclekit.learning.coupling.events.trips import are_trips, parted_courses, trip_places, waits_before_s, with_trips
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits
from cyclekit.learning.coupling.pace.common_pace import with_common_pace
from cyclekit.learning.coupling.pace.own_work import own_work_by_place, rest_at_start
from cyclekit.learning.coupling.pace.pace import at_latest_pace, operator_pace, paces_beside
from cyclekit.learning.coupling.parts.unseen_parts import find_unseen_parts, with_parts
from cyclekit.learning.coupling.phases import with_phases
from cyclekit.learning.coupling.several_people import several_people
from cyclekit.learning.coupling.sources import find_sources
from cyclekit.learning.coupling.subset import in_runs

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from cyclekit.config import Wait
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Vector

    UnseenParts = Callable[[str], SourceCard | None]

MIN_EXECUTIONS, MAX_EXECUTIONS = 5, 400
"""Minimum and maximum number of executions to learn from; if there are more, evenly spaced runs of them are used."""
EVEN = 0.2
"""Maximum ratio of the ranges of lag and standstill, 10 to 90 %, if the event explains the standstills."""
NEARLY_ALL = 0.9
"""Minimum share of the long standstills at a place that need a condition of the way to another place, if that explains
them."""
AGENTS: tuple[Agent, ...] = ("robot", "operator")


def learn_coupling(dataset: Dataset) -> CouplingCard | None:
    """Return who waits for whom in a dataset.

    None in too few executions, of the robot alone without waits, or where several people are taken for one.
    """
    if dataset.card.coupling is not None and not dataset.is_part:
        return dataset.card.coupling
    if "robot" not in dataset.positions or several_people(dataset.recordings):
        return None
    try:
        mine = dataset.tasks()
    except DatasetError:  # without tasks the safety function can still be learned
        return None
    return learn_executions(courses_of_dataset(dataset), mine, dataset.card.settings.waits)


def told_coupling(dataset: Dataset) -> CouplingCard | None:
    """Return the card of a dataset if nobody waits but for what the cell file tells: waits are part of the work."""
    courses, given = courses_of_dataset(dataset), dataset.card.settings.waits
    return learn_executions(courses, dataset.tasks(), given, told_only=True)


def courses_of_dataset(dataset: Dataset) -> list[ExecutionVisits]:
    """Return the complete executions of a dataset, as `courses_of` does.

    Raises:
        DatasetError: It has no tasks.
    """
    fields = [name for one in dataset.card.operator_signals for name in (one.signal, one.reset) if name]
    every = dataset.every_task()
    goals, read, bits = dataset.card.settings.goal_signals, dataset.recorded, dataset.bits
    return courses_of(dataset.card.executions, every, dataset.recordings, read, bits, fields, goals)


def pace_before_and_after(older: Dataset, newer: Dataset) -> tuple[Vector, Vector] | None:
    """Return the durations of the operator's work and walks per execution, relative to the usual ones in older logs.

    Those of older logs are at his latest pace in them. None where he waits for nothing, or too little is known.
    """
    card = older.card.coupling
    if card is None or not card.coupled or newer.card.coupling is None:
        return None
    before, after = (_without_known_trips(courses_of_dataset(each), card) for each in (older, newer))
    return paces_beside(before, after, card)


def learn_executions(
    courses: Sequence[ExecutionVisits], tasks: pl.DataFrame, given: Sequence[Wait] = (), *, told_only: bool = False
) -> CouplingCard | None:
    """Return who waits for whom in some executions; None in too few, or of the robot alone where it does not wait.

    Args:
        courses: The executions.
        tasks: Tasks of the robot, table TASKS.
        given: Waits given in the cell file.
        told_only: Whether only these are waited for.

    Raises:
        UnknownName: The cell file names a place or event that the logs do not contain.
    """
    if len(courses) < MIN_EXECUTIONS:
        return None
    some = [courses[number] for number in in_runs(len(courses), MAX_EXECUTIONS)]
    found = learn_courses(some, given, told_only=told_only)
    if (pace := operator_pace(_without_known_trips(courses, found), found)) is not None:
        factors = pace.factors()
        paced = [dataclass_replace(one, pace=factors[one.name][0]) for one in some]
        found = learn_courses(paced, given, told_only=told_only)
        found = replace(found, pace=pace)
    found = with_common_pace(_without_known_trips(courses, found), found)
    if not found.coupled and not any(course.visits["operator"] for course in courses):
        return None
    return replace(found, gates=with_phases(found.gates, tasks))


def _without_known_trips(courses: Sequence[ExecutionVisits], card: CouplingCard) -> Sequence[ExecutionVisits]:
    """Return executions with the trips, errands and waits at spots of a card parted from the operator's visits."""
    courses = with_errands(courses, card.errands) if card.errands else courses
    courses = with_spots(courses, spots) if (spots := spots_of(card)) else courses
    gates = {(gate.at, gate.place): gate.trip for gate in card.gates if gate.trip is not None}
    if not gates:
        return courses
    places = {place for trip in gates.values() for place in trip.places}
    return parted_courses(courses, places, gates, max(trip.after_s for trip in gates.values()))[0]


def learn_courses(
    courses: Sequence[ExecutionVisits], given: Sequence[Wait] = (), *, told_only: bool = False
) -> CouplingCard:
    """Return the wait conditions learned from executions, without the `phase` of the robot's approach gates.

    Where the operator makes trips while he waits, these are parted from his visits first. Errands in the middle of his
    work are part of the visit that they interrupt, and visits to a place where he only waits are waits on the way.
    """
    if told := next((wait.task for wait in given if wait.task is not None), None):
        msg = f"cell.toml [[waits]]: task {told!r} tells of a task list, and these logs have positions"
        raise ConfigError(msg, cure='Name the place: before = "fixture" or leaving = "fixture"')
    works_at = [wait.spot for wait in given if wait.spot is not None]
    given = [wait for wait in given if wait.place("approach") or wait.place("leave")]
    parts = None if told_only else cache(partial(find_unseen_parts, courses))  # slow; no visit of the robot changes
    places, known = trip_places(courses), None
    if places:
        known = _at_spots(courses, _without_trips(courses, given, parts), given, parts, works_at)
        if (spots := spots_of(known)) and not trip_places(with_spots(courses, spots)):
            return known
        parted, trips = parted_courses(courses, places)
        found = _without_trips(parted, given, parts)
        gates = {(gate.at, gate.place) for gate in found.gates if gate.agent == "operator" and gate.conditions}
        after_s = waits_before_s(found, parted, trips)
        parted, trips = parted_courses(courses, places, gates, after_s)
        if are_trips(parted, trips):
            tried = with_trips(_without_trips(parted, given, parts), parted, trips, places, after_s)
            if tried is not None:
                return tried
    errands = errand_places(courses)
    courses = with_errands(courses, errands) if errands else courses
    if known is None or errands:
        known = _at_spots(courses, _without_trips(courses, given, parts), given, parts, works_at)
    return replace(known, errands=errands)


def _at_spots(
    courses: Sequence[ExecutionVisits],
    found: CouplingCard,
    given: Sequence[Wait],
    parts: UnseenParts | None,
    works_at: Collection[str],
) -> CouplingCard:
    """Return the card learned with visits to places where the operator only waits as waits on the way."""
    spots = {}
    for place, spot in possible_spots(courses, found.gates, works_at).items():
        tried = _without_trips(with_spots(courses, {place: spot}), given, parts)
        if is_spot(courses, place, next((gate for gate in tried.gates if _goes_on(gate, spot.goal)), None)):
            spots[place] = spot
    if not spots:
        return found
    found = _without_trips(with_spots(courses, spots), given, parts)
    gates = list(found.gates)
    for place, (goal, origins) in spots.items():
        changed = {"wait_at": place, "wait_from": origins}
        gates = [replace(gate, **changed) if _goes_on(gate, goal) else gate for gate in gates]
    return replace(found, gates=tuple(gates))


def _goes_on(gate: GateCard, goal: str) -> bool:
    return (gate.agent, gate.at, gate.place) == ("operator", "approach", goal)


def _without_trips(
    courses: Sequence[ExecutionVisits], given: Sequence[Wait], parts: UnseenParts | None
) -> CouplingCard:
    """Return the wait conditions learned from executions in which no visit is a trip; without `parts` those given."""
    barred: dict[Agent, set[Event]] = {agent: set() for agent in AGENTS}
    if parts is None:
        barred = {agent: set(times_of(courses)) for agent in AGENTS}
    kinds: dict[Agent, Kinds] = {}
    departures = {agent: find_with_alike(courses, agent, given, barred[agent]) for agent in AGENTS}
    turns: tuple[tuple[Agent, Agent], ...] = (("robot", "operator"), ("operator", "robot"), ("robot", "operator"))
    for who, other in turns:
        known, kinds[who] = kinds.get(who, {}), kinds_by_waits(departures[other])
        if kinds[who] != known:
            departures[who] = find_with_alike(courses, who, given, barred[who], kinds[who])
    unseen = _unseen(departures["robot"], given, parts) if parts else ()
    if unseen:
        courses = with_parts(courses, unseen)
        departures["robot"] = find_with_alike(courses, "robot", given, (), kinds["robot"])
    while (tools := _tools(courses, departures["robot"]) - barred["robot"]) and not given:
        barred["robot"] |= tools
        departures["robot"] = find_with_alike(courses, "robot", given, barred["robot"], kinds["robot"])
    while circle := next(in_circles(departures["robot"], departures["operator"]), None):
        agent, event = circle
        if event in barred[agent]:  # given in the cell file
            break
        barred[agent].add(event)
        departures[agent] = find_with_alike(courses, agent, given, barred[agent], kinds[agent])
    together, waited = needed_together(*departures.values()), waited_visits(departures["operator"])
    found = []
    for mine in departures.values():
        beside = _Beside(_usual_work_s(mine), together, waited)
        found += [_gate(courses, gate, given, beside) for gate in mine]
    gates = tuple(gate for gate in found if gate is not None)
    held = {one.place for gate in gates for one in gate.conditions}
    in_turn, answers = find_in_turn(courses, find_sources(courses, gates))
    sources = (*answers, *(source for source in unseen if source.signal in held))
    try:
        return CouplingCard(gates=gates, sources=sources, in_turn=in_turn, executions=len(courses))
    except ValueError as error:
        cure = "Take one of them out, or write back = 1 where the event before it is meant."
        raise ConfigError(f"cell.toml [[waits]]: {error}: no execution could go on", cure=cure) from error


def _unseen(gates: Sequence[Departures], given: Sequence[Wait], parts: UnseenParts) -> tuple[SourceCard, ...]:
    """Return sources of parts that no signal reports, where the robot waits for no signal and not always for people."""
    leaving = {each.gate.place: each for each in gates if each.gate.at == "leave"}
    known = {place for place, each in leaving.items() if any(_explains(each, *one) for one in each.since_s)}
    by_file = {wait.leaving for wait in given if wait.agent == "robot"}
    found = (parts(place) for place in leaving if place not in known | by_file)
    return tuple(source for source in found if source is not None)


def _explains(leaving: Departures, gate: Gate, condition: Condition) -> bool:
    """Return whether a condition of the robot leaves no waits for parts that no signal reports.

    One of the operator does, or a process time of a machine, if the robot reacts to it far more evenly than it stands.
    One of the way to the next place does, too, if nearly all long standstills need it.
    """
    since_s, stood_s = leaving.since_s[gate, condition], leaving.left_s - leaving.own_s
    if gate != leaving.gate:
        waited = stood_s > np.quantile(stood_s, USUAL) + WAITED_S
        if not waited.any() or np.isfinite(since_s[waited]).mean() < NEARLY_ALL:
            return False
    if condition.event.agent == "signal" or condition.partly:
        return condition.event.agent == "signal"
    decided = lag_of(leaving, condition, since_s, gate).decided
    if decided.sum() < MIN_DECIDED:
        return False
    lag, stood = (np.ptp(np.quantile(x[decided], (0.1, 0.9))) for x in (since_s, stood_s))
    return bool(lag < EVEN * stood)


def _tools(courses: Sequence[ExecutionVisits], gates: Sequence[Departures]) -> set[Event]:
    """Return signals of the robot's own tools that it was said to wait for, in logs without operators."""
    if any(course.visits["operator"] for course in courses):
        return set()
    pairs = [(one.event, gate.gate) for gate in gates for one in gate.found if one.event.agent == "signal"]
    return {event for event, gate in pairs if gate.at == "leave" and is_own_tool(courses, event, gate.place)}


def _usual_work_s(gates: Sequence[Departures]) -> float:
    """Return the median work time at places where an agent never waits, s; inf if there are none."""
    never = [gate for gate in gates if gate.gate.at == "leave" and not gate.since_s]
    return (
        float(np.median([np.median(gate.left_s - gate.own_s + gate.more_s) for gate in never]))
        if never
        else float("inf")
    )


class _Beside(NamedTuple):
    """What the other gates tell of one.

    Attributes:
        usual_s: Median work time of its agent at places where he never waits, s; inf if there are none.
        together: Conditions that both agents need in the same passages.
        waited: The operator's visits that ended with a wait.
    """

    usual_s: float
    together: Mapping[tuple[Gate, Condition], NeededTogether]
    waited: Waited


def _gate(
    courses: Sequence[ExecutionVisits],
    found: Departures,
    given: Sequence[Wait],
    beside: _Beside,
) -> GateCard | None:
    """Return the card of a gate; without conditions, only a `leave` gate has one (with its own work)."""
    gate = found.gate
    if gate.at == "approach" and not found.found:
        return None
    by_file = any(wait.agent == gate.agent and gate.place == wait.place(gate.at) for wait in given)
    found = at_latest_pace(found, courses)
    own_s, cards = _parts(courses, found, beside)
    least = MIN_DECIDED if len(found.since_s) > 1 else FEW_DECIDED  # one of several may be redundant given the others
    cards = [card for card in cards if by_file or max(card.decided, card.alike) >= least]
    if gate.at == "approach" and not cards:
        return None
    own_by: tuple[OwnWorkCard, ...] = ()
    if gate.at == "leave" and gate.agent == "operator":
        begun = rest_at_start(courses, found, own_s)
        own_s, own_by = (begun[0], (begun[1],)) if begun else (own_s, ())
        own_by += own_work_by_place(courses, found, own_s)
    return GateCard(
        agent=gate.agent,
        at=gate.at,
        place=gate.place,
        own_s=own_s if gate.at == "leave" else (0.0,),
        own_by=own_by,
        conditions=tuple(cards),
        told=by_file,
        passages=len(found.left_s),
    )


def _parts(
    courses: Sequence[ExecutionVisits],
    found: Departures,
    beside: _Beside,
) -> tuple[tuple[float, ...], list[ConditionCard]]:
    """Return the quantiles of own work, and the condition cards.

    If the agent always waits, own work never ends a dwell. It is then estimated as the shortest dwell if many dwells
    are as short; otherwise as the typical work time at other places, or half of the shortest dwell if there
    is none, but never more than the shortest dwell.
    """
    step = -(-len(found.left_s) // KEPT)
    since = np.array([column[::step] for column in (found.left_s - found.own_s, *found.since_s.values())])
    decided, stays_s = decided_by(since), (found.left_s - found.own_s + found.more_s)[::step]
    if own_work_decides(found.gate, stays_s, decided == 0):
        own_s = own_work(found, stays_s, decided == 0)
    else:
        shortest_s, low, middle = np.quantile(stays_s, (0.0, 0.1, 0.3)).tolist()
        other_s = min(beside.usual_s, shortest_s) if np.isfinite(beside.usual_s) else 0.5 * shortest_s
        own_s = (round(low if middle - low <= TIE_S else other_s, 4),)
    cards = []
    for gate, condition in found.since_s:
        if gate != found.gate:
            continue
        every, alike = found.since_s[gate, condition], found.alike.get(condition)
        seen_s = every if condition.event.signal is None else since_given(courses, found, condition, beside.waited)
        lag = lag_of(alike.joined, alike.condition, alike.seen_s) if alike else lag_of(found, condition, seen_s)
        mine = lag.decided[alike.mine] if alike else lag.decided
        there, event = ~np.isnan(every), condition.event
        shared = beside.together.get((gate, condition))
        cards.append(
            ConditionCard(
                agent=event.agent,  # type: ignore[arg-type]  # of these three
                place=event.place,
                event=event.event,  # type: ignore[arg-type]  # of these four
                back=condition.back,
                turns=condition.turns,
                needed=shared.needed if shared else lag.needed if condition.partly else 1.0,
                together=shared.number if shared else 0,
                lag_s=lag.quantiles_s,
                held=float((every[there] >= -early_s(condition)).mean()) if there.any() else 1.0,
                decided=int(mine.sum()),
                alike=int(lag.decided.sum()) if alike else 0,
                signal=event.signal,
            )
        )
    return own_s, cards
