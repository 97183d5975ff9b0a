"""Run calls in order in a background thread, one at a time: results are written while more are computed.

An error of a call is raised at the next call, or at the end.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class BackgroundWriter:
    """Runs calls in a background thread, started with the first call and stopped by `end`."""

    def __init__(self) -> None:
        self._worker: ThreadPoolExecutor | None = None
        self._call: Future[None] | None = None

    def begin(self, call: Callable[[], None]) -> None:
        """Start a call as soon as the one before is done; raise the error of that one, if any."""
        self._wait()
        self._worker = self._worker or ThreadPoolExecutor(1, "background")
        self._call = self._worker.submit(call)

    def end(self) -> None:
        """Wait for the last call, raise its error, if any, and stop the thread."""
        try:
            self._wait()
        finally:
            if self._worker is not None:
                self._worker.shutdown()

    def _wait(self) -> None:
        call, self._call = self._call, None
        if call is not None:
            call.result()
