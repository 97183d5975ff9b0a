"""Unpack one compressed chunk, but never more than was announced, and never a bomb.

A chunk says how large it will be. Unpacking goes piece by piece and stops one byte after that, so a lying chunk costs
no more memory than an honest one, and what announces more than any logger writes is refused before it is unpacked.
"""

from __future__ import annotations

import bz2
import sys
from typing import Any

import numpy as np

from cyclekit_adapters.rosbag.payloads import Bytes, Damage

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

STORED = ("", "none")
"""What a chunk is called that is not compressed."""
MAX_BYTES = 1 << 30
"""No logger writes chunks of a gigabyte."""
_STEP = 4 << 20  # bytes unpacked at once
_SLICE = 1 << 20  # bytes handed over at once: lz4 copies at every step what it was given and has not read yet
MAX_RATIO = 1000
"""Messages of a robot do not compress a thousandfold; zeros do."""


def inflate(stored: bytes, compression: str, into: Bytes, *, whole: bool = True) -> tuple[int, bytes]:
    """Unpack a chunk piece by piece into an array of the size that the chunk announces.

    Returns how many bytes that are, and the last piece.

    Whoever unpacks many chunks should hold that piece until the next is there: if it is freed before, the memory goes
    back to the system and has to be asked for again, which takes as long as unpacking.

    Args:
        stored: The chunk as it is in the file.
        compression: `lz4` (frames), `zstd`, `bz2`.
        into: Where its bytes go, shape (announced size,).
        whole: False = the file ends within the chunk, and as much of it is unpacked as there is.

    Raises:
        Damage: It announces too much, holds less or more than it announces, cannot be unpacked, or is not cut.
    """
    if whole:
        check_size(len(stored), into.size)
    decompressor, filled, given, part = _decompressor(compression), 0, 0, b""
    while True:
        piece = stored[given : given + _SLICE] if decompressor.needs_input or not part else b""
        given += len(piece)
        try:
            part = decompressor.decompress(piece, max_length=min(_STEP, into.size - filled + 1))
        except Exception as error:  # each of the three libraries has errors of its own
            raise Damage(f"it cannot be unpacked ({compression}: {str(error)[:60]})") from error
        if filled + len(part) > into.size and whole:
            raise Damage(f"it holds more than the {into.size} bytes it announces")
        part = part[: into.size - filled]
        into[filled : filled + len(part)] = np.frombuffer(part, np.uint8)
        filled += len(part)
        if decompressor.eof or (given == len(stored) and (decompressor.needs_input or not part)):
            break
    if decompressor.eof and not whole:
        raise Damage("it ends before the file does, so it is not cut: its length is wrong")
    if filled < into.size and whole:
        raise Damage(f"it holds less than the {into.size} bytes it announces")
    return filled, bytes(part)


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
    raise Damage(f"its compression {compression!r} is not supported")
