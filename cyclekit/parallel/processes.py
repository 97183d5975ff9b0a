"""Engine `local`: worker processes on this machine, each with a pipe.

A process pool of the standard library fails as a whole when one of its processes dies. With one pipe per worker, the
item of a dead worker is known: a new worker replaces it, and the item is repeated.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import Counter, deque
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any

from cyclekit.errors import EngineError
from cyclekit.parallel.outcome import ONE_THREAD, RETRIES, Done, in_chunks, outcomes, packed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence


def map_in_processes(function: Callable[[Any], Any], items: Sequence[Any], jobs: int) -> Iterator[Done[Any, Any]]:
    """Run `Engine.map` in `jobs` processes."""
    waiting = deque(in_chunks(len(items), jobs))
    lost = Counter[int]()
    crew = [_Worker(packed(function)) for _ in range(min(jobs, len(waiting)))]
    try:
        while waiting or any(worker.at for worker in crew):
            for worker in crew:
                if waiting and not worker.at:
                    worker.give(waiting.popleft(), items)
            for worker in _with_news([worker for worker in crew if worker.at]):
                if (outcome := worker.outcome()) is not None:
                    number = worker.at.popleft()
                    yield Done(number, items[number], *outcome)
                    continue
                crew[crew.index(worker)] = _Worker(packed(function))
                number, *rest = worker.end()
                waiting.extendleft([[other] for other in reversed(rest)])
                lost[number] += 1
                if lost[number] <= RETRIES:
                    waiting.append([number])  # last: an item that kills workers must not delay the others
                else:
                    yield Done(number, items[number], None, gave_up(worker.process.exitcode))
    finally:
        for worker in crew:
            worker.end()


def gave_up(exit_code: int | None) -> EngineError:
    """Return the error for an item whose worker died each time."""
    how = "" if exit_code is None else f" (exit code {exit_code})"
    seen = f"the process that worked on it died {RETRIES + 1} times{how}"
    return EngineError(seen, cure="Often memory is too small: give fewer --jobs, or use a machine with more memory.")


class _Worker:
    """A process, the pipe to it, and the indices of its unfinished items."""

    def __init__(self, function: bytes) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, function), daemon=False)
        with _one_thread_each():
            self.process.start()
        theirs.close()
        self.at: deque[int] = deque()

    def give(self, numbers: list[int], items: Sequence[Any]) -> None:
        self.at.extend(numbers)
        with suppress(OSError):  # the worker died; `outcome` will detect that
            self.pipe.send([items[number] for number in numbers])

    def outcome(self) -> tuple[Any, Exception | None] | None:
        """Return result and error of the next item; None if the worker has died."""
        try:
            return self.pipe.recv()  # type: ignore[no-any-return]
        except (EOFError, OSError):
            return None

    def end(self) -> list[int]:
        """Terminate the process; return the indices of its unfinished items."""
        self.process.terminate()
        self.process.join()
        self.pipe.close()
        left, self.at = list(self.at), deque()
        return left


def _with_news(workers: Sequence[_Worker]) -> list[_Worker]:
    ready = wait([worker.pipe for worker in workers])
    return [worker for worker in workers if worker.pipe in ready]


def _serve(pipe: Connection, function: bytes) -> None:
    """Process the items from the pipe, one by one, until its other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles interrupts and ends its workers
    _end_with_parent()
    with suppress(EOFError, OSError):
        while True:
            for outcome in outcomes(function, pipe.recv()):
                pipe.send(outcome)


def _end_with_parent() -> None:
    """End this worker when its parent is killed; else it would continue to write files."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Set ONE_THREAD in the environment of processes started within the block."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
