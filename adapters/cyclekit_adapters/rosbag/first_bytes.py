"""Detection of bags by the first bytes of a file.

Called for every file, so this module imports nothing that reads a bag.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

MCAP = b"\x89MCAP0\r\n"
ROS1 = b"#ROSBAG V"
SQLITE = b"SQLite format 3\0"


def is_bag(path: Path) -> bool:
    """Return whether `path` is a bag, by its first bytes; for a folder, by its metadata.yaml."""
    if path.is_dir():
        return b"rosbag2_bagfile_information" in head(path / "metadata.yaml", 4096)
    first = head(path, 65536)
    return first.startswith((ROS1, MCAP)) or (first.startswith(SQLITE) and b"serialization_format" in first)


def head(path: Path, size: int) -> bytes:
    """Return the first `size` bytes of a file; empty if it cannot be read."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as log:
            return log.read(size)
    except OSError:
        return b""
