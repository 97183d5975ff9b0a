"""Where each number of a message stands, and reading it out of many messages at once.

In CDR (XCDR1) and in ROS 1 the place of every field depends on the definition and on the length words (of texts and
sequences) before it, and on nothing else. So one message is traced, field by field. Another message of the same size
with the same length words has the same layout, by induction over its fields; if its texts are the same too, then its
numbers are all that can differ. Those are read as one strided view over the whole group.

What the numbers mean is the business of `tracks`; what does not fit in here is decoded by rosbags, one by one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

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
_MAX_FIELDS = 20_000  # a message of more numbers than this gains nothing from a layout
_FILLER = "structure_needs_at_least_one_member"  # in CDR an empty message holds one byte, in ROS 1 none
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
class Layout:
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


def trace(types: Typestore, kind: str, raw: bytes, *, cdr: bool) -> Layout:
    """Walk through one message and note where its numbers stand.

    Args:
        types: The definitions in force.
        kind: Type of the message.
        raw: The message; it should be one that the library can decode.
        cdr: CDR with its head of four bytes, else ROS 1.

    Raises:
        NoLayout: It cannot be traced.
    """
    try:
        walk = _Walk(types, raw, cdr=cdr)
        walk.message(kind, ())
    except (KeyError, RecursionError) as error:
        raise NoLayout(f"no definition of {error}") from error
    spare = len(raw) - walk.position
    if spare < 0 or spare > (3 if cdr else 0):
        raise NoLayout("the message is not as long as its definition says")
    return walk.layout


class _Walk:
    def __init__(self, types: Typestore, raw: bytes, *, cdr: bool) -> None:
        self.types, self.raw, self.cdr = types, raw, cdr
        self.layout = Layout(len(raw))
        self.base = self.position = _CDR_HEAD if cdr else 0
        self.order = "<"
        if cdr:
            if len(raw) < _CDR_HEAD or raw[0] != 0 or raw[1] > 1:
                raise NoLayout("not the CDR that ROS 2 writes")
            self.order = "<" if raw[1] else ">"
            self.layout.fixed.append((0, 2))

    def message(self, kind: str, path: Path) -> None:
        for name, description in self.types.get_msgdef(kind).fields:
            if self.cdr or name != _FILLER:
                self.field(description, (*path, name))

    def field(self, description: Any, path: Path) -> None:  # noqa: ANN401 - nested tuples of four kinds
        kind, what = description
        if kind == Nodetype.NAME:
            self.message(what, path)
        elif kind == Nodetype.BASE:
            self.single(what[0], path)
        else:
            item, count = what
            self.many(item, count if kind == Nodetype.ARRAY else self.length(), path)
        if len(self.layout.leaves) > _MAX_FIELDS:
            raise NoLayout("too many fields")

    def single(self, name: str, path: Path) -> None:
        if name == "string":
            self.skip_fixed(self.length())
        else:
            self.leaf(name, None, path)

    def many(self, item: Any, count: int, path: Path) -> None:  # noqa: ANN401
        if item[0] == Nodetype.BASE and item[1][0] != "string":
            self.leaf(item[1][0], count, path)
            return
        if count > _MAX_FIELDS:
            raise NoLayout("too many fields")
        for number in range(count):
            self.field(item, (*path, number))

    def leaf(self, name: str, count: int | None, path: Path) -> None:
        if name not in _DTYPES:
            raise NoLayout(f"numbers of type {name}")
        dtype = self.order + _DTYPES[name]
        width = np.dtype(dtype).itemsize
        if count != 0:  # an empty sequence adds no padding
            self.align(width)
        self.layout.leaves[path] = Leaf(self.position, dtype, count)
        self.forward(width * (1 if count is None else count))

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
