"""Prefetch the next item of an iterator in another thread while the current one is processed.

Reading and processing of a log then run in parallel, as polars and numpy release the GIL while they compute. One
thread, one item ahead.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator

Item = TypeVar("Item")


def prefetch(items: Iterator[Item]) -> Iterator[Item]:
    """Yield the items in order, each prefetched in another thread while the one before it is processed.

    The whole iterator, including its end, runs in that thread, since a file or database may be bound to the thread that
    opened it. Its errors are raised to the caller at the item they replace.
    """
    with ThreadPoolExecutor(1, "prefetch") as worker:
        try:
            coming = worker.submit(next, items, worker)  # the worker is the sentinel for "no more items"
            while (item := coming.result()) is not worker:
                coming = worker.submit(next, items, worker)
                yield item  # type: ignore[misc]
        finally:
            worker.submit(getattr(items, "close", bool))
