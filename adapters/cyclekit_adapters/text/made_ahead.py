"""Several items worked on at the same time, their results in order.

For work that lets other threads run while it computes, as polars and numpy do: while one block of a log is handed on,
the next ones are parsed. What the items are is the caller's business.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

Item = TypeVar("Item")
Made = TypeVar("Made")

AT_ONCE = 2
"""Enough for one to compute while another waits for memory or for Python; more would hold more blocks in memory."""
BEGUN = AT_ONCE + 1
"""One waits for its turn, so that nobody does while the caller hands one on and fetches the next."""


def made_ahead(items: Iterable[Item], make: Callable[[Item], Made]) -> Iterator[tuple[Item, Made]]:
    """Yield each item with what `make` makes of it, in order; of the next ones it is made meanwhile.

    Items are taken in the caller's thread, results are made in others, unless there is one item alone. An error of
    `make` is raised at its item. One who stops early waits for what has been begun.
    """
    coming = iter(items)
    first = list(zip(range(2), coming, strict=False))
    if len(first) < 2:  # no thread for the many logs of a single block
        yield from ((item, make(item)) for _, item in first)
        return
    waiting = deque[tuple[Item, Future[Made]]]()
    with ThreadPoolExecutor(AT_ONCE, "made ahead") as workers:
        try:
            for item in chain((item for _, item in first), coming):
                waiting.append((item, workers.submit(make, item)))
                if len(waiting) == BEGUN:
                    begun, made = waiting.popleft()
                    yield begun, made.result()
            while waiting:
                begun, made = waiting.popleft()
                yield begun, made.result()
        finally:
            workers.shutdown(cancel_futures=True)
