"""A folder as parts named by their content, and the manifest that says which part is which file."""

from __future__ import annotations

import contextlib
import datetime as dt
import hashlib
import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

from cyclekit.atomic import built, locked, settle, write_text
from cyclekit.errors import StorageError
from cyclekit.storage.cache import WAIT_S, cached, known_parts
from cyclekit.storage.remote import AT_ONCE, content, fetch, files_below, opened, put, said, send

if TYPE_CHECKING:
    from pathlib import Path

    from pyarrow.fs import FileSystem

MANIFEST = "manifest.json"
_FORMAT = "cyclekit-folder"
_GRACE = dt.timedelta(days=1)
"""A part that no manifest speaks of any more is kept for so long: somebody may be reading by an older manifest."""


def _manifest(system: FileSystem, base: str, url: str) -> dict[str, Any] | None:
    with said(url, "read"):
        text = content(system, f"{base}/{MANIFEST}")
    if text is None:
        return None
    try:
        found = json.loads(text)
        assert found["format"] == _FORMAT and isinstance(found["files"], dict)  # noqa: PT018
        names = [PurePosixPath(name) for name in found["files"]]
        assert not any(name.is_absolute() or ".." in name.parts or "\\" in str(name) for name in names)
    except (ValueError, KeyError, TypeError, AssertionError) as error:
        raise StorageError(url, f"its {MANIFEST} is not one of cyclekit's", cure="Use another address.") from error
    return dict(found)


def fetched(url: str) -> Path | None:
    """Bring the cached folder up to date; None where nothing is published."""
    system, base = opened(url)
    folder = cached(url)
    known = known_parts(folder)
    for attempt in range(3):
        manifest = _manifest(system, base, url)
        if manifest is None:
            return None
        with locked(folder, wait_s=WAIT_S):
            settle(folder)
            here = json.loads(known.read_text(encoding="utf-8")) if known.is_file() and folder.is_dir() else {}
            if here == manifest["files"]:
                return folder
            try:
                _build(url, manifest["files"], folder, here)
            except StorageError:
                if attempt == 2 or _manifest(system, base, url) == manifest:
                    raise
                continue  # it was published anew, and an old part has gone
            write_text(known, json.dumps(manifest["files"]))
            return folder
    return None


def _build(url: str, files: dict[str, Any], folder: Path, here: dict[str, Any]) -> None:
    system, base = opened(url)
    with built(folder) as making, ThreadPoolExecutor(AT_ONCE) as pool:

        def place(name: str) -> None:
            target = making / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if here.get(name) == files[name]:
                with contextlib.suppress(OSError):
                    os.link(folder / name, target)
                    return
            with said(url, "read"):
                fetch(system, f"{base}/{files[name]['part']}", target, files[name]["sha256"])

        list(pool.map(place, files))


def publish(folder: Path, url: str) -> None:
    """Put a folder at a URL: what is new of it as parts, then the manifest.

    Raises:
        StorageError: The URL cannot be read or written; who reads finds what was there before.
    """
    system, base = opened(url)
    before = _manifest(system, base, url)
    there = {entry["part"] for entry in before["files"].values()} if before else set[str]()
    files = {file.relative_to(folder).as_posix(): file for file in sorted(folder.rglob("*")) if file.is_file()}
    with said(url, "written"), ThreadPoolExecutor(AT_ONCE) as pool:
        entries = dict(zip(files, pool.map(_entry, files, files.values()), strict=True))
        missing = [name for name, entry in entries.items() if entry["part"] not in there]
        list(pool.map(lambda name: send(system, files[name], f"{base}/{entries[name]['part']}"), missing))
        if before is None or before["files"] != entries:
            document = json.dumps({"format": _FORMAT, "version": 1, "files": entries}, indent=1)
            put(system, f"{base}/{MANIFEST}", document.encode())
        _sweep(system, base, {entry["part"] for entry in entries.values()})
    write_text(known_parts(folder), json.dumps(entries))


def _entry(name: str, file: Path) -> dict[str, Any]:
    with file.open("rb") as handle:
        digest = hashlib.file_digest(handle, "sha256").hexdigest()
    whole = PurePosixPath(name)
    part = f"parts/{whole.with_name(f'{whole.stem}-{digest[:20]}{whole.suffix}')}"
    return {"part": part, "size": file.stat().st_size, "sha256": digest}


def _sweep(system: FileSystem, base: str, used: set[str]) -> None:
    """Remove parts that nobody can be reading any more."""
    before = dt.datetime.now(tz=dt.UTC) - _GRACE
    for info in files_below(system, f"{base}/parts"):
        old = info.mtime is not None and info.mtime.astimezone(dt.UTC) < before
        if old and info.path.removeprefix(f"{base}/") not in used:
            system.delete_file(info.path)
