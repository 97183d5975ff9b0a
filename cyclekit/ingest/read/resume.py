"""Recordings already read by an ingest, stored next to the dataset until it is complete, to resume after a kill.

They hold people as logged, so they are deleted as soon as they are not needed (docs/privacy.md).

`.NAME.read` has one folder per recording, named by the key of its log, with the tables and the card. A folder is always
complete, because it is created by a rename. The key changes with the log, its adapter or its options, so a folder is
never used for anything else.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from cyclekit import schema
from cyclekit.dataset.cards import BadCard, LogCard, checked, plain, read_json
from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.read.read_log import QUARANTINE
from cyclekit.ingest.read.reuse import as_read, link_files, named_anew
from cyclekit.storage.atomic import hidden_sibling
from cyclekit.storage.files import resolved
from cyclekit.storage.parquet import TableWriter, parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit.ingest.discover import Log

_ENTRY = "entry.json"
WORTH_BYTES = 1 << 20
"""Minimum size, bytes, of a log worth storing; a smaller one is read again faster."""


class ResumeStore:
    """The stored recordings next to one dataset; the user must hold the dataset's lock."""

    def __init__(self, out: Path, options: str) -> None:
        """Set the paths.

        Args:
            out: The dataset.
            options: Further settings on which the stored content depends; other settings give another recording.
        """
        out = resolved(out)
        self._folder, self._gone = hidden_sibling(out, "read"), hidden_sibling(out, "read-gone")
        self._options = options

    def find(self, log: Log) -> Path | None:
        """Return the folder of a log's recording; None if it is absent or unusable (then it is removed)."""
        place = self._folder / f"{log.key[:32]}-{self._options}"
        try:
            entry = checked(read_json(place / _ENTRY), LogCard)
        except FileNotFoundError:
            return None
        except (BadCard, OSError):
            entry = None
        if entry is not None and all((place / f"{name}.parquet").is_file() for name in entry.tables):
            return place
        shutil.rmtree(place, ignore_errors=True)
        return None

    def take(self, place: Path, log: Log, staging: Path) -> LogCard:
        """Link a recording into the dataset being built; return its card."""
        entry = checked(read_json(place / _ENTRY), LogCard)
        target = staging / "recordings" / log.id
        link_files(sorted(place.iterdir()), target)
        (target / _ENTRY).unlink()
        aside = target / f"{QUARANTINE}.parquet"
        if aside.is_file() and entry.id != log.id:
            aside.unlink()  # it is a link
            with TableWriter(aside, schema.QUARANTINE) as table:
                for part in parts_of(place / aside.name):
                    table.write(named_anew(part, log))
        return as_read(entry, log)

    def put(self, entry: LogCard, log: Log, staging: Path) -> None:
        """Store a recording of the dataset being built; a failure only costs the shortcut."""
        if log.size < WORTH_BYTES:
            return
        place = self._folder / f"{log.key[:32]}-{self._options}"
        making = self._folder / f"tmp-{os.getpid()}-{secrets.token_hex(3)}"
        try:
            self._folder.mkdir(exist_ok=True)
            link_files(sorted((staging / "recordings" / log.id).iterdir()), making)
            (making / _ENTRY).write_text(json.dumps(plain(entry), ensure_ascii=False), encoding="utf-8")
            making.rename(place)
        except OSError:
            shutil.rmtree(making, ignore_errors=True)

    @property
    def is_left(self) -> bool:
        """Whether a killed (or running) ingest has left something."""
        return self._folder.exists() or self._gone.exists()

    @property
    def left(self) -> Path | None:
        """Folder of recordings for the next ingest; None if there is none."""
        return self._folder if self._folder.exists() else None

    @contextmanager
    def while_making(self) -> Iterator[None]:
        """Delete everything when the dataset is complete or has failed, unless the next ingest can resume.

        It can resume after an interruption, and after an error in the cell file or a log, which is quickly corrected.
        """
        try:
            yield
        except (KeyboardInterrupt, ConfigError, LogError):
            raise
        except BaseException:
            self.clear()
            raise
        self.clear()

    def clear(self) -> None:
        """Delete everything.

        The folder is renamed first, so that a kill during deletion leaves no recording with a missing table.
        """
        shutil.rmtree(self._gone, ignore_errors=True)
        try:
            self._folder.rename(self._gone)
        except OSError:  # absent, or the disk refuses: a recording without card is not used
            for entry in self._folder.glob(f"*/{_ENTRY}"):
                with suppress(OSError):
                    entry.unlink()
            shutil.rmtree(self._folder, ignore_errors=True)
        shutil.rmtree(self._gone, ignore_errors=True)
