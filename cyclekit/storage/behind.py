"""Calls made in another thread, in their order, one waiting at most: writing what was computed while more is.

What the calls do is the caller's business; an error of one is raised at the next, or at the end.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class Behind:
    """Makes calls in a thread of its own, which is begun with the first of them. End it, or the thread stays."""

    def __init__(self) -> None:
        self._worker: ThreadPoolExecutor | None = None
        self._call: Future[None] | None = None

    def begin(self, call: Callable[[], None]) -> None:
        """Begin a call as soon as the one before it is made; what that one raised is raised here."""
        self._wait()
        self._worker = self._worker or ThreadPoolExecutor(1, "behind")
        self._call = self._worker.submit(call)

    def end(self) -> None:
        """Wait for the last call; what it raised is raised here."""
        try:
            self._wait()
        finally:
            if self._worker is not None:
                self._worker.shutdown()

    def _wait(self) -> None:
        call, self._call = self._call, None
        if call is not None:
            call.result()
