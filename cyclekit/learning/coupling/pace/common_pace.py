"""Tests whether the durations of one execution's works and walks move together: a slow person is slow in all of them.

Each work and each walk is compared with others of its kind. If people differ, the products of two such differences in
one execution are positive on average: that average is the variance that they share. Two executions of one session tell
in the same way how much of it is between sessions.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec.structs import replace

from cyclekit.dataset.cards.coupling import CommonPaceCard
from cyclekit.learning.coupling.events.visits import Event
from cyclekit.learning.coupling.pace.pace import MIN_ALIKE, OUTLIER, every_segment

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.dataset.cards.coupling import Agent, ConditionCard, CouplingCard, GateCard
    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.schema import Floats, Ints, Vector

MIN_EXECUTIONS = 20
"""Minimum number of executions."""
SURE, OTHER_SURE = 3.5, 2.0
"""Threshold, standard errors, of the variance that works or walks share, and that of the other kind then."""
MIN_SPREAD = 0.02
"""Minimum standard deviation of the shared log duration."""
DRAWN = 10.0
"""Number of durations of one kind by which their variance is drawn to that of all kinds."""
MIN_LAGS = 10
"""Minimum number of lags of one condition."""
SOONEST, LATEST = 0.05, 0.95
"""Levels of the quantiles between which a lag, or own work, counts as over or not."""
MAX_SHARE = 0.98
"""Maximum correlation of a duration with the shared part."""


class _Differences(NamedTuple):
    """Differences of durations from those of their kind: number of the execution, difference, its variance, (N,)."""

    number: Ints
    off: Vector
    variance: Vector


class _Shared(NamedTuple):
    """A mean product of two differences, and its standard error if nothing is shared."""

    value: float
    error: float

    @property
    def sure(self) -> float:
        """How many standard errors it is above 0."""
        return self.value / self.error


def with_common_pace(courses: Sequence[ExecutionVisits], card: CouplingCard) -> CouplingCard:
    """Return a card with what the durations of one execution share; unchanged if that is not significant.

    Args:
        courses: The executions in their order, trips apart.
        card: Who waits for whom in them.
    """
    if len(courses) < MIN_EXECUTIONS:
        return card
    works, walks = (_of_segments(courses, card, kind) for kind in ("work", "walk"))
    sessions = np.unique([course.session for course in courses], return_inverse=True)[1]
    found = [_parts(each, sessions) for each in (works, walks)]
    if max(each.sure for each in found) < SURE:
        return card
    work, walk = (max(each.whole, 0.0) ** 0.5 if each.sure >= OTHER_SURE else 0.0 for each in found)
    work, walk = (each if each >= MIN_SPREAD else 0.0 for each in (work, walk))
    if not work and not walk:
        return card
    both = _shared(works, walks, len(courses)).value / (work * walk) if work and walk else 0.0
    common = CommonPaceCard(
        work=round(work, 4),
        walk=round(walk, 4),
        together=round(float(np.clip(both, 0.0, 1.0)), 4),
        between=round(min(found[0 if work else 1].between, 1.0), 4),
        sessions=int(sessions.max()) + 1,
        once=round(_seen_once(works if work else walks, sessions), 4),
    )
    gates = card.gates if not work else tuple(_with_lags(gate, courses, card, works, work) for gate in card.gates)
    return replace(card, gates=gates, common=common)


def _of_segments(courses: Sequence[ExecutionVisits], card: CouplingCard, kind: str) -> _Differences:
    """Return the differences of log durations of works or walks, each from the mean of its kind at the latest pace."""
    factors = card.pace.factors() if card.pace is not None else {}
    paces = np.array([factors.get(course.name, (1.0, 1.0))[kind == "walk"] for course in courses])
    found: dict[tuple[str, str], list[tuple[int, float]]] = defaultdict(list)
    for one in every_segment(courses, card)["work" if kind == "work" else "walk"]:
        found[one.name].append((one.number, one.took_s / paces[one.number]))
    return _joined([_differences(some, logarithm=True) for some in found.values() if len(some) >= MIN_ALIKE])


def _differences(some: Sequence[tuple[int, float]], *, logarithm: bool) -> _Differences:
    number, took_s = np.array([n for n, _ in some], np.int64), np.array([s for _, s in some])
    if logarithm:
        middle = max(float(np.median(took_s)), 1e-9)
        took_s = np.log(np.clip(took_s / middle, 1.0 / OUTLIER, OUTLIER))
    else:
        low, middle, high = np.quantile(took_s, (0.25, 0.5, 0.75)).tolist()
        took_s = np.clip(took_s, middle - OUTLIER * (high - low), middle + OUTLIER * (high - low))
    free = (len(some) / (len(some) - 1)) ** 0.5  # the mean is of the same durations
    off = free * (took_s - took_s.mean())
    return _Differences(number, off, np.full(len(off), max(float((off**2).mean()), 1e-12)))


def _joined(parts: Sequence[_Differences]) -> _Differences:
    """Return the differences of all kinds; the variance of few is drawn to that of all."""
    if not parts:
        return _Differences(np.empty(0, np.int64), np.empty(0), np.empty(0))
    number, off, variance = (np.concatenate(column) for column in zip(*parts, strict=True))
    count = np.concatenate([np.full(len(part.off), len(part.off)) for part in parts])
    usual = max(float((off**2).mean()), 1e-12)
    return _Differences(number, off, (count * variance + DRAWN * usual) / (count + DRAWN))


def _sums(some: _Differences, group: Ints, count: int) -> Floats:
    """Return the sums of each group, shape (4, count): differences, weights, and the squares of both.

    The more a kind scatters, the less it weighs.
    """
    weight = 1.0 / some.variance
    each = some.off * weight, weight, (some.off * weight) ** 2, weight**2
    return np.array([np.bincount(group, one, count) for one in each])


def _shared(one: _Differences, other: _Differences, count: int) -> _Shared:
    """Return the mean product of two differences in one execution; of `one` with itself, of two different ones."""
    sums, others = (_sums(each, each.number, count) for each in (one, other))
    if one is other:
        return _mean(0.5 * (sums[0] ** 2 - sums[2]), 0.5 * (sums[1] ** 2 - sums[3]))
    return _mean(sums[0] * others[0], sums[1] * others[1])


def _mean(products: Vector, weights: Vector) -> _Shared:
    """Return the mean of weighted products; without anything shared, their variance is their weight."""
    total = float(weights.sum())
    return _Shared(float(products.sum()) / total, 1.0 / total**0.5) if total > 0.0 else _Shared(0.0, np.inf)


def _in_sessions(some: _Differences, sessions: Ints, whole: float) -> _Shared:
    """Return the mean product of two differences in two executions of one session.

    Args:
        some: The differences.
        sessions: Session of each execution, shape (executions,).
        whole: Variance that one execution shares: executions differ even where sessions do not.
    """
    by = _sums(some, some.number, len(sessions))
    sums = np.array([np.bincount(sessions, each) for each in (by[0], by[0] ** 2, by[1], by[1] ** 2)], np.float64)
    found = _mean(0.5 * (sums[0] ** 2 - sums[1]), 0.5 * (sums[2] ** 2 - sums[3]))
    wide = by[1] + max(whole, 0.0) * (by[1] ** 2 - by[3])
    pairs = 0.5 * (np.bincount(sessions, wide) ** 2 - np.bincount(sessions, wide**2))
    return found._replace(error=found.error**2 * float(pairs.sum()) ** 0.5)


class _Parts(NamedTuple):
    """Variance that all durations of an execution share, the part of it between sessions, and whether it is sure."""

    whole: float
    between: float
    sure: float


def _parts(some: _Differences, sessions: Ints) -> _Parts:
    """Return the variance that one execution shares: that of its session, and more if that is significant."""
    count = len(sessions)
    mine = _shared(some, some, count)
    alike = _in_sessions(some, sessions, 0.0) if sessions.max() else _Shared(0.0, np.inf)
    error = _in_sessions(some, sessions, mine.value).error if sessions.max() else np.inf
    if alike.sure >= SURE and mine.value - alike.value < OTHER_SURE * np.hypot(mine.error, error):
        weight = np.array([mine.error, error]) ** -2
        both = float(weight @ [mine.value, alike.value] / weight.sum())
        return _Parts(both, 1.0, alike.sure)
    return _Parts(mine.value, alike.value / mine.value if alike.value > SURE * error else 0.0, mine.sure)


def _seen_once(some: _Differences, sessions: Ints) -> float:
    """Return the share of the sessions with a pace that no other session has.

    So likely is a pace that was not seen yet (Good and Turing's estimate).
    """
    sums = _sums(some, some.number, len(sessions))
    seen = sums[1] > 0.0
    pace, session = sums[0][seen] / sums[1][seen], np.unique(sessions[seen], return_inverse=True)[1]
    count = np.bincount(session)
    means = np.bincount(session, pace) / count
    rest = pace - means[session]
    error = (float((rest**2).sum()) / max(len(pace) - len(count), 1) / count) ** 0.5
    order = np.argsort(means)
    apart = np.diff(means[order]) > OTHER_SURE * np.hypot(error[order][1:], error[order][:-1])
    alone = np.concatenate([[True], apart]) & np.concatenate([apart, [True]])
    return float(alone.mean())


def _with_lags(
    gate: GateCard, courses: Sequence[ExecutionVisits], card: CouplingCard, works: _Differences, spread: float
) -> GateCard:
    """Return a gate whose lags that contain work of the operator move together with his other work."""
    conditions = []
    for one in gate.conditions:
        some = list(_lags(gate, one, courses, card)) if "operator" in (gate.agent, one.agent) else []
        if len(some) >= MIN_LAGS and len(one.lag_s) > 1:
            lags = _differences(some, logarithm=False)
            found = _shared(lags, works, len(courses))
            share = found.value / (spread * float(lags.variance[0]) ** 0.5)
            one = replace(one, common=round(min(share, MAX_SHARE), 4)) if found.sure >= SURE else one
        conditions.append(one)
    return replace(gate, conditions=tuple(conditions))


def _lags(
    gate: GateCard, one: ConditionCard, courses: Sequence[ExecutionVisits], card: CouplingCard
) -> Iterator[tuple[int, float]]:
    """Yield execution and lag, s, of each passage that only this condition can have decided, however long it took."""
    for number, course in enumerate(courses):
        for turn, (ready_s, left_s) in enumerate(_passages(gate, course, card)):
            came_s = _came_s(one, course, turn)
            if came_s is None or not np.isfinite(left_s):
                continue
            others = [(other, _came_s(other, course, turn)) for other in gate.conditions if other is not one]
            rest = [at + float(np.quantile(other.lag_s, LATEST)) for other, at in others if at is not None]
            if came_s + float(np.quantile(one.lag_s, SOONEST)) >= max(ready_s, *rest, -np.inf):
                yield number, left_s - came_s


def _came_s(one: ConditionCard, course: ExecutionVisits, turn: int) -> float | None:
    """Return when the event that a passage needs came, s; None if it needs none or it is not known."""
    number = one.turns.event(turn, one.back)
    came = course.events.get(Event(one.agent, one.place, one.event), np.empty(0))
    return float(came[number]) if number is not None and number < len(came) and np.isfinite(came[number]) else None


def _passages(gate: GateCard, course: ExecutionVisits, card: CouplingCard) -> Iterator[tuple[float, float]]:
    """Yield until when own work may have lasted at each passage of a gate, and when the agent went on, s."""
    for before, after in pairwise(course.visits[gate.agent]):
        if gate.at == "leave" and before.place == gate.place:
            yield before.arrived_s + before.away_s + float(np.quantile(gate.own_s, LATEST)), before.left_s
        elif gate.at == "approach" and after.place == gate.place:
            if np.isfinite(after.reached_s):
                yield after.reached_s, after.went_on_s
            else:
                yield before.arrived_s + before.away_s + _own_s(card, gate.agent, before.place), before.left_s


def _own_s(card: CouplingCard, agent: Agent, place: str) -> float:
    own = (gate.own_s for gate in card.gates if (gate.agent, gate.at, gate.place) == (agent, "leave", place))
    return float(np.quantile(next(own, (0.0,)), LATEST))
