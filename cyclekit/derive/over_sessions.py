"""Run functions over all sessions on the engine."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, TypeVar

from cyclekit.derive.sample_file import in_order

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.derive.stage_progress import StageProgress
    from cyclekit.parallel.engine import Engine

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

    def __init__(self, engine: Engine, work: StageProgress) -> None:
        self.engine, self.work = engine, work

    def over(
        self, function: Callable[[Item], Result], items: Sequence[Item], stage: str, what: str = ""
    ) -> list[Result]:
        """Call a function for each item alone; see `over_files`."""
        files = [[number] for number in range(len(items))]
        return self.over_files(partial(_one, function), items, files, stage, what)

    def over_files(
        self,
        function: Callable[[Sequence[Item]], Sequence[Result]],
        items: Sequence[Item],
        files: Sequence[Sequence[int]],
        stage: str,
        what: str = "",
    ) -> list[Result]:
        """Call a function once per file with its items; report how far a stage of the work is, as `what`."""
        found, count = [], 0
        for done in self.engine.map(function, [[items[number] for number in numbers] for numbers in files]):
            found.append((files[done.number], done.get()))
            count += len(files[done.number])
            if count < len(items) or stage != "motion":  # its end is told with what it found
                self.work.at(stage, count / len(items), f"{what or stage}, {count} of {len(items)} sessions")
        return in_order(found)


def _one(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    return [function(item) for item in items]
