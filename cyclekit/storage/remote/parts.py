"""Fetch and publish a folder as parts named by their content, and a manifest that assigns them to files."""

from __future__ import annotations

import contextlib
import datetime as dt
import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import msgspec

from cyclekit.errors import CyclekitError, StorageError
from cyclekit.storage.atomic import built, clean_up, locked, write_text
from cyclekit.storage.remote.cache import WAIT_S, cached, known_parts
from cyclekit.storage.remote.file_system import AT_ONCE, content, fetch, files_below, opened, put, send, storage_errors
from cyclekit.storage.remote.manifest import (
    FORMAT,
    MANIFEST,
    MAX_BYTES,
    VERSION,
    Files,
    Manifest,
    ManifestEntry,
    check,
    parsed,
    part_of,
    read_known,
)
from cyclekit.storage.safe_path import leads_out, safe_path

if TYPE_CHECKING:
    from pathlib import Path

    from pyarrow.fs import FileSystem

_GRACE = dt.timedelta(days=1)
"""Minimum age of an unused part before it is deleted: a reader may still use an older manifest."""


def _manifest(system: FileSystem, base: str, url: str) -> Manifest | None:
    with storage_errors(url, "read"):
        text = content(system, f"{base}/{MANIFEST}", MAX_BYTES)
    return None if text is None else parsed(text, url)


def fetched(url: str) -> Path | None:
    """Update the cached folder and return its path; None if nothing is published."""
    system, base = opened(url)
    folder = cached(url)
    known = known_parts(folder)
    for attempt in range(3):
        manifest = _manifest(system, base, url)
        if manifest is None:
            return None
        with locked(folder, wait_s=WAIT_S):
            clean_up(folder)
            here = read_known(known.read_text("utf-8", "replace")) if known.is_file() and folder.is_dir() else {}
            if here == manifest.files:
                return folder
            try:
                _build(url, manifest.files, folder, here)
            except StorageError:
                if attempt == 2 or _manifest(system, base, url) == manifest:
                    raise
                continue  # published again meanwhile, and an old part was deleted
            write_text(known, msgspec.json.encode(manifest.files).decode())
            return folder
    return None


def _build(url: str, files: Files, folder: Path, here: Files) -> None:
    system, base = opened(url)
    with built(folder) as making, ThreadPoolExecutor(AT_ONCE) as pool:

        def place(name: str) -> None:
            entry, names = files[name], name.split("/")
            with storage_errors(url, "read"):
                target = safe_path(making, *names)
                target.parent.mkdir(parents=True, exist_ok=True)
                if here.get(name) == entry:
                    with contextlib.suppress(OSError):
                        os.link(safe_path(folder, *names), target)
                        return
                fetch(system, f"{base}/{entry.part}", target, entry)

        list(pool.map(place, files))


def publish(folder: Path, url: str) -> None:
    """Publish a folder at a URL: new parts first, then the manifest.

    Raises:
        StorageError: The URL cannot be read or written; readers find the previous content.
    """
    system, base = opened(url)
    before = _manifest(system, base, url)
    there = {entry.part for entry in before.files.values()} if before else set[str]()
    files = _files(folder)
    with storage_errors(url, "written"), ThreadPoolExecutor(AT_ONCE) as pool:
        entries = dict(zip(files, pool.map(_entry, files, files.values()), strict=True))
        _check(entries, folder)
        missing = [name for name, entry in entries.items() if entry.part not in there]
        list(pool.map(lambda name: send(system, files[name], f"{base}/{entries[name].part}"), missing))
        if before is None or before.files != entries:
            document = msgspec.json.encode(Manifest(FORMAT, VERSION, entries))
            put(system, f"{base}/{MANIFEST}", msgspec.json.format(document, indent=1))
        _sweep(system, base, {entry.part for entry in entries.values()})
    write_text(known_parts(folder), msgspec.json.encode(entries).decode())


def _files(folder: Path) -> dict[str, Path]:
    """Return the files to publish by name, without hidden ones and without links out of the folder."""
    found = {file.relative_to(folder): file for file in sorted(folder.rglob("*")) if file.is_file()}
    return {
        name.as_posix(): file
        for name, file in found.items()
        if not any(part.startswith(".") for part in name.parts) and not leads_out(file, folder)
    }


def _check(entries: Files, folder: Path) -> None:
    """Raise an error for a file that could not be fetched again."""
    try:
        check(entries)
    except ValueError as error:
        raise CyclekitError(f"{folder}: cannot be published ({error})", cure="Rename the file named above.") from error


def _entry(name: str, file: Path) -> ManifestEntry:
    with file.open("rb") as handle:
        digest = hashlib.file_digest(handle, "sha256").hexdigest()
    return ManifestEntry(part_of(name, digest), file.stat().st_size, digest)


def _sweep(system: FileSystem, base: str, used: set[str]) -> None:
    """Delete unused parts older than _GRACE."""
    before = dt.datetime.now(tz=dt.UTC) - _GRACE
    for info in files_below(system, f"{base}/parts"):
        old = info.mtime is not None and info.mtime.astimezone(dt.UTC) < before
        if old and info.path.removeprefix(f"{base}/") not in used:
            system.delete_file(info.path)
