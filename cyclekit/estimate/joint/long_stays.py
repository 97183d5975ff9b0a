"""Long stays of the operator: several consecutive tasks at one place, and the short walks between these."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.coupling.events.visits import PlaceVisit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence


def parted_stays(visits: Sequence[PlaceVisit], place: str, most: int, least_s: float) -> tuple[PlaceVisit, ...]:
    """Return visits with the longest at a place parted until there are `most`, each of at least `least_s`."""
    took_s = [visit.left_s - visit.arrived_s if visit.place == place else 0.0 for visit in visits]
    parts = [1] * len(visits)
    for _ in range(most - sum(visit.place == place for visit in visits)):
        longest = max(range(len(visits)), key=lambda n: took_s[n] / (parts[n] + 1))
        if took_s[longest] / (parts[longest] + 1) < least_s:
            break
        parts[longest] += 1
    found = []
    for visit, count in zip(visits, parts, strict=True):
        at = np.linspace(visit.arrived_s, visit.left_s, count + 1).tolist()
        found += [PlaceVisit(visit.place, *times) for times in pairwise(at)]
    return tuple(found)


def unseen_walks(
    orders: Mapping[str, Sequence[PlaceVisit]], place: str, task_s: float, pace_of: Callable[[str], float]
) -> Iterator[tuple[str, float, float]]:
    """Yield when the operator walked between two tasks of a parted stay: only longer walks there are seen as such.

    Each walk takes what these stays last beyond so many single tasks, on average.

    Args:
        orders: The visits in each execution, long stays parted.
        place: The place.
        task_s: Mean duration of a single task there, s.
        pace_of: Duration of work in an execution relative to now, by its name.

    Yields:
        Name of the execution, begin of the walk and its duration now, s.
    """
    long = list(_long_stays(orders, place))
    if not long:
        return
    tasks = sum(len(visits) for _, visits in long)
    took_s = sum((visits[-1].left_s - visits[0].arrived_s) / pace_of(name) for name, visits in long)
    walk_s = max(took_s - tasks * task_s, 0.0) / (tasks - len(long))
    for name, visits in long:
        yield from ((name, visit.left_s - walk_s * pace_of(name) / 2.0, walk_s) for visit in visits[:-1])


def _long_stays(orders: Mapping[str, Sequence[PlaceVisit]], place: str) -> Iterator[tuple[str, Sequence[PlaceVisit]]]:
    """Yield the execution and the visits of each parted stay at a place, except those cut by the execution's ends."""
    for name, visits in orders.items():
        begins = [n for n, visit in enumerate(visits) if not n or visits[n - 1].left_s < visit.arrived_s]
        for first, end in pairwise([*begins, len(visits)]):
            if end - first > 1 and visits[first].place == place and visits[first].arrived_s > 0.0 and end < len(visits):
                yield name, visits[first:end]
