"""The work to be put in order: places to visit, the place between them, and what must come first.

start = "home"
end = "home"
via = "conveyor"                        # visited before each; leave it out where the robot goes straight on
visit = ["left_1", "left_2", "right_1"]
before = [["left_1", "left_2"]]         # the first one before the second one

Where robot and operator wait for each other, the order of both can be sought; a job may be several places in a row:

visit = ["feeder->fixture", "tray->rack_1"]
operator = ["bench->fixture", "shelf"]
operator_end = "rest"
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from cyclekit.config.toml_file import followed, read_toml
from cyclekit.errors import ConfigError, UnknownName

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

ROW = "->"
"""Between the places of a job of several."""
_EXAMPLE = """For example:
  start = "home"
  end = "home"
  via = "conveyor"
  visit = ["left_1", "right_1"]"""


@dataclass(frozen=True)
class Jobs:
    """Places to visit in an order that is to be found.

    Attributes:
        visit: The places; one that is visited twice stands there twice. `feeder->fixture` is one job of two places.
        start, end: Where the robot begins and ends; None: where it happens to be.
        via: Place visited before each.
        before: Pairs of places; every visit to the first comes before every visit to the second.
        operator: Jobs of the operator in the same form, in an order that is to be found too; empty: what he does is
            drawn from the logs.
        operator_end: Place where he ends.
        shown: How a message names it.
        unlogged: Tasks that no order may need, since they were never logged.
    """

    visit: tuple[str, ...]
    start: str
    end: str | None = None
    via: str | None = None
    before: Annotated[tuple[tuple[str, str], ...], Meta(examples=[[["left_1", "left_2"]]])] = ()
    operator: tuple[str, ...] = ()
    operator_end: str | None = None
    shown: str = "the jobs"
    unlogged: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Refuse jobs that no order can fulfil.

        Raises:
            UnknownName: A constraint names a place that is not visited.
            ConfigError: There is nothing to order, or the constraints form a circle.
        """
        if len(self.visit) < 2:
            raise ConfigError(f"{self.shown}: fewer than two places to visit", cure=_EXAMPLE)
        for pair in self.before:
            for name in pair:
                if name not in self.visit:
                    raise UnknownName(self.shown, "place in before", name, self.visit)
        left = set(self.visit)
        while free := {name for name in left if not any(b == name and a in left for a, b in self.before)}:
            left -= free
        if left:
            msg = f"{self.shown}: the constraints form a circle: {', '.join(sorted(left))}"
            raise ConfigError(msg, cure="No order is possible; take one of these pairs out of before.")

    def places(self, order: Sequence[str]) -> tuple[str, ...]:
        """Return the places that the robot goes through for an order of the visits."""
        via = (self.via,) if self.via else ()
        stops = [stop for name in order for stop in (*via, *name.split(ROW))]
        found = [self.start, *stops, *([self.end] if self.end else [])]
        return tuple(name for i, name in enumerate(found) if i == 0 or name != found[i - 1])

    def allowed(self, order: Sequence[str]) -> bool:
        """Tell whether an order keeps every constraint and needs no task that was never logged."""
        last = {name: i for i, name in enumerate(order)}
        first = {name: i for i, name in reversed(list(enumerate(order)))}
        if not all(last[a] < first[b] for a, b in self.before):
            return False
        return not self.unlogged.intersection(tasks_of(self.places(order)))

    def needed(self) -> set[str]:
        """Return every task that an order may need which keeps the constraints; whether it was logged is not asked."""
        names = set(self.visit)
        first, last = names.difference(b for _, b in self.before), names.difference(a for a, _ in self.before)
        follow = [(a, b) for a in names for b in names if (b, a) not in self.before]
        last_of = {name: name.split(ROW)[-1] for name in names}
        begins = [(last_of[a], b) for a, b in follow if a != b or self.visit.count(a) > 1]
        ways = [replace(self, start=a, end=None).places((b,)) for a, b in begins]
        ways += [replace(self, end=None).places((name,)) for name in first]
        ways += [(last_of[name], self.end) for name in last if self.end not in (None, last_of[name])]
        return {task for places in ways for task in tasks_of(places)}

    def next_of(self, left: Sequence[str], last: str | None = None) -> list[str]:
        """Return which of the visits that are left may come next, each once.

        Args:
            left: The visits that are left.
            last: The visit before; None: the start.

        Returns:
            Where tasks are missing, those to which a logged way leads; that an order can be completed then is likely
            but not sure.
        """
        free = [name for name in dict.fromkeys(left) if not any(b == name and a in left for a, b in self.before)]
        return [name for name in free if _leads_on(self, last or self.start, name, left)] if self.unlogged else free


def tasks_of(places: Sequence[str]) -> list[str]:
    """Return the tasks `start->goal` between places."""
    return [f"{a}->{b}" for a, b in pairwise(places)]


@lru_cache(maxsize=8)
def _ways(jobs: Jobs) -> dict[str, frozenset[str]]:
    """Return the visits that the robot can go on to from each visit and from the start, by logged tasks alone."""

    def is_logged(one: str, other: str) -> bool:
        via = (jobs.via,) if jobs.via else ()
        stops = (one.split(ROW)[-1], *via, *other.split(ROW))
        went = [name for i, name in enumerate(stops) if name is not None and (i == 0 or name != stops[i - 1])]
        return not jobs.unlogged.intersection(tasks_of(went))

    return {one: frozenset(name for name in jobs.visit if is_logged(one, name)) for one in (jobs.start, *jobs.visit)}


def _leads_on(jobs: Jobs, last: str, name: str, left: Sequence[str]) -> bool:
    """Tell whether `name` can follow `last`, and no visit is cut off then: one that nothing leads to, two dead ends."""
    ways = _ways(jobs)
    if name not in ways[last]:
        return False
    rest = list(left)
    rest.remove(name)
    if not rest:
        return _ends_after(jobs, name)
    names = set(rest)
    if names.difference(ways[name], *(ways[other] for other in names)):
        return False
    dead_ends = [other for other in names if not (ways[other] & names) - {other}] if len(names) > 1 else []
    return len(dead_ends) <= 1 and all(_ends_after(jobs, other) for other in dead_ends)


def _ends_after(jobs: Jobs, name: str) -> bool:
    last = name.split(ROW)[-1]
    return jobs.end is None or last == jobs.end or f"{last}->{jobs.end}" not in jobs.unlogged


def load_jobs(path: Path) -> Jobs:
    """Read a jobs file.

    Raises:
        ConfigError: The file cannot be read, or its jobs cannot be put in any order.
    """
    raw = read_toml(path)
    if not raw:
        raise ConfigError(f"{path}: no jobs in it", cure=_EXAMPLE)
    return followed(str(path), raw, Jobs, shown=str(path), unlogged=frozenset())
