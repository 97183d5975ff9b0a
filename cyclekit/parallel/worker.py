"""What a worker does, of whichever engine: its part of the items, one after the other, every failure caught."""

from __future__ import annotations

import pickle
import traceback
from functools import lru_cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    Outcome = tuple[Any, Exception | None]


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
