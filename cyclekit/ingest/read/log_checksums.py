"""Checksums of the logs, computed beside the reading: a second look at a file that is in memory anyway.

BLAKE3, which `b3sum` prints: SHA-256 takes longer than the reading on a processor without instructions for it. What an
earlier version has put into a dataset stays what it is; the name of the entry says by which function it was made.
Nothing waits for a checksum before the card of the dataset is written.
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
    """Computes the checksums of files in the background, one after the other, until its `with` block is left.

    Attributes:
        wanted: Whether it does.
    """

    def __init__(self, *, wanted: bool = True) -> None:
        """Begin.

        Args:
            wanted: Compute them; else only watch whether a log changes.
        """
        self.wanted = wanted
        self._worker: ThreadPoolExecutor | None = None
        self._given_up = threading.Event()
        self._pending: dict[str, tuple[Log, list[Future[str]]]] = {}

    def sources(self, log: Log) -> tuple[SourceFile, ...]:
        """Return where a log comes from, file by file; `settle` gives each its `blake3`.

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
        """Return the card of a log taken over, with its checksums to come if it has none yet.

        Raises:
            OSError: A file has gone.
        """
        if self.wanted and any(source.checksum is None for source in entry.sources):
            return replace(entry, sources=self.sources(log))
        return entry

    def settle(self, entries: Iterable[AnyLog]) -> list[AnyLog]:
        """Return the cards with the checksums of their files, and warnings of logs that changed since they were found.

        Raises:
            LogError: A file cannot be read any more.
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
