"""The jobs to order: places to visit, a place between visits, and precedence constraints.

start = "home"
end = "home"
via = "conveyor"                        # visited before each; leave it out if the robot goes on directly
visit = ["left_1", "left_2", "right_1"]
before = [["left_1", "left_2"]]         # the first before the second

If robot and operator wait for each other, the order of both can be searched; a job may be several places in a row:

visit = ["feeder->fixture", "tray->rack_1"]
operator = ["bench->fixture", "shelf"]
operator_end = "rest"
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from cyclekit.config.toml_file import read_toml, to_dataclass
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.text.numbers import count

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

ROW = "->"
"""Separator between the places of one job."""
MAX_VISITS = 100
"""Maximum number of jobs of one agent, a size: 100 visits to five places were ordered in 150 s and 271 MiB, 50 in 24 s;
each step of the local search looks at the square of the number, so 200 take an hour."""
_EXAMPLE = """For example:
  start = "home"
  end = "home"
  via = "conveyor"
  visit = ["left_1", "right_1"]"""
_OF_BOTH = """Name the places of both agents. For example:
  start = "home"
  visit = ["feeder->fixture", "tray->rack_1"]
  operator = ["bench->fixture", "shelf"]"""


@dataclass(frozen=True)
class Jobs:
    """Places to visit, in an order to be found.

    Attributes:
        visit: The places, repeated if visited several times. `feeder->fixture` is one job of two places.
        start, end: Start and end of the robot; None: anywhere.
        via: Place visited before each.
        before: Pairs of places; every visit to the first comes before every visit to the second.
        operator: Jobs of the operator in the same form, also to be ordered; empty: his orders are drawn from the logs.
        operator_end: Place where the operator ends.
        shown: Name of the jobs in messages.
        unlogged: Tasks that were never logged; no order may need them.
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
            ConfigError: There are fewer than two visits or more than MAX_VISITS, or the constraints are cyclic.
        """
        if len(self.visit) < 2:
            raise ConfigError(f"{self.shown}: fewer than two places to visit", cure=_EXAMPLE)
        for agent, jobs in (("robot", self.visit), ("operator", self.operator)):
            if len(jobs) > MAX_VISITS:
                msg = f"{self.shown}: {count(len(jobs))} jobs of the {agent}; at most {MAX_VISITS} can be ordered"
                raise ConfigError(msg, cure="Plan a part of the work, such as one tray or one layer.")
        for pair in self.before:
            for name in pair:
                if name not in self.visit:
                    raise UnknownName(self.shown, "place in before", name, self.visit)
        try:
            TopologicalSorter(self._earlier).prepare()
        except CycleError as error:
            msg = f"{self.shown}: the constraints form a circle: {', '.join(sorted(set(error.args[1])))}"
            raise ConfigError(msg, cure="No order is possible; take one of these pairs out of before.") from error

    @cached_property
    def _earlier(self) -> dict[str, set[str]]:
        """The places that come before each place."""
        found: dict[str, set[str]] = {}
        for a, b in self.before:
            found.setdefault(b, set()).add(a)
        return found

    def places(self, order: Sequence[str]) -> tuple[str, ...]:
        """Return the places that the robot drives to for an order of the visits."""
        via = (self.via,) if self.via else ()
        stops = [stop for name in order for stop in (*via, *name.split(ROW))]
        found = [self.start, *stops, *([self.end] if self.end else [])]
        return tuple(name for i, name in enumerate(found) if i == 0 or name != found[i - 1])

    def allowed(self, order: Sequence[str]) -> bool:
        """Return whether an order satisfies every constraint and needs no unlogged task."""
        last = {name: i for i, name in enumerate(order)}
        first = {name: i for i, name in reversed(list(enumerate(order)))}
        if not all(last[a] < first[b] for a, b in self.before):
            return False
        return not self.unlogged.intersection(tasks_of(self.places(order)))

    def needed(self) -> set[str]:
        """Return every task that an order within the constraints may need, logged or not."""
        names = set(self.visit)
        first, last = names.difference(b for _, b in self.before), names.difference(a for a, _ in self.before)
        follow = [(a, b) for a in names for b in names if b not in self._earlier.get(a, ())]
        last_of = {name: name.split(ROW)[-1] for name in names}
        begins = [(last_of[a], b) for a, b in follow if a != b or self.visit.count(a) > 1]
        ways = [replace(self, start=a, end=None).places((b,)) for a, b in begins]
        ways += [replace(self, end=None).places((name,)) for name in first]
        ways += [(last_of[name], self.end) for name in last if self.end not in (None, last_of[name])]
        return {task for places in ways for task in tasks_of(places)}

    def next_of(self, left: Sequence[str], last: str | None = None) -> list[str]:
        """Return which of the remaining visits may come next, without repetition.

        Args:
            left: The remaining visits.
            last: The previous visit; None: the start.

        Returns:
            If tasks are unlogged, only visits reached by logged tasks from which the order can probably be completed.
        """
        waiting = set(left)
        free = [name for name in dict.fromkeys(left) if waiting.isdisjoint(self._earlier.get(name, ()))]
        return [name for name in free if _leads_on(self, last or self.start, name, left)] if self.unlogged else free


def tasks_of(places: Sequence[str]) -> list[str]:
    """Return the tasks `start->goal` between places."""
    return [f"{a}->{b}" for a, b in pairwise(places)]


@lru_cache(maxsize=8)
def _ways(jobs: Jobs) -> dict[str, frozenset[str]]:
    """Return the visits that the robot can reach by logged tasks from each visit and from the start."""

    def is_logged(one: str, other: str) -> bool:
        via = (jobs.via,) if jobs.via else ()
        stops = (one.split(ROW)[-1], *via, *other.split(ROW))
        went = [name for i, name in enumerate(stops) if name is not None and (i == 0 or name != stops[i - 1])]
        return not jobs.unlogged.intersection(tasks_of(went))

    return {one: frozenset(name for name in jobs.visit if is_logged(one, name)) for one in (jobs.start, *jobs.visit)}


def _leads_on(jobs: Jobs, last: str, name: str, left: Sequence[str]) -> bool:
    """Return whether `name` can follow `last` and leaves no unreachable visit and at most one dead end."""
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


def load_jobs(path: Path | str) -> Jobs:
    """Read a jobs file.

    Raises:
        ConfigError: The file cannot be read, or its jobs cannot be ordered.
    """
    raw = read_toml(path, _EXAMPLE)
    if not raw:
        raise ConfigError(f"{path}: no jobs in it", cure=_EXAMPLE)
    if "task" in raw:
        seen = f"{path}: [[task]] is for models of task lists, and this model knows positions"
        raise ConfigError(seen, cure=_OF_BOTH)
    return to_dataclass(str(path), raw, Jobs, shown=str(path), unlogged=frozenset())
