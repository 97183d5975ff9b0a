"""Where work is done: on the cores of this machine, or on a Ray cluster. This room owns the choice.

Everything else maps a function over items and knows nothing of processes:

    for done in engine.map(read_one, logs):
        entry = done.get()

`local` needs nothing installed; with one job the work is done here, without a process of its own. `ray` hands the same
function to Ray core tasks. In both a task that loses its worker (killed, out of memory) is done again, so that a task
must not mind being done twice: it gets paths, puts its output in place by a rename, and returns a row, never a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar

from cyclekit.errors import ConfigError
from cyclekit.parallel.outcome import Done

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Engine:
    """Which engine does the work, and how much of it.

    Attributes:
        name: `local` or `ray`.
        jobs: Items worked on at the same time. None = one (`local`), all that the cluster has cores for (`ray`).
        address: Of a running Ray cluster, `auto` (found on this machine) or `HOST:PORT`; None = one of its own on this
            machine, which ends with the process.
    """

    name: Literal["local", "ray"] = "local"
    jobs: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        """Refuse what contradicts itself.

        Raises:
            ConfigError: No such engine, no job, or an address for an engine that has none.
        """
        if self.name not in ("local", "ray") or (self.jobs is not None and self.jobs < 1):
            raise ConfigError(
                f"engine {self.name!r} with {self.jobs} jobs", cure="Give local or ray, with one job or more."
            )
        if self.address is not None and self.name != "ray":
            raise ConfigError(f"a Ray address {self.address!r} for engine {self.name!r}", cure="Add --engine ray.")

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Done[Item, Result]]:
        """Do `function` for every item; yield what comes of each as it comes, in any order.

        Where workers do it, function, items and results cross to them by pickle, and each worker has one thread. What
        a function raises is in its `Done`; the others go on.

        Raises:
            MissingExtra: Engine `ray`, and Ray is not installed.
            EngineError: The cluster cannot be reached.
        """
        if self.name == "ray":
            from cyclekit.parallel.ray_tasks import map_in_cluster

            return map_in_cluster(function, items, self.jobs, self.address)
        if self.stays_here(len(items)):
            return _map_here(function, items)
        from cyclekit.parallel.processes import map_in_processes

        return map_in_processes(function, items, min(self.jobs or 1, len(items)))

    def stays_here(self, count: int) -> bool:
        """Return whether `map` works on `count` items in this process, where they can share memory."""
        return self.name == "local" and ((self.jobs or 1) == 1 or count <= 1)


LOCAL = Engine()
"""One item after the other, in this process."""


def _map_here(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Done[Item, Result]]:
    for number, item in enumerate(items):
        try:
            result = function(item)
        except Exception as error:  # of any kind: the items after it are still done
            yield Done(number, item, None, error)
        else:
            yield Done(number, item, result)
