"""Survey of an mcap: its channels, its chunks, and how far it is readable.

Only record headers are read, so a large file takes milliseconds. A chunk is opened only if it has no index or names an
unknown channel: a truncated file lost its summary, but every chunk that introduces a channel holds its definition. ROS
2 and ROS 1 profiles are read alike. Format: MCAP specification 1.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field, replace
from io import BufferedReader
from pathlib import Path

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from cyclekit.text.numbers import fixed
from cyclekit_adapters.rosbag.chunks import MAX_RECORDS, Chunk, ChunkedFile, Messages, moment, records
from cyclekit_adapters.rosbag.first_bytes import MCAP
from cyclekit_adapters.rosbag.payloads import Bytes, Channel, Ints, column, gather

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX, _DATA_END = 2, 3, 4, 5, 6, 7, 15
_STATISTICS, _CHUNK_COUNT = 11, 22  # record number, and offset of the number of chunks in it
_RECORD = struct.Struct("<BQ")
_HEAD = 31  # bytes of a message record before its payload
_WINDOW = 4 << 20  # bytes of messages outside of chunks that are grouped into one chunk
_NOTATIONS = {"ros2msg": "msg", "ros1msg": "msg", "ros2idl": "idl", "omgidl": "idl"}


class _Records:
    """Records of an mcap: opcode, length, content."""

    def walk(self, raw: Bytes, begin: int, end: int) -> tuple[list[int], int]:
        starts, position, unpack, data = [], begin, _RECORD.unpack_from, raw.data
        for _ in range(MAX_RECORDS):
            if position + 9 > end:
                break
            after = position + 9 + unpack(data, position)[1]
            if after > end:
                break
            starts.append(position)
            position = after
        return starts, position

    def ends(self, buffer: Bytes, start: Ints, end: int) -> Ints | None:
        if start[-1] + 9 > end:
            return None
        after = start + 9 + column(gather(buffer, start, 9), 1, "<u8")
        return after if ((after > start) & (after <= end)).all() else None

    def indexed(self, raw: bytes) -> Ints:
        entries = np.frombuffer(raw, "<u8", len(raw) // 16 * 2).reshape(-1, 2)
        return entries[:, 1].astype(np.int64)

    def messages(self, buffer: Bytes, start: Ints) -> Messages:
        # in one operation, unless a record starts too close to the end for the header of a message
        fits = not start.size or int(start[-1]) + _HEAD <= buffer.size
        heads = gather(buffer, start, _HEAD if fits else 9)
        size = column(heads, 1, "<u8") - (_HEAD - 9)
        is_message = (heads[:, 0] == _MESSAGE) & (size >= 0)
        other: list[int] = []
        if not is_message.all():
            other = start[~is_message].tolist()
            start, size, heads = start[is_message], size[is_message], heads[is_message]
        heads = heads if fits else gather(buffer, start, _HEAD)
        return Messages(column(heads, 9, "<u2"), column(heads, 15, "<u8"), start + _HEAD, size, other)


@dataclass
class _Index:
    """Findings so far."""

    found: ChunkedFile
    schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    pending: list[tuple[int, int, str, str]] = field(default_factory=list)
    loose: bool = False
    data_crc: int = 0
    data_end: int = 0
    summary: int = 0
    promised: int = 0
    before_summary: tuple[dict[int, Channel], dict[int, tuple[str, str, str]]] | None = None

    def schema(self, body: bytes) -> None:
        (number,) = struct.unpack_from("<H", body)
        name, at = _text(body, 2)
        encoding, at = _text(body, at)
        text, _ = _text(body, at)
        self.schemas[number] = (name, encoding, text)

    def channel(self, body: bytes) -> None:
        number, schema = struct.unpack_from("<HH", body)
        topic, at = _text(body, 4)
        coding, _ = _text(body, at)
        name, encoding, text = self.schemas.get(schema, ("", "", ""))
        known = encoding in _NOTATIONS
        self.found.channels[number] = Channel(
            number=number,
            topic=topic,
            kind=normalize_msgtype(name) if "/" in name else name,
            definition=text if known else "",
            notation=_NOTATIONS.get(encoding, "msg"),
            coding=coding,
        )

    def end_of_data(self, position: int, after: int, crc: int) -> None:
        """Store what is known without the summary, in case the summary is damaged."""
        self.data_end, self.summary, self.data_crc = position, after, crc
        self.before_summary = dict(self.found.channels), dict(self.schemas)

    def forget_summary(self) -> None:
        if self.before_summary is not None:
            self.found.channels, self.schemas = self.before_summary
            self.found.warnings.append("the summary of the bag is damaged and is not used")

    def take(self, op: int, body: bytes) -> None:
        if op == _SCHEMA:
            self.schema(body)
        elif op == _CHANNEL:
            self.channel(body)


def open_file(path: Path) -> ChunkedFile:
    """Return the content of an mcap, as far as it is readable.

    Raises:
        OSError: The file cannot be read.
        Exception: A record is invalid; any parse error.
    """
    survey = _Index(ChunkedFile(path, _Records()))
    with path.open("rb") as log:
        end = log.seek(0, 2)
        cut = _heads(log, survey, end)
        if cut is None and not survey.loose and survey.promised > (there := len(survey.found.chunks)):
            survey.found.warnings.append(f"the bag is damaged: {there} of {survey.promised} chunks were found")
        survey.found.refuse_bombs()
        for chunk in survey.found.chunks:
            if not chunk.index or any(number not in survey.found.channels for number, _, _ in chunk.index):
                _open(log, survey, chunk)
        if cut is not None:
            survey.found.warnings.append(_how_much(survey.found, log, cut, end))
        elif survey.loose and survey.data_crc and _crc(log, 0, survey.data_end) != survey.data_crc:
            survey.found.warnings.append("the checksum of the bag does not match: some of its values are wrong")
    return survey.found


def _heads(log: BufferedReader, survey: _Index, end: int) -> int | None:
    """Read the headers of all records; return the offset at which the file becomes unreadable, or None."""
    position, chunks = len(MCAP), survey.found.chunks
    while True:
        log.seek(position)
        head = log.read(9)
        if head[:8] == MCAP:
            return None
        if len(head) < 9:
            return position
        op, length = _RECORD.unpack(head)
        after = position + 9 + length
        if after > end or op == 0:
            if op == _CHUNK and not _closed(log, end):
                _cut_chunk(log, survey.found, position, length)
            return position
        if op == _MESSAGE:
            after = _loose(log, survey, position, after - position)
        elif op in (_SCHEMA, _CHANNEL):
            survey.take(op, log.read(length))
        elif op == _CHUNK:
            chunks.append(_chunk(log, survey.found, position, after))
        elif op == _INDEX and chunks:
            number, size = struct.unpack("<HI", log.read(6))
            count = survey.found.counts.get(number, 0) + size // 16
            survey.found.counts[number] = count
            entry = (number, position + 15, min(size, length - 6))
            chunks[-1].index.append(entry)
        elif op == _DATA_END:
            survey.end_of_data(position, after, struct.unpack("<I", log.read(4))[0])
        elif op == _STATISTICS and length >= _CHUNK_COUNT + 4:
            log.seek(_CHUNK_COUNT, 1)
            (survey.promised,) = struct.unpack("<I", log.read(4))
        elif op == _FOOTER and length == 20:
            log.seek(16, 1)
            (crc,) = struct.unpack("<I", log.read(4))
            if crc and _crc(log, survey.summary, after - 4) != crc:
                survey.forget_summary()
        position = after


def _chunk(log: BufferedReader, found: ChunkedFile, position: int, after: int) -> Chunk:
    _, until_ns, size, crc, letters = struct.unpack("<QQQII", log.read(32))
    compression = log.read(letters).decode()
    (stored,) = struct.unpack("<Q", log.read(8))
    found.last_ns = max(found.last_ns or 0, until_ns)
    place = position + 9 + 40 + letters
    return Chunk(place, min(stored, after - place), size, compression, crc)


def _closed(log: BufferedReader, end: int) -> bool:
    """Return whether the file has its end mark: then it is not cut, and a contradicting record is damaged."""
    log.seek(max(0, end - len(MCAP)))
    return log.read() == MCAP


def _cut_chunk(log: BufferedReader, found: ChunkedFile, position: int, length: int) -> None:
    """Keep the readable part of a chunk within which the file ends."""
    last_ns, end = found.last_ns, log.seek(0, 2)
    log.seek(position + 9)
    try:
        chunk = _chunk(log, found, position, position + 9 + length)
    except (struct.error, UnicodeDecodeError):
        return
    finally:
        found.last_ns = last_ns  # the chunk header refers to messages that are lost
    log.seek(chunk.place - 8)
    # the chunk length is written twice: if the two differ, a bit is wrong and the file may not be cut at all
    if chunk.place < end and struct.unpack("<Q", log.read(8))[0] == position + 9 + length - chunk.place:
        found.add_cut(log, replace(chunk, stored=end - chunk.place))


def _loose(log: BufferedReader, survey: _Index, position: int, first: int) -> int:
    """Make a chunk from messages outside of chunks; return its end."""
    log.seek(position)
    raw = np.frombuffer(log.read(max(_WINDOW, first)), np.uint8)
    starts, reached = _Records().walk(raw, 0, len(raw))
    foreign = (start for start in starts if raw[start] not in (_SCHEMA, _CHANNEL, _MESSAGE))
    reached = next(foreign, reached)
    survey.found.chunks.append(Chunk(position, reached, reached))
    survey.loose = True
    return position + reached


def _open(log: BufferedReader, survey: _Index, chunk: Chunk) -> None:
    """Open a chunk for information that its index lacks."""
    found = survey.found
    raw = found.unpacked(log, chunk)
    if raw is None:
        return
    start, _ = records(found.form, raw, np.zeros(0, np.int64))
    messages = found.form.messages(raw, start)
    other = np.asarray(messages.other, np.int64)
    kinds = raw[other]
    for begin in other[(kinds == _SCHEMA) | (kinds == _CHANNEL)].tolist():  # a bomb has millions of others
        op, length = _RECORD.unpack_from(raw.data, begin)
        survey.take(op, raw[begin + 9 : begin + 9 + length].tobytes())
    if messages.receive_ns.size:
        found.last_ns = max(found.last_ns or 0, int(messages.receive_ns.max()))
    if not chunk.index:
        for number, count in messages.by_channel().items():
            found.counts[number] = found.counts.get(number, 0) + count


def _how_much(found: ChunkedFile, log: BufferedReader, cut: int, end: int) -> str:
    """Return a description of what a cut bag has lost, as far as known."""
    message = f"its last {end - cut} of {end} bytes cannot be read"
    if _closed(log, end):
        return f"the bag is damaged at byte {cut}: {message}; copy the bag again if the original is whole"
    message = f"the bag is cut: {message}"
    if any(chunk.cut for chunk in found.chunks):
        message = (
            f"the bag is cut: it ends within a chunk, at byte {end}, and the checksum of that chunk cannot be checked"
        )
    if found.last_ns is None:
        return message
    message += f"; messages up to {moment(found.last_ns)} are recovered, later ones are lost"
    log.seek(cut)
    head = log.read(9 + 16)
    if len(head) == 25 and head[0] == _CHUNK:
        lost_ns = struct.unpack_from("<Q", head, 17)[0] - found.last_ns  # last time of the cut chunk
        if 0 < lost_ns < 10**13:
            message += f" (at least {fixed(lost_ns / 1e9, 1)} s)"
    return f"{message}; copy the bag again if the original is whole"


def _crc(log: BufferedReader, begin: int, end: int) -> int:
    crc, left = 0, end - begin
    log.seek(begin)
    while left > 0 and (part := log.read(min(left, 1 << 20))):
        crc, left = zlib.crc32(part, crc), left - len(part)
    return crc


def _text(body: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", body, at)
    if at + 4 + size > len(body):
        raise ValueError("a text reaches beyond its record")
    return body[at + 4 : at + 4 + size].decode(), at + 4 + size
