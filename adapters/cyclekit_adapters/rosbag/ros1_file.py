"""Survey of a ROS 1 bag: its connections, its chunks, and how far it is readable.

The index at the end of the file is not needed: every chunk that introduces a connection holds its definition, and the
index records after each chunk list its content. So a bag that was cut or never closed is read like any other, as far as
its chunks are complete. ROS 1 bags have no checksums. Format: bag format 2.0.
"""

from __future__ import annotations

import re
import struct
from dataclasses import replace
from io import BufferedReader
from pathlib import Path

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from cyclekit_adapters.rosbag.chunks import MAX_RECORDS, Chunk, ChunkedFile, Messages, moment, records
from cyclekit_adapters.rosbag.inflate import STORED
from cyclekit_adapters.rosbag.payloads import Bytes, Channel, Damage, Ints, column, distinct, gather

_MESSAGE, _BAG, _INDEX, _CHUNK, _CONNECTION = b"\x02", b"\x03", b"\x04", b"\x05", b"\x07"
_MAX_HEADER = 1 << 20
_SIZE = struct.Struct("<I")


class _Records:
    """Records of a ROS 1 bag: length and fields of a header, length and bytes of the data."""

    def walk(self, raw: Bytes, begin: int, end: int) -> tuple[list[int], int]:
        starts, position, unpack, text = [], begin, _SIZE.unpack_from, raw.data
        for _ in range(MAX_RECORDS):
            if position + 8 > end:
                break
            data = position + 4 + unpack(text, position)[0]
            if data + 4 > end:
                break
            after = data + 4 + unpack(text, data)[0]
            if after > end:
                break
            starts.append(position)
            position = after
        return starts, position

    def ends(self, buffer: Bytes, start: Ints, end: int) -> Ints | None:
        if start[-1] + 8 > end:
            return None
        data = start + 4 + column(gather(buffer, start, 4), 0, "<u4")
        if (data + 4 > end).any():
            return None
        after = data + 4 + column(gather(buffer, data, 4), 0, "<u4")
        return after if (after <= end).all() else None

    def indexed(self, raw: bytes) -> Ints:
        return np.frombuffer(raw, "<u4", len(raw) // 12 * 3).reshape(-1, 3)[:, 2].astype(np.int64)

    def messages(self, buffer: Bytes, start: Ints) -> Messages:
        lengths = column(gather(buffer, start, 4), 0, "<u4")
        parts, other = [], []
        for length in distinct(lengths).tolist():
            same, left = _alike(buffer, start[lengths == length], length)
            other += left
            if same is not None:
                parts.append(same)
        if not parts:
            none = np.zeros(0, np.int64)
            return Messages(none, none, none, none, other)
        joined = [np.concatenate(part) for part in zip(*parts, strict=True)]
        if len(parts) > 1:
            order = np.argsort(joined[2], kind="stable")
            joined = [part[order] for part in joined]
        channel, receive_ns, begin, size = joined
        return Messages(channel, receive_ns, begin, size, sorted(other))


def _alike(buffer: Bytes, start: Ints, length: int) -> tuple[tuple[Ints, Ints, Ints, Ints] | None, list[int]]:
    """Parse the message headers among records with headers of one length; also return the starts of other records.

    The first message gives the positions of its fields; they apply to all messages with the same bytes around them.
    """
    heads = gather(buffer, start, length + 8)
    other: list[int] = []
    for row in range(start.size):
        places = _places(heads[row, 4 : 4 + length].tobytes())
        if places is not None:
            break
        other.append(int(start[row]))
    else:
        return None, other
    values = sorted((places[name] + 4, places[name] + 4 + size) for name, size in (("conn", 4), ("time", 8)))
    bounds = [0, *(bound for value in values for bound in value), length + 4]
    alike = np.ones(start.size, bool)
    for begin, end in zip(bounds[::2], bounds[1::2], strict=True):
        alike &= (heads[:, begin:end] == heads[row, begin:end]).all(1)
    other += [int(begin) for begin in start[row:][~alike[row:]]]
    if not alike.all():
        heads, start = heads[alike], start[alike]
    seconds, nanos = (column(heads, places["time"] + 4 + 4 * half, "<u4") for half in (0, 1))
    size = column(heads, length + 4, "<u4")
    return (column(heads, places["conn"] + 4, "<u4"), seconds * 10**9 + nanos, start + length + 8, size), other


def _places(header: bytes) -> dict[str, int] | None:
    """Return the positions of the values in a message's header; None if the record is no message."""
    places, position = {}, 0
    try:
        while position < len(header):
            (size,) = _SIZE.unpack_from(header, position)
            name, _, value = header[position + 4 : position + 4 + size].partition(b"=")
            places[name.decode()] = position + 4 + len(name) + 1
            if name == b"op" and value != _MESSAGE:
                return None
            position += 4 + size
    except (struct.error, UnicodeDecodeError):
        return None
    inside = all(places.get(name, len(header)) + size <= len(header) for name, size in (("conn", 4), ("time", 8)))
    return places if "op" in places and inside else None


def open_file(path: Path) -> ChunkedFile:
    """Return the content of a ROS 1 bag, as far as it is readable.

    Raises:
        Damage: The bag is encrypted, or of another format version.
        OSError: The file cannot be read.
        Exception: A record is invalid; any parse error.
    """
    found = ChunkedFile(path, _Records())
    with path.open("rb") as log:
        end = log.seek(0, 2)
        log.seek(0)
        version = re.match(rb"#ROSBAG V(\d+\.\d+)\n", log.readline(32))
        if version is None or version[1] != b"2.0":
            raise Damage("only format 2.0 of ROS 1 bags is read")
        cut, about = _heads(log, found, end)
        written = sum(not chunk.cut for chunk in found.chunks)
        found.refuse_bombs()
        for chunk in found.chunks:
            if not chunk.index or any(number not in found.channels for number, _, _ in chunk.index):
                _open(log, found, chunk)
        promised = _number(about, b"chunk_count")
        unclosed = _number(about, b"index_pos") == 0
        if cut is not None or unclosed or promised > written:
            _last(log, found)
            there = f"{written} of {promised} chunks were found"
            if unclosed:
                there = f"its last {end - (end if cut is None else cut)} bytes cannot be read"
            if any(chunk.cut for chunk in found.chunks):
                there += ", and the beginning of one more"
            what = "was never closed" if unclosed else "is cut"
            if cut is not None and cut < _chunks_end(about, end):
                what = f"is damaged at byte {cut}"
            found.warnings.append(_how_much(found, f"the bag {what}: {there}"))
    return found


def _heads(log: BufferedReader, found: ChunkedFile, end: int) -> tuple[int | None, dict[bytes, bytes]]:
    """Read the headers of all records; return where the file becomes unreadable (else None), and the bag header."""
    position, about = log.tell(), dict[bytes, bytes]()
    while position < end:
        log.seek(position)
        fields = _header(log)
        if fields is None or b"op" not in fields:  # zeros would be an endless series of empty records
            return position, about
        size = log.read(4)
        place = log.tell()
        after = place + _SIZE.unpack(size)[0] if len(size) == 4 else end + 1
        op = fields.get(b"op")
        if after > end:
            if op == _CHUNK and place < end and not _chunks_end(about, end):
                _cut_chunk(log, found, Chunk(place, end - place, _number(fields, b"size"), _compression(fields)), after)
            return position, about
        if op == _BAG:
            about = fields
            if fields.get(b"encryptor"):
                raise Damage("the bag is encrypted")
        elif op == _CHUNK:
            found.chunks.append(Chunk(place, after - place, _number(fields, b"size"), _compression(fields)))
        elif op == _INDEX and found.chunks:
            number, count = _number(fields, b"conn"), _number(fields, b"count")
            found.counts[number] = found.counts.get(number, 0) + count
            found.chunks[-1].index.append((number, place, after - place))
        elif op == _CONNECTION:
            _connect(found, fields, log.read(after - place))
        position = after
    return None, about


def _chunks_end(about: dict[bytes, bytes], end: int) -> int:
    """Return the end of the chunks, if the file extends beyond it, so that no chunk is cut; 0 if unknown."""
    at = _number(about, b"index_pos")
    return at if at < end else 0


def _cut_chunk(log: BufferedReader, found: ChunkedFile, chunk: Chunk, after: int) -> None:
    """Keep the readable part of a chunk within which the file ends; `after` is its expected end."""
    # the length of an uncompressed chunk is written twice: if the two differ, a bit is wrong
    if chunk.compression not in STORED or chunk.size == after - chunk.place:
        found.add_cut(log, chunk)


def _compression(fields: dict[bytes, bytes]) -> str:
    return fields.get(b"compression", b"").decode("ascii", "replace")


def _header(log: BufferedReader) -> dict[bytes, bytes] | None:
    size = log.read(4)
    if len(size) < 4 or (length := _SIZE.unpack(size)[0]) > _MAX_HEADER:
        return None
    raw = log.read(length)
    return _fields(raw) if len(raw) == length else None


def _fields(raw: bytes) -> dict[bytes, bytes] | None:
    fields, position = {}, 0
    while position + 4 <= len(raw):
        (size,) = _SIZE.unpack_from(raw, position)
        name, sign, value = raw[position + 4 : position + 4 + size].partition(b"=")
        if not sign or position + 4 + size > len(raw):
            return None
        fields[name] = value
        position += 4 + size
    return fields


def _number(fields: dict[bytes, bytes], name: bytes) -> int:
    return int.from_bytes(fields.get(name, b""), "little")


def _connect(found: ChunkedFile, fields: dict[bytes, bytes], data: bytes) -> None:
    about = _fields(data)
    if about is None or b"type" not in about:
        return
    topic = fields.get(b"topic", b"").decode()
    number = _number(fields, b"conn")
    found.channels[number] = Channel(
        number=number,
        topic="/" * topic.startswith("/") + "/".join(part for part in topic.split("/") if part),
        kind=normalize_msgtype(about[b"type"].decode()),
        definition=about.get(b"message_definition", b"").decode(),
        coding="ros1",
        digest=about.get(b"md5sum", b"").decode(),
    )


def _open(log: BufferedReader, found: ChunkedFile, chunk: Chunk) -> Messages | None:
    """Open a chunk for information that its index lacks."""
    raw = found.unpacked(log, chunk)
    if raw is None:
        return None
    start, _ = records(found.form, raw, np.zeros(0, np.int64))
    messages = found.form.messages(raw, start)
    for begin in messages.other:
        data = begin + 4 + _SIZE.unpack_from(raw.data, begin)[0]
        fields = _fields(raw[begin + 4 : data].tobytes())
        if fields and fields.get(b"op") == _CONNECTION and _number(fields, b"conn") not in found.channels:
            _connect(found, fields, raw[data + 4 : data + 4 + _SIZE.unpack_from(raw.data, data)[0]].tobytes())
    if not chunk.index:
        for number, count in messages.by_channel().items():
            found.counts[number] = found.counts.get(number, 0) + count
    return messages


def _last(log: BufferedReader, found: ChunkedFile) -> None:
    """Find the last recovered time, in the last readable chunk."""
    for chunk in reversed(found.chunks):
        messages = _open(log, found, replace(chunk, index=chunk.index or [(-1, 0, 0)]))
        if messages is not None and messages.receive_ns.size:
            found.last_ns = int(messages.receive_ns.max())
            return


def _how_much(found: ChunkedFile, message: str) -> str:
    """Return a description of what a cut bag has lost, as far as known."""
    if found.last_ns is not None:
        message += f"; messages up to {moment(found.last_ns)} are recovered, later ones are lost"
    return f"{message}; copy the bag again if the original is whole"
