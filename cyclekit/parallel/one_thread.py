"""Linear algebra on one thread, so that results do not depend on the number of cores.

A matrix product on two threads is summed in another order than on one, and differs in the last digits. Results that are
stored or compared are computed on one thread, so that they are equal in this process, in a worker process and on a
cluster. Besides, for small products, more threads are slower.
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
"""One entry per active caller; the limits of the first one apply to the whole process."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit numpy's linear algebra to one thread, for the whole process, until the last caller has left.

    Also a decorator: `@one_thread()`. scikit-learn has separate libraries: limit those where it is imported.
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
    """Return the controller of the loaded libraries; cached, as the search takes milliseconds."""
    return ThreadpoolController()
