"""Detection of bags by the first bytes of a file.

Called for every file, so this module imports nothing that reads a bag.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

MCAP = b"\x89MCAP0\r\n"
ROS1 = b"#ROSBAG V"
SQLITE = b"SQLite format 3\0"
ZSTD = b"\x28\xb5\x2f\xfd"
_SEARCHED = 65536


def is_bag(path: Path) -> bool:
    """Return whether `path` is a bag, by its first bytes; for a folder, by its metadata.yaml."""
    if path.is_dir():
        return b"rosbag2_bagfile_information" in head(path / "metadata.yaml", 4096)
    first = head(path, _SEARCHED)
    if first.startswith(ZSTD):
        first = _unpacked(first)
    return first.startswith((ROS1, MCAP)) or (first.startswith(SQLITE) and b"serialization_format" in first)


def _unpacked(first: bytes) -> bytes:
    """Return the first bytes of a compressed file as they were before; empty if it is damaged."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    try:
        return bytes(zstd.ZstdDecompressor().decompress(first, max_length=_SEARCHED))
    except zstd.ZstdError:
        return b""


def head(path: Path, size: int) -> bytes:
    """Return the first `size` bytes of a file; empty if it cannot be read."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as log:
            return log.read(size)
    except OSError:
        return b""
