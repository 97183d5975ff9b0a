"""Logs -> their native-rate tables on the disk and their entries of provenance; at the same time if asked.

What is unchanged since the last ingest is taken over from the old dataset without reading, and so is what an ingest
that was killed had already read (`shelf`). What one log becomes is decided in `keep`, what the recordings mean together
in `derive`.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context, parent_process
from typing import TYPE_CHECKING, Any

from cyclekit.errors import LogError
from cyclekit.intake.digests import Digests
from cyclekit.intake.keep import How, Kept, keep_or_error
from cyclekit.intake.shelf import Shelf
from cyclekit.intake.take_over import is_whole, take_over

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from cyclekit.dataset import Dataset
    from cyclekit.discover import Log

__all__ = ["How", "Intake", "read_all"]

_AT_ONCE = 32
"""Logs handed to a worker at once where there are thousands: a task costs half a millisecond."""


@dataclass(frozen=True)
class Intake:
    """What came of reading.

    Attributes:
        entries: Entries of the recordings, in order of the logs.
        failed: Why the others could not be read.
        kept: How many recordings were taken over without reading.
        digests: Checksums of the files, some of them still being computed.
    """

    entries: list[dict[str, Any]]
    failed: list[LogError]
    kept: int
    digests: Digests


def read_all(
    logs: Sequence[Log],
    staging: Path,
    *,
    old: Dataset | None = None,
    shelf: Shelf | None = None,
    jobs: int = 1,
    how: How | None = None,
    tell: Callable[[float, str], None],
) -> Intake:
    """Read the logs into `staging/recordings`.

    Args:
        logs: What to read.
        staging: Folder of the dataset in the making.
        old: Dataset to take unchanged recordings over from.
        shelf: Where recordings are put as soon as they are read, and found again after a kill.
        jobs: Logs read at the same time, in processes of their own.
        how: What of each log is kept.
        tell: Told the fraction done and what is being done.
    """
    how = how or How()
    known = {entry["key"]: entry for entry in old.card["recordings"]} if old else {}
    entries: dict[str, dict[str, Any]] = {}
    failed: list[LogError] = []
    todo, digests = [], Digests(wanted=how.checksums)
    for log in logs:
        before = known.get(log.key)
        if old is not None and before is not None and is_whole(before, old.path):
            entries[log.id] = digests.completed(take_over(before, log, old.path, staging), log)
        elif shelf is not None and (found := shelf.find(log)) is not None:
            entries[log.id] = digests.completed(shelf.take(found, log, staging), log)
        else:
            todo.append(log)
    kept = len(entries)
    size = sum(log.size for log in todo) or 1
    done = 0
    for log, result in _read_each(todo, partial(keep_or_error, staging=staging, how=how), jobs, digests):
        done += log.size
        tell(done / size, f"read {log.shown}")
        if isinstance(result, LogError):
            failed.append(result)
            continue
        entries[log.id] = result.entry
        if shelf is not None:
            shelf.put(result.entry, log, staging)
    return Intake([entries[log.id] for log in logs if log.id in entries], failed, kept, digests)


def _read_each(
    logs: Sequence[Log], work: Callable[..., Kept | LogError], jobs: int, digests: Digests
) -> Iterator[tuple[Log, Kept | LogError]]:
    if jobs <= 1 or len(logs) <= 1:
        yield from ((log, work(log, digests)) for log in logs)
        return
    with (
        one_thread_each(),
        ProcessPoolExecutor(
            min(jobs, len(logs)), mp_context=get_context("spawn"), initializer=_end_with_parent
        ) as pool,
    ):
        some = max(1, min(_AT_ONCE, len(logs) // (8 * jobs)))
        yield from zip(
            logs, pool.map(partial(_in_worker, work=work, checksums=digests.wanted), logs, chunksize=some), strict=True
        )


def _in_worker(log: Log, *, work: Callable[..., Kept | LogError], checksums: bool) -> Kept | LogError:
    with Digests(wanted=checksums) as digests:
        result = work(log, digests)
        if isinstance(result, Kept):
            digests.settle([result.entry])
        return result


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let processes started meanwhile use one thread for tables: as many processes as cores are busy already."""
    name = "POLARS_MAX_THREADS"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = before


def _end_with_parent() -> None:
    """End this worker when its parent was killed; else it would wait for work for ever, or write where nobody asked."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
