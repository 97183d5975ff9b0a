"""The file system behind a URL: reads and writes objects; every error names the URL and the cure."""

from __future__ import annotations

import hashlib
import os
import re
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING

from cyclekit.errors import StorageError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pyarrow import fs

    from cyclekit.storage.remote.manifest import ManifestEntry

URL = re.compile(r"[a-z][a-z0-9+.-]+://", re.IGNORECASE)  # at least two letters: C:\\ is a drive
AT_ONCE = 8
"""Maximum number of objects fetched or sent at the same time."""
_STEP = 8 << 20
_OBJECTS = ("s3", "gcs", "abfs")
"""File systems without folders, in which an object is written atomically."""


@lru_cache(maxsize=8)
def opened(url: str) -> tuple[fs.FileSystem, str]:
    """Return the file system of a URL and the path in it.

    Raises:
        StorageError: That kind of URL is not supported.
    """
    import pyarrow as pa
    from pyarrow import fs  # slow to import, and URLs are rare

    try:
        system, path = fs.FileSystem.from_uri(url)
    except (ValueError, pa.ArrowException) as error:
        try:
            from fsspec.core import url_to_fs

            found, path = url_to_fs(url)
        except (ImportError, ValueError):
            kinds = "Known: file, s3, gs, abfs, hdfs; more with a package of fsspec's installed."
            raise StorageError(url, f"not a usable address ({error})", cure=kinds) from error
        system = fs.PyFileSystem(fs.FSSpecHandler(found))
    return system, path.rstrip("/")


def _failures() -> tuple[type[Exception], ...]:
    import pyarrow as pa

    return OSError, pa.ArrowException


@contextmanager
def storage_errors(url: str, what: str) -> Iterator[None]:
    """Convert errors of Arrow within the block to a `StorageError` that names the URL."""
    try:
        yield
    except _failures() as error:
        why = str(error).strip().partition("\n")[0] or type(error).__name__
        cure = "Check address and credentials (of s3: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_ENDPOINTURL)."
        raise StorageError(url, f"cannot be {what} ({why})", cure=cure) from error


def content(system: fs.FileSystem, key: str, most: int | None = None) -> bytes | None:
    """Return the content of a small object; None if it does not exist.

    Raises:
        OSError: It has more than `most` bytes.
    """
    info = system.get_file_info(key)
    if not info.is_file:
        return None
    if most is not None and info.size > most:
        raise OSError(f"{key} has {info.size} bytes, more than cyclekit writes")
    with system.open_input_stream(key) as stream:
        return bytes(stream.read())


def put(system: fs.FileSystem, key: str, content: bytes) -> None:
    """Write a small object atomically; on a file system with folders, by a rename."""
    if system.type_name in _OBJECTS:
        with system.open_output_stream(key) as stream:
            stream.write(content)
        return
    system.create_dir(key.rpartition("/")[0], recursive=True)
    with system.open_output_stream(f"{key}.{os.getpid()}.tmp") as stream:
        stream.write(content)
    system.move(f"{key}.{os.getpid()}.tmp", key)


def files_below(system: fs.FileSystem, path: str) -> list[fs.FileInfo]:
    """Return the files below a path, or the file at the path; empty if there is nothing."""
    whole = system.get_file_info(path)
    from pyarrow import fs

    below = fs.FileSelector(path, recursive=True, allow_not_found=True)
    found = [whole] if whole.is_file else system.get_file_info(below)
    return [info for info in found if info.is_file]


def fetch(system: fs.FileSystem, key: str, target: Path, wanted: ManifestEntry | None) -> None:
    """Copy an object into a file; if `wanted` is given, check size and checksum.

    Raises:
        OSError: It cannot be read or written, or does not match `wanted`.
    """
    digest, size = hashlib.sha256(), 0
    with system.open_input_stream(key) as stream, target.open("wb") as handle:
        while piece := stream.read(_STEP):
            size += len(piece)
            if wanted is not None and size > wanted.size:
                break
            digest.update(piece)
            handle.write(piece)
    if wanted is not None and (size, digest.hexdigest()) != (wanted.size, wanted.sha256):
        msg = f"{key} does not match its manifest"
        raise OSError(msg)


def send(system: fs.FileSystem, file: Path, key: str) -> None:
    """Write a file as an object, in pieces, as it may be larger than memory."""
    if system.type_name not in _OBJECTS:
        system.create_dir(key.rpartition("/")[0], recursive=True)
    with file.open("rb") as handle, system.open_output_stream(key) as stream:
        while piece := handle.read(_STEP):
            stream.write(piece)
    if system.get_file_info(key).size != file.stat().st_size:
        msg = f"{key} arrived incomplete"
        raise OSError(msg)
