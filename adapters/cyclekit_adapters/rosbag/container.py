"""Open a bag, whatever wrote it, and walk through the messages of chosen topics.

The rosbags library reads the container; what it raises on a damaged file is its own business (a KeyError as well as a
failed assertion), so everything that goes wrong in it comes out of here as one error that names cause and cure. One
message that cannot be decoded is counted and left out; a container that cannot be walked is refused.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, get_typestore

from cyclekit.errors import DamagedLog, LogError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

ROS1, MCAP, SQLITE = b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\0"
_LFS = b"version https://git-lfs.github.com/spec/"
_AGAIN = "Copy it again from where it was recorded"

# A message of a bag has whatever fields its recorded definition has.
Message = Any


@dataclass
class Bag:
    """An open bag.

    Attributes:
        path: The file or folder.
        topics: Message type of every topic, as `package/msg/Type`, in ROS 1 bags too.
        counts: Messages per topic.
        messages_read: Messages decoded so far.
        undecodable: (topic, index within the topic, reason) of every message that could not be decoded.
    """

    path: Path
    topics: dict[str, str]
    counts: dict[str, int]
    _connections: list[Connection]
    _messages: Callable[[list[Connection]], Iterator[tuple[Connection, int, bytes]]]
    _decode: Callable[[bytes, str], object]
    messages_read: int = 0
    undecodable: list[tuple[str, int, str]] = field(default_factory=list)

    def messages(self, wanted: set[str]) -> Iterator[tuple[str, int, float, Message]]:
        """Yield (topic, index within the topic, receive time in s, message) of the `wanted` topics in bag order.

        Raises:
            DamagedLog: The container is broken somewhere in the middle.
        """
        connections = [connection for connection in self._connections if connection.topic in wanted]
        if not connections:  # to the library, none means all
            return
        index = dict.fromkeys(wanted, -1)
        try:
            for connection, receive_ns, raw in self._messages(connections):
                topic = connection.topic
                index[topic] += 1
                try:
                    message = self._decode(raw, connection.msgtype)
                except Exception as error:  # a broken payload raises anything
                    self.undecodable.append(
                        (topic, index[topic], f"{topic}: message cannot be decoded ({error!r:.80})")
                    )
                    continue
                self.messages_read += 1
                yield topic, index[topic], receive_ns * 1e-9, message
        except Exception as error:
            raise _damaged(self.path, error) from error


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Open a ROS 1 .bag, a ROS 2 folder, or a bare .mcap or .db3.

    Raises:
        LogError: There is no such file, or it cannot be read.
        DamagedLog: It is no bag, or a broken one.
    """
    _check(path)
    with ExitStack() as stack:
        reader, decode = _open(path, stack)
        connections = list(reader.connections)
        counts: dict[str, int] = {}
        for connection in connections:
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
        topics = {connection.topic: connection.msgtype for connection in connections}
        yield Bag(path, topics, counts, connections, reader.messages, decode)


def is_bag(path: Path) -> bool:
    """Tell from the first bytes whether `path` is a bag; a folder is one if its metadata.yaml says so."""
    if path.is_dir():
        return b"rosbag2_bagfile_information" in head(path / "metadata.yaml", 4096)
    first = head(path, 65536)
    return first.startswith((ROS1, MCAP)) or (first.startswith(SQLITE) and b"serialization_format" in first)


def head(path: Path, size: int) -> bytes:
    """Return the first `size` bytes of a file, none of what cannot be read."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as log:
            return log.read(size)
    except OSError:
        return b""


def _check(path: Path) -> None:
    """Refuse what can be named better than by the library's error."""
    if not path.exists():
        raise LogError(path, "there is no such file or folder", cure="Check the path.")
    for file in _files(path):
        first = head(file, 64)
        if first.startswith(_LFS):
            raise DamagedLog(
                file, "this is a Git LFS pointer, not the bag itself", cure="Fetch the content: git lfs pull"
            )
        if not first:
            raise DamagedLog(file, "the file is empty or cannot be read", cure=f"{_AGAIN}.")
        if not first.startswith((ROS1, MCAP, SQLITE)) and file.suffix not in (".zstd", ".yaml"):
            raise DamagedLog(file, "not a ROS 1 bag, an mcap or a sqlite3 bag by its content", cure=f"{_AGAIN}.")
        if first.startswith(MCAP) and not _ends_with(file, MCAP):
            cure = f"{_AGAIN}, or recover what there is: mcap recover {file.name} -o recovered.mcap"
            raise DamagedLog(file, "the bag is cut: its footer is missing", cure=cure)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))


def _ends_with(path: Path, ending: bytes) -> bool:
    with path.open("rb") as log:
        log.seek(-min(len(ending), path.stat().st_size), 2)
        return log.read() == ending


def _open(path: Path, stack: ExitStack) -> tuple[Any, Callable[[bytes, str], object]]:
    """Open by the definitions in the bag; where they contradict themselves, by the well-known ones."""
    ros1 = head(path, 16).startswith(ROS1)
    try:
        if not ros1 or path.suffix == ".bag":  # AnyReader tells ROS 1 by the name alone
            reader = stack.enter_context(AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)))
            return reader, reader.deserialize
    except Exception as error:
        return _open_known(path, stack, ros1=ros1, because=error)
    return _open_known(path, stack, ros1=ros1, because=None)


def _open_known(
    path: Path, stack: ExitStack, *, ros1: bool, because: Exception | None
) -> tuple[Any, Callable[[bytes, str], object]]:
    try:
        if ros1:
            store = get_typestore(Stores.ROS1_NOETIC)
            return stack.enter_context(Reader1(path)), store.deserialize_ros1
        store = get_typestore(Stores.ROS2_HUMBLE)
        return stack.enter_context(Reader2(path)), store.deserialize_cdr
    except Exception as error:
        raise _damaged(path, because or error) from error


def _damaged(path: Path, error: Exception) -> DamagedLog:
    """Put what the library said into cause and cure."""
    said = " ".join(str(part) for part in error.args) or repr(error)
    cure = f"{_AGAIN}."
    if "Profile is not ros2" in said:
        return DamagedLog(path, "a ROS 1 recording in an mcap, which is not read", cure="Give the .bag it came from.")
    if "index" in said and head(path, 16).startswith(ROS1):
        return DamagedLog(
            path, "the bag is cut or was never closed: it has no index", cure=f"Run: rosbag reindex {path.name}"
        )
    if isinstance(error, sqlite3.Error):
        cure = f"{_AGAIN}, or recover what there is: sqlite3 {path.name} .recover"
    return DamagedLog(path, f"the bag is damaged ({type(error).__name__}: {said[:120]})", cure=cure)
