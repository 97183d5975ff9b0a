"""Checksums of files (BLAKE3), which detect files of a folder that changed since they were written.

A file is hashed in pieces of `PIECE_BYTES`, so that a reader of part of a large file (a column of a table) verifies
only that part. Digests are cached by size and modification time of the file, whatever its name, except for files that
have just been written, whose changes their time may not show.
"""

from __future__ import annotations

import os
import re
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

import polars as pl
from blake3 import blake3

from cyclekit.dataset.cards import FileCard
from cyclekit.errors import DatasetError

if TYPE_CHECKING:
    import threading
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from io import FileIO
    from pathlib import Path

PIECE_BYTES = 1 << 18
"""Bytes per piece; smaller pieces would hash more slowly and make the card long."""
EARLIER_PIECE_BYTES = 16 << 20
"""Bytes per piece of files listed without `piece_bytes`."""
_STEP = 1 << 17
_YOUNG_NS = 2_000_000_000
_AT_ONCE, _TAKEN = 4, 64
"""Number of threads, and number of pieces per task of a thread."""
_SEAL = ',\n "card_blake3": "{}"\n}}\n'
_ENDS_AS_SEALED = re.compile(r',\n "[^"\n]*": "[0-9a-f]{64}"\n}\n\Z')

_MAX_KNOWN = 1 << 17
"""Maximum number of cached digests: those of 32 GiB."""
_known: dict[tuple[int, ...], str] = {}
"""Cached digests by device, inode, size and time of a file, piece size and piece number."""


def digest_of(file: Path, given_up: threading.Event | None = None) -> str:
    """Return the BLAKE3 of a whole file, 64 hexadecimal digits, as printed by `b3sum`.

    Args:
        file: The file.
        given_up: Event that stops the hashing when set.

    Raises:
        OSError: The file cannot be read.
    """
    with file.open("rb", buffering=0) as handle:
        return _digest_from(handle, None, memoryview(bytearray(_STEP)), given_up)


def file_cards(folder: Path) -> dict[str, FileCard]:
    """Return size and digests of every file of a folder, by its path in the folder.

    Raises:
        OSError: A file cannot be read.
    """
    files = {file.relative_to(folder).as_posix(): file for file in sorted(folder.rglob("*")) if file.is_file()}
    sizes = {name: file.stat().st_size for name, file in files.items()}
    wanted = [(files[name], PIECE_BYTES, range(_count(size, PIECE_BYTES))) for name, size in sizes.items()]
    found: dict[str, FileCard] = {}
    for (name, size), digests in zip(sizes.items(), _digests(wanted), strict=True):
        piece_bytes = None if len(digests) == 1 else PIECE_BYTES
        found[name] = FileCard(size=size, piece_bytes=piece_bytes, blake3=tuple(digests))
    return found


def damaged_files(folder: Path, files: Mapping[str, FileCard]) -> dict[str, str]:
    """Return the files that changed since they were listed: by name, the problem."""
    wrong = {name: problem for name, entry in files.items() if (problem := _wrong_size(folder / name, entry))}
    same = {name: entry for name, entry in files.items() if name not in wrong}
    wanted = [(folder / name, _piece_bytes(entry), range(len(entry.blake3))) for name, entry in same.items()]
    for (name, entry), digests in zip(same.items(), _digests(wanted), strict=True):
        if digests != list(entry.blake3):
            wrong[name] = "damaged"
    return {name: wrong[name] for name in files if name in wrong}


