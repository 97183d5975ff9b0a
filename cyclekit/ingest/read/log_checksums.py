"""Checksums of the logs, computed beside the reading: a second look at a file that is in memory anyway.

BLAKE3, which `b3sum` prints: SHA-256 takes longer than the reading on a processor without instructions for it. What an
earlier version has put into a dataset stays what it is; the name of the entry says by which function it was made.
Nothing waits for a checksum before the card of the dataset is written.
"""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Self

from cyclekit.errors import LogError
from cyclekit.ingest.discover import Log, files_of, key_of
from cyclekit.storage.checksums import digest_of

if TYPE_CHECKING:
    from collections.abc import Sequence

KINDS = ("blake3", "sha256")
"""Functions by which the checksum of a log can have been made."""
CHANGED = "the log changed while it was read: is it still being written? ingest again when it is complete"


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

    def sources(self, log: Log) -> list[dict[str, Any]]:
        """Return where a log comes from, file by file; `blake3` is filled in by `settle`.

        Raises:
            OSError: A file has gone.
        """
        found, digests = [], []
        for file in files_of(log.path):
            if self.wanted:
                self._worker = self._worker or ThreadPoolExecutor(1)
                digests.append(self._worker.submit(digest_of, file, self._given_up))
            shown = log.shown if file == log.path else f"{log.shown}/{file.relative_to(log.path).as_posix()}"
            found.append({"path": shown, "blake3": None, "size": file.stat().st_size})
        self._pending[log.id] = (log, digests)
        return found

    def completed(self, entry: dict[str, Any], log: Log) -> dict[str, Any]:
        """Return the entry of a recording taken over, with its checksums to come if it has none yet.

        Raises:
            OSError: A file has gone.
        """
        if self.wanted and any(not any(map(source.get, KINDS)) for source in entry["sources"]):
            return {**entry, "sources": self.sources(log)}
        return entry

    def settle(self, entries: Sequence[dict[str, Any]]) -> None:
        """Fill in the checksums, and warn of logs that changed since they were found.

        Raises:
            LogError: A file cannot be read any more.
        """
        for entry in entries:
            if entry["id"] not in self._pending:
                continue
            log, digests = self._pending.pop(entry["id"])
            for source, digest in zip(entry["sources"], digests, strict=self.wanted):
                try:
                    source["blake3"] = digest.result()
                except OSError as error:
                    raise LogError(log.path, f"cannot be read ({error.strerror})", cure="Check the file.") from error
            if _has_changed(log) and CHANGED not in entry["warnings"]:
                entry["warnings"].append(CHANGED)

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
