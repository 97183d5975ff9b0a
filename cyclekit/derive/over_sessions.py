"""Run functions over all sessions on the engine."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, TypeVar

from cyclekit.derive.sample_file import in_order

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.parallel.engine import Engine
    from cyclekit.schema import Progress

Item = TypeVar("Item")
Result = TypeVar("Result")

SHARED_ROWS = 2_000_000
"""Minimum number of robot rows for workers: below, a pass takes less time than they need to start."""
SESSION_ROWS = 1000
"""Fixed cost of a session, in rows."""


def is_much(groups: Sequence[LogGroup]) -> bool:
    """Return whether a pass over the sessions takes longer than workers need to start."""
    rows = sum(log.rows.get("robot", 0) for group in groups for log in group.logs)
    return rows + SESSION_ROWS * len(groups) >= SHARED_ROWS


class Passes:
    """Runs functions over all sessions on the engine: results in order, progress reported."""

    def __init__(self, engine: Engine, progress: Progress) -> None:
        self.engine, self.progress = engine, progress

    def over(
        self, function: Callable[[Item], Result], items: Sequence[Item], begin: float, end: float, what: str
    ) -> list[Result]:
        """Call a function for each item alone; see `over_files`."""
        files = [[number] for number in range(len(items))]
        return self.over_files(partial(_one, function), items, files, begin, end, what)

    def over_files(
        self,
        function: Callable[[Sequence[Item]], Sequence[Result]],
        items: Sequence[Item],
        files: Sequence[Sequence[int]],
        begin: float,
        end: float,
        what: str,
    ) -> list[Result]:
        """Call a function once per file with its items; report progress from `begin` to `end`."""
        found, count = [], 0
        for done in self.engine.map(function, [[items[number] for number in numbers] for numbers in files]):
            found.append((files[done.number], done.get()))
            count += len(files[done.number])
            told = f"{what}, {count} of {len(items)} sessions"
            self.progress(begin + (end - begin) * count / len(items), told)
        return in_order(found)


def _one(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    return [function(item) for item in items]
