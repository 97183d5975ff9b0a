"""Access to a bag of any container format: messages of chosen topics in groups.

Any error of a damaged file (a KeyError as well as a failed assertion) becomes one error with cause and cure, unless
some of the bag can be recovered: then it is read as far as possible, and the loss is reported. A single message that
cannot be decoded is counted and left out.
"""

from __future__ import annotations

import sqlite3
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cyclekit.adapter import Scratch
from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.rosbag import mcap_file, ros1_file, sqlite_file
from cyclekit_adapters.rosbag.chunks import ChunkedFile
from cyclekit_adapters.rosbag.decode import Decoder, Group
from cyclekit_adapters.rosbag.definitions import is_known
from cyclekit_adapters.rosbag.first_bytes import MCAP, ROS1, SQLITE, ZSTD, head
from cyclekit_adapters.rosbag.folder import Folder, folder_of
from cyclekit_adapters.rosbag.inflate import unpack_file, unpacked
from cyclekit_adapters.rosbag.known import KNOWN
from cyclekit_adapters.rosbag.payloads import BagFile, Channel, Damage, Ints
from cyclekit_adapters.rosbag.undefined import find_layout

_LFS = b"version https://git-lfs.github.com/spec/"
AGAIN = "Copy it again from where it was recorded"


@dataclass
class Arrived:
    """A group and the arrival numbers of its messages within their topic, shape (N,)."""

    topic: str
    kind: str
    number: Ints
    group: Group


@dataclass
class Bag:
    """An open bag.

    Attributes:
        path: The file or folder.
        topics: Message type of every topic, as `package/msg/Type`, in ROS 1 bags too.
        counts: Number of messages per topic.
        warnings: Damage of the bag, one sentence each.
        messages_read: Number of messages of wanted topics so far, decoded or not.
        undecodable: (topic, arrival number within the topic, reason) of every message that cannot be used.
        layouts: For topics without a definition in the bag: how their layout was determined.
    """

    path: Path
    files: list[BagFile]
    topics: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    messages_read: int = 0
    undecodable: list[tuple[str, int, str]] = field(default_factory=list)
    layouts: dict[str, str] = field(default_factory=dict)
    _received: dict[str, list[tuple[int, Ints]]] = field(default_factory=dict)

    def has_checksums(self) -> bool:
        """Return whether every chunk of the bag has a checksum, so that a flipped bit is detected."""
        chunked = [file for file in self.files if isinstance(file, ChunkedFile)]
        chunks = [chunk for file in chunked for chunk in file.chunks]
        return len(chunked) == len(self.files) and bool(chunks) and all(chunk.crc for chunk in chunks)

    def messages(self, wanted: set[str]) -> Iterator[Arrived]:
        """Yield the messages of the `wanted` topics, in groups, in the order of the files.

        Raises:
            DamagedLog: The container is damaged and nothing can be recovered.
        """
        try:
            for number, file in enumerate(self.files):
                yield from self._of_file(number, file, wanted)
        except (LogError, GeneratorExit):
            raise
        except Exception as error:
            raise damaged(self.path, error) from error

    def _of_file(self, place: int, file: BagFile, wanted: set[str]) -> Iterator[Arrived]:
        decoders = {number: Decoder(one) for number, one in file.channels.items() if one.topic in wanted}
        if not decoders:
            return
        for block in file.blocks(set(decoders)):
            for number, payloads in block.items():
                decoder = decoders[number]
                topic, kind = decoder.channel.topic, decoder.channel.kind
                received = self._received.setdefault(topic, [])
                before = sum(part.size for _, part in received)
                received.append((place, payloads.receive_ns))
                self.messages_read += payloads.size.size
                for group in decoder.groups(unpacked(payloads)):
                    yield Arrived(topic, kind, group.rows + before, group)
                self.undecodable += [(topic, before + row, reason) for row, reason in decoder.broken]

    def order(self, topic: str) -> Ints:
        """Return the index of each arrival number of a topic; complete once all messages were taken.

        Messages are numbered file by file, in the order of the files' first times, and by time within a file.
        """
        parts = self._received[topic]
        received = np.concatenate([part for _, part in parts])
        if len({place for place, _ in parts}) == 1 and (received[1:] >= received[:-1]).all():
            return np.arange(received.size)
        ranks = self._ranks()
        file = np.repeat([ranks[place] for place, _ in parts], [part.size for _, part in parts])
        index = np.empty(received.size, np.int64)
        index[np.lexsort((received, file))] = np.arange(received.size)
        return index

    def parts(self, topic: str) -> list[tuple[str, int]]:
        """Return the files that hold messages of a topic, and their number of messages, in the order of the index."""
        counts: dict[int, int] = {}
        for place, part in self._received.get(topic, []):
            counts[place] = counts.get(place, 0) + part.size
        ranks = self._ranks()
        return [(self.files[place].path.name, counts[place]) for place in sorted(counts, key=lambda one: ranks[one])]

    def _ranks(self) -> dict[int, int]:
        """Return the rank of each file by its first time."""
        begins: dict[int, int] = {}
        for parts in self._received.values():
            for place, part in parts:
                if part.size:
                    begins[place] = min(begins.get(place, int(part[0])), int(part.min()))
        ordered = sorted(range(len(self.files)), key=lambda place: (begins.get(place, 0), place))
        return {place: rank for rank, place in enumerate(ordered)}

    def resolve_layouts(self, topics: set[str]) -> dict[str, str]:
        """Determine the layout of topics without a definition; return unreadable topics with reasons."""
        lost: dict[str, str] = {}
        for file in self.files:
            for number, channel in file.channels.items():
                if channel.topic in topics and not _is_defined(channel) and channel.notation != "known":
                    verdict = find_layout(file, channel) if channel.kind in KNOWN and channel.coding == "cdr" else None
                    if verdict is None:
                        lost[channel.topic] = f"its type {channel.kind} is defined neither in the bag nor in ROS"
                    elif verdict.channel is None:
                        lost[channel.topic] = verdict.reason
                    else:
                        file.channels[number] = verdict.channel
                        self.layouts[channel.topic] = verdict.reason
        return lost

    def set_aside(self) -> list[str]:
        """Return the reason for every unusable part of the container."""
        return [reason for file in self.files for reason in file.set_aside]


