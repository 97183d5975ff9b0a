"""What bombs are made of. Large ones are sparse or made of one block, so that they cost the disk little."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Callable
from pathlib import Path

from reliability.clean_logs import KINDS

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Maker = Callable[[Path], Path]
BOMBS: dict[str, Maker] = {}
SLOW: set[str] = set()
"""Those that take tens of seconds, for the benchmark."""
GIB = 1 << 30
UR = KINDS[1].text()
UR_HEADER, _, _ = UR.partition("\r\n")
CSV_CELL = """
[[sources]]
path = "{name}"
adapter = "csv"
role = "{role}"
map = {{ {map} }}
"""


def bomb(name: str, *, slow: bool = False) -> Callable[[Maker], Maker]:
    """Register a maker."""

    def keep(maker: Maker) -> Maker:
        BOMBS[name] = maker
        if slow:
            SLOW.add(name)
        return maker

    return keep


def put(folder: Path, name: str, data: bytes) -> Path:
    """Write a file below a folder; return its path."""
    (folder / name).write_bytes(data)
    return folder / name


def sparse(path: Path, size: int, head: bytes = b"") -> Path:
    """Write a file of `size` bytes: a head, and zeros that cost the disk nothing."""
    with path.open("wb") as file:
        file.write(head)
        file.truncate(size)
    return path


def repeated(path: Path, block: bytes, times: int, head: bytes = b"", tail: bytes = b"") -> Path:
    """Write a file of one block again and again, between a head and a tail."""
    with path.open("wb") as file:
        file.write(head)
        for _ in range(times):
            file.write(block)
        file.write(tail)
    return path


def zstd_of(head: bytes, block: bytes, times: int) -> bytes:
    """Return a head and a block again and again, packed by zstd."""
    pack = zstd.ZstdCompressor(level=3)
    return b"".join([pack.compress(head), *(pack.compress(block) for _ in range(times)), pack.flush()])


def gzip_of(head: bytes, block: bytes, times: int) -> bytes:
    """Return a head and a block again and again, packed by gzip."""
    pack = zlib.compressobj(1, zlib.DEFLATED, 31)
    return b"".join([pack.compress(head), *(pack.compress(block) for _ in range(times)), pack.flush()])


def with_a_log(folder: Path) -> Path:
    """Put a sound log in a folder as well; return the folder."""
    put(folder, "run.csv", UR.encode())
    return folder
