"""Damaged bags, truncated at random bytes or with one flipped bit: recovered messages, warnings and wrong values.

Writes one short recording (JointState 500 Hz, PoseStamped 125 Hz, Float64 100 Hz) in six containers. A truncated bag is
read message by message and compared with the intact one: share of recovered messages in chunks (of a db3: pages) before
the cut, number of wrong values, and whether the reported end of the recovered time is right. A fifth of the truncated
bags is also read with rosbags. A bag with a flipped bit is read into tables as by an ingest. Counted: refused,
warning of the reader (checksum, structure), warning of the checks of values, or no warning although a value differs.

    python benchmarks/bag_damage.py --cuts 500 --flips 1000 --seconds 6
"""

from __future__ import annotations

import argparse
import random
import re
import struct
import tempfile
from collections import Counter
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from bag_reading import JOINTS, POSE, SCALING, TOPICS, message, moments
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as WriterM
from rich.console import Console
from rich.table import Table
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from cyclekit.adapter import ReadOptions, Recording
from cyclekit.errors import LogError
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.rosbag import ADAPTER
from cyclekit_adapters.rosbag.chunks import moment
from cyclekit_adapters.rosbag.container import opened

Rows = dict[str, np.ndarray[Any, Any]]

CHUNK_BYTES = 32 << 10
KINDS = ("ros1", "ros1-lz4", "mcap", "mcap-zstd", "mcap-lz4", "db3")
COMPRESSIONS = {"mcap": CompressionType.NONE, "mcap-zstd": CompressionType.ZSTD, "mcap-lz4": CompressionType.LZ4}
PATHS: dict[str, list[tuple[str, ...]]] = {
    JOINTS: [("position",), ("velocity",), ("effort",)],
    POSE: [("pose", "position", axis) for axis in "xyz"] + [("pose", "orientation", axis) for axis in "xyzw"],
    SCALING: [("data",)],
}


def write(folder: Path, kind: str, seconds: int) -> Path:
    """Write the recording as one file in a container."""
    ros1 = kind.startswith("ros1")
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    pack = store.serialize_ros1 if ros1 else store.serialize_cdr
    said = [
        (topic, at, bytes(pack(message(store.types, topic, at, ros1=ros1), TOPICS[topic][0])))
        for at, topic in moments(seconds)
    ]
    if kind in COMPRESSIONS:
        with (folder / "run.mcap").open("wb") as log:
            writer = WriterM(log, chunk_size=CHUNK_BYTES, compression=COMPRESSIONS[kind])
            writer.start("ros2", "benchmark")
            channels = {}
            for topic, (name, _) in TOPICS.items():
                text = store.generate_msgdef(name, ros_version=2)[0].encode()
                channels[topic] = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", text))
            for topic, at, raw in said:
                writer.add_message(channels[topic], at, raw, at)
            writer.finish()
        return folder / "run.mcap"
    other: Any = (
        Writer1(folder / "run.bag")
        if ros1
        else Writer2(folder / "run", version=9, storage_plugin=StoragePlugin.SQLITE3)
    )
    if ros1:
        other.chunk_threshold = CHUNK_BYTES
        if kind == "ros1-lz4":
            other.set_compression(Writer1.CompressionFormat.LZ4)
    with other:
        known = {topic: other.add_connection(topic, name, typestore=store) for topic, (name, _) in TOPICS.items()}
        for topic, at, raw in said:
            other.write(known[topic], at, raw)
    return folder / "run.bag" if ros1 else folder / "run" / "run.db3"


