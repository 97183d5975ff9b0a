"""Survey of a sqlite3 bag (.db3), and its messages topic by topic.

One SELECT per topic returns the rows without Python code in between. A file that sqlite cannot open, or not read to its
end, is read page by page instead (`sqlite_pages`). Bags of older ROS 2 versions store no definitions; `undefined`
replaces them.
"""

from __future__ import annotations

import shutil
import sqlite3
import weakref
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import numpy as np

from cyclekit.adapter import Scratch
from cyclekit_adapters.rosbag.chunks import moment
from cyclekit_adapters.rosbag.payloads import BLOCK_BYTES, Channel, Damage, Ints, Payloads
from cyclekit_adapters.rosbag.sqlite_pages import NoPages, Pages, Value

_NOTATIONS = {"ros2msg": "msg", "ros2idl": "idl"}
_ROWS = 512  # rows fetched at once; more of them leave the processor's cache before they are joined
_GLANCE = 10_000  # rows read before all of them are counted
_MAX_ROW = 64 << 20  # bytes; limit for sqlite values, whatever a table declares
_SELECT = "SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY rowid"
_DATABASE = "no tables of topics and messages"


@dataclass
class SqliteFile:
    """The readable part of a .db3; implements `payloads.BagFile`.

    Attributes:
        salvaged: Sqlite cannot read the file, so its pages are read one by one.
        copy: File that is read instead, if the recorder was killed.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    set_aside: list[str] = field(default_factory=list)
    salvaged: bool = False
    copy: Path | None = None

    def blocks(self, wanted: set[int]) -> Iterator[Mapping[int, Payloads]]:
        """Yield the messages of the wanted channels in file order, about BLOCK_BYTES at a time."""
        if self.salvaged:
            yield from self._from_pages(wanted, {})
            return
        broken: dict[int, int] = {}
        with closing(_connect(self.copy or self.path)) as bag:
            for number in sorted(wanted):
                batches: list[_Batch] = []
                for batch in self._batches(bag, number, broken):
                    batches.append(batch)
                    if sum(len(one.raw) for one in batches) >= BLOCK_BYTES:
                        yield {number: _joined(batches)}
                        batches = []
                if batches:
                    yield {number: _joined(batches)}
        if broken:
            yield from self._from_pages(set(broken), broken)

    def _batches(self, bag: sqlite3.Connection, number: int, broken: dict[int, int]) -> Iterator[_Batch]:
        """Yield the rows of a topic; if sqlite stops, store the last row that it returned."""
        done = 0
        try:
            cursor = bag.execute(_SELECT, (number,))
            while rows := cursor.fetchmany(_ROWS):
                done += len(rows)
                yield self._batch(rows)
        except sqlite3.DatabaseError as error:
            message = f"{self.channels[number].topic}: a page of the bag is damaged ({error}); the others are read"
            self.set_aside += [message] if message not in self.set_aside else []
            broken[number] = _last_row(bag, number, done)

    def _batch(self, rows: list[tuple[object, object]]) -> _Batch:
        """Join rows; rows with columns of wrong type, as in a damaged file, are set aside."""
        times, messages = zip(*rows, strict=True)
        if set(map(type, times)) != {int} or set(map(type, messages)) != {bytes}:
            sound = [row for row in rows if isinstance(row[0], int) and isinstance(row[1], bytes)]
            self.set_aside += ["a row of the bag is damaged: no time or no message"] * (len(rows) - len(sound))
            times, messages = [t for t, _ in sound], [data for _, data in sound]  # type: ignore[assignment]
        size = np.fromiter(map(len, messages), np.int64, len(messages))
        return _Batch(np.array(times, np.int64), size, b"".join(messages))

    def _from_pages(self, wanted: set[int], after: Mapping[int, int]) -> Iterator[Mapping[int, Payloads]]:
        """Yield the messages after a given row of each topic, from the pages."""
        with (self.copy or self.path).open("rb") as log:
            rows = _messages(Pages(log), set(self.channels))
            found = ((t, at, raw) for row, t, at, raw in rows if t in wanted and row > after.get(t, -1))
            while some := list(_up_to(found, BLOCK_BYTES)):
                block = {}
                for number in sorted({topic for topic, _, _ in some}):
                    block[number] = _joined([self._batch([(at, raw) for topic, at, raw in some if topic == number])])
                yield block


@dataclass(frozen=True)
class _Batch:
    """Some rows of one topic: receive times (ns) and sizes, shape (N,), and the concatenated messages."""

    receive_ns: Ints
    size: Ints
    raw: bytes


def _joined(batches: list[_Batch]) -> Payloads:
    size = np.concatenate([batch.size for batch in batches])
    buffer = np.frombuffer(b"".join(batch.raw for batch in batches), np.uint8)
    return Payloads(buffer, np.cumsum(size) - size, size, np.concatenate([batch.receive_ns for batch in batches]))


def _up_to(rows: Iterable[tuple[int, int, bytes]], most: int) -> Iterator[tuple[int, int, bytes]]:
    size = 0
    for row in rows:
        size += len(row[2])
        yield row
        if size >= most:
            return


def open_file(path: Path) -> SqliteFile:
    """Return the content of a sqlite3 bag.

    Raises:
        sqlite3.Error: The tables of topics cannot be read.
        Damage: The file is a database, but no bag.
    """
    found = SqliteFile(path)
    journal = path.with_name(path.name + "-wal")
    if journal.is_file() and journal.stat().st_size:
        found.copy = _recovered(found, journal)
    try:
        with closing(_connect(found.copy or path)) as bag:
            found.channels = _channels(bag)
            found.counts = _present(bag, set(found.channels), torn=_torn(path) > 0 and found.copy is None)
    except sqlite3.DatabaseError as error:
        _salvage(found, error)
    return found


def _recovered(found: SqliteFile, journal: Path) -> Path | None:
    """Return a copy of the bag into which sqlite merged the log of a killed recorder; None if that fails."""
    scratch = Scratch()
    folder = scratch.path
    weakref.finalize(found, scratch.remove)
    copy = Path(folder, found.path.name)
    try:
        for file in (found.path, journal):
            shutil.copyfile(file, Path(folder, file.name))
        with closing(sqlite3.connect(copy)) as bag:
            bag.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    except (sqlite3.Error, OSError):
        message = f"the recorder was killed: the content of {journal.name} is not in the bag and cannot be read"
        found.warnings.append(message)
        return None
    found.warnings.append(f"the recorder was killed: the content of {journal.name} is read too")
    return copy


def _torn(path: Path) -> int:
    """Return the number of bytes of an incomplete page at the end of the file."""
    with path.open("rb") as log:
        page = int.from_bytes(log.read(18)[16:], "big")
        return log.seek(0, 2) % {0: 512, 1: 65536}.get(page, page)


def _connect(path: Path) -> sqlite3.Connection:
    """Open read-only."""
    bag = sqlite3.connect(f"file:{quote(str(path.absolute()))}?immutable=1&mode=ro", uri=True)
    bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_ROW)
    return bag


def _last_row(bag: sqlite3.Connection, number: int, done: int) -> int:
    """Return the number of the last returned row of a topic; -1 if none."""
    select = "SELECT rowid FROM messages WHERE topic_id = ? ORDER BY rowid LIMIT ?"
    with suppress(sqlite3.DatabaseError):
        return max((int(row) for (row,) in bag.execute(select, (number, done))), default=-1)
    return -1


def _channels(bag: sqlite3.Connection) -> dict[int, Channel]:
    tables = {name for (name,) in bag.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"messages", "topics"} <= tables:
        raise Damage(_DATABASE)
    if any(hidden for *_, hidden in bag.execute("PRAGMA table_xinfo(messages)")):
        raise Damage("its messages are computed, not recorded")
    definitions: list[tuple[Value, ...]] = []
    if "message_definitions" in tables:
        select = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions ORDER BY id"
        definitions = list(bag.execute(select))
    return _made(bag.execute("SELECT id, name, type, serialization_format FROM topics"), definitions)


def _made(topics: Iterable[tuple[Value, ...]], definitions: Iterable[tuple[Value, ...]]) -> dict[int, Channel]:
    """Return channels from (number, name, type, coding) and (type, notation, text)."""
    known: dict[object, tuple[str, str]] = {}
    for kind, encoding, text in definitions:
        if encoding in _NOTATIONS:
            known.setdefault(kind, (str(text), _NOTATIONS[str(encoding)]))
    channels = {}
    for number, topic, kind, coding in topics:
        text, notation = known.get(kind, ("", "msg"))
        channels[int(str(number))] = Channel(int(str(number)), str(topic), str(kind), text, notation, str(coding))
    return channels


def _present(bag: sqlite3.Connection, topics: set[int], *, torn: bool) -> dict[int, int]:
    """Count messages by topic; if the first rows already show every topic, their counts suffice."""
    if torn:
        raise sqlite3.DatabaseError("its last page is not whole")
    for rows in (f"(SELECT topic_id FROM messages LIMIT {_GLANCE})", "messages"):
        counts: dict[int, int] = dict(bag.execute(f"SELECT topic_id, count(*) FROM {rows} GROUP BY topic_id"))
        if topics <= set(counts):
            break
    return counts


def _salvage(found: SqliteFile, error: sqlite3.DatabaseError) -> None:
    """Read the pages of a file that sqlite cannot read.

    Raises:
        sqlite3.DatabaseError: Not even the topics can be read.
    """
    found.salvaged, counts, numbers, last_ns = True, Counter[int](), 0, 0
    with (found.copy or found.path).open("rb") as log:
        try:
            pages = Pages(log)
        except NoPages as reason:
            raise sqlite3.DatabaseError(str(reason)) from error
        tables = pages.tables()
        if not {"messages", "topics"} <= set(tables):
            raise error
        rows = ((number, *row[1:4]) for number, row in pages.below(tables["topics"]) if len(row) >= 4)
        root = tables.get("message_definitions", 0)
        found.channels = _made(rows, (tuple(row[1:4]) for _, row in pages.below(root) if len(row) >= 4))
        for number, topic, time, _ in _messages(pages, set(found.channels)):
            counts[topic] += 1
            numbers, last_ns = max(numbers, number), max(last_ns, time)
        missing = pages.missing
    if not counts:
        raise error
    found.counts = dict(counts)
    message = f"the bag is cut or damaged ({error}): {missing} of its pages are missing; " if missing else ""
    message = message or f"the bag is cut or damaged ({error}); "
    between = numbers - sum(counts.values())
    message += f"messages up to {moment(last_ns)} are recovered"
    message += f", except {between} in between," if between > 0 else ","
    found.warnings.append(f"{message} later ones are lost")


def _messages(pages: Pages, topics: set[int]) -> Iterator[tuple[int, int, int, bytes]]:
    """Yield row number, topic, time (ns) and bytes of every message, from any page."""
    others = {page for name, root in pages.tables().items() if name != "messages" for page in pages.pages_below(root)}
    for number, row in pages.everywhere(but=others):
        if len(row) == 4:
            _, topic, time, raw = row
            if isinstance(topic, int) and isinstance(time, int) and isinstance(raw, bytes) and topic in topics:
                yield number, topic, time, raw
