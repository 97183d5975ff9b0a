"""Engines that run work on the cores of this machine, or on a Ray cluster.

Other modules map a function over items, without knowledge of processes:

    for done in engine.map(read_one, logs):
        entry = done.get()

`local` needs no extra package; with one job, the work is done in this process. `ray` passes the same function to Ray
core tasks. In both, a task that loses its worker (killed, out of memory) is repeated, so tasks must be idempotent: a
task gets paths, puts its output in place by a rename, and returns a row, never a table.
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
    """Engine and number of parallel jobs.

    Attributes:
        name: `local` or `ray`.
        jobs: Maximum number of items at the same time. None = one (`local`), one per core of the cluster (`ray`).
        address: Address of a running Ray cluster, `auto` (found on this machine) or `HOST:PORT`; None = a new one on
            this machine, which ends with the process.
    """

    name: Literal["local", "ray"] = "local"
    jobs: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            ConfigError: Unknown engine, less than one job, or an address for an engine other than Ray.
        """
        if self.name not in ("local", "ray") or (self.jobs is not None and self.jobs < 1):
            raise ConfigError(
                f"engine {self.name!r} with {self.jobs} jobs", cure="Give local or ray, with one job or more."
            )
        if self.address is not None and self.name != "ray":
            raise ConfigError(f"a Ray address {self.address!r} for engine {self.name!r}", cure="Add --engine ray.")

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Done[Item, Result]]:
        """Call `function` for every item; yield the results as they complete, in any order.

        With workers, function, items and results are pickled, and each worker has one thread. An exception is returned
        in its `Done`; the other items continue.

        Raises:
            MissingExtra: The engine is `ray`, but Ray is not installed.
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
        """Return whether `map` processes `count` items in this process, where they can share memory."""
        return self.name == "local" and ((self.jobs or 1) == 1 or count <= 1)


LOCAL = Engine()
"""Engine that processes one item after the other in this process."""


def _map_here(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Done[Item, Result]]:
    for number, item in enumerate(items):
        try:
            result = function(item)
        except Exception as error:  # any error: the items after it are still processed
            yield Done(number, item, None, error)
        else:
            yield Done(number, item, result)
