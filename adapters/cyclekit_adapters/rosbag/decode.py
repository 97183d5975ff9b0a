"""Decode messages in bulk: groups of equal form at once, the odd ones by the rosbags library.

The library is the slow path and the judge: the first message of every group is decoded by it, so a group is only read
at once if the library can read it, and the texts and lengths of a group are those that the library found. Groups too
small to be worth a layout, and messages without one, are decoded one by one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from cyclekit_adapters.rosbag.definitions import types_of
from cyclekit_adapters.rosbag.layout import Layout, NoLayout, Numbers, trace
from cyclekit_adapters.rosbag.payloads import Bytes, Channel, Ints, Payloads, distinct

MIN_ROWS = 32
"""A smaller group is decoded one by one: finding its layout would take as long."""
_MAX_MISSES = 8  # so many groups that came out small, and the rest of that size is decoded one by one

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
    _layout: Layout | None = None
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
        for size in distinct(payloads.size).tolist():
            rows = np.flatnonzero(payloads.size == size)
            yield from self._of_one_size(types, payloads, rows)

    def _of_one_size(self, types: Typestore, payloads: Payloads, rows: Ints) -> Iterator[Group]:
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

    def _leading(self, types: Typestore, payloads: Payloads, rows: Ints, block: Bytes) -> tuple[Group | None, Any]:
        """Return the group of the first row, None if it is none, and which rows it covers, shape (N,)."""
        raw = block[0].tobytes()
        alone = np.arange(len(rows)) == 0
        try:
            message = self._judge(types, raw)
            layout = trace(types, self.channel.kind, raw, cdr=self.channel.coding == "cdr")
        except NoLayout:
            return None, np.ones(len(rows), bool)
        except Exception:  # the slow path says why
            return None, alone
        alike = layout.alike(block)
        if np.count_nonzero(alike) < MIN_ROWS:
            return None, alike
        chosen, same = (rows, block) if alike.all() else (rows[alike], block[alike])
        return Group(chosen, payloads.receive_ns[chosen], message, layout, same), alike

    def _one_by_one(self, types: Typestore, payloads: Payloads, rows: Ints) -> Iterator[Group]:
        for row in rows.tolist():
            try:
                message = self._judge(types, payloads.one(row))
            except Exception as error:  # a broken payload raises anything
                self.broken.append((row, f"{self.channel.topic}: message cannot be decoded ({error!r:.80})"))
                continue
            yield Group(np.array([row]), payloads.receive_ns[row : row + 1], message)

    def _judge(self, types: Typestore, raw: bytes) -> Message:
        if self.channel.coding == "cdr":
            return types.deserialize_cdr(raw, self.channel.kind)
        if self.channel.coding == "ros1":
            return types.deserialize_ros1(raw, self.channel.kind)
        raise ValueError(f"it is coded as {self.channel.coding!r}, which is not read")
