"""Tests whether the operator's own work and his walks become quicker or slower over the logged executions.

His waits do not count: work after which he may wait counts only where everything he might wait for had come before he
arrived. Each work and each walk is compared with others of its kind, so another order is no other pace. Another person
is none either (`pace_trend`).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from msgspec import structs

from cyclekit.dataset.cards.coupling import OperatorPaceCard, TrendCard
from cyclekit.learning.coupling.events.visits import Event
from cyclekit.learning.pace_trend import MIN_EXECUTIONS, ChangeShape, find_trend

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cyclekit.dataset.cards.coupling import CouplingCard, GateCard
    from cyclekit.learning.coupling.conditions.departures import Departures
    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.schema import Floats, Ints, Vector

MIN_ALIKE = 3
"""Minimum number of repetitions of one kind of work or walk."""
MAX_CHANGE = 0.7
"""Maximum change of the log duration that is believed: half as long, or twice."""
SURE, OTHER_SURE = 0.9, 0.5
"""Minimum probability of a trend, and of one of his walks where his work changes, or of his work where his walks do."""
SETTLES = (None, 1.0, 0.5, 0.25)
"""Share of the executions in which 63 % of the lasting change has happened; None: it is linear."""
MIN_CHANGE = 0.04
"""Minimum change of the log duration that is corrected."""
OUTLIER = 3.0
"""A duration counts as at most so many times as long, or as short, as the usual one: somebody was interrupted."""
LATEST = 0.95
"""Level of the quantile of a lag after which nobody waits any more."""
Kind = Literal["work", "walk"]


class _Segment(NamedTuple):
    """One work or walk of the operator: number of the execution, what it is, duration, s."""

    number: int
    name: tuple[str, str]
    took_s: float


class _Paces(NamedTuple):
    """Each execution's mean log duration relative to the usual one, and how it weighs.

    Attributes:
        number: Number of the execution, shape (N,).
        session: Number of its session, shape (N,).
        off: Mean log duration relative to the usual ones, shape (N,).
        mine: Share of the time of each execution, by kind of work or walk, shape (N, K).
    """

    number: Ints
    session: Ints
    off: Vector
    mine: Floats


def operator_pace(courses: Sequence[ExecutionVisits], card: CouplingCard) -> OperatorPaceCard | None:
    """Return how the operator's pace changes over the executions; None if no change is significant.

    Args:
        courses: The executions in their order, trips apart.
        card: Who waits for whom in them.
    """
    if len(courses) < MIN_EXECUTIONS:
        return None
    every = every_segment(courses, card)
    sessions = np.unique([course.session for course in courses], return_inverse=True)[1]
    paces = [_paces(every[kind], sessions) for kind in ("work", "walk")]
    if not any(_trend(each, len(courses), SURE) for each in paces):
        return None
    work, walk = (_trend(each, len(courses), OTHER_SURE) for each in paces)
    spent = [sum(one.took_s for one in every[kind]) for kind in ("work", "walk")]
    names = tuple(course.name for course in courses)
    return OperatorPaceCard(executions=names, work=work, walk=walk, work_share=round(spent[0] / sum(spent), 4))


def paces_beside(
    older: Sequence[ExecutionVisits], newer: Sequence[ExecutionVisits], card: CouplingCard
) -> tuple[Vector, Vector] | None:
    """Return the durations of work and walks per execution relative to the usual ones of the older executions.

    Args:
        older: Executions from which the card was learned; they count as at the operator's latest pace.
        newer: Other executions of the cell.
        card: Who waits for whom, and the operator's pace in the older executions.
    """
    factors = card.pace.factors() if card.pace is not None else {}
    usual: dict[tuple[Kind, tuple[str, str]], list[float]] = defaultdict(list)
    before: list[tuple[Kind, _Segment]] = []
    for kind, some in every_segment(older, card).items():
        for one in some:
            pace = factors.get(older[one.number].name, (1.0, 1.0))[kind == "walk"]
            before.append((kind, one._replace(took_s=one.took_s / pace)))
            usual[kind, one.name].append(one.took_s / pace)
    means = {key: float(np.mean(took_s)) for key, took_s in usual.items() if len(took_s) >= MIN_ALIKE}
    after = [(kind, one) for kind, some in every_segment(newer, card).items() for one in some]
    found = [_relative(some, means) for some in (before, after)]
    return (found[0], found[1]) if all(len(each) for each in found) else None


def _relative(
    segments: Sequence[tuple[Kind, _Segment]], usual_s: Mapping[tuple[Kind, tuple[str, str]], float]
) -> Vector:
    took: dict[int, float] = defaultdict(float)
    usual: dict[int, float] = defaultdict(float)
    for kind, one in segments:
        if (kind, one.name) in usual_s:
            middle = usual_s[kind, one.name]
            took[one.number] += min(max(one.took_s, middle / OUTLIER), middle * OUTLIER)
            usual[one.number] += middle
    return np.array([took[number] / usual[number] for number in sorted(took)])


def every_segment(courses: Sequence[ExecutionVisits], card: CouplingCard) -> dict[Kind, list[_Segment]]:
    """Return the operator's works and walks in all executions, without those with waits or trips."""
    found: dict[Kind, list[_Segment]] = {"work": [], "walk": []}
    mine = [gate for gate in card.gates if gate.agent == "operator" and gate.conditions]
    gates: dict[tuple[str, str], GateCard] = {(gate.at, gate.place): gate for gate in mine}
    for number, course in enumerate(courses):
        for kind, segment in _segments(number, course, gates):
            found[kind].append(segment)
    return found


