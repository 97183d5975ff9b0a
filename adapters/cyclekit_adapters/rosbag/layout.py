"""Positions of all numbers in a message, and bulk reading of them from many messages.

In CDR (XCDR1) and in ROS 1, the position of a field depends only on the definition and on the length words (of texts
and sequences) before it. So one message is traced field by field. Another message of the same size with the same length
words has the same layout, by induction over its fields. If its texts are also equal, only its numbers can differ. These
are read as one strided view over the whole group.

`tracks` interprets the numbers; messages that cannot be traced are decoded by the rosbags library, one by one.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Nodetype

from cyclekit_adapters.rosbag.definitions import Types
from cyclekit_adapters.rosbag.msg_text import EMPTY_FIELD, Description
from cyclekit_adapters.rosbag.payloads import Bytes

Path = tuple[str | int, ...]
Numbers = npt.NDArray[Any]

# As in the library: a byte is signed, a char is not.
_DTYPES = {
    "bool": "?",
    "byte": "i1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_LETTERS = {"?": "?", "i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q"}
_LETTERS |= {"f4": "f", "f8": "d"}
_MAX_STEPS = 20_000  # no robot or tracker writes a message with more fields
_CDR_HEAD = 4
_PADDING = 3  # maximum number of bytes between a text and the next length word
_SLAB = 1024  # rows compared at once, so that they stay in the processor's cache


class NoLayout(ValueError):
    """The message cannot be traced: cut, of unknown type, or too large."""


@dataclass(frozen=True)
class Leaf:
    """Position of one number or one array of numbers: offset in bytes, dtype, count (None for a single number)."""

    offset: int
    dtype: str
    count: int | None


@dataclass
class MessageLayout:
    """Positions of all numbers in messages of one layout.

    Attributes:
        size: Number of bytes of such a message.
        leaves: Positions by path of the field, as ("pose", "position", "x") or ("poses", 0, "position", "x").
        fixed: Byte ranges (begin, end) that are equal in all messages of this layout: the header with the CDR kind,
            length words, texts.
    """

    size: int
    leaves: dict[Path, Leaf] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)

    def alike(self, block: Bytes) -> npt.NDArray[np.bool_]:
        """Return a mask of the rows of `block`, shape (N, size), with the layout of its first row; shape (N,)."""
        for begin, end in _spans(self.fixed):  # with padding, which most writers set to zero
            for row in range(0, len(block), _SLAB):
                same = block[row : row + _SLAB, begin:end] == block[0, begin:end]
                if not same.all():
                    return self._alike_but_for_padding(block)
        return np.ones(len(block), bool)

    def _alike_but_for_padding(self, block: Bytes) -> npt.NDArray[np.bool_]:
        places = np.concatenate([np.arange(*part) for part in self.fixed])
        alike: npt.NDArray[np.bool_] = (block[:, places] == block[0, places]).all(1)
        return alike

    def read(self, block: Bytes, path: Path) -> Numbers:
        """Return one field of all rows, shape (N,) or (N, count), in native byte order.

        Raises:
            KeyError: These messages have no number of this name.
        """
        leaf = self.leaves[path]
        dtype = np.dtype(leaf.dtype)
        count = 1 if leaf.count is None else leaf.count
        if not count:
            return np.zeros((len(block), 0), dtype.newbyteorder("="))
        raw = block[:, leaf.offset : leaf.offset + count * dtype.itemsize]
        values = (raw != 0) if dtype.kind == "b" else raw.view(dtype).astype(dtype.newbyteorder("="))
        return values[:, 0] if leaf.count is None else values


def _spans(fixed: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join ranges separated only by padding."""
    spans: list[tuple[int, int]] = []
    for begin, end in fixed:
        if spans and begin - spans[-1][1] <= _PADDING:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    return spans


class TooMany(ValueError):
    """The message has too many fields to be of use."""


