"""Atomic replacement of files and folders: a reader finds the old one or the new one. One writer at a time.

A file or folder is built under a temporary name next to its path, flushed to disk, and renamed. The next writer removes
leftovers of killed processes. The lock is the operating system's: it ends with the process that holds it, so a lock
file left behind never blocks.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
from filelock import FileLock, Timeout

from cyclekit.errors import BusyPlace, CyclekitError
from cyclekit.storage.files import resolved, shortened

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

COMPLETE = ".complete"
_MANY = 64
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)  # without locks


def write_parquet(frame: pl.DataFrame, file: Path) -> None:
    """Write one table (zstd) to a temporary path of `built` or `replaced`; equal frames give equal bytes.

    Raises:
        OSError: The file cannot be written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("wb") as handle:
        try:
            frame.write_parquet(handle, compression="zstd", statistics=True)
        except pl.exceptions.PolarsError as error:  # polars reports "out of specification" for a full disk
            raise OSError(errno.EIO, str(error).rpartition("error: ")[2], str(file)) from error


def write_text(file: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        CyclekitError: The target cannot be written; the old file is unchanged.
    """
    with replaced(file) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as handle:
        handle.write(text)


@contextmanager
def replaced(file: Path) -> Iterator[Path]:
    """Yield a temporary path to write; on success the file replaces `file`, on failure nothing changes.

    A link remains: its target is replaced. To a device or pipe, the content is written when it is complete.

    Raises:
        BusyPlace: Another process has been writing there for several seconds.
        CyclekitError: The path cannot be written.
    """
    if file.exists() and not file.is_file():
        with write_errors(file), _streamed(file) as temporary:
            yield temporary
        return
    with write_errors(file):
        file = Path(os.path.realpath(file))
    with write_errors(file), locked(file, wait_s=5.0):
        _sweep(file, "tmp")
        temporary = _new_sibling(file, "tmp")
        try:
            yield temporary
            _to_disk(temporary)
            temporary.replace(file)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextmanager
def _streamed(place: Path) -> Iterator[Path]:
    """Yield a temporary path to write; its content is then copied to a device or pipe."""
    if place.is_dir():
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(place))
    with tempfile.TemporaryDirectory(prefix="cyclekit-", ignore_cleanup_errors=True) as folder:
        temporary = Path(folder) / "whole"
        yield temporary
        with temporary.open("rb") as whole, place.open("wb") as sink:
            shutil.copyfileobj(whole, sink)


@contextmanager
def staged(path: Path) -> Iterator[Path]:
    """Yield an empty folder to fill; on success it replaces `path`, on failure nothing changes.

    Raises:
        BusyPlace: Another process is writing there.
        CyclekitError: The path cannot be written.
    """
    with write_errors(path):
        path = resolved(path)  # "." has no name for temporary folders, and links must be kept
    with write_errors(path), locked(path):
        clean_up(path)
        with built(path) as staging:
            yield staging


@contextmanager
def built(path: Path) -> Iterator[Path]:
    """Same as `staged`, for a caller that holds the lock of `path` and has called `clean_up`.

    The swap takes two renames. A process killed between them leaves the complete new folder under its temporary name,
    and `recover` finishes the swap when the folder is next opened.
    """
    with write_errors(path):
        path = resolved(path)
    staging = _new_sibling(path, "new")
    with write_errors(path):
        try:
            staging.mkdir(parents=True)
            yield staging
            _all_to_disk(staging)
            (staging / COMPLETE).touch()
            _swap(staging, path)
        except OSError:
            with suppress(OSError):
                _undo(staging, path)
            raise
        finally:
            if not (staging / COMPLETE).exists():
                shutil.rmtree(staging, ignore_errors=True)


def recover(path: Path) -> None:
    """Finish the swap of a process killed between its two renames.

    For readers: it acts only if `path` does not exist, so it cannot disturb a running writer.
    """
    with suppress(OSError):
        path = resolved(path)
        if path.exists():
            return
        finished = [folder for folder in _leftovers(path, "new") if (folder / COMPLETE).is_file()]
        for folder in [*finished, *_leftovers(path, "old")][:1]:
            folder.rename(path)


def clean_up(path: Path) -> None:
    """Finish or undo the swaps of killed processes at `path`; the caller holds its lock."""
    path = resolved(path)
    recover(path)
    for folder in _leftovers(path, "new"):
        if (folder / COMPLETE).is_file():
            _swap(folder, path)
        shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        (path / COMPLETE).unlink(missing_ok=True)
    _sweep(path, "old")


def needs_clean_up(path: Path) -> bool:
    """Return whether temporary folders of a killed or running process exist next to `path`."""
    return any(_leftovers(resolved(path), kind) for kind in ("new", "old"))


@contextmanager
def locked(path: Path, *, wait_s: float = 0.2) -> Iterator[None]:
    """Lock `path` against other writers, across processes; no lock on file systems that do not support it.

    Raises:
        BusyPlace: Another process still holds the lock after `wait_s`.
        CyclekitError: The folder of `path` cannot be written.
    """
    with write_errors(path):
        path = resolved(path)
        lock = hidden_sibling(path, "lock")
        path.parent.mkdir(parents=True, exist_ok=True)
        held = FileLock(lock, wait_s, thread_local=False, poll_interval=0.02, on_acquired=_sign)
        try:
            held.acquire()
        except Timeout:
            raise BusyPlace(path, _holder(lock)) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
    try:
        yield
    finally:
        with suppress(OSError):  # before release; on Windows, the open file is removed by the release
            lock.unlink(missing_ok=True)
        held.release()


def _sign(descriptor: int) -> None:
    """Write the process ID into the lock file after the first byte, which Windows locks against reading."""
    with suppress(OSError):  # full disk: no process ID
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f" {os.getpid()}\n".encode())


def _holder(lock: Path) -> str:
    try:
        with lock.open("rb", buffering=0) as signed:
            signed.seek(1)
            return f" (process {int(signed.read(32))})"
    except (OSError, ValueError):
        return ""


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Convert errors of the file system within the block to a `CyclekitError` that names the path."""
    try:
        yield
    except OSError as error:
        msg = f"{path}: cannot be written ({error.strerror or error})"
        raise CyclekitError(msg, cure="Check the folder, its permissions and the free space.") from error


def hidden_sibling(path: Path, kind: str) -> Path:
    """Return the path of a hidden file of ours next to `path`; a long name is shortened."""
    return path.with_name(f".{shortened(path.name)}.{kind}")


def _new_sibling(path: Path, kind: str) -> Path:
    return hidden_sibling(path, f"{kind}-{os.getpid()}-{secrets.token_hex(3)}")


def _leftovers(path: Path, kind: str) -> list[Path]:
    begin = hidden_sibling(path, f"{kind}-").name
    try:
        return sorted(entry for entry in path.parent.iterdir() if entry.name.startswith(begin))
    except OSError:
        return []


def _sweep(path: Path, kind: str) -> None:
    for entry in _leftovers(path, kind):
        if entry.is_dir():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            with suppress(OSError):
                entry.unlink(missing_ok=True)


def _to_disk(file: Path) -> None:
    with file.open("rb+") as handle:
        os.fsync(handle.fileno())


def _all_to_disk(folder: Path) -> None:
    """Flush every file of a folder to disk; many files by one system call."""
    files = [file for file in folder.rglob("*") if file.is_file()]
    if len(files) > _MANY and hasattr(os, "sync"):
        os.sync()
        return
    for file in files:
        _to_disk(file)


def _swap(staging: Path, path: Path) -> None:
    if path.exists():
        path.rename(_new_sibling(path, "old"))
    with suppress(FileNotFoundError):  # a reader has already finished the swap
        _patiently(lambda: staging.rename(path))
    with suppress(OSError):
        (path / COMPLETE).unlink(missing_ok=True)
    _sweep(path, "old")


def _undo(staging: Path, path: Path) -> None:
    """Restore the old folder if the new one could not be renamed."""
    if not path.exists():
        for old in _leftovers(path, "old"):
            old.rename(path)
    (staging / COMPLETE).unlink(missing_ok=True)


def _patiently(do: Callable[[], object]) -> None:
    """Retry for a second: on Windows, an open file cannot be renamed."""
    for _ in range(20 if os.name == "nt" else 0):
        try:
            do()
        except PermissionError:
            time.sleep(0.05)
        else:
            return
    do()