def damage_of(file: Path, entry: FileCard, spans: Iterable[tuple[int, int]] | None = None) -> str | None:
    """Return the problem of one file; None if it is as listed.

    Args:
        file: File about to be read.
        entry: Its listed size and digests.
        spans: Byte ranges [first, end) that will be read; None = all.
    """
    if (problem := _wrong_size(file, entry)) is not None:
        return problem
    piece = _piece_bytes(entry)
    numbers: Sequence[int] = range(len(entry.blake3))
    if spans is not None:
        numbers = sorted({n for a, b in spans for n in range(a // piece, _count(b, piece))} & set(numbers))
    [digests] = _digests([(file, piece, numbers)])
    return None if digests == [entry.blake3[number] for number in numbers] else "damaged"


def with_checksum(text: str) -> str:
    """Return an indented JSON object as text, with a checksum of its content as the last entry."""
    body = text.removesuffix("\n}\n")
    return body + _SEAL.format(blake3(body.encode()).hexdigest())


def is_damaged(text: str) -> bool:
    """Return whether a text written by `with_checksum` has changed; one without a checksum counts as unchanged."""
    body, mark, _ = text.rpartition(',\n "card_blake3"')
    if not mark:
        return _ENDS_AS_SEALED.search(text) is not None  # the name of the checksum itself was changed
    return with_checksum(f"{body}\n}}\n") != text


Stamp = tuple[int, int, int, int]


def stamp_of(file: Path) -> Stamp | None:
    """Return what changes if a file is replaced: device, inode, size and time; None if there is no file."""
    try:
        about = file.stat()
    except OSError:
        return None
    return about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns


@contextmanager
def reading(file: Path, again: Path) -> Iterator[None]:
    """Convert errors of polars and Arrow about an unreadable table into one message.

    Args:
        file: The table.
        again: The dataset to ingest again.
    """
    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        # Arrow raises a ValueError or an OSError; polars panics over a file that was replaced while it was read
        raise unreadable(file, again, str(error).strip().partition("\n")[0]) from error
    except ValueError as error:
        if type(error).__module__ != "pyarrow.lib":
            raise
        raise unreadable(file, again, str(error).strip().partition("\n")[0]) from error


def unreadable(file: Path, dataset: Path, why: str) -> DatasetError:
    """Return the error that names a changed file of a dataset, with the cure."""
    return DatasetError(f"{file}: {why}", cure=f"Ingest the logs again: cyclekit ingest LOGS --out {dataset}")


def _wrong_size(file: Path, entry: FileCard) -> str | None:
    try:
        size = file.stat().st_size
    except OSError:
        return "missing"
    return None if size == entry.size else f"damaged: {size} bytes of {entry.size}"


def _piece_bytes(entry: FileCard) -> int:
    return entry.piece_bytes or EARLIER_PIECE_BYTES


def _count(size: int, piece_bytes: int) -> int:
    return max(1, -(-size // piece_bytes))


def _digests(wanted: Iterable[tuple[Path, int, Sequence[int]]]) -> list[list[str]]:
    """Return the digests of pieces of files, each given with its piece size and the piece numbers, ascending.

    A piece that cannot be read has digest "".
    """
    every = list(wanted)
    parts = [
        (number, file, piece, numbers[begin : begin + _TAKEN])
        for number, (file, piece, numbers) in enumerate(every)
        for begin in range(0, len(numbers), _TAKEN)
    ]
    found: list[list[str]] = [[] for _ in every]
    with ThreadPoolExecutor(min(_AT_ONCE, os.cpu_count() or 1)) if len(parts) > 1 else nullcontext() as pool:
        made = map(_of_part, parts) if pool is None else pool.map(_of_part, parts)
        for (number, *_), digests in zip(parts, made, strict=True):
            found[number] += digests
    return found


def _of_part(part: tuple[int, Path, int, Sequence[int]]) -> list[str]:
    _, file, piece, numbers = part
    try:
        about = file.stat()
        identity = (about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns, piece)
        known = {number: _known.get((*identity, number)) for number in numbers}
        missing = [number for number, digest in known.items() if digest is None]
        found = dict(zip(missing, _hashed_pieces(file, piece, missing), strict=True)) if missing else {}
        if time.time_ns() - about.st_mtime_ns > _YOUNG_NS:
            if len(_known) + len(found) > _MAX_KNOWN:
                _known.clear()
            _known.update({(*identity, number): digest for number, digest in found.items()})
    except OSError:
        return [""] * len(numbers)
    return [known[number] or found[number] for number in numbers]


def _hashed_pieces(file: Path, piece: int, numbers: Iterable[int]) -> Iterator[str]:
    """Yield the digests of pieces of a file, with the file opened once."""
    with file.open("rb", buffering=0) as handle:
        view = memoryview(bytearray(min(piece, _STEP, os.fstat(handle.fileno()).st_size + 1)))
        for number in numbers:
            handle.seek(number * piece)
            yield _digest_from(handle, piece, view, None)


def _digest_from(handle: FileIO, count: int | None, view: memoryview, given_up: threading.Event | None) -> str:
    """Return the digest of the next `count` bytes of a file (None: of all), read through a buffer."""
    digest = blake3()
    while count is None or count > 0:
        read = handle.readinto(view if count is None else view[:count])
        if not read or (given_up is not None and given_up.is_set()):
            break  # otherwise an interrupt would wait for the rest of a large log
        digest.update(view[:read])
        count = None if count is None else count - read
    return digest.hexdigest()
