"""One unseen operator who serves several places of the robot in turn.

Each place has a signal that comes after the robot has brought a part (`answers`). If one operator gives them all, his
signals are one sequence: each comes at the latest of his own work since the signal before it, at whatever place, and of
his lag after the robot has brought the part. Where he does other work first, a part that was brought early waits long,
and one that was brought late does not. Signals after the robot's execution has ended show that too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec.structs import replace

from cyclekit.dataset.cards.coupling import InTurnCard, SourceCard
from cyclekit.learning.coupling.conditions.answers import own_s_of
from cyclekit.learning.coupling.conditions.conditions import KEPT, MIN_DECIDED, decided_by
from cyclekit.learning.coupling.conditions.departures import least_gain
from cyclekit.learning.coupling.conditions.lags import deciding_causes, quantiles, reverse_kaplan_meier
from cyclekit.learning.coupling.events.visits import Event

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.schema import Bools, Floats, Ints

MIN_SERVED = 30
"""Minimum number of signals; fewer do not tell one operator from several."""
AT_ONCE_S, MAX_AT_ONCE = 1.0, 0.02
"""One operator does not give signals at two places within so long, s; maximum share of signals that come so soon."""
MAX_ORDERS = 400
"""Maximum number of logged orders of service in a card."""


class Served(NamedTuple):
    """A part that was served.

    Attributes:
        source: Number of its source.
        since_any_s, since_same_s: Time from the signal before (or the start) to its signal, at any and at this place.
        since_brought_s: Time since the robot brought it.
        first: Whether it was served first.
    """

    source: int
    since_any_s: float
    since_same_s: float
    since_brought_s: float
    first: bool


def find_in_turn(
    courses: Sequence[ExecutionVisits], sources: Sequence[SourceCard]
) -> tuple[InTurnCard | None, tuple[SourceCard, ...]]:
    """Return how one operator gives the signals of several sources in turn, and all sources with the lags then.

    Args:
        courses: Executions without operators.
        sources: Sources found in them.

    Returns:
        None and the same sources if fewer than two sources are answers to the robot, or if several operators (or
        machines) explain the signals better.
    """
    some = [number for number, source in enumerate(sources) if _is_answer(source)]
    if len(some) < 2:
        return None, tuple(sources)
    mine = [sources[number] for number in some]
    rows, orders = list[Served](), list[tuple[int, ...]]()
    for course in courses:
        served, order = _served(course, mine)
        rows += served
        orders += [order] if order else []
    if len(rows) < MIN_SERVED or not orders:
        return None, tuple(sources)
    rows = rows[:: -(-len(rows) // KEPT)]
    which = np.array([row.source for row in rows])
    together = np.array([[row.since_any_s for row in rows], [row.since_brought_s for row in rows]])
    apart = np.array([[row.since_same_s for row in rows], [row.since_brought_s for row in rows]])
    alone = max(_fit(apart), sum(_fit(apart[:, which == one]) for one in np.unique(which)))
    at_once = np.mean(together[0] < AT_ONCE_S)
    if at_once > MAX_AT_ONCE or _fit(together) < alone + least_gain(len(rows)):
        return None, tuple(sources)
    decided, first = decided_by(together), np.array([row.first for row in rows])
    gap_s, first_s = (own_s_of(together[0, part], decided[part] == 0) for part in (~first, first))
    found = list(sources)
    for one, number in enumerate(some):
        found[number] = _with_lag(sources[number], together, decided, which == one)
    step = -(-len(orders) // MAX_ORDERS)
    names = tuple(source.signal for source in mine)
    return InTurnCard(signals=names, gap_s=gap_s, first_s=first_s, orders=tuple(orders[::step])), tuple(found)


def _is_answer(source: SourceCard) -> bool:
    """Return whether a signal comes once for each part that the robot has brought to a place."""
    return len(source.after) == 1 and source.after[0].back == 0 and tuple(source.after[0].turns) == (1, 0, 1, 0)


def _fit(since_s: Floats) -> float:
    return float(deciding_causes(since_s).log_likelihood.sum())


def _with_lag(source: SourceCard, since_s: Floats, decided: Ints, mine: Bools) -> SourceCard:
    """Return a source with its lag; where it decided rarely, with that of all places."""
    waited = decided == 1
    some = mine if np.count_nonzero(waited & mine) >= MIN_DECIDED else np.ones(len(mine), np.bool_)
    mass = reverse_kaplan_meier(since_s[1, some], waited[some] * 1.0, np.ones(np.count_nonzero(some), np.bool_))
    (after,) = source.after
    lag_s, count = quantiles(since_s[1, some], mass), int(np.count_nonzero(waited & mine))
    return replace(source, after=(replace(after, lag_s=lag_s, decided=count),))


def _served(course: ExecutionVisits, sources: Sequence[SourceCard]) -> tuple[list[Served], tuple[int, ...]]:
    """Return the parts that were served in an execution, and their order; no order if one was not served."""
    start_s, found, brought = course.visits["robot"][0].left_s, [], []
    for number, source in enumerate(sources):
        key = Event("signal", source.signal, source.event)
        given = np.concatenate([course.events.get(key, np.empty(0)), course.later.get(key, np.empty(0))])
        (after,) = source.after
        came = course.events.get(Event("robot", after.place, after.event), np.empty(0))
        brought += [(float(at), number, turn) for turn, at in enumerate(came) if np.isfinite(at)]
        if len(given) > len(came) or (len(given) and given[0] < start_s):  # it answers a part of before
            return [], ()
        found += [(float(at), number, turn, float(came[turn])) for turn, at in enumerate(given)]
    rank = {(number, turn): n for n, (_, number, turn) in enumerate(sorted(brought))}
    rows, before_s, same_s = list[Served](), start_s, dict[int, float]()
    for at, number, _, came_s in sorted(found):
        since_same = at - same_s.get(number, start_s)
        rows.append(Served(number, at - before_s, since_same, at - came_s, not rows))
        before_s = same_s[number] = at
    order = tuple(rank[number, turn] for _, number, turn, _ in sorted(found))
    return rows, order if len(order) == len(brought) else ()
