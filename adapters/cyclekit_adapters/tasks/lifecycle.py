"""Tasks from rows or events that each hold the start or the end of one, paired by their transition.

A task starts with the event whose transition is `start`, and ends with the `complete` event of the same execution,
name, agent and, if present, instance: the first that started ends first. `xes` and `task_list` find the fields.
"""

from __future__ import annotations

from collections import defaultdict, deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Iterable, Iterator

Record = dict[str, str]
NO_START = "\x1fno start"
"""Key of a record whose task completes without a start."""
_STARTS = {"start", "started", "begin", "beginn"}
_ENDS = {
    **dict.fromkeys(("complete", "completed", "end", "ended", "finish", "finished", "ende"), None),
    **dict.fromkeys(("ate_abort", "pi_abort", "withdraw", "abort"), "failed"),
}
TRANSITIONS = {*_STARTS, *_ENDS}
"""Words that start or end a task, in lower case."""


def paired(events: Iterable[Record], passed_over: Counter[str]) -> Iterator[Record]:
    """Yield the tasks of events, and a record with key `NO_START` for each that completes without a start.

    Args:
        events: Field -> text; the time of an event is its `end`, unless it has a `start` of its own.
        passed_over: Gets the number of events of each transition that neither starts nor ends a task.
    """
    waiting = _Waiting()
    for event in events:
        transition = event.pop("transition", "complete").lower()
        if "start" in event:
            yield event
        elif transition in _STARTS:
            event["start"] = event.pop("end", "")
            waiting.add(event)
        elif transition in _ENDS:
            begun = waiting.taken(event)
            if begun is None:
                yield {**event, NO_START: event.get("task", "")}
                continue
            row = {"source_row": begun["source_row"]} if "source_row" in begun else {}
            outcome = _ENDS[transition]
            yield {**begun, **event, **row, **({"outcome": outcome} if outcome else {})}
        else:
            passed_over[transition] += 1
    yield from waiting.left.values()


class _Waiting:
    """Started tasks that have not ended; those that an end may match are found without looking at the others.

    Attributes:
        left: Number -> task, in the order of their starts.
    """

    def __init__(self) -> None:
        self.left: dict[int, Record] = {}
        self._started = 0
        self._queues: defaultdict[tuple[str | None, ...], deque[int]] = defaultdict(deque)

    def add(self, begun: Record) -> None:
        self.left[self._started] = begun
        what = _task_of(begun)
        for key in (what, (*what, begun.get("agent"))):
            self._queues[key].append(self._started)
        self._started += 1

    def taken(self, ended: Record) -> Record | None:
        """Remove and return the first started task that matches one that ends; None if there is none."""
        what = _task_of(ended)
        queue = self._queues[(*what, ended["agent"]) if "agent" in ended else what]
        while queue:
            if (begun := self.left.pop(queue.popleft(), None)) is not None:
                return begun
        return None


def _task_of(event: Record) -> tuple[str | None, ...]:
    return event.get("execution"), event.get("task"), event.get("instance")