def needed(path: Path, rows: Rows) -> Rows:
    """Return for every message the end, bytes, of its chunk or page: the minimum size of a file that has it."""
    if path.suffix == ".db3":
        content, ends = path.read_bytes(), {}
        page = struct.unpack_from(">H", content, 16)[0]
        for topic, table in rows.items():
            # the time directly precedes the payload, which begins with the encoding's mark
            at = [content.index(struct.pack(">q", int(time_ns)) + b"\0\1\0\0") for time_ns in table["time"]]
            ends[topic] = (np.array(at) // page + 1) * page
        return ends
    found: dict[str, list[int]] = {topic: [] for topic in rows}
    if path.suffix == ".bag":
        with Reader1(path) as bag:
            topics = {connection.id: connection.topic for connection in bag.connections}
            for info in bag.chunk_infos:
                chunk = bag.chunks[info.pos]
                for number, count in info.connection_counts.items():
                    found[topics[number]] += [chunk.datapos + chunk.datasize] * count
    else:
        with path.open("rb") as log:
            summary = make_reader(log).get_summary()
            assert summary is not None
            for index in summary.chunk_indexes:
                for channel, offset in index.message_index_offsets.items():
                    log.seek(offset + 11)
                    count = struct.unpack("<I", log.read(4))[0] // 16
                    found[summary.channels[channel].topic] += [index.chunk_start_offset + index.chunk_length] * count
    return {topic: np.array(ends) for topic, ends in found.items()}


def read(path: Path) -> tuple[Rows, list[str]]:
    """Return times and values of all messages by topic, and the reader's warnings."""
    parts: dict[str, list[np.ndarray[Any, Any]]] = {topic: [] for topic in TOPICS}
    with opened(path) as bag:
        for arrived in bag.messages(set(TOPICS)):
            columns = [np.asarray(arrived.group.numbers(*one)) for one in PATHS[arrived.topic]]
            values = np.column_stack(columns)
            rows = np.empty(len(values), [("time", "i8"), ("values", "f8", values.shape[1:])])
            rows["time"], rows["values"] = arrived.group.receive_ns, values
            parts[arrived.topic].append(rows)
        said = [*bag.warnings, *bag.set_aside(), *(reason for _, _, reason in bag.undecodable)]
    return {topic: np.sort(np.concatenate(part), order="time") for topic, part in parts.items() if part}, said


def cut(kind: str, whole: Path, seed: int, times: int) -> dict[str, Any]:
    """Truncate the file at random bytes, read the rest, and return the counts."""
    content, true, chance = whole.read_bytes(), read(whole)[0], random.Random(seed)
    ends, path, count = needed(whole, true), whole.with_name(f"cut{whole.suffix}"), Counter[str]()
    for number in range(times):
        size = chance.randrange(1, len(content))
        path.write_bytes(content[:size])
        complete = {topic: true[topic]["time"][ends[topic] <= size] for topic in true}
        count["complete"] += sum(part.size for part in complete.values())
        try:
            found, said = read(path)
        except LogError:
            found, said = {}, []
            count["refused"] += 1
            count["refused with complete messages"] += any(part.size for part in complete.values())
        else:
            count["silent"] += not said
        last = max((int(part["time"][-1]) for part in found.values()), default=0)
        text = " ".join(said)
        count["time said"] += "recovered, later ones are lost" in text
        count["time right"] += bool(last) and f"up to {moment(last)} are recovered" in text
        if least := re.search(r"at least ([\d.]+) s", text):
            lost = (max(int(part["time"][-1]) for part in true.values()) - last) / 1e9
            count["loss said"] += 1
            count["loss overstated"] += float(least[1]) > lost + 0.1
        for topic, part in found.items():
            place = np.searchsorted(true[topic]["time"], part["time"]).clip(0, true[topic].size - 1)
            count["wrong"] += int((true[topic][place] != part).sum()) + part.size - np.unique(part["time"]).size
            count["recovered"] += int(np.isin(complete[topic], part["time"]).sum())
            count["beyond"] += int((~np.isin(part["time"], complete[topic])).sum())
        if number % 5 == 0:
            count["rival tries"] += 1
            count["rival"] += rosbags_reads(path)
    return {"kind": kind, **count}


def rosbags_reads(path: Path) -> bool:
    """Return whether rosbags reads at least one message of a file."""
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            return next(reader.messages(), None) is not None
    except Exception:
        return False


def flip(kind: str, whole: Path, seed: int, times: int) -> dict[str, Any]:
    """Flip one random bit at a time, read the bag into tables, and return the counts."""
    content, chance, count = whole.read_bytes(), random.Random(seed), Counter[str]()
    true = ADAPTER.read(whole, ReadOptions())
    true_examined = examined(true)
    path = whole.with_name(f"flipped{whole.suffix}")
    for _ in range(times):
        broken = bytearray(content)
        broken[chance.randrange(len(broken))] ^= 1 << chance.randrange(8)
        path.write_bytes(broken)
        count[judged(path, true, true_examined)] += 1
    return {"kind": kind, **count}


def judged(path: Path, true: Recording, true_examined: Recording) -> str:
    """Return the category of the result for one damaged bag."""
    try:
        found = ADAPTER.read(path, ReadOptions())
    except LogError:
        return "refused"
    if said_more(found, true):
        return "structure"
    looked = examined(found)
    if said_more(looked, true_examined):
        return "plausibility"
    theirs, ours = looked.tables(), true_examined.tables()
    same = theirs.keys() == ours.keys() and all(theirs[name].equals(ours[name]) for name in ours)
    return "harmless" if same else "unnoticed"


def said_more(found: Recording, true: Recording) -> bool:
    """Return whether a recording has other warnings than the intact one, or rows set aside."""
    return set(found.warnings) != set(true.warnings) or bool(found.set_aside is not None and found.set_aside.height)


def work(task: tuple[str, str, int, int, int]) -> dict[str, Any]:
    """Apply one kind of damage to one container, in a separate process and folder."""
    what, kind, seed, times, seconds = task
    with tempfile.TemporaryDirectory() as folder:
        return (cut if what == "cut" else flip)(kind, write(Path(folder), kind, seconds), seed, times)


def main() -> None:
    """Damage the bags and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--cuts", type=int, default=500)
    parser.add_argument("--flips", type=int, default=1000)
    parser.add_argument("--seconds", type=int, default=6, help="length of the recording")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    console = Console(width=150)
    with get_context("spawn").Pool(2) as pool:
        tasks = [("cut", kind, asked.seed, asked.cuts, asked.seconds) for kind in KINDS if asked.cuts]
        columns = ("complete", "recovered", "beyond", "wrong", "refused", "refused with complete messages", "silent")
        columns += ("time said", "time right", "loss said", "loss overstated", "rival tries", "rival")
        show(console, f"{asked.cuts} cuts each", columns, pool.imap(work, tasks))
        tasks = [("flip", kind, asked.seed, asked.flips, asked.seconds) for kind in KINDS if asked.flips]
        columns = ("refused", "structure", "plausibility", "harmless", "unnoticed")
        show(console, f"{asked.flips} flipped bits each", columns, pool.imap(work, tasks))


def show(console: Console, title: str, columns: tuple[str, ...], rows: Any) -> None:  # noqa: ANN401 - an iterator
    """Print a table of counts."""
    table = Table(title=title)
    for name in ("container", *columns):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(row["kind"], *(f"{row.get(name, 0)}" for name in columns))
    if table.row_count:
        console.print(table)


if __name__ == "__main__":
    main()