def at_latest_pace(gate: Departures, courses: Sequence[ExecutionVisits]) -> Departures:
    """Return the departures of the operator from a gate with his own work as long as at his latest pace."""
    pace = np.array([course.pace for course in courses])[gate.course]
    if gate.gate.agent == "robot" or (pace == 1.0).all():
        return gate
    took_s = gate.left_s - gate.own_s + gate.more_s
    return replace(gate, own_s=gate.left_s + gate.more_s - took_s / pace)


def _segments(
    number: int, course: ExecutionVisits, gates: dict[tuple[str, str], GateCard]
) -> Iterator[tuple[Kind, _Segment]]:
    """Yield the operator's works and walks in one execution, without those that a wait or a trip may lengthen."""
    turns: dict[tuple[str, str], int] = defaultdict(int)
    for n, (here, after) in enumerate(pairwise(course.visits["operator"])):
        free = here.away_s == 0.0
        on_way = bool(np.isfinite(after.reached_s))  # what he needs there he would have waited for on his way
        for key, over in {("leave", here.place): False, ("approach", after.place): on_way}.items():
            free &= over or key not in gates or _had_come(course, gates[key], turns[key], here.arrived_s)
            turns[key] += 1
        name = (here.place, after.place)
        if n and free and here.left_s > here.arrived_s:
            yield "work", _Segment(number, name, here.left_s - here.arrived_s)
        aside = after.reached_s > here.left_s  # he waited on his way
        if here.away_s == 0.0 and here.place != after.place and after.arrived_s > here.left_s and not aside:
            yield "walk", _Segment(number, name, after.arrived_s - here.left_s)


def _had_come(course: ExecutionVisits, gate: GateCard, turn: int, at_s: float) -> bool:
    """Return whether all that a passage of a gate needs had come, and its lag was over, at a time."""
    for one in gate.conditions:
        number = one.turns.event(turn, one.back)
        if number is not None:
            came = course.events.get(Event(one.agent, one.place, one.event), np.empty(0))
            known = number < len(came) and not np.isnan(came[number])
            if not known or came[number] + np.quantile(one.lag_s, LATEST) > at_s:
                return False
    return True


def _paces(segments: Sequence[_Segment], sessions: Ints) -> _Paces | None:
    """Return the pace of each execution from works or walks of kinds with enough repetitions; None without any."""
    found: dict[tuple[str, str], list[_Segment]] = defaultdict(list)
    for segment in segments:
        found[segment.name].append(segment)
    kinds = [some for some in found.values() if len(some) >= MIN_ALIKE]
    if not kinds:
        return None
    took, usual, mine = (np.zeros((len(kinds), len(sessions))) for _ in range(3))
    for k, some in enumerate(kinds):
        number, took_s = np.array([one.number for one in some]), np.array([one.took_s for one in some])
        middle = float(np.median(took_s))
        took_s = np.clip(took_s, middle / OUTLIER, middle * OUTLIER)
        np.add.at(took[k], number, took_s)
        np.add.at(usual[k], number, took_s.mean())
    seen = usual.sum(axis=0) > 0.0
    mine = (usual / np.maximum(usual.sum(axis=0), 1e-9))[:, seen].T
    off = np.log(took.sum(axis=0)[seen] / usual.sum(axis=0)[seen])
    return _Paces(np.flatnonzero(seen), sessions[seen], off, mine)


def _trend(paces: _Paces | None, count: int, least: float) -> TrendCard | None:
    """Return the trend of the pace over `count` executions; None if its probability is not at least so large."""
    if paces is None:
        return None

    cards = [TrendCard(change=0.0, settles=part and round(part * count, 1), count=count) for part in SETTLES]
    shapes = []
    for card in cards:
        passed, middle = card.passed(paces.number), float(card.passed(paces.number).mean())
        usual = paces.mine.T @ passed / np.maximum(paces.mine.sum(axis=0), 1e-9)  # when each kind was done, on average
        shapes.append(ChangeShape(passed - paces.mine @ usual + middle, middle))
    found = find_trend(paces.off, paces.session, shapes)
    if found is None or found.probability < least or not MIN_CHANGE <= abs(found.change) <= MAX_CHANGE:
        return None
    change, error = round(found.change, 4), round(found.error, 4)
    return structs.replace(cards[found.shape], change=change, error=error, chance=1.0 - found.probability)