def trace(types: Types, kind: str, raw: bytes, *, cdr: bool) -> tuple[MessageLayout, SimpleNamespace]:
    """Trace one message; return the positions of its numbers, and its content.

    Args:
        types: Type definitions.
        kind: Type of the message.
        raw: The message.
        cdr: True for CDR with its 4-byte header, False for ROS 1.

    Raises:
        NoLayout: The message cannot be traced.
        TooMany: It has too many fields.
        NoDefinition: Its type has no usable definition.
    """
    types.check(kind)
    walk = _Walk(types, raw, cdr=cdr)
    try:
        content = walk.message(kind, ())
    except UnicodeDecodeError as error:
        raise NoLayout("a text is not UTF-8") from error
    if len(raw) - walk.position > (3 if cdr else 0):
        raise NoLayout("the message is not as long as its definition says")
    return walk.layout, content


class _Walk:
    def __init__(self, types: Types, raw: bytes, *, cdr: bool) -> None:
        self.types, self.raw, self.cdr = types, raw, cdr
        self.layout = MessageLayout(len(raw))
        self.base = self.position = _CDR_HEAD if cdr else 0
        self.order = "<"
        self.steps = 0
        if cdr:
            if len(raw) < _CDR_HEAD or raw[0] != 0 or raw[1] > 1:
                raise NoLayout("not the CDR that ROS 2 writes")
            self.order = "<" if raw[1] else ">"
            self.layout.fixed.append((0, 2))

    def message(self, kind: str, path: Path) -> SimpleNamespace:
        content = SimpleNamespace()
        for name, description in self.types.fields[kind]:
            if self.cdr or name != EMPTY_FIELD:
                setattr(content, name, self.field(description, (*path, name)))
        return content

    def field(self, description: Description, path: Path) -> Any:  # noqa: ANN401 - a field is what its type says
        self.steps += 1
        if self.steps > _MAX_STEPS:
            raise TooMany(f"more than {_MAX_STEPS} fields")
        kind, what = description
        if kind == Nodetype.NAME:
            return self.message(what, path)
        if kind == Nodetype.BASE:
            return self.text() if what[0] == "string" else self.number(what[0], path)
        item, count = what
        return self.many(item, count if kind == Nodetype.ARRAY else self.length(), path)

    def many(self, item: Description, count: int, path: Path) -> Any:  # noqa: ANN401
        if item[0] == Nodetype.BASE and item[1][0] != "string":
            return self.numbers(item[1][0], count, path)
        if count > len(self.raw):
            raise NoLayout("the message is cut")
        if self.steps + count > _MAX_STEPS:
            raise TooMany(f"more than {_MAX_STEPS} fields")
        return [self.field(item, (*path, number)) for number in range(count)]

    def number(self, name: str, path: Path) -> Any:  # noqa: ANN401
        dtype = self.leaf(name, None, path)
        return struct.unpack_from(self.order + _LETTERS[dtype], self.raw, self.layout.leaves[path].offset)[0]

    def numbers(self, name: str, count: int, path: Path) -> Numbers:
        dtype = np.dtype(self.order + self.leaf(name, count, path))
        values = np.frombuffer(self.raw, dtype, count, self.layout.leaves[path].offset if count else 0)
        return values.astype(dtype.newbyteorder("="))

    def leaf(self, name: str, count: int | None, path: Path) -> str:
        if name not in _DTYPES:
            raise NoLayout(f"numbers of type {name}")
        dtype = _DTYPES[name]
        width = 1 if dtype == "?" else int(dtype[1:])
        if count != 0:  # an empty sequence adds no padding
            self.align(width)
        self.layout.leaves[path] = Leaf(self.position, self.order + dtype, count)
        self.forward(width * (1 if count is None else count))
        return dtype

    def text(self) -> str:
        size = self.length()
        begin = self.position
        self.skip_fixed(size)
        if not self.cdr:
            return self.raw[begin : begin + size].decode()
        if not size or self.raw[begin + size - 1]:
            raise NoLayout("a text without its end")
        return self.raw[begin : begin + size - 1].decode()

    def length(self) -> int:
        self.align(4)
        begin = self.position
        self.skip_fixed(4)
        return int.from_bytes(self.raw[begin : begin + 4], "little" if self.order == "<" else "big")

    def skip_fixed(self, size: int) -> None:
        begin = self.position
        self.forward(size)
        self.layout.fixed.append((begin, self.position))

    def align(self, width: int) -> None:
        if self.cdr and width > 1:
            self.position += -(self.position - self.base) % width

    def forward(self, size: int) -> None:
        self.position += size
        if self.position > len(self.raw):
            raise NoLayout("the message is cut")
