"""Messages in bulk: which topic they belong to, when they came, and their bytes, many in one buffer.

Every container hands out the same two things: its channels (a topic, its message type and the definition recorded
with it) and blocks of undecoded messages. How a container is laid out is the business of the files beside this one.
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
"""About as much of a bag as is held in memory at once; larger blocks do not fit the cache and are slower."""


@dataclass(frozen=True)
class Channel:
    """One source of one topic.

    Attributes:
        number: Its number within its file.
        topic: Topic.
        kind: Message type as `package/msg/Type`, in ROS 1 bags too.
        definition: Text of the definition recorded with it, empty where none was.
        notation: `msg` or `idl`, the language of the definition.
        coding: `cdr` or `ros1`; messages of another one cannot be decoded.
        digest: Hash of the definition, empty where none was recorded.
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
        """Return the bytes of messages that all have the same size, shape (rows, size)."""
        return gather(self.buffer, self.start[rows], int(self.size[rows[0]]))


class BagFile(Protocol):
    """One file of a recording, looked through and ready to be read.

    Attributes:
        path: Where it is.
        channels: By their number.
        counts: Messages by channel number, or some of them where counting all would mean reading all; absent is none.
        warnings: What is damaged, one sentence each.
        set_aside: The reason for every part that cannot be used; complete once all blocks were read.
    """

    path: Path
    channels: dict[int, Channel]
    counts: dict[int, int]
    warnings: list[str]
    set_aside: list[str]

    def blocks(self, wanted: set[int]) -> Iterator[Mapping[int, Payloads]]:
        """Yield the messages of the wanted channels in the order of the file, about BLOCK_BYTES at a time.

        The payloads of a block hold until the next one is asked for: their memory is used again.
        """
        ...


@dataclass
class Damage(Exception):
    """A part of a file cannot be used."""

    reason: str = field(default="")

    def __str__(self) -> str:
        return self.reason


def gather(buffer: Bytes, start: Ints, width: int) -> Bytes:
    """Return `width` bytes from each start, shape (N, width); the starts must leave room for them."""
    if not start.size or not width:
        return np.zeros((start.size, width), np.uint8)
    places = np.ndarray((buffer.size - width + 1,), f"V{width}", buffer, strides=(1,))  # one at every byte
    return places[start].view(np.uint8).reshape(start.size, width)


def column(rows: Bytes, offset: int, dtype: str) -> Ints:
    """Return the integer at `offset` of each row, shape (N,)."""
    width = np.dtype(dtype).itemsize
    return rows[:, offset : offset + width].copy().view(dtype)[:, 0].astype(np.int64)


def distinct(values: Ints) -> Ints:
    """Return the different values, ascending; `numpy.unique` would import a part of numpy that nothing here needs."""
    if not values.size or (values == values[0]).all():
        return values[:1]
    ordered = np.sort(values)
    different: Ints = ordered[np.append(True, ordered[1:] != ordered[:-1])]
    return different
