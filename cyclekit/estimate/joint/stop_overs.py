"""Stop-overs: places by which the operator always went from one task to the next, such as a step back behind a line.

A plan that leaves one out lets him go where he never went straight. A task of his own, in logs of one order, looks the
same from a single way; but its number depends on the work of an execution, that of a stop-over on the order of it.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from cyclekit.estimate.finding import Finding
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.schema import Vector

MIN_TIMES = 5
"""Minimum number of times that he went by a stop-over from one place to another."""
SELDOM = 0.05
"""Maximum share of exceptions: a stop-over that the tracker missed, or one that was none."""
MIN_BY_ORDER = 3
"""Minimum number of executions with another number of stop-overs than most with the same other visits."""

CHANGES = 0.01
"""Change of the mean cycle time, as a share, from which on a stop-over is said."""


class StopOver(NamedTuple):
    """A place by which he went from `start` to `goal`, how often, and whether the order decides where he does."""

    start: str
    place: str
    goal: str
    times: int
    by_order: bool


class StopOvers:
    """The stop-overs of logged orders of the operator."""

    def __init__(self, orders: Iterable[Sequence[str]]) -> None:
        """Count the ways in orders of places, one of each execution."""
        self._orders = [tuple(order) for order in orders]
        self._straight = Counter(way for order in self._orders for way in pairwise(order))
        self._ends = Counter(order[-1] for order in self._orders if order)
        self._last = Counter(order[-2:] for order in self._orders if len(order) > 1)
        self._by = Counter(
            (start, place, goal)
            for order in self._orders
            for start, place, goal in zip(order, order[1:], order[2:], strict=False)
            if place not in (start, goal)
        )
        self._via = Counter[tuple[str, str]]()
        for (start, _, goal), times in self._by.items():
            self._via[start, goal] += times
        ways: dict[str, list[int]] = defaultdict(lambda: [0, 0])
        for (start, place, goal), times in self._by.items():
            ways[place][self._never(start, goal)] += times
        found = {place for place, (some, never) in ways.items() if some <= SELDOM * (some + never)}
        self._known = {place: self._is_by_order(place) for place in sorted(found)}

    def left_out(self, order: Sequence[str]) -> list[tuple[int, StopOver]]:
        """Return the stop-overs that an order of places leaves out, each with the number of the place after it."""
        between = [(number, self.between(*way)) for number, way in enumerate(pairwise(order), 1)]
        return [(number, one) for number, one in between if one is not None and self._lacks(order, one.place)]

    def through(self, order: Sequence[str]) -> tuple[str, ...]:
        """Return an order of places with the stop-overs that it leaves out and of which the order decides."""
        missing = {number: one.place for number, one in self.left_out(order) if one.by_order}
        return tuple(place for number, goal in enumerate(order) for place in (missing.get(number), goal) if place)

    def between(self, start: str, goal: str) -> StopOver | None:
        """Return the stop-over between two places; None if he went straight, by several places, or never.

        One that may be a task of its own counts only between two tasks at one place.
        """
        if not self._never(start, goal):
            return None
        found = {place: times for place in self._known if (times := self._by[start, place, goal])}
        place = max(found, key=found.__getitem__, default="")
        if not place or found[place] < max(MIN_TIMES, (1.0 - SELDOM) * sum(found.values())):
            return None
        one = StopOver(start, place, goal, found[place], self._known[place])
        return one if one.by_order or start == goal else None

    def at_end(self, start: str) -> str | None:
        """Return the stop-over to which he went from a place at the end of executions, which never ended there."""
        found = {place: times for place in self._known if (times := self._last[start, place])}
        place = max(found, key=found.__getitem__, default=None)
        is_one = place is not None and found[place] >= MIN_TIMES and self._known[place]
        return place if is_one and self._ends[start] <= SELDOM * found[place or ""] else None

    def _never(self, start: str, goal: str) -> bool:
        return self._straight[start, goal] <= SELDOM * self._via[start, goal]

    def _lacks(self, order: Sequence[str], place: str) -> bool:
        """Return whether an order names a place less often than executions with no more visits elsewhere."""
        mine = Counter(order)
        if not mine[place]:
            return True
        others = [(each, Counter(each)) for each in self._orders]
        more = [its for _, its in others if its[place] > mine[place]]
        return sum(all(its[other] <= n for other, n in mine.items() if other != place) for its in more) >= MIN_BY_ORDER

    def _is_by_order(self, place: str) -> bool:
        """Return whether executions with the same other visits have different numbers of visits to a place.

        Executions that end there count as little as those that may have ended on the way there.
        """
        numbers: dict[tuple[str, ...], Counter[int]] = defaultdict(Counter)
        for order in self._orders:
            if order and order[-1] != place and not self._last[order[-1], place]:
                numbers[tuple(sorted(other for other in order if other != place))][order.count(place)] += 1
        return sum(some.total() - max(some.values()) for some in numbers.values()) >= MIN_BY_ORDER


def with_stop_overs(
    asked: tuple[CycleEstimate, Vector], through: tuple[CycleEstimate, Vector], left_out: Sequence[StopOver]
) -> tuple[CycleEstimate, Vector]:
    """Return the estimate of a sequence that leaves out stop-overs, with its mean in each resample, s.

    It is that with them if the order decides where he goes by them. A place that may be a task of its own is left out
    as asked; the interval of the mean then covers both. Where it changes little, nothing is said.

    Args:
        asked: Estimate and means of the sequence as it is.
        through: The same with the stop-overs.
        left_out: The stop-overs.
    """
    (without, _), (found, means) = asked, through
    alike = abs(found.expected_s / without.expected_s - 1.0) < CHANGES
    by_order = all(one.by_order for one in left_out)
    if alike:
        return through if by_order else asked
    ways = (f"from {one.start} straight to {one.goal}, but by {one.place} ({one.times} times)" for one in left_out)
    said = f"in the logs the operator never went {' or '.join(dict.fromkeys(ways))}; "
    names = " and ".join(dict.fromkeys(one.place for one in left_out))
    if by_order:
        said += (
            f"the estimate includes that ({fixed(without.expected_s, 1)} s without it): name {names} in the sequence"
        )
        return replace(found, findings=(Finding("stop-over", "amber", said), *found.findings)), means
    said += (
        f"with that the mean is {fixed(found.expected_s, 1)} s, and its interval covers both: name "
        f"{names} in the sequence"
    )
    said += " if he goes there"
    low, high = min(without.expected_low_s, found.expected_low_s), max(without.expected_high_s, found.expected_high_s)
    findings = (Finding("stop-over", "amber", said), *without.findings)
    both = without.distribution and found.distribution and replace(without.distribution, also=(found.distribution,))
    return (
        replace(without, expected_low_s=low, expected_high_s=high, distribution=both, findings=findings),
        asked[1],
    )
