"""Look through a sqlite3 bag (.db3) and read it topic by topic.

One SELECT per topic hands the rows over without a step of Python in between. A file that was cut is read up to the
first page that is missing; where the cut goes through a page, sqlite would take what is missing of it for zeros, so a
temporary copy that ends with the last whole page is read instead. The bags of older ROS 2 versions record no
definitions; the well-known ones are used then.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
import weakref
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import numpy as np

from cyclekit_adapters.rosbag.chunks import moment
from cyclekit_adapters.rosbag.payloads import BLOCK_BYTES, Channel, Ints, Payloads

MAGIC = b"SQLite format 3\0"
_NOTATIONS = {"ros2msg": "msg", "ros2idl": "idl"}
_ROWS = 512  # rows fetched at once; many more, and they leave the processor's cache before they are joined
_GLANCE = 10_000  # rows looked at before all of them are counted
_SELECT = "SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY rowid"


@dataclass
class SqliteFile:
    """A .db3 as far as it is whole; meets `payloads.BagFile`."""

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    set_aside: list[str] = field(default_factory=list)
    cut: bool = False

    def blocks(self, wanted: set[int]) -> Iterator[Mapping[int, Payloads]]:
        """Yield the messages of the wanted channels in the order of the file, about BLOCK_BYTES at a time."""
        with closing(_connect(self.path, cut=self.cut)) as bag:
            for number in sorted(wanted):
                batches: list[_Batch] = []
                for batch in self._batches(bag, number):
                    batches.append(batch)
                    if sum(len(one.raw) for one in batches) >= BLOCK_BYTES:
                        yield {number: _joined(batches)}
                        batches = []
                if batches:
                    yield {number: _joined(batches)}

    def _batches(self, bag: sqlite3.Connection, number: int) -> Iterator[_Batch]:
        done = 0
        try:
            cursor = bag.execute(_SELECT, (number,))
            while rows := cursor.fetchmany(_ROWS):
                done += len(rows)
                yield self._batch(rows)
        except sqlite3.DatabaseError as error:
            if not self.cut:
                self.set_aside.append(f"{self.channels[number].topic}: the rest cannot be read ({error})")
            yield from self._one_by_one(bag, number, done)

    def _one_by_one(self, bag: sqlite3.Connection, number: int, done: int) -> Iterator[_Batch]:
        """Fetch the whole rows that were lost with the one that broke their batch."""
        try:
            for row in bag.execute(f"{_SELECT} LIMIT {_ROWS} OFFSET {done}", (number,)):
                yield self._batch([row])
        except sqlite3.DatabaseError:
            return

    def _batch(self, rows: list[tuple[object, object]]) -> _Batch:
        """Join rows; those whose columns are not what they should be, as in a damaged file, are set aside."""
        times, messages = zip(*rows, strict=True)
        if set(map(type, times)) != {int} or set(map(type, messages)) != {bytes}:
            sound = [row for row in rows if isinstance(row[0], int) and isinstance(row[1], bytes)]
            self.set_aside += ["a row of the bag is damaged: no time or no message"] * (len(rows) - len(sound))
            times, messages = [t for t, _ in sound], [data for _, data in sound]  # type: ignore[assignment]
        size = np.fromiter(map(len, messages), np.int64, len(messages))
        return _Batch(np.array(times, np.int64), size, b"".join(messages))


@dataclass(frozen=True)
class _Batch:
    """Some rows of one topic: receive times (ns) and sizes, shape (N,), and the messages end to end."""

    receive_ns: Ints
    size: Ints
    raw: bytes


def _joined(batches: list[_Batch]) -> Payloads:
    size = np.concatenate([batch.size for batch in batches])
    buffer = np.frombuffer(b"".join(batch.raw for batch in batches), np.uint8)
    return Payloads(buffer, np.cumsum(size) - size, size, np.concatenate([batch.receive_ns for batch in batches]))


def look(path: Path) -> SqliteFile:
    """Return what a sqlite3 bag holds, as far as it is whole.

    Raises:
        sqlite3.Error: The tables of topics cannot be read.
    """
    found = SqliteFile(path)
    try:
        with closing(_connect(path, cut=False)) as bag:
            found.channels = _channels(bag)
            found.counts = _present(bag, set(found.channels), torn=_torn(path) > 0)
    except sqlite3.DatabaseError as error:
        found.cut = True
        found.path = _whole_pages(found)
        with closing(_connect(found.path, cut=True)) as bag:
            found.channels = _channels(bag)
            last_ns = _count(bag, found)
        if last_ns is None:
            raise
        found.warnings.append(
            f"the bag is cut or damaged ({error}); messages up to {moment(last_ns)} are recovered, "
            "what came after is lost"
        )
    beside = path.with_name(path.name + "-wal")
    if beside.is_file() and beside.stat().st_size:
        found.warnings.append(
            f"the recorder was killed: what stands in {beside.name} is not in the bag and is not read"
        )
    return found


def _torn(path: Path) -> int:
    """Return how many bytes of a page that is not whole stand at the end of the file."""
    with path.open("rb") as log:
        page = int.from_bytes(log.read(18)[16:], "big")
        return log.seek(0, 2) % {0: 512, 1: 65536}.get(page, page)


def _whole_pages(found: SqliteFile) -> Path:
    """Return the file, or a temporary copy without its torn page that lives as long as `found`."""
    torn = _torn(found.path)
    if not torn:
        return found.path
    folder = tempfile.mkdtemp(prefix="cyclekit-")
    weakref.finalize(found, shutil.rmtree, folder, ignore_errors=True)
    copy = Path(folder, found.path.name)
    shutil.copyfile(found.path, copy)
    with copy.open("r+b") as out:
        out.truncate(copy.stat().st_size - torn)
    return copy


def _connect(path: Path, *, cut: bool) -> sqlite3.Connection:
    """Open for reading alone; `cut` lets sqlite begin on a file that is shorter than its first page says."""
    bag = sqlite3.connect(f"file:{quote(str(path.absolute()))}?immutable=1&mode=ro", uri=True)
    if cut:
        bag.execute("PRAGMA writable_schema = ON")
    return bag


def _channels(bag: sqlite3.Connection) -> dict[int, Channel]:
    tables = {name for (name,) in bag.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"messages", "topics"} <= tables:
        raise sqlite3.DatabaseError("no tables of topics and messages")
    definitions: dict[str, tuple[str, str]] = {}
    if "message_definitions" in tables:
        select = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions ORDER BY id"
        for kind, encoding, text in bag.execute(select):
            if encoding in _NOTATIONS:
                definitions.setdefault(kind, (str(text), _NOTATIONS[encoding]))
    channels = {}
    for number, topic, kind, coding in bag.execute("SELECT id, name, type, serialization_format FROM topics"):
        text, notation = definitions.get(kind, ("", "msg"))
        channels[int(number)] = Channel(int(number), str(topic), str(kind), text, notation, str(coding))
    return channels


def _present(bag: sqlite3.Connection, topics: set[int], *, torn: bool) -> dict[int, int]:
    """Count messages by topic; where the first rows already show every topic, theirs are count enough."""
    if torn:
        raise sqlite3.DatabaseError("its last page is not whole")
    for rows in (f"(SELECT topic_id FROM messages LIMIT {_GLANCE})", "messages"):
        counts: dict[int, int] = dict(bag.execute(f"SELECT topic_id, count(*) FROM {rows} GROUP BY topic_id"))
        if topics <= set(counts):
            break
    return counts


def _count(bag: sqlite3.Connection, found: SqliteFile) -> int | None:
    """Count the messages before the first missing page; return the last time among them."""
    counts: Counter[int] = Counter()
    last_ns: int | None = None
    try:
        for number, time in bag.execute("SELECT topic_id, timestamp FROM messages ORDER BY rowid"):
            if number in found.channels and isinstance(time, int):
                counts[number] += 1
                last_ns = max(last_ns or 0, time)
    except sqlite3.DatabaseError:
        pass
    found.counts = dict(counts)
    return last_ns
