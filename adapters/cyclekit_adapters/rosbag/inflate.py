"""Unpack one compressed chunk, but never more than was announced, and never a bomb.

A chunk says how large it will be. The decompressors here are stopped one byte after that, so a lying chunk costs no
more memory than an honest one, and what announces more than any logger writes is refused before it is unpacked.
"""

from __future__ import annotations

import bz2
import sys
from typing import Any

from cyclekit_adapters.rosbag.payloads import Damage

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAX_BYTES = 1 << 30
"""No logger writes chunks of a gigabyte."""
MAX_RATIO = 1000
"""Messages of a robot do not compress a thousandfold; zeros do."""


def inflate(stored: bytes, compression: str, size: int) -> bytes:
    """Return the `size` bytes that a chunk holds.

    Args:
        stored: The chunk as it is in the file.
        compression: Empty or `none`, `lz4` (frames), `zstd`, `bz2`.
        size: Bytes that the chunk says it holds.

    Raises:
        Damage: It announces too much, holds less or more than it announces, or cannot be unpacked.
    """
    if compression in ("", "none"):
        unpacked = stored
    else:
        check_size(len(stored), size)
        try:
            unpacked = _decompressor(compression).decompress(stored, max_length=size + 1)
        except Damage:
            raise
        except Exception as error:  # each of the three libraries has errors of its own
            raise Damage(f"it cannot be unpacked ({compression}: {str(error)[:60]})") from error
    if len(unpacked) != size:
        than = "more" if len(unpacked) > size else "less"
        raise Damage(f"it holds {than} than the {size} bytes it announces")
    return unpacked


def check_size(stored: int, size: int) -> None:
    """Raise Damage for a chunk of `stored` bytes that announces a `size` no logger writes."""
    if size > MAX_BYTES or size > stored * MAX_RATIO:
        raise Damage(f"it announces {size} bytes in {stored}: more than any logger writes, so it is not unpacked")


def _decompressor(compression: str) -> Any:  # noqa: ANN401 - three libraries without a common type
    if compression == "zstd":
        return zstd.ZstdDecompressor()
    if compression == "bz2":
        return bz2.BZ2Decompressor()
    if compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]  # it publishes no types

        return lz4.frame.LZ4FrameDecompressor()
    raise Damage(f"it is compressed by {compression!r}, which is not read")
