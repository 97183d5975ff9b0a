"""What a worker does with its items, in processes and in a cluster alike: one after the other, each failure caught."""

from __future__ import annotations

import os
import pickle
import traceback
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    Outcome = tuple[Any, Exception | None]

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

    One at a time, unless there are so many that the messages would cost more than an even load saves.
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


def packed(function: Callable[[Any], Any]) -> bytes:
    """Return a function as bytes, so that its module is imported when the worker is ready for that and not before."""
    return pickle.dumps(function)


def outcomes(function: bytes, items: Sequence[Any]) -> Iterator[Outcome]:
    """Yield the result (or None) and the error (or None) of every item."""
    for item in items:
        try:
            yield _unpacked(function)(item), None
        except Exception as error:
            yield None, _portable(error)


@lru_cache(maxsize=1)  # what it is bound to may be large, and items are many
def _unpacked(function: bytes) -> Callable[[Any], Any]:
    return pickle.loads(function)  # type: ignore[no-any-return]


def _portable(error: Exception) -> Exception:
    """Return the error as it can cross to another process, with the lines where it arose as a note."""
    told = "".join(traceback.format_exception(error))
    try:
        again = pickle.loads(pickle.dumps(error))
    except Exception:  # an error of a library that cannot be pickled
        again = RuntimeError(f"{type(error).__name__}: {error}")
    again.add_note(f"In the worker:\n{told}")
    return again if isinstance(again, Exception) else RuntimeError(told)
