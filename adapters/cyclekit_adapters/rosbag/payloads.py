"""Messages in bulk: topic, receive time and bytes, many in one buffer.

Every container provides its channels (a topic, its message type and the recorded definition) and blocks of undecoded
messages. The sibling modules handle the container formats.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int64]

BLOCK_BYTES = 8 << 20
"""Approximate amount of a bag in memory at once, bytes; larger blocks exceed the cache and are slower."""


@dataclass(frozen=True)
class Channel:
    """One source of one topic.

    Attributes:
        number: Number within its file.
        topic: Topic.
        kind: Message type as `package/msg/Type`, in ROS 1 bags too.
        definition: Text of the recorded definition; empty if none.
        notation: `msg` or `idl`, the language of the definition.
        coding: `cdr` or `ros1`; messages of other encodings cannot be decoded.
        digest: Hash of the definition; empty if none was recorded.
    """

    number: int
    topic: str
    kind: str
    definition: str = ""
    notation: str = "msg"
    coding: str = "cdr"
    digest: str = ""


@dataclass(frozen=True)
class Payloads:
    """N messages of one channel in one buffer: first byte, number of bytes and receive time (ns), each shape (N,)."""

    buffer: Bytes
    start: Ints
    size: Ints
    receive_ns: Ints

    def one(self, row: int) -> bytes:
        """Return the bytes of one message."""
        begin = int(self.start[row])
        return self.buffer[begin : begin + int(self.size[row])].tobytes()

    def block(self, rows: Ints) -> Bytes:
        """Return the bytes of messages of equal size, shape (rows, size)."""
        return gather(self.buffer, self.start[rows], int(self.size[rows[0]]))


class BagFile(Protocol):
    """One file of a recording, surveyed and ready to be read.

    Attributes:
        path: Path of the file.
        channels: Channels by number.
        counts: Messages by channel number; a lower bound if an exact count would need a full read; no entry means none.
        warnings: Damage, one sentence each.
        set_aside: Reason for every unusable part; complete once all blocks were read.
    """

    path: Path
    channels: dict[int, Channel]
    counts: dict[int, int]
    warnings: list[str]
    set_aside: list[str]

    def blocks(self, wanted: set[int]) -> Iterator[Mapping[int, Payloads]]:
        """Yield the messages of the wanted channels in file order, about BLOCK_BYTES at a time.

        The payloads of a block are valid until the next one is requested, because their memory is reused.
        """
        ...


@dataclass
class Damage(Exception):
    """A part of a file cannot be used."""

    reason: str = field(default="")

    def __str__(self) -> str:
        return self.reason


def gather(buffer: Bytes, start: Ints, width: int) -> Bytes:
    """Return `width` bytes from each start, shape (N, width); all of them must lie within the buffer."""
    if not start.size or not width:
        return np.zeros((start.size, width), np.uint8)
    places = np.ndarray((buffer.size - width + 1,), f"V{width}", buffer, strides=(1,))  # one at each byte
    return places[start].view(np.uint8).reshape(start.size, width)


def column(rows: Bytes, offset: int, dtype: str) -> Ints:
    """Return the integer at `offset` of each row, shape (N,)."""
    width = np.dtype(dtype).itemsize
    return rows[:, offset : offset + width].copy().view(dtype)[:, 0].astype(np.int64)


def distinct(values: Ints) -> Ints:
    """Return the distinct values, ascending; `numpy.unique` would import more of numpy."""
    if not values.size or (values == values[0]).all():
        return values[:1]
    ordered = np.sort(values)
    different: Ints = ordered[np.append(True, ordered[1:] != ordered[:-1])]
    return different
