"""Checksums of files by BLAKE3: which file of a folder differs from what was written.

A file is hashed in pieces of `PIECE_BYTES`, so that who reads a part of a large one checks that part. What was hashed
once is not hashed again while the file has its size and time, under whatever name; only a file that has just been
written is, since a change might not show in its time.
"""

from __future__ import annotations

import os
import re
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import polars as pl
from blake3 import blake3

from cyclekit.errors import DatasetError

if TYPE_CHECKING:
    import threading
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

PIECE_BYTES = 16 << 20
_STEP = 1 << 20
_YOUNG_NS = 2_000_000_000
_AT_ONCE = 4
_SEAL = ',\n "card_blake3": "{}"\n}}\n'
_ENDS_AS_SEALED = re.compile(r',\n "[^"\n]*": "[0-9a-f]{64}"\n}\n\Z')

_known: dict[tuple[int, ...], str] = {}
"""Digest by device, number, size and time of a file, and piece."""


def digest_of(file: Path, given_up: threading.Event | None = None) -> str:
    """Return the BLAKE3 of a whole file, 64 hexadecimal digits, as `b3sum` prints it.

    Args:
        file: What is hashed.
        given_up: When it is set, the rest is left out.

    Raises:
        OSError: It cannot be read.
    """
    return _hashed(file, 0, None, given_up)


def listed(folder: Path) -> dict[str, dict[str, Any]]:
    """Return size and digests of every file of a folder, by its name in there.

    Raises:
        OSError: A file cannot be read.
    """
    files = {file.relative_to(folder).as_posix(): file for file in sorted(folder.rglob("*")) if file.is_file()}
    sizes = {name: file.stat().st_size for name, file in files.items()}
    todo = [(name, number) for name, size in sizes.items() for number in range(_count(size))]
    found: dict[str, dict[str, Any]] = {name: {"size": size, "blake3": []} for name, size in sizes.items()}
    for (name, _), digest in zip(todo, _digests([(files[name], n) for name, n in todo]), strict=True):
        found[name]["blake3"].append(digest)
    return found


def changes(folder: Path, files: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return the files that differ from the list: by name, the fault."""
    wrong: dict[str, str] = {}
    todo: list[tuple[str, int]] = []
    for name, entry in files.items():
        if (problem := _wrong_size(folder / name, entry)) is not None:
            wrong[name] = problem
        else:
            todo += [(name, number) for number in range(len(entry["blake3"]))]
    for (name, number), digest in zip(todo, _digests([(folder / name, n) for name, n in todo]), strict=True):
        if digest != files[name]["blake3"][number]:
            wrong.setdefault(name, "damaged")
    return wrong


def change(file: Path, entry: Mapping[str, Any], spans: Iterable[tuple[int, int]] | None = None) -> str | None:
    """Return the fault of one file, None if it matches the list.

    Args:
        file: What is about to be read.
        entry: Its size and digests.
        spans: Bytes that will be read, from and to before; None = all.
    """
    if (problem := _wrong_size(file, entry)) is not None:
        return problem
    numbers: Sequence[int] = range(len(entry["blake3"]))
    if spans is not None:
        numbers = sorted({n for a, b in spans for n in range(a // PIECE_BYTES, _count(b))} & set(numbers))
    same = all(d == entry["blake3"][n] for n, d in zip(numbers, _digests([(file, n) for n in numbers]), strict=True))
    return None if same else "damaged"


def sealed(text: str) -> str:
    """Return an indented JSON object as text with the checksum of all that stands in it as its last entry."""
    body = text.removesuffix("\n}\n")
    return body + _SEAL.format(blake3(body.encode()).hexdigest())


def is_broken(text: str) -> bool:
    """Tell whether a text that `sealed` wrote is another now; one without a checksum counts as whole."""
    body, mark, _ = text.rpartition(',\n "card_blake3"')
    if not mark:
        return _ENDS_AS_SEALED.search(text) is not None  # the name of the checksum itself is another now
    return sealed(f"{body}\n}}\n") != text


@contextmanager
def reading(file: Path, again: Path) -> Iterator[None]:
    """Turn what polars and Arrow raise over a table that they cannot read into one message.

    Args:
        file: The table.
        again: The dataset, to be made again.
    """
    try:
        yield
    except (pl.exceptions.PolarsError, OSError) as error:  # Arrow's own is a ValueError or an OSError
        raise unreadable(file, again, str(error).strip().partition("\n")[0]) from error
    except ValueError as error:
        if type(error).__module__ != "pyarrow.lib":
            raise
        raise unreadable(file, again, str(error).strip().partition("\n")[0]) from error


def unreadable(file: Path, dataset: Path, why: str) -> DatasetError:
    """Return the error that says which file of a dataset is not what it should be, and the cure."""
    return DatasetError(f"{file}: {why}", cure=f"Ingest the logs again: cyclekit ingest LOGS --out {dataset}")


def _wrong_size(file: Path, entry: Mapping[str, Any]) -> str | None:
    try:
        size = file.stat().st_size
    except OSError:
        return "missing"
    return None if size == entry["size"] else f"damaged: {size} bytes of {entry['size']}"


def _count(size: int) -> int:
    return max(1, -(-size // PIECE_BYTES))


def _digests(pieces: Sequence[tuple[Path, int]]) -> list[str]:
    """Return the digests of pieces; "" for one that cannot be read."""
    if len(pieces) < 2:
        return [_digest(*piece) for piece in pieces]
    with ThreadPoolExecutor(min(_AT_ONCE, os.cpu_count() or 1)) as pool:
        return list(pool.map(lambda piece: _digest(*piece), pieces))


def _digest(file: Path, number: int) -> str:
    try:
        about = file.stat()
        key = (about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns, number)
        found = _known.get(key) or _hashed(file, number * PIECE_BYTES, PIECE_BYTES)
        if time.time_ns() - about.st_mtime_ns > _YOUNG_NS:
            _known[key] = found
    except OSError:
        return ""
    return found


def _hashed(file: Path, begin: int, count: int | None, given_up: threading.Event | None = None) -> str:
    digest, view = blake3(), memoryview(bytearray(_STEP))
    with file.open("rb", buffering=0) as handle:
        handle.seek(begin)
        while count is None or count > 0:
            read = handle.readinto(view if count is None else view[:count])
            if not read or (given_up is not None and given_up.is_set()):
                break  # else who interrupts the reading of a large log would wait for the rest of this
            digest.update(view[:read])
            count = None if count is None else count - read
    return digest.hexdigest()
