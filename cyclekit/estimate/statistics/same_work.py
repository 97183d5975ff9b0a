"""Work of a cycle: only cycles of the same work are compared, ranked, or said to save time.

The work of a cycle is the multiset of its visits: every place the robot drives to, as often as it does, in any order.
The start is not a visit. A cycle that ends at its start is closed, and its work does not depend on the place where it
is entered. Otherwise the start belongs to the work, because a cycle that begins elsewhere lacks a motion. The requested
operator tasks belong to it too: with other operators the order is not the only difference.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

from cyclekit.config.sequences import PLAN

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

SHOWN = 6
"""Maximum number of different places that are named in a description of the work."""


class Works(Protocol):
    """A sequence, or the estimate of one."""

    @property
    def places(self) -> tuple[str, ...]:
        """Ordered places, the start first."""
        ...

    @property
    def operator(self) -> tuple[str, ...] | None:
        """Requested operator tasks."""
        ...


Cycle = TypeVar("Cycle", bound=Works)


@dataclass(frozen=True)
class Work:
    """The work of a cycle; equal for cycles of the same work.

    Attributes:
        visits: Places driven to, sorted; a place visited twice occurs twice.
        start: Start of an open cycle; None if the cycle ends at its start.
        operator: Requested operator tasks; None if left open.
        plan: Whether it is the work of both agents; each visit then begins with the name of its agent.
    """

    visits: tuple[str, ...]
    start: str | None
    operator: tuple[str, ...] | None = None
    plan: bool = False

    def __str__(self) -> str:
        """Describe the work: `3 visits (conveyor x2, left_1) from home`, `7 tasks of robot, 5 tasks of operator`."""
        if self.plan:
            of = Counter(visit.partition(": ")[0] for visit in self.visits)
            return ", ".join(f"{n} task{'s' * (n != 1)} of {agent}" for agent, n in sorted(of.items(), reverse=True))
        often = Counter(self.visits)
        text = f"{len(self.visits)} visits" if len(self.visits) != 1 else "1 visit"
        if len(often) <= SHOWN:
            text += f" ({', '.join(name if n == 1 else f'{name} x{n}' for name, n in often.items())})"
        text += f" from {self.start}" if self.start else ""
        return text + (f" with an operator at {', '.join(self.operator)}" if self.operator else "")


def work_of(places: Sequence[str], operator: tuple[str, ...] | None = None) -> Work:
    """Return the work of a cycle through ordered places, the start first, or of a plan for both agents.

    A robot task `a->b` of a plan counts by its goal, so that orders of the same visits are the same work.
    """
    if places[:1] == (PLAN,):
        return Work(tuple(sorted(plan_goals(places[1:]))), None, operator, plan=True)
    closed = len(places) > 1 and places[0] == places[-1]
    return Work(tuple(sorted(places[1:])), None if closed or not places else places[0], operator)


def plan_goals(tasks: Iterable[str]) -> tuple[str, ...]:
    """Return the tasks of a plan (`robot: a->b`, `operator: c`) with the goals alone (`robot: b`)."""
    parts = (task.partition(": ") for task in tasks)
    return tuple(f"{agent}: {name.rpartition('->')[2]}" for agent, _, name in parts)


def by_work(cycles: Iterable[Cycle]) -> dict[Work, list[Cycle]]:
    """Return the cycles grouped by work, in the order of first occurrence."""
    found: dict[Work, list[Cycle]] = {}
    for cycle in cycles:
        found.setdefault(work_of(cycle.places, cycle.operator), []).append(cycle)
    return found
