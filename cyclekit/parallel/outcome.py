"""The result of one item, and how many items a worker gets at once; the same for processes and for a cluster."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

RETRIES = 3
"""Number of retries of a task whose worker died; after that the task itself is taken as the cause."""
_MOST_AT_ONCE = 32
"""Items handed to a worker at once where there are thousands."""


@dataclass(frozen=True)
class Done(Generic[Item, Result]):
    """The result of one item.

    Attributes:
        number: Which item, from 0.
        item: The item.
        result: What the function returned; None where it failed.
        error: What it raised, or `EngineError` where its worker died again and again; None where it did not fail.
    """

    number: int
    item: Item
    result: Result | None
    error: Exception | None = None

    def get(self) -> Result:
        """Return the result, or raise what the function raised."""
        if self.error is not None:
            raise self.error
        return self.result  # type: ignore[return-value]  # None only where the function returns that


def in_chunks(count: int, workers: int) -> list[list[int]]:
    """Return the numbers 0 ... count - 1 in the parts that are handed to a worker at once.

    One by one, unless there are so many that handing out would cost more than it shares evenly.
    """
    size = max(1, min(_MOST_AT_ONCE, count // (8 * workers)))
    return [list(range(first, min(first + size, count))) for first in range(0, count, size)]


ONE_THREAD = dict.fromkeys(("POLARS_MAX_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a worker: as many workers as cores are busy already. Read when the libraries are imported."""


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
