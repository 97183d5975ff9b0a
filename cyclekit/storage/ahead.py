"""The next item of an iterator made while the present one is worked on.

Reading a log and judging its rows would take turns on one core otherwise: polars and numpy let other threads run while
they compute. One thread and one item ahead; what the items mean is the caller's business.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator

Item = TypeVar("Item")


def ahead(items: Iterator[Item]) -> Iterator[Item]:
    """Yield the items, in order, each made in another thread while the one before it is worked on.

    All of the iterator runs in that one thread, its end included, since a file or a database may be bound to the
    thread that opened it. Its errors are raised here, at the item that they came in place of.
    """
    with ThreadPoolExecutor(1, "ahead") as worker:
        try:
            coming = worker.submit(next, items, worker)  # the worker itself stands for "no more items"
            while (item := coming.result()) is not worker:
                coming = worker.submit(next, items, worker)
                yield item  # type: ignore[misc]
        finally:
            worker.submit(getattr(items, "close", bool))
