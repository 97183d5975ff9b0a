"""Where each number of a message stands, and reading it out of many messages at once.

In CDR (XCDR1) and in ROS 1 the place of every field depends on the definition and on the length words (of texts and
sequences) before it, and on nothing else. So one message is traced, field by field. Another message of the same size
with the same length words has the same layout, by induction over its fields; if its texts are the same too, then its
numbers are all that can differ. Those are read as one strided view over the whole group.

What the numbers mean is the business of `tracks`; what cannot be traced is left to the rosbags library, one by one.
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
from cyclekit_adapters.rosbag.msg_text import FILLER, Description
from cyclekit_adapters.rosbag.payloads import Bytes

Path = tuple[str | int, ...]
Numbers = npt.NDArray[Any]

# As the library unpacks them: a byte is signed, a char is not.
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
_MAX_STEPS = 20_000  # a message of more fields than this was not written by a robot or a tracker
_CDR_HEAD = 4
_PADDING = 3  # bytes at most between a text and the length word after it
_SLAB = 1024  # rows compared at once: what is compared then stays in the processor's cache


class NoLayout(ValueError):
    """The message cannot be traced: cut, of an unknown kind, or too large."""


@dataclass(frozen=True)
class Leaf:
    """Where one number, or one array of numbers, stands: offset in bytes, dtype, count (None for a single one)."""

    offset: int
    dtype: str
    count: int | None


@dataclass
class MessageLayout:
    """The places of all numbers in messages of one form.

    Attributes:
        size: Bytes of such a message.
        leaves: By the path of the field, as ("pose", "position", "x") or ("poses", 0, "position", "x").
        fixed: Ranges of bytes (begin, end) that are the same in all messages of this form: the head that says which
            CDR it is, length words, texts.
    """

    size: int
    leaves: dict[Path, Leaf] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)

    def alike(self, block: Bytes) -> npt.NDArray[np.bool_]:
        """Tell which rows of `block`, shape (N, size), have the form of its first row; shape (N,)."""
        for begin, end in _spans(self.fixed):  # padding included, which most writers leave as zeros
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
        """Return one field of all rows, shape (N,) or (N, count), in the machine's byte order.

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
    """Join ranges with nothing but padding between them."""
    spans: list[tuple[int, int]] = []
    for begin, end in fixed:
        if spans and begin - spans[-1][1] <= _PADDING:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    return spans


class TooMany(ValueError):
    """The message has more fields than any that is of use here."""


def trace(types: Types, kind: str, raw: bytes, *, cdr: bool) -> tuple[MessageLayout, SimpleNamespace]:
    """Walk through one message; return where its numbers stand, and what it says.

    Args:
        types: The definitions in force.
        kind: Type of the message.
        raw: The message.
        cdr: CDR with its head of four bytes, else ROS 1.

    Raises:
        NoLayout: It cannot be traced.
        TooMany: It has too many fields.
        NoDefinition: Its type is not defined, or in a way that no message has.
    """
    types.check(kind)
    walk = _Walk(types, raw, cdr=cdr)
    try:
        said = walk.message(kind, ())
    except UnicodeDecodeError as error:
        raise NoLayout("a text is not UTF-8") from error
    if len(raw) - walk.position > (3 if cdr else 0):
        raise NoLayout("the message is not as long as its definition says")
    return walk.layout, said


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
        said = SimpleNamespace()
        for name, description in self.types.fields[kind]:
            if self.cdr or name != FILLER:
                setattr(said, name, self.field(description, (*path, name)))
        return said

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
