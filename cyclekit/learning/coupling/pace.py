"""Tests whether the operator's own work and his walks become quicker or slower over the logged executions.

His waits do not count: work after which he may wait counts only where everything he might wait for had come before he
arrived. Each work and each walk is compared with others of its kind, so another order is no other pace. Another person
is none either: with few sessions only what changes within them counts; with many, the sessions scatter as their people
do, and a pace that changes in one or two steps is taken for other people.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from msgspec import structs
from scipy.special import ndtri, stdtr, stdtrit

from cyclekit.dataset.cards.coupling import OperatorPaceCard, TrendCard
from cyclekit.learning.coupling.visits import Event

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cyclekit.dataset.cards.coupling import CouplingCard, GateCard
    from cyclekit.learning.coupling.departures import Departures
    from cyclekit.learning.coupling.visits import ExecutionVisits
    from cyclekit.schema import Floats, Ints, Vector

MIN_EXECUTIONS, MIN_ALIKE = 30, 3
"""Minimum number of executions, and of repetitions of one kind of work or walk."""
MIN_SESSIONS, MAX_SESSIONS = 5, 8
"""Number of sessions from which on these are compared, and up to which what changes within them is tested: beyond, that
is too little of the whole."""
MAX_CHANGE = 0.7
"""Maximum change of the log duration that is believed: half as long, or twice."""
BLOCKS = 12
"""Number of blocks of executions whose means are tested: neighbours are correlated."""
LEVEL, OTHER_LEVEL = 0.0005, 0.05
"""Significance level, and that of his walks where his work changes, or of his work where his walks do."""
MIN_CHANGE = 0.04
"""Minimum change of the log duration that is corrected."""
SETTLES = (np.inf, 0.5, 0.25)
"""Share of the executions in which 63 % of the lasting change has happened; infinity: it is linear."""
OUTLIER = 3.0
"""A duration counts as at most so many times as long, or as short, as the usual one: somebody was interrupted."""
MANY = 400
"""Maximum number of executions, or means of them, that are searched for steps."""
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
    if not any(_trend(each, len(courses), LEVEL) for each in paces):
        return None
    work, walk = (_trend(each, len(courses), OTHER_LEVEL) for each in paces)
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


def _trend(paces: _Paces | None, count: int, level: float) -> TrendCard | None:
    """Return the trend of the pace over `count` executions; None if it is not significant at a level."""
    if paces is None or len(paces.number) < MIN_EXECUTIONS:
        return None
    sessions = len(np.unique(paces.session))
    between = _significant(paces, count, level, within=False) if sessions >= MIN_SESSIONS else None
    return between or (_significant(paces, count, level, within=True) if sessions <= MAX_SESSIONS else None)


def _significant(paces: _Paces, count: int, level: float, *, within: bool) -> TrendCard | None:
    """Return the trend between sessions, or within them, if it is significant."""
    blocks = _blocks(paces.session, within=within)
    fits = []
    for part in SETTLES:
        card = TrendCard(change=0.0, settles=None if np.isinf(part) else round(part * count, 1), count=count)
        fits.append((card, _fitted(card.passed(paces.number), paces, blocks, within=within)))
    card, best = min(fits, key=lambda fit: fit[1].left)
    if best.chance > level or not MIN_CHANGE <= abs(best.change) <= MAX_CHANGE or _in_steps(paces, best, within=within):
        return None
    weight = np.array([(best.left / max(fit.left, 1e-12)) ** (len(blocks) / 2) for _, fit in fits])
    at_end = np.array([fit.change * (1.0 - fit.middle) for _, fit in fits])
    error = np.array([fit.error * (1.0 - fit.middle) for _, fit in fits])
    apart = at_end - best.change * (1.0 - best.middle)
    at_last = float(np.sqrt(weight @ (error**2 + apart**2) / weight.sum()))
    return structs.replace(card, change=round(best.change, 4), error=round(at_last, 4), chance=best.chance)


class _Fit(NamedTuple):
    """A regression line: change, its standard error and p-value, residual mean square, mean x, residuals (N,)."""

    change: float
    error: float
    chance: float
    left: float
    middle: float
    rest: Vector


def _fitted(passed: Vector, paces: _Paces, blocks: Sequence[Ints], *, within: bool) -> _Fit:
    """Fit the pace of executions to the share of the change that has passed at each of them, shape (N,)."""
    usual = paces.mine.T @ passed / np.maximum(paces.mine.sum(axis=0), 1e-9)  # when each kind was done, on average
    x, y = passed - paces.mine @ usual, paces.off
    weight = np.sqrt([len(block) for block in blocks])
    columns, sides = (np.array([values[block].mean() for block in blocks]) for values in (x, y))
    groups = [int(paces.session[block[0]]) if within else 0 for block in blocks]
    columns, sides = (_without_means(values, weight**2, groups) * weight for values in (columns, sides))
    free = len(blocks) - len(set(groups)) - 1
    if free < 2 or not columns.any():
        return _Fit(0.0, np.inf, 1.0, np.inf, float(passed.mean()), y)
    spread = float(columns @ columns)
    change = float(columns @ sides) / spread
    left = float(((sides - change * columns) ** 2).sum()) / free
    error = float(np.sqrt(left / spread)) + 1e-12
    wide = float(stdtrit(free, 0.975) / ndtri(0.975))  # few blocks tell little of their scatter
    chance = float(2.0 * stdtr(free, -abs(change) / error))
    return _Fit(change, wide * error, chance, left, float(passed.mean()), y - change * x)


def _without_means(values: Vector, weight: Vector, groups: Sequence[int]) -> Vector:
    _, group = np.unique(groups, return_inverse=True)
    return np.asarray(values - (np.bincount(group, weight * values) / np.bincount(group, weight))[group])


def _blocks(session: Ints, *, within: bool) -> list[Ints]:
    """Return the executions of each block: parts of sessions if `within`, else whole sessions together."""
    parts = np.split(np.arange(len(session)), np.flatnonzero(np.diff(session)) + 1)
    if not within:
        groups = np.array_split(np.arange(len(parts)), min(BLOCKS, len(parts)))
        return [np.concatenate([parts[n] for n in some]) for some in groups]
    wanted = [min(max(2, round(BLOCKS * len(part) / len(session))), len(part)) for part in parts]
    return [block for part, count in zip(parts, wanted, strict=True) for block in np.array_split(part, count)]


def _in_steps(paces: _Paces, best: _Fit, *, within: bool) -> bool:
    """Return whether the pace changes in steps rather than steadily (Bayesian information criterion).

    One step in each session if `within`, else at most two in all.
    """
    if len(paces.off) > MANY:
        together = np.array_split(np.arange(len(paces.off)), MANY)
        rest, off = (np.array([values[part].mean() for part in together]) for values in (best.rest, paces.off))
        session = np.array([paces.session[part[0]] for part in together])
        paces, best = paces._replace(off=off, session=session), best._replace(rest=rest)
    count, log_count = len(paces.off), np.log(len(paces.off))
    parts = np.split(np.arange(count), np.flatnonzero(np.diff(paces.session)) + 1) if within else [np.arange(count)]
    steady = _left(best.rest, parts)
    scores = [count * np.log(max(steady, 1e-12)) + 2.0 * log_count]
    for steps in (1,) if within else (1, 2):
        left = sum(_least_left(paces.off[part], steps) for part in parts)
        scores.append(count * np.log(max(left, 1e-12)) + 3.0 * steps * len(parts) * log_count)
    return bool(min(scores) < scores[0])


def _left(values: Vector, parts: Sequence[Ints]) -> float:
    return float(sum(((values[part] - values[part].mean()) ** 2).sum() for part in parts))


def _least_left(values: Vector, steps: int) -> float:
    """Return the least sum of squares about the means of stretches with so many steps between them, 1 or 2."""
    count = len(values)
    sums, squares = (np.concatenate([[0.0], np.cumsum(some)]) for some in (values, values**2))
    at = np.arange(count + 1)
    long = np.maximum(at[None, :] - at[:, None], 1)
    cost = squares[None, :] - squares[:, None] - (sums[None, :] - sums[:, None]) ** 2 / long
    one = np.array([float((cost[0, : end + 1] + cost[: end + 1, end]).min()) for end in at])
    return float(one[-1] if steps == 1 else (one + cost[:, -1]).min())
