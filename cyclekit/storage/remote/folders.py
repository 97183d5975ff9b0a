"""Datasets and models on shared storage: a folder at a URL, fetched to this machine and published from it.

    s3://bucket/cell-7/dataset      also the other file systems of Arrow (gs, abfs, hdfs) and of fsspec
    file:///mnt/plant/dataset       a folder of this machine, used in place

An object store has no folders and no rename, only objects that are written atomically. So a folder is published as
parts named by their content, and one manifest that assigns parts to files:

    URL/parts/tasks-3f9a….parquet   written once, never changed
    URL/manifest.json               written last: a reader finds the old folder or the new one

The work is done on a copy in the local cache (CYCLEKIT_CACHE, else the system's cache folder), to which only missing
parts are fetched. The caller must ensure one writer at a time: of two, the last one wins.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.errors import NothingPublished, OutsideFolder, StorageError
from cyclekit.storage.atomic import locked
from cyclekit.storage.atomic import write_text as write_file
from cyclekit.storage.remote.cache import WAIT_S, cached, known_parts, of_file_url
from cyclekit.storage.remote.file_system import AT_ONCE, URL, content, fetch, files_below, opened, put, storage_errors
from cyclekit.storage.remote.parts import fetched, publish
from cyclekit.storage.safe_path import safe_path

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pyarrow.fs import FileInfo, FileSystem


def is_url(place: Path | str) -> bool:
    """Return whether a place is a URL, not a local path."""
    return isinstance(place, str) and URL.match(place) is not None


def join(place: Path | str, name: str) -> str:
    """Return the path or URL of `name` in a place; the query of a URL (after `?`) stays at the end."""
    if not is_url(place):
        return str(Path(place) / name)
    url, mark, options = str(place).partition("?")
    return f"{url.rstrip('/')}/{name}{mark}{options}"


def from_folder(folder: Path, place: str) -> str:
    """Return a path given in a file of `folder`, to which it may be relative; a URL is unchanged, `~/` is at home."""
    if place.startswith(("~/", "~\\")):
        return str(Path(place).expanduser())
    return place if is_url(place) else join(folder, place)


def local(place: Path | str) -> Path:
    """Return the local path of a folder, fetched if it is at a URL.

    Raises:
        StorageError: Nothing is published at the URL, or it cannot be read.
    """
    if not is_url(place):
        return Path(place)
    url = str(place)
    if (path := of_file_url(url)) is not None:
        return path
    if (folder := fetched(url)) is None:
        raise NothingPublished(url)
    return folder


def check_reachable(url: str) -> None:
    """Access a file system once, so that a wrong address or key is detected before the work.

    Raises:
        StorageError: The URL cannot be reached.
    """
    if of_file_url(url) is None:
        with storage_errors(url, "reached"):
            system, path = opened(url)
            system.get_file_info(path)


@contextmanager
def published(place: Path | str) -> Iterator[Path]:
    """Yield the local path of a folder to write; for a URL, it has the current content and is published at the end.

    After an error in the block, nothing is published.

    Raises:
        StorageError: The URL cannot be read or written.
    """
    path = of_file_url(str(place)) if is_url(place) else Path(place)
    if path is not None:
        yield path
        return
    url = str(place)
    path = fetched(url) or cached(url)
    known_parts(path).unlink(missing_ok=True)  # until published, the copy differs from the URL
    yield path
    publish(path, url)


def mirrored(place: Path | str) -> Path:
    """Return the local path of files from others, such as logs.

    For a URL, files that are new or differ in size or time are fetched, and local files missing there are deleted.

    Raises:
        StorageError: There is nothing at the URL, or it cannot be read.
    """
    if not is_url(place):
        return Path(place)
    url = str(place)
    if (path := of_file_url(url)) is not None:
        return path
    (system, base), target = opened(url), cached(url, "logs")
    with storage_errors(url, "read"), locked(target, wait_s=WAIT_S):
        files = {_named(target, info.path[len(base) :], url): info for info in files_below(system, base)}
        for file in [file for file in target.rglob("*") if file.is_file() and file not in files]:
            file.unlink()
        with ThreadPoolExecutor(AT_ONCE) as pool:
            list(pool.map(lambda file: _mirror(system, files[file], file), files))
    if not files:
        raise StorageError(url, "nothing was found there", cure="Check the address.")
    return target


def _named(folder: Path, key: str, url: str) -> Path:
    try:
        return safe_path(folder, *(name for name in key.split("/") if name))
    except OutsideFolder as error:
        raise StorageError(url, error.cause, cure="Rename that object, or give an address without it.") from error


def _mirror(system: FileSystem, info: FileInfo, target: Path) -> None:
    changed_ns = info.mtime_ns or 0
    if target.is_file() and target.stat().st_size == info.size:
        apart_ns = abs(target.stat().st_mtime_ns - changed_ns)
        if apart_ns < 1_000_000:  # not every file system keeps nanoseconds
            return
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".{target.name}.part")
    fetch(system, info.path, part, None)
    os.utime(part, ns=(changed_ns, changed_ns))
    part.replace(target)


def read_text(place: str) -> str | None:
    """Return the text of a file; None if it does not exist.

    Raises:
        StorageError: The URL cannot be read.
    """
    if not is_url(place) or of_file_url(place) is not None:
        path = local(place)
        return path.read_text(encoding="utf-8") if path.is_file() else None
    system, key = opened(place)
    with storage_errors(place, "read"):
        found = content(system, key)
    return None if found is None else found.decode()


def write_text(place: str, text: str) -> None:
    """Write a text file atomically.

    Raises:
        CyclekitError: It cannot be written.
    """
    if not is_url(place) or of_file_url(place) is not None:
        write_file(local(place), text)
        return
    system, key = opened(place)
    with storage_errors(place, "written"):
        put(system, key, text.encode())
