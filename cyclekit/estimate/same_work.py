"""Which cycles do the same work: only these are compared, ranked, or said to save time against each other.

The work of a cycle is the multiset of its visits: every place that the robot drives to, as often as it does, in any
order. The start is no visit. Where a cycle ends at its start it is closed, and it is the same work wherever on the way
it is entered; otherwise the start belongs to the work, as a cycle that begins elsewhere is spared a motion. What the
operator was asked to do belongs to it too: beside other operators an order is not what made the difference.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

from cyclekit.config.sequences import PLAN

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

SHOWN = 6
"""So many different places are named where work is described; of more, only how many visits there are."""


class Works(Protocol):
    """A sequence or an estimate of one."""

    @property
    def places(self) -> tuple[str, ...]:
        """Ordered places, the start first."""
        ...

    @property
    def operator(self) -> tuple[str, ...] | None:
        """What the operator was asked to do."""
        ...


Cycle = TypeVar("Cycle", bound=Works)


@dataclass(frozen=True)
class Work:
    """What a cycle does; equal for cycles that do the same.

    Attributes:
        visits: Places driven to, sorted; one that is visited twice stands there twice.
        start: Where an open cycle begins; None where the cycle ends at its start.
        operator: What the operator was asked to do; None where that was left open.
    """

    visits: tuple[str, ...]
    start: str | None
    operator: tuple[str, ...] | None = None

    def __str__(self) -> str:
        """Describe the work: `3 visits (conveyor x2, left_1) from home`."""
        often = Counter(self.visits)
        text = f"{len(self.visits)} visits" if len(self.visits) != 1 else "1 visit"
        if len(often) <= SHOWN:
            text += f" ({', '.join(name if n == 1 else f'{name} x{n}' for name, n in often.items())})"
        text += f" from {self.start}" if self.start else ""
        return text + (f" with an operator at {', '.join(self.operator)}" if self.operator else "")


def work_of(places: Sequence[str], operator: tuple[str, ...] | None = None) -> Work:
    """Return the work of a cycle through ordered places, the start first; of a plan for both, of its tasks.

    A task `a->b` of the robot counts for where it leads, so that orders of the same visits are the same work.
    """
    if places[:1] == (PLAN,):
        tasks = (task.partition(": ") for task in places[1:])
        return Work(tuple(sorted(f"{agent}: {name.rpartition('->')[2]}" for agent, _, name in tasks)), None, operator)
    closed = len(places) > 1 and places[0] == places[-1]
    return Work(tuple(sorted(places[1:])), None if closed or not places else places[0], operator)


def by_work(cycles: Iterable[Cycle]) -> dict[Work, list[Cycle]]:
    """Return the cycles of each work, works in the order of their first cycle."""
    found: dict[Work, list[Cycle]] = {}
    for cycle in cycles:
        found.setdefault(work_of(cycle.places, cycle.operator), []).append(cycle)
    return found
