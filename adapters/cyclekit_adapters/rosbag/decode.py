"""Decode messages in bulk: groups of equal form at once, the odd ones one by one.

The first message of a group is walked through, field by field; its texts and lengths are those of the whole group, and
the numbers of all are read in one go. Groups too small to be worth that, and messages that cannot be walked through,
are decoded by the rosbags library, which is the slow path here and the judge in the tests.
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
"""A smaller group is decoded one by one: finding its layout would take as long."""
_MAX_MISSES = 8  # so many groups that came out small, and the rest of that size is decoded one by one
_FEW = 16  # so few messages are walked through: the library first writes itself code for their type
_LARGE = 1 << 16  # bytes; a message beyond is walked through, since the walk knows when to stop

_CODINGS = ("cdr", "ros1")

# A message of a bag has whatever fields its recorded definition has.
Message = Any


@dataclass(frozen=True)
class Group:
    """N messages of one channel that differ in their numbers alone.

    Attributes:
        rows: Which of the payloads these are, ascending, shape (N,).
        receive_ns: When each was received, ns, shape (N,).
        message: The first of them, decoded: texts and lengths of all are as in this one.
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
        """Tell whether the numbers of both groups stand at the same places under the same names."""
        mine, theirs = ({} if one._layout is None else one._layout.leaves for one in (self, other))
        return mine == theirs

    def first(self, *path: str | int) -> Any:  # noqa: ANN401 - a field is whatever its definition says
        """Return a field of the first message: for texts and lengths, that of all.

        Raises:
            AttributeError: These messages have no such field.
        """
        value = self.message
        for step in path:
            value = value[step] if isinstance(step, int) else getattr(value, step)
        return value


@dataclass
class Decoder:
    """Decodes the messages of one channel.

    Attributes:
        channel: The channel.
        broken: Row and reason of every message of the last call of `groups` that cannot be decoded.
    """

    channel: Channel
    broken: list[tuple[int, str]] = field(default_factory=list)

    def groups(self, payloads: Payloads) -> Iterator[Group]:
        """Yield the messages in groups of equal form, those with the earliest first row of each size first."""
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
        """Return the group of the first row, None if it is none, and which rows it covers, shape (N,)."""
        try:
            layout, message = trace(types, self.channel.kind, block[0].tobytes(), cdr=self.channel.coding == "cdr")
        except TooMany:
            return None, np.ones(len(rows), bool)
        except NoLayout:  # the slow path says why
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
            except Exception as error:  # a broken payload raises anything
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
