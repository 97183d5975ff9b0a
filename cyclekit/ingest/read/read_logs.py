"""Logs -> their native-rate tables on the disk and their entries of provenance, one log a task of the engine.

What is unchanged since the last ingest is taken over from the old dataset without reading, and so is what an ingest
that was killed had already read (`shelf`). What one log becomes is decided in `keep`, what the recordings mean together
in `derive`.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from cyclekit.errors import EngineError, LogError
from cyclekit.ingest.read.log_checksums import Digests
from cyclekit.ingest.read.read_log import MAKING, How, Kept, keep_or_error
from cyclekit.ingest.read.resume import Shelf
from cyclekit.ingest.read.reuse import is_whole, take_over
from cyclekit.parallel.engine import LOCAL, Engine

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.ingest.discover import Log

__all__ = ["Digests", "How", "Intake", "check_shared", "read_all"]


@dataclass(frozen=True)
class Intake:
    """What came of reading.

    Attributes:
        entries: Entries of the recordings, in order of the logs.
        failed: Why the others could not be read.
        kept: How many recordings were taken over without reading.
    """

    entries: list[dict[str, Any]]
    failed: list[LogError]
    kept: int


def read_all(
    logs: Sequence[Log],
    staging: Path,
    digests: Digests,
    *,
    old: Dataset | None = None,
    shelf: Shelf | None = None,
    engine: Engine = LOCAL,
    how: How | None = None,
    tell: Callable[[float, str], None],
) -> Intake:
    """Read the logs into `staging/recordings`.

    Args:
        logs: What to read.
        staging: Folder of the dataset in the making.
        digests: Computes the checksums of the files; some are still to come when all is read.
        old: Dataset to take unchanged recordings over from.
        shelf: Where recordings are put as soon as they are read, and found again after a kill.
        engine: Who reads. Its workers must see the logs and `staging` under the same paths.
        how: What of each log is kept.
        tell: Told the fraction done and what is being done.
    """
    how = how or How()
    damaged = old.damaged() if old else {}
    known = {entry["key"]: entry for entry in old.card["recordings"]} if old else {}
    entries: dict[str, dict[str, Any]] = {}
    todo = []
    for log in logs:
        before = known.get(log.key)
        if old is not None and before is not None and is_whole(before, old.path, damaged):
            entries[log.id] = digests.completed(take_over(before, log, old.path, staging), log)
        elif shelf is not None and (found := shelf.find(log)) is not None:
            entries[log.id] = digests.completed(shelf.take(found, log, staging), log)
        else:
            todo.append(log)
    kept = len(entries)
    size = sum(log.size for log in todo) or 1
    done = 0
    failures: dict[str, LogError] = {}
    read: Callable[[Log], Kept | LogError] = partial(_read, staging=staging, how=how)
    if engine.stays_here(len(todo)):  # then no log waits for the checksums of the one before
        read = partial(keep_or_error, digests=digests, staging=staging, how=how)
    for outcome in engine.map(read, todo):
        log, result = outcome.item, outcome.get()
        done += log.size
        tell(done / size, f"read {log.shown}")
        if isinstance(result, LogError):
            failures[log.id] = result
            continue
        entries[log.id] = result.entry
        if shelf is not None:
            shelf.put(result.entry, log, staging)
    for left in staging.glob(f"recordings/{MAKING}*"):
        shutil.rmtree(left, ignore_errors=True)  # of a worker that was killed; its log was read again
    failed = [failures[log.id] for log in todo if log.id in failures]
    return Intake([entries[log.id] for log in logs if log.id in entries], failed, kept)


def check_shared(staging: Path) -> None:
    """Refuse to work for a dataset that this machine does not see.

    Raises:
        EngineError: The folder in which it is made is not here.
    """
    if not staging.is_dir():
        seen = f"{staging}: not there on the machine of the worker"
        cure = "Put the dataset where all machines see it, or work cell by cell: cyclekit fleet all FLEET.toml"
        raise EngineError(seen, cure=cure)


def _read(log: Log, *, staging: Path, how: How) -> Kept | LogError:
    """Read one log, wherever that is; its checksums are computed beside the reading."""
    check_shared(staging)
    with Digests(wanted=how.checksums) as digests:
        result = keep_or_error(log, digests, staging=staging, how=how)
        if isinstance(result, Kept):
            digests.settle([result.entry])
        return result
