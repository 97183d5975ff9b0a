"""Bulk decoding of messages: groups of equal layout at once, the others one by one.

The first message of a group is traced field by field. Its texts and lengths apply to the whole group, and the numbers
of all messages are read in one operation. Small groups, and messages that cannot be traced, are decoded by the rosbags
library, which is slower and serves as reference in the tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cyclekit_adapters.rosbag.definitions import NoDefinition, Types, types_of
from cyclekit_adapters.rosbag.layout import MessageLayout, NoLayout, Numbers, TooMany, trace
from cyclekit_adapters.rosbag.payloads import Bytes, Channel, Ints, Payloads, distinct

MIN_ROWS = 32
"""Minimum size of a group for bulk decoding: finding the layout of a smaller one takes as long as decoding it."""
_MAX_MISSES = 8  # after this many small groups, the rest of that size is decoded one by one
_FEW = 16  # below this number, messages are traced: the library first generates code for their type
_LARGE = 1 << 16  # bytes; a larger message is traced, because tracing has a limit

_CODINGS = ("cdr", "ros1")

# The fields of a message depend on its recorded definition.
Message = Any


@dataclass(frozen=True)
class Group:
    """N messages of one channel that differ only in their numbers.

    Attributes:
        rows: Indices among the payloads, ascending, shape (N,).
        receive_ns: Receive times, ns, shape (N,).
        message: The first message, decoded; its texts and lengths apply to all.
    """

    rows: Ints
    receive_ns: Ints
    message: Message
    _layout: MessageLayout | None = None
    _block: Bytes | None = None

    def numbers(self, *path: str | int) -> Numbers:
        """Return a field of all messages, shape (N,), or (N, count) for an array of numbers.

        Raises:
            AttributeError: These messages have no such field.
            TypeError: The field holds no numbers.
        """
        first = self.first(*path)
        if self._layout is None or self._block is None:
            values: Numbers = np.asarray(first)[None]
            if values.dtype.kind not in "biuf":
                raise TypeError(f"{'.'.join(map(str, path))} holds no numbers")
            return values
        try:
            return self._layout.read(self._block, path)
        except KeyError:
            raise TypeError(f"{'.'.join(map(str, path))} holds no numbers") from None

    def has_places_of(self, other: Group) -> bool:
        """Return whether the numbers of both groups have the same positions and names."""
        mine, theirs = ({} if one._layout is None else one._layout.leaves for one in (self, other))
        return mine == theirs

    def first(self, *path: str | int) -> Any:  # noqa: ANN401 - a field is whatever its definition says
        """Return a field of the first message; texts and lengths apply to all messages.

        Raises:
            AttributeError: These messages have no such field.
        """
        value = self.message
        for step in path:
            value = value[step] if isinstance(step, int) else getattr(value, step)
        return value


@dataclass
class Decoder:
    """Decoder of the messages of one channel.

    Attributes:
        channel: The channel.
        broken: Row and reason of every message that the last call of `groups` could not decode.
    """

    channel: Channel
    broken: list[tuple[int, str]] = field(default_factory=list)

    def groups(self, payloads: Payloads) -> Iterator[Group]:
        """Yield the messages in groups of equal layout; for each message size, in the order of their first rows."""
        self.broken = []
        types = types_of(self.channel)
        try:
            self._check(types)
        except (NoDefinition, RecursionError) as error:
            self._leave(np.arange(payloads.size.size), error)
            return
        for size in distinct(payloads.size).tolist():
            rows = np.flatnonzero(payloads.size == size)
            yield from self._of_one_size(types, payloads, rows)

    def _check(self, types: Types) -> None:
        if self.channel.coding not in _CODINGS:
            raise NoDefinition(f"its encoding {self.channel.coding!r} is not supported")
        types.check(self.channel.kind)

    def _leave(self, rows: Ints, error: object) -> None:
        reason = f"{self.channel.topic}: message cannot be decoded ({error!r:.80})"
        self.broken += [(row, reason) for row in rows.tolist()]

    def _of_one_size(self, types: Types, payloads: Payloads, rows: Ints) -> Iterator[Group]:
        block = payloads.block(rows) if len(rows) >= MIN_ROWS else None
        misses = 0
        while block is not None and len(rows) >= MIN_ROWS and misses < _MAX_MISSES:
            group, alike = self._leading(types, payloads, rows, block)
            if group is None:
                yield from self._one_by_one(types, payloads, rows[alike])
                misses += 1
            else:
                yield group
            rows, block = (rows[:0], None) if alike.all() else (rows[~alike], block[~alike])
        yield from self._one_by_one(types, payloads, rows)

    def _leading(self, types: Types, payloads: Payloads, rows: Ints, block: Bytes) -> tuple[Group | None, Any]:
        """Return the group of the first row (None if it is too small), and a mask of the rows it covers, shape (N,)."""
        try:
            layout, message = trace(types, self.channel.kind, block[0].tobytes(), cdr=self.channel.coding == "cdr")
        except TooMany:
            return None, np.ones(len(rows), bool)
        except NoLayout:  # the slow path reports the reason
            return None, np.arange(len(rows)) == 0
        alike = layout.alike(block)
        if np.count_nonzero(alike) < MIN_ROWS:
            return None, alike
        chosen, same = (rows, block) if alike.all() else (rows[alike], block[alike])
        return Group(chosen, payloads.receive_ns[chosen], message, layout, same), alike

    def _one_by_one(self, types: Types, payloads: Payloads, rows: Ints) -> Iterator[Group]:
        walked = len(rows) <= _FEW
        for number, row in enumerate(rows.tolist()):
            try:
                message = self._one(types, payloads.one(row), walked=walked)
            except TooMany as error:
                self._leave(rows[number:], error)  # the others of this size would take as long
                return
            except Exception as error:  # a damaged payload may raise anything
                self._leave(rows[number : number + 1], error)
                continue
            yield Group(np.array([row]), payloads.receive_ns[row : row + 1], message)

    def _one(self, types: Types, raw: bytes, *, walked: bool) -> Message:
        kind, cdr = self.channel.kind, self.channel.coding == "cdr"
        if walked or len(raw) > _LARGE:
            try:
                return trace(types, kind, raw, cdr=cdr)[1]
            except NoLayout:
                if len(raw) > _LARGE:
                    raise
        store = types.store(kind)
        return store.deserialize_cdr(raw, kind) if cdr else store.deserialize_ros1(raw, kind)
