"""Reader of a recording that was compressed as a whole or per message, based on the rosbags library.

Such folders are rare and declared in metadata.yaml; the sibling modules read all others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from cyclekit_adapters.rosbag.payloads import BLOCK_BYTES, Channel, Payloads

_NOTATIONS = {MessageDefinitionFormat.MSG: "msg", MessageDefinitionFormat.IDL: "idl"}


@dataclass
class LibraryFile:
    """A compressed ROS 2 folder; implements `payloads.BagFile`."""

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    set_aside: list[str] = field(default_factory=list)

    def blocks(self, wanted: set[int]) -> Iterator[Mapping[int, Payloads]]:
        """Yield the messages of the wanted channels in file order, about BLOCK_BYTES at a time."""
        with Reader(self.path) as reader:
            connections = [connection for connection in reader.connections if connection.id in wanted]
            kept: dict[int, list[tuple[int, bytes]]] = {}
            size = 0
            for connection, receive_ns, raw in reader.messages(connections) if connections else ():
                kept.setdefault(connection.id, []).append((receive_ns, bytes(raw)))
                size += len(raw)
                if size >= BLOCK_BYTES:
                    yield {number: _joined(rows) for number, rows in kept.items()}
                    kept, size = {}, 0
            yield {number: _joined(rows) for number, rows in kept.items()}


def open_file(path: Path) -> LibraryFile:
    """Return the content of a compressed folder; passes on any error of the library for a damaged one."""
    found = LibraryFile(path)
    with Reader(path) as reader:
        for connection in reader.connections:
            found.channels[connection.id] = _channel(connection)
            found.counts[connection.id] = connection.msgcount
    return found


def _channel(connection: Connection) -> Channel:
    known = connection.msgdef.format in _NOTATIONS
    coding = connection.ext.serialization_format if isinstance(connection.ext, ConnectionExtRosbag2) else "ros1"
    return Channel(
        number=connection.id,
        topic=connection.topic,
        kind=connection.msgtype,
        definition=connection.msgdef.data if known else "",
        notation=_NOTATIONS.get(connection.msgdef.format, "msg"),
        coding=coding,
    )


def _joined(rows: list[tuple[int, bytes]]) -> Payloads:
    size = np.fromiter((len(raw) for _, raw in rows), np.int64, len(rows))
    start = np.cumsum(size) - size
    buffer = np.frombuffer(b"".join(raw for _, raw in rows), np.uint8)
    return Payloads(buffer, start, size, np.fromiter((t for t, _ in rows), np.int64, len(rows)))
