"""Reader of files made of chunks: finds every message, sets damaged chunks aside.

An mcap and a ROS 1 bag have the same structure: chunks of whole records, most often followed by an index with the
position of each message. The index is used but not trusted: it is complete only if its records lie end to end and fill
the chunk; otherwise the chunk is read record by record. A `Format` describes the records.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from io import BufferedReader
from pathlib import Path
from typing import Protocol

import numpy as np

from cyclekit.text.numbers import fixed
from cyclekit_adapters.rosbag.inflate import MAX_BYTES, MAX_RATIO, STORED, check_size, inflate
from cyclekit_adapters.rosbag.payloads import BLOCK_BYTES, Bytes, Channel, Damage, Ints, Payloads, distinct

MAX_RECORDS = 4_000_000
"""Maximum number of records of a chunk: no logger writes more, so the rest is ignored."""
_SMALL_BYTES = 4096
"""Size, bytes, below which a chunk is faster to read than its index; a bag may have a million such chunks."""
_MAX_STEP = 64  # indexed chunks have few gaps (connections); with more, a plain read is faster


@dataclass(frozen=True)
class Chunk:
    """Position and header of a chunk.

    Attributes:
        place: File offset of the stored bytes.
        stored: Number of bytes in the file.
        size: Number of bytes when decompressed.
        compression: See `inflate`.
        crc: CRC-32 of the decompressed bytes; 0 if the writer computed none.
        index: Channel, file offset and number of bytes of each index of this chunk.
        cut: The file ends within the chunk: it holds at most `size` bytes, and its last record is incomplete.
    """

    place: int
    stored: int
    size: int
    compression: str = ""
    crc: int = 0
    index: list[tuple[int, int, int]] = field(default_factory=list)
    cut: bool = False


@dataclass(frozen=True)
class Messages:
    """Messages among the records of a chunk, each shape (N,), and the starts of all other records."""

    channel: Ints
    receive_ns: Ints
    start: Ints
    size: Ints
    other: Sequence[int] = ()

    def by_channel(self) -> dict[int, int]:
        """Return channel -> number of messages."""
        return {number: int(np.count_nonzero(self.channel == number)) for number in distinct(self.channel).tolist()}


class Format(Protocol):
    """Record format within a chunk."""

    def walk(self, raw: Bytes, begin: int, end: int) -> tuple[list[int], int]:
        """Return the starts of the complete records from `begin`, and the end of the last one."""
        ...

    def ends(self, buffer: Bytes, start: Ints, end: int) -> Ints | None:
        """Return the end of each record, shape (N,); None if one of them cannot be a record before `end`."""
        ...

    def indexed(self, raw: bytes) -> Ints:
        """Return the starts in an index, relative to its chunk."""
        ...

    def messages(self, buffer: Bytes, start: Ints) -> Messages:
        """Parse the headers of the records that start at `start`, shape (N,)."""
        ...


@dataclass
class ChunkedFile:
    """The readable part of an mcap or a ROS 1 bag; implements `payloads.BagFile`."""

    path: Path
    form: Format
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    set_aside: list[str] = field(default_factory=list)
    chunks: list[Chunk] = field(default_factory=list)
    last_ns: int | None = None
    _broken: set[int] = field(default_factory=set)
    _reported: set[str] = field(default_factory=set)
    _piece: bytes = b""

    def refuse_bombs(self) -> None:
        """Set aside chunks with an implausible declared size; call it before any chunk is opened."""
        kept = []
        for chunk in self.chunks:
            try:
                if not chunk.cut:
                    check_size(chunk.stored, chunk.size)
            except Damage as damage:
                self.drop(chunk, damage)
            else:
                kept.append(chunk)
        self.chunks = kept

    def unpacked(self, log: BufferedReader, chunk: Chunk, into: Bytes | None = None) -> Bytes | None:
        """Return the bytes of a chunk, shape (size,), in `into` if given.

        Returns None for a damaged chunk, which is reported once and not read again.
        """
        if chunk.place in self._broken:
            return None
        into = np.empty(chunk.size, np.uint8) if into is None else into
        try:
            self._unpack(log, chunk, into)
        except Damage as damage:
            self.drop(chunk, damage)
            self._broken.add(chunk.place)
            return None
        return into

    def _unpack(self, log: BufferedReader, chunk: Chunk, into: Bytes) -> None:
        log.seek(chunk.place)
        if chunk.compression in STORED:
            if chunk.stored != chunk.size or log.readinto(into.data) != chunk.size:
                raise Damage(f"it holds less than the {chunk.size} bytes it announces")
        else:
            _, self._piece = inflate(log.read(chunk.stored), chunk.compression, into, whole=not chunk.cut)
        if chunk.crc and zlib.crc32(into.data) != chunk.crc:
            raise Damage("its checksum does not match")

    def add_cut(self, log: BufferedReader, chunk: Chunk) -> None:
        """Add the readable part of a chunk within which the file ends; its declared size may be wrong.

        Its checksum covers the whole chunk, so it cannot be checked.
        """
        size = min(chunk.size, chunk.stored * MAX_RATIO, MAX_BYTES)
        if chunk.compression in STORED:
            size = min(size, chunk.stored)
        else:
            log.seek(chunk.place)
            try:
                size, _ = inflate(log.read(chunk.stored), chunk.compression, np.empty(size, np.uint8), whole=False)
            except Damage as damage:
                self.drop(chunk, damage)
                return
        stored = size if chunk.compression in STORED else chunk.stored
        if size:
            self.chunks.append(replace(chunk, stored=stored, size=size, crc=0, cut=True))

    def drop(self, chunk: Chunk, reason: object) -> None:
        """Report once that a chunk, or the rest of it, is not used."""
        message = f"chunk at byte {chunk.place}: {reason}"
        if message not in self._reported:
            self._reported.add(message)
            self.set_aside.append(message)

    def blocks(self, wanted: set[int]) -> Iterator[Mapping[int, Payloads]]:
        """Yield the messages of the wanted channels in file order, about BLOCK_BYTES at a time."""
        room = np.empty(0, np.uint8)
        with self.path.open("rb") as log:
            for group in _in_blocks(self.chunks):
                size = sum(chunk.size for chunk in group)
                room = np.empty(size, np.uint8) if room.size < size else room
                yield self._block(log, group, wanted, room[:size])

    def _block(self, log: BufferedReader, chunks: list[Chunk], wanted: set[int], buffer: Bytes) -> dict[int, Payloads]:
        found, base = [], 0
        for chunk in chunks:
            end = base + chunk.size
            raw = self.unpacked(log, chunk, buffer[base:end])
            if raw is not None:
                start, reached = records(self.form, raw, self._indexed(log, chunk))
                if reached != chunk.size and not chunk.cut:
                    self.drop(chunk, f"its records end at byte {reached} of {chunk.size}")
                found.append(start + base)
            base = end
        messages = self.form.messages(buffer, np.concatenate(found) if found else np.zeros(0, np.int64))
        block = {}
        for channel in sorted(wanted & set(distinct(messages.channel).tolist())):
            rows = np.flatnonzero(messages.channel == channel)
            block[channel] = Payloads(buffer, messages.start[rows], messages.size[rows], messages.receive_ns[rows])
        return block

    def _indexed(self, log: BufferedReader, chunk: Chunk) -> Ints:
        parts = []
        for _, place, size in chunk.index if chunk.size > _SMALL_BYTES else ():
            log.seek(place)
            parts.append(self.form.indexed(log.read(size)))
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)


def records(form: Format, raw: Bytes, indexed: Ints) -> tuple[Ints, int]:
    """Return the starts of all records of a chunk, shape (N,), and the byte at which reading stopped.

    Args:
        form: Format of the records.
        raw: The decompressed chunk.
        indexed: Starts in its index, used only if consistent.
    """
    if indexed.size:
        start = np.sort(indexed)
        complete = _filled(form, raw, start) if start[0] >= 0 else None
        if complete is not None:
            return complete, len(raw)
    walked, reached = form.walk(raw, 0, len(raw))
    return np.asarray(walked, np.int64), reached


def _filled(form: Format, raw: Bytes, start: Ints) -> Ints | None:
    """Return the starts including those in gaps; None if the records do not fill the chunk end to end."""
    ends = form.ends(raw, start, len(raw))
    if ends is None:
        return None
    begins, stops = np.append(0, ends), np.append(start, len(raw))
    gaps = np.flatnonzero(begins != stops)
    if gaps.size > _MAX_STEP + start.size // 16:
        return None
    between: list[int] = []
    for gap in gaps.tolist():
        walked, reached = form.walk(raw, int(begins[gap]), int(stops[gap]))
        if reached != stops[gap]:
            return None
        between += walked
    return np.sort(np.append(start, np.asarray(between, np.int64))) if between else start


def _in_blocks(chunks: list[Chunk]) -> Iterator[list[Chunk]]:
    group: list[Chunk] = []
    held = 0
    for chunk in chunks:
        size = chunk.size
        if group and held + size > BLOCK_BYTES:
            yield group
            group, held = [], 0
        group.append(chunk)
        held += size
    if group:
        yield group


def moment(receive_ns: int) -> str:
    """Return a time as text: a date if it counts from 1970, else seconds."""
    if 10**17 < receive_ns < 10**19:
        return datetime.fromtimestamp(receive_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3] + " UTC"
    return f"{fixed(receive_ns / 1e9, 3)} s"
