"""Checksums of the logs, computed in parallel with reading, while the file is in memory anyway.

BLAKE3, as printed by `b3sum`: on a processor without SHA instructions, SHA-256 takes longer than reading. Checksums
from earlier versions remain in a dataset; the entry's name shows the function. Nothing waits for a checksum before the
card of the dataset is written.
"""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Self, TypeVar

from msgspec.structs import replace

from cyclekit.dataset.cards import LogCard, SourceFile, note
from cyclekit.dataset.checksums import digest_of
from cyclekit.errors import LogError
from cyclekit.ingest.discover import Log, files_of, key_of

if TYPE_CHECKING:
    from collections.abc import Iterable

CHANGED = note("log-changed")


AnyLog = TypeVar("AnyLog", bound=LogCard)


class Digests:
    """Computes checksums of files in the background, one at a time, until its `with` block ends.

    Attributes:
        wanted: Whether checksums are computed.
    """

    def __init__(self, *, wanted: bool = True) -> None:
        """Set up; no thread is started yet.

        Args:
            wanted: Compute checksums; otherwise only detect changes of a log.
        """
        self.wanted = wanted
        self._worker: ThreadPoolExecutor | None = None
        self._given_up = threading.Event()
        self._pending: dict[str, tuple[Log, list[Future[str]]]] = {}

    def sources(self, log: Log) -> tuple[SourceFile, ...]:
        """Return the files of a log; `settle` adds their `blake3`.

        Raises:
            OSError: A file has gone.
        """
        found, digests = [], []
        for file in files_of(log.path):
            if self.wanted:
                self._worker = self._worker or ThreadPoolExecutor(1)
                digests.append(self._worker.submit(digest_of, file, self._given_up))
            shown = log.shown if file == log.path else f"{log.shown}/{file.relative_to(log.path).as_posix()}"
            found.append(SourceFile(path=shown, size=file.stat().st_size))
        self._pending[log.id] = (log, digests)
        return tuple(found)

    def completed(self, entry: LogCard, log: Log) -> LogCard:
        """Return the card of a reused log, and schedule its checksums if they are missing.

        Raises:
            OSError: A file has gone.
        """
        if self.wanted and any(source.checksum is None for source in entry.sources):
            return replace(entry, sources=self.sources(log))
        return entry

    def settle(self, entries: Iterable[AnyLog]) -> list[AnyLog]:
        """Return the cards with checksums of their files, and warnings for logs that changed since they were found.

        Raises:
            LogError: A file can no longer be read.
        """
        return [self._settled(entry) if entry.id in self._pending else entry for entry in entries]

    def _settled(self, entry: AnyLog) -> AnyLog:
        log, digests = self._pending.pop(entry.id)
        try:
            found = [digest.result() for digest in digests]
        except OSError as error:
            raise LogError(log.path, f"cannot be read ({error.strerror})", cure="Check the file.") from error
        sources = entry.sources
        if self.wanted:
            sources = tuple(replace(one, blake3=digest) for one, digest in zip(sources, found, strict=True))
        changed = _has_changed(log) and CHANGED not in entry.warnings
        return replace(entry, sources=sources, warnings=(*entry.warnings, CHANGED) if changed else entry.warnings)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *about: object) -> None:
        self._given_up.set()
        if self._worker is not None:
            self._worker.shutdown(wait=False, cancel_futures=True)


def _has_changed(log: Log) -> bool:
    try:
        return key_of(log) != log.key
    except OSError:
        return True
