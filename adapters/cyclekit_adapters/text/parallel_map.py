"""Parallel processing of consecutive items, with results in order.

For work that releases the interpreter lock while it computes, as polars and numpy do: the next blocks of a log are
parsed while the caller uses the current one.
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

THREADS = 2
"""Number of worker threads: one computes while another waits; more would hold more blocks in memory."""
MAX_PENDING = THREADS + 1
"""Maximum number of items in progress: one more than threads, so that no thread idles meanwhile."""


def parallel_map(items: Iterable[Item], make: Callable[[Item], Made]) -> Iterator[tuple[Item, Made]]:
    """Yield each item with the result of `make`, in order, while the next results are computed.

    Items are taken in the caller's thread; results are computed in worker threads, unless there is only one item. An
    error of `make` is raised at its item. Closing the iterator early waits for the work in progress.
    """
    coming = iter(items)
    first = list(zip(range(2), coming, strict=False))
    if len(first) < 2:  # no thread for the many logs of a single block
        yield from ((item, make(item)) for _, item in first)
        return
    waiting = deque[tuple[Item, Future[Made]]]()
    with ThreadPoolExecutor(THREADS, "parallel map") as workers:
        try:
            for item in chain((item for _, item in first), coming):
                waiting.append((item, workers.submit(make, item)))
                if len(waiting) == MAX_PENDING:
                    item, made = waiting.popleft()
                    yield item, made.result()
            while waiting:
                item, made = waiting.popleft()
                yield item, made.result()
        finally:
            workers.shutdown(cancel_futures=True)
