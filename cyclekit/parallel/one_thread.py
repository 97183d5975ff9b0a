"""Linear algebra on one thread, so that a number does not depend on how many cores are free.

A product of matrices that two threads share is summed in another order than by one, and differs in its last digits.
What is stored or compared is computed inside of this, so that it is the same in this process, in a worker process and
on a cluster, on one core and on many. In products as small as ours more threads only wait for each other besides.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np  # noqa: F401 - its libraries must be loaded before they can be found
from threadpoolctl import ThreadpoolController

if TYPE_CHECKING:
    from collections.abc import Iterator

_lock = threading.Lock()
_inside: list[Any] = []
"""One entry per caller that is inside; the first of them holds the limits, of the process and not of a thread."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep numpy's linear algebra to one thread, for the whole process, until the last caller has left.

    Also a decorator: `@one_thread()`. scikit-learn brings libraries of its own: limit those where it is imported.
    """
    with _lock:
        _inside.append(_inside[0] if _inside else _libraries().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            limits = _inside.pop()
            if not _inside:
                limits.restore_original_limits()


@cache
def _libraries() -> ThreadpoolController:
    """Return the libraries that are loaded; looking for them takes milliseconds."""
    return ThreadpoolController()
