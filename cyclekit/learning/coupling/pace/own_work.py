"""The operator's own work at a place by where he goes next, or by where he came from, if it differs.

Before a departure he prepares what he needs there: screws for one fixture, a heavy part for the other. Where he begins
an execution, he has only the rest of his work left. A group has a
distribution of its own if that raises the likelihood of the departures enough, waits taken into account (`lags`); with
few departures it is drawn to that of all.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Literal

import numpy as np

from cyclekit.dataset.cards.coupling import OwnWorkCard
from cyclekit.learning.coupling.conditions.conditions import KEPT
from cyclekit.learning.coupling.conditions.departures import least_gain
from cyclekit.learning.coupling.conditions.lags import LEVELS, deciding_causes, quantiles, reverse_kaplan_meier
from cyclekit.learning.coupling.conditions.observed import own_work

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.learning.coupling.conditions.departures import Departures
    from cyclekit.learning.coupling.events.visits import ExecutionVisits
    from cyclekit.schema import Floats, Ints, Vector

MIN_OWN = 5.0
"""Minimum number of departures of a group that own work decided."""
MIN_READY = 10
"""Minimum number of executions begun at a place, and of other visits to it, to tell them apart."""
AT_START_S = 0.5
"""Maximum time, s, from the start of an execution to a stay that counts as begun before the start."""
SHRINK = 1.0
"""Number of departures by which the distribution of one group is drawn to that of all."""
Side = Literal["next", "before"]


def own_work_by_place(
    courses: Sequence[ExecutionVisits], found: Departures, own_s: Sequence[float]
) -> tuple[OwnWorkCard, ...]:
    """Return the operator's own work at a place by the next place or the one before; empty if it does not differ.

    Args:
        courses: The executions.
        found: His departures from the place, with their conditions.
        own_s: Quantiles of his own work there in all of them, s.
    """
    step = -(-len(found.left_s) // KEPT)
    since = np.array(
        [column[::step] for column in (found.left_s - found.own_s + found.more_s, *found.since_s.values())]
    )
    together = float(deciding_causes(since).log_likelihood.sum())
    best: tuple[float, tuple[OwnWorkCard, ...]] = (least_gain(since.shape[1]), ())
    for side in ("next", "before"):
        names, group = np.unique(_others(courses, found, side)[::step], return_inverse=True)
        if len(names) < 2:
            continue
        split = _split(since, group)
        causes = deciding_causes(split)
        gain = float(causes.log_likelihood.sum()) - together
        if gain > best[0]:
            decided = causes.share.argmax(axis=0)
            cards = (
                _card(side, str(name), split[n], (decided == n) * 1.0, own_s) for n, name in enumerate(names) if name
            )
            best = gain, tuple(card for card in cards if card is not None)
    return best[1] if len(best[1]) > 1 else ()


def rest_at_start(
    courses: Sequence[ExecutionVisits], found: Departures, own_s: Sequence[float]
) -> tuple[tuple[float, ...], OwnWorkCard] | None:
    """Return the operator's own work where he came during an execution, and where he began it; None if there are few.

    When an execution begins, an unknown part of it may be done: that it is whole then is not assumed.

    Args:
        courses: The executions.
        found: His departures from the place, with their conditions.
        own_s: Quantiles of his own work there in all of them, s.
    """
    since = np.array([found.left_s - found.own_s + found.more_s, *found.since_s.values()])
    start_s = np.array([course.visits["robot"][0].arrived_s for course in courses])[found.course]
    came = found.own_s - found.more_s > start_s + AT_START_S  # where he first goes he does his whole work
    later = ((_others(courses, found, "before") != "") | came) * 1
    step = -(-len(later) // KEPT)
    since, later = since[:, ::step], later[::step]
    if np.bincount(later, minlength=2).min() < MIN_READY:
        return None
    split = _split(since, later)
    causes = deciding_causes(split)
    decided = causes.share.argmax(axis=0)
    if np.count_nonzero(decided == 1) < MIN_OWN:
        return None
    whole = own_work(found, split[1], decided == 1)
    card = _card("before", "", split[0], (decided == 0) * 1.0, own_s)
    return None if card is None else (whole, card)


def _others(courses: Sequence[ExecutionVisits], found: Departures, side: Side) -> Vector:
    """Return the next place, or the one before, of each departure; empty if there is none."""
    seen: dict[int, list[str]] = defaultdict(list)
    for number, course in enumerate(courses):
        visits = course.visits[found.gate.agent]
        for n, visit in enumerate(visits[:-1]):
            if visit.place == found.gate.place:
                other = n + 1 if side == "next" else n - 1
                seen[number].append(visits[other].place if other >= 0 else "")
    pairs = zip(found.course.tolist(), found.occurrence.tolist(), strict=True)
    return np.array([seen[course][occurrence] for course, occurrence in pairs])


def _split(since: Floats, group: Ints) -> Floats:
    """Return the causes with own work, their first row, as one cause for each group."""
    own = np.where(group[None] == np.arange(group.max() + 1)[:, None], since[0], np.nan)
    return np.concatenate([own, since[1:]])


def _card(side: Side, name: str, since: Vector, decided: Vector, own_s: Sequence[float]) -> OwnWorkCard | None:
    known = np.isfinite(since)
    count = float(decided[known].sum())
    ready = not name and count < MIN_OWN  # own work hardly ever decides: he is ready sooner than any of these times
    if count < MIN_OWN and not ready:
        return None
    some = np.where(known, since, 0.0)
    mine = np.array(quantiles(some, reverse_kaplan_meier(some, decided, known)))
    part, levels = 1.0 if ready else count / (count + SHRINK), np.linspace(0.0, 1.0, LEVELS)
    alone, every = (
        np.interp(levels, np.linspace(0.0, 1.0, max(len(q), 2)), np.resize(q, max(len(q), 2)))
        for q in (mine, np.array(own_s))
    )
    drawn = part * alone + (1.0 - part) * every
    return OwnWorkCard(side=side, place=name, own_s=tuple(np.round(drawn, 4).tolist()))
