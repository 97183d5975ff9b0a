"""Processing of items in a worker, for processes and cluster: one after the other, with errors caught."""

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
"""Maximum number of retries of a task whose worker died; after that, the task is considered the cause."""
_MAX_AT_ONCE = 32
"""Maximum number of items sent to a worker at once."""


@dataclass(frozen=True)
class Done(Generic[Item, Result]):
    """The result of one item.

    Attributes:
        number: Index of the item.
        item: The item.
        result: Return value of the function; None after an error.
        error: Exception of the function, or `EngineError` if its worker died repeatedly; None without an error.
    """

    number: int
    item: Item
    result: Result | None
    error: Exception | None = None

    def get(self) -> Result:
        """Return the result, or raise the error."""
        if self.error is not None:
            raise self.error
        return self.result  # type: ignore[return-value]  # None only where the function returns that


def in_chunks(count: int, workers: int) -> list[list[int]]:
    """Return the indices 0 ... count - 1 in the chunks that are sent to a worker at once.

    Chunks have one item, unless there are many items and messages would cost more than an even load saves.
    """
    size = max(1, min(_MAX_AT_ONCE, count // (8 * workers)))
    return [list(range(first, min(first + size, count))) for first in range(0, count, size)]


ONE_THREAD = dict.fromkeys(("POLARS_MAX_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a worker: one thread, as there is one worker per core. Read when the libraries are imported."""


def cores() -> int:
    """Return the number of cores available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def packed(function: Callable[[Any], Any]) -> bytes:
    """Return a pickled function, so that its module is imported only when the worker is set up."""
    return pickle.dumps(function)


def outcomes(function: bytes, items: Sequence[Any]) -> Iterator[Outcome]:
    """Yield the result (or None) and the error (or None) of every item."""
    for item in items:
        try:
            yield _unpacked(function)(item), None
        except Exception as error:
            yield None, _portable(error)


@lru_cache(maxsize=1)  # its arguments may be large, and there are many items
def _unpacked(function: bytes) -> Callable[[Any], Any]:
    return pickle.loads(function)  # type: ignore[no-any-return]


def _portable(error: Exception) -> Exception:
    """Return the error in a form that can be pickled, with its traceback as a note."""
    told = "".join(traceback.format_exception(error))
    try:
        again = pickle.loads(pickle.dumps(error))
    except Exception:  # an error of a library that cannot be pickled
        again = RuntimeError(f"{type(error).__name__}: {error}")
    again.add_note(f"In the worker:\n{told}")
    return again if isinstance(again, Exception) else RuntimeError(told)
