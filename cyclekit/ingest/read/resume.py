"""Recordings that an ingest has read, kept beside the dataset until it is in place: a killed ingest goes on from here.

They hold people as logged, so they go as soon as they are of no use: docs/privacy.md says when.

One folder per recording under `.NAME.read`, named by the key of its log: the tables and the entry. What is there is
whole, since it is put there by a rename. The key changes when the log, its reader or its options do, so that nothing
else is ever taken for it.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from cyclekit import schema
from cyclekit.dataset.cards import BadCard, LogCard, checked, read_json
from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.read.read_log import QUARANTINE
from cyclekit.ingest.read.reuse import as_read, link_files, named_anew
from cyclekit.storage.atomic import beside
from cyclekit.storage.files import resolved
from cyclekit.storage.parquet import TableWriter, parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit.ingest.discover import Log

_ENTRY = "entry.json"
WORTH_BYTES = 1 << 20
"""A smaller log is sooner read again than put on the shelf."""


class Shelf:
    """The recordings beside one dataset; for one who holds its lock."""

    def __init__(self, out: Path, options: str) -> None:
        """Open the shelf.

        Args:
            out: The dataset.
            options: What else than the log decides what is kept of it; other options, another recording.
        """
        out = resolved(out)
        self._folder, self._gone = beside(out, "read"), beside(out, "read-gone")
        self._options = options

    def find(self, log: Log) -> Path | None:
        """Return where the recording of a log stands, None if it does not, or cannot be used: then it is removed."""
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

    def take(self, place: Path, log: Log, staging: Path) -> dict[str, Any]:
        """Link a recording into the dataset in the making; return its entry."""
        entry = read_json(place / _ENTRY)
        target = staging / "recordings" / log.id
        link_files(sorted(place.iterdir()), target)
        (target / _ENTRY).unlink()
        aside = target / f"{QUARANTINE}.parquet"
        if aside.is_file() and entry["id"] != log.id:
            aside.unlink()  # it is a link
            with TableWriter(aside, schema.QUARANTINE) as table:
                for part in parts_of(place / aside.name):
                    table.write(named_anew(part, log))
        return as_read(entry, log)

    def put(self, entry: dict[str, Any], log: Log, staging: Path) -> None:
        """Keep a recording that is in the dataset in the making; where that fails nothing is lost but the shortcut."""
        if log.size < WORTH_BYTES:
            return
        place = self._folder / f"{log.key[:32]}-{self._options}"
        making = self._folder / f"tmp-{os.getpid()}-{secrets.token_hex(3)}"
        try:
            self._folder.mkdir(exist_ok=True)
            link_files(sorted((staging / "recordings" / log.id).iterdir()), making)
            (making / _ENTRY).write_text(json.dumps(entry, ensure_ascii=False), encoding="utf-8")
            making.rename(place)
        except OSError:
            shutil.rmtree(making, ignore_errors=True)

    @property
    def is_left(self) -> bool:
        """Tell whether a killed ingest (or one at work) has left something."""
        return self._folder.exists() or self._gone.exists()

    @property
    def left(self) -> Path | None:
        """Where recordings wait for the next ingest, None if there are none."""
        return self._folder if self._folder.exists() else None

    @contextmanager
    def while_making(self) -> Iterator[None]:
        """Have everything forgotten when the dataset is made, or cannot be; not where the next ingest shall go on.

        That is so where it was interrupted, and where the cell file or a log is wrong: both are mended in a minute.
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
        """Forget everything.

        Under another name first, so that one who is killed here leaves no recording that has lost a table.
        """
        shutil.rmtree(self._gone, ignore_errors=True)
        try:
            self._folder.rename(self._gone)
        except OSError:  # there is none, or the disk refuses: what has lost its entry is not used
            for entry in self._folder.glob(f"*/{_ENTRY}"):
                with suppress(OSError):
                    entry.unlink()
            shutil.rmtree(self._folder, ignore_errors=True)
        shutil.rmtree(self._gone, ignore_errors=True)
