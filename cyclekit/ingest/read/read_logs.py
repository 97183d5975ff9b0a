"""Logs to their native-rate tables on disk and their cards, with one log per task of the engine.

Recordings unchanged since the last ingest are reused from the old dataset, and those of a killed ingest from its
`ResumeStore` (`resume`). `read_log` handles a single log; `derive` combines the recordings.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from cyclekit.errors import EngineError, LogError
from cyclekit.ingest.read.log_checksums import Digests
from cyclekit.ingest.read.read_log import MAKING, ReadLog, ReadSettings, read_or_error
from cyclekit.ingest.read.resume import ResumeStore
from cyclekit.ingest.read.reuse import is_whole, take_over
from cyclekit.ingest.read.shared_files import SharedFileWriter, tables_shared
from cyclekit.parallel.engine import LOCAL, Engine

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from cyclekit.dataset.cards import LogCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.ingest.discover import Log

__all__ = ["Digests", "ReadResult", "ReadSettings", "check_shared", "read_all"]


@dataclass(frozen=True)
class ReadResult:
    """Result of reading.

    Attributes:
        cards: Cards of the recordings, in the order of the logs.
        failed: Errors of the other logs.
        kept: Number of recordings reused without reading.
    """

    cards: list[LogCard]
    failed: list[LogError]
    kept: int


def read_all(
    logs: Sequence[Log],
    staging: Path,
    digests: Digests,
    *,
    old: Dataset | None = None,
    store: ResumeStore | None = None,
    engine: Engine = LOCAL,
    settings: ReadSettings | None = None,
    tell: Callable[[int, int, str, Sequence[LogCard]], None],
) -> ReadResult:
    """Read the logs into `staging/recordings`.

    Args:
        logs: Logs to read.
        staging: Folder of the dataset being built.
        digests: Computes the checksums of the files; some may be pending at the end.
        old: Dataset with recordings to reuse.
        store: Stores recordings as soon as they are read, for an ingest after a kill.
        engine: Runs the reading. Its workers must see the logs and `staging` under the same paths.
        settings: What to store of each log.
        tell: Called with the bytes read, those of all logs to read, a description and the recordings read.
    """
    settings = settings or ReadSettings()
    damaged = old.damaged() if old else {}
    known = {entry.key: entry for entry in old.recordings} if old else {}
    entries: dict[str, LogCard] = {}
    todo, shared_files = [], SharedFileWriter(logs, staging)
    for log in logs:
        before = known.get(log.key)
        if old is not None and before is not None and is_whole(before, old.path, damaged):
            entries[log.id] = digests.completed(take_over(before, log, old.path, staging), log)
            shared_files.put(log.id, tables_shared(before, old.path))
        elif store is not None and (found := store.find(log)) is not None:
            entries[log.id] = digests.completed(store.take(found, log, staging), log)
            shared_files.put(log.id, {})
        else:
            todo.append(log)
    kept = len(entries)
    size = sum(log.size for log in todo) or 1
    done = 0
    failures: dict[str, LogError] = {}
    # pseudonymising changes the times in each recording's own files
    hold = shared_files.shares and not settings.pseudonymise
    read: Callable[[Log], ReadLog | LogError] = partial(_read, staging=staging, settings=settings, hold=hold)
    if engine.stays_here(len(todo)):  # so no log waits for the checksums of the previous one
        read = partial(read_or_error, digests=digests, staging=staging, settings=settings, hold=hold)
    for outcome in engine.map(read, todo):
        log, result = outcome.item, outcome.get()
        done += log.size
        if isinstance(result, LogError):
            failures[log.id] = result
            shared_files.put(log.id, {})
            continue
        entries[log.id] = result.card
        tell(done, size, f"read {log.shown}", [*entries.values()][kept:])
        shared_files.put(log.id, result.tables)
        if store is not None and not result.tables:
            store.put(result.card, log, staging)
    shared_files.close()
    for left in staging.glob(f"recordings/{MAKING}*"):
        shutil.rmtree(left, ignore_errors=True)  # of a killed worker; its log was read again
    failed = [failures[log.id] for log in todo if log.id in failures]
    return ReadResult([entries[log.id] for log in logs if log.id in entries], failed, kept)


def check_shared(staging: Path) -> None:
    """Check that this machine sees the dataset being built.

    Raises:
        EngineError: Its folder does not exist here.
    """
    if not staging.is_dir():
        seen = f"{staging}: not there on the machine of the worker"
        cure = "Put the dataset where all machines see it, or work cell by cell: cyclekit fleet all FLEET.toml"
        raise EngineError(seen, cure=cure)


def _read(log: Log, *, staging: Path, settings: ReadSettings, hold: bool) -> ReadLog | LogError:
    """Read one log, on any machine; its checksums are computed in parallel."""
    check_shared(staging)
    with Digests(wanted=settings.checksums) as digests:
        result = read_or_error(log, digests, staging=staging, settings=settings, hold=hold)
        if isinstance(result, ReadLog):
            [card] = digests.settle([result.card])
            return replace(result, card=card)
        return result
