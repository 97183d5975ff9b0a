"""Decompression of chunks, messages and files, limited in size as a protection against decompression bombs.

A chunk declares its decompressed size. Decompression goes piece by piece and stops one byte after that size, so a wrong
declaration costs no more memory. A chunk that declares more than any logger writes is refused before decompression.
"""

from __future__ import annotations

import bz2
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit_adapters.rosbag.first_bytes import ZSTD
from cyclekit_adapters.rosbag.payloads import Bytes, Damage, Payloads, gather

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

if TYPE_CHECKING:
    from pathlib import Path

STORED = ("", "none")
"""Names for "not compressed"."""
MAX_BYTES = 1 << 30
"""Maximum size of a chunk, bytes: no logger writes a gigabyte."""
_STEP = 4 << 20  # bytes decompressed at once
_SLICE = 1 << 20  # bytes handed over at once: lz4 copies its unread input at every step
MAX_RATIO = 1000
"""Maximum compression ratio: only zeros reach a thousand, not messages of a robot."""


def inflate(stored: bytes, compression: str, into: Bytes, *, whole: bool = True) -> tuple[int, bytes]:
    """Decompress a chunk piece by piece into an array of its declared size.

    Returns the number of bytes and the last piece. A caller that decompresses many chunks should keep that piece until
    the next one exists. Otherwise its memory goes back to the system and is requested again, which takes as long as
    decompression.

    Args:
        stored: The chunk as stored in the file.
        compression: `lz4` (frames), `zstd`, `bz2`.
        into: Output, shape (declared size,).
        whole: False = the file ends within the chunk; decompress what exists.

    Raises:
        Damage: The declared size is implausible or wrong, the chunk cannot be decompressed, or it is not cut.
    """
    if whole:
        check_size(len(stored), into.size)
    decompressor, filled, given, part = _decompressor(compression), 0, 0, b""
    while True:
        piece = stored[given : given + _SLICE] if decompressor.needs_input or not part else b""
        given += len(piece)
        try:
            part = decompressor.decompress(piece, max_length=min(_STEP, into.size - filled + 1))
        except Exception as error:  # each of the three libraries has its own errors
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


def unpacked(payloads: Payloads) -> Payloads:
    """Return messages with those decompressed that rosbag2 compressed one by one; no message begins like such a one."""
    first = gather(payloads.buffer, payloads.start[payloads.size >= len(ZSTD)][:1], len(ZSTD))
    if first.tobytes() != ZSTD:
        return payloads
    messages = [_message(payloads.one(row)) for row in range(payloads.size.size)]
    size = np.fromiter(map(len, messages), np.int64, len(messages))
    buffer = np.frombuffer(b"".join(messages), np.uint8)
    return Payloads(buffer, np.cumsum(size) - size, size, payloads.receive_ns)


def _message(stored: bytes) -> bytes:
    """Return a message decompressed; as stored if it is damaged, which the decoder then says of it."""
    if not stored.startswith(ZSTD):
        return stored
    try:
        return bytes(zstd.ZstdDecompressor().decompress(stored, max_length=MAX_RATIO * len(stored)))
    except zstd.ZstdError:
        return stored


def unpack_file(path: Path, into: Path) -> None:
    """Write the content of a file that is compressed as a whole.

    Raises:
        Damage: It cannot be decompressed, to more than any recorder writes, or is compressed twice.
    """
    size, most = 0, MAX_RATIO * path.stat().st_size
    try:
        with zstd.ZstdFile(path) as stored, into.open("wb") as file:
            while piece := stored.read(_STEP):
                if not size and piece.startswith(ZSTD):
                    raise Damage("it is compressed twice")
                size += file.write(piece)
                if size > most:
                    raise Damage(f"it unpacks to more than {MAX_RATIO} times its size: it is not a bag")
    except (zstd.ZstdError, EOFError) as error:
        raise Damage(f"it cannot be unpacked (zstd: {str(error)[:60]})") from error


def check_size(stored: int, size: int) -> None:
    """Raise Damage for a chunk of `stored` bytes that declares an implausible `size`."""
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