def _is_defined(channel: Channel) -> bool:
    """Return whether the layout of a channel's messages is known; for types that changed, only from the bag."""
    return is_known(channel) and bool(channel.definition or channel.kind not in KNOWN)


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Open a ROS 1 .bag, a ROS 2 folder, or a bare .mcap or .db3.

    Raises:
        LogError: The file does not exist, or cannot be read.
        DamagedLog: The file is no bag, or nothing of it can be recovered.
    """
    if not path.exists():
        raise LogError(path, "there is no such file or folder", cure="Check the path.")
    folder = folder_of(path) if path.is_dir() else Folder([path])
    for file in folder.files:
        _check(file)
    try:
        files = [_open_file(file) for file in folder.files]
    except LogError:
        raise
    except Exception as error:
        raise damaged(path, error) from error
    bag = Bag(path, list(files), warnings=list(folder.warnings))
    for found, file in zip(files, folder.files, strict=False):
        named = f"{file.name}: " if len(folder.files) > 1 else ""
        bag.warnings += [named + message for message in found.warnings]
        for number, channel in sorted(found.channels.items()):
            bag.topics[channel.topic] = channel.kind
            bag.counts[channel.topic] = bag.counts.get(channel.topic, 0) + found.counts.get(number, 0)
    if not any(bag.counts.values()) and (bag.warnings or bag.set_aside()):
        why = "; ".join([*bag.warnings, *bag.set_aside()][:3])
        raise DamagedLog(path, f"nothing can be recovered from it: {why}", cure=f"{AGAIN}.")
    yield bag


def _check(file: Path) -> None:
    """Refuse files with an obvious fault."""
    first = head(file, 64)
    if first.startswith(_LFS):
        raise DamagedLog(file, "this is a Git LFS pointer, not the bag itself", cure="Fetch the content: git lfs pull")
    if not first:
        raise DamagedLog(file, "the file is empty or cannot be read", cure=f"{AGAIN}.")
    if not first.startswith((ROS1, MCAP, SQLITE, ZSTD)):
        raise DamagedLog(file, "its content is not a ROS 1 bag, an mcap or a sqlite3 bag", cure=f"{AGAIN}.")


def _open_file(file: Path) -> BagFile:
    first = head(file, 64)
    if first.startswith(ZSTD):
        return _open_copy(file)
    if first.startswith(ROS1):
        return ros1_file.open_file(file)
    if first.startswith(MCAP):
        return mcap_file.open_file(file)
    return sqlite_file.open_file(file)


def _open_copy(file: Path) -> BagFile:
    """Open a file that the recorder compressed as a whole, unpacked for as long as it is in use."""
    scratch = Scratch()
    try:
        copy = scratch.path / file.stem
        unpack_file(file, copy)
        _check(copy)
        found = _open_file(copy)
    except BaseException:
        scratch.remove()
        raise
    weakref.finalize(found, scratch.remove)
    return found


def damaged(path: Path, error: Exception) -> DamagedLog:
    """Return the error with cause and cure."""
    if isinstance(error, Damage):
        return DamagedLog(path, str(error), cure="Record it again without encryption, or convert it: rosbag migrate.")
    cure = f"{AGAIN}."
    if isinstance(error, sqlite3.Error):
        cure = f"{AGAIN}, or recover what there is: sqlite3 {path.name} .recover"
    message = " ".join(str(part) for part in error.args) or repr(error)
    return DamagedLog(path, f"the bag is damaged ({type(error).__name__}: {message[:120]})", cure=cure)
