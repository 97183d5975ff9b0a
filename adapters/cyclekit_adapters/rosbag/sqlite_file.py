"""Look through a sqlite3 bag (.db3) and read it topic by topic.

One SELECT per topic hands the rows over without a step of Python in between. A file that was cut is read up to the
first page that is missing. The bags of older ROS 2 versions record no definitions; the well-known ones are used then.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import numpy as np

from cyclekit_adapters.rosbag.payloads import BLOCK_BYTES, Channel, Payloads

_NOTATIONS = {"ros2msg": "msg", "ros2idl": "idl"}
_ROWS = 4096  # so many rows are fetched at once


@dataclass
class SqliteFile:
    """A .db3 as far as it is whole; meets `payloads.BagFile`."""

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    set_aside: list[str] = field(default_factory=list)

    def blocks(self, wanted: set[int]) -> Iterator[Mapping[int, Payloads]]:
        """Yield the messages of the wanted channels in the order of the file, about BLOCK_BYTES at a time."""
        with closing(_connect(self.path)) as bag:
            for number in sorted(wanted):
                for payloads in self._topic(bag, number):
                    yield {number: payloads}

    def _topic(self, bag: sqlite3.Connection, number: int) -> Iterator[Payloads]:
        rows = bag.execute("SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY id", (number,))
        whole = True
        while whole:
            times: list[int] = []
            messages: list[bytes] = []
            size = 0
            while size < BLOCK_BYTES:
                try:
                    part = rows.fetchmany(_ROWS)
                except sqlite3.DatabaseError as error:
                    whole = False
                    self._broken(number, error)
                    break
                if not part:
                    whole = False
                    break
                part = self._sound(part)
                times += [time for time, _ in part]
                messages += [data for _, data in part]
                size += sum(map(len, messages[-len(part) :])) if part else 0
            if messages:
                yield _joined(times, messages)

    def _sound(self, rows: list[tuple[object, object]]) -> list[tuple[int, bytes]]:
        """Return the rows that are what they should be; in a damaged file a column may hold anything."""
        sound = [(t, data) for t, data in rows if isinstance(t, int) and isinstance(data, bytes)]
        if len(sound) < len(rows):
            self.set_aside += ["a row of the bag is damaged: no time or no message"] * (len(rows) - len(sound))
        return sound

    def _broken(self, number: int, error: sqlite3.DatabaseError) -> None:
        self.set_aside.append(f"{self.channels[number].topic}: the rest cannot be read ({error})")


def _joined(times: list[int], messages: list[bytes]) -> Payloads:
    size = np.fromiter(map(len, messages), np.int64, len(messages))
    start = np.cumsum(size) - size
    return Payloads(np.frombuffer(b"".join(messages), np.uint8), start, size, np.asarray(times, np.int64))
