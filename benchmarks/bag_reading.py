"""Speed of reading bags: the usual loop with the rosbags library compared with the vectorised reader.

Writes one recording (JointState 500 Hz, PoseStamped 125 Hz, Float64 100 Hz) as mcap, mcap with zstd chunks, ROS 1 bag,
ROS 1 bag with lz4 chunks and db3; then reads each with both into the same arrays, each time in a separate process,
alternating. Prints medians and ratios of wall and CPU time, and whether both read the same numbers. The third way is
the whole adapter, which writes the arrays into one table with one clock. Each process first reads a recording of one
second, so that imports are not measured.

    python benchmarks/bag_reading.py --seconds 180 --repeats 5
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

JOINTS, POSE, SCALING = "/joint_states", "/tcp_pose_broadcaster/pose", "/speed_scaling_factor"
TOPICS = {
    JOINTS: ("sensor_msgs/msg/JointState", 500),
    POSE: ("geometry_msgs/msg/PoseStamped", 125),
    SCALING: ("std_msgs/msg/Float64", 100),
}
NAMES = [f"{part}_joint" for part in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
BAGS = {"mcap": "mcap", "mcap-zstd": "mcap-zstd", "ros1": "ros1.bag", "ros1-lz4": "ros1-lz4.bag", "db3": "db3"}
WAYS = ("rosbags", "vectorised", "adapter")
BEGIN_NS = 1_700_000_000 * 10**9


def moments(seconds: int) -> Iterator[tuple[int, str]]:
    """Yield (time in ns, topic) of every message of the recording, by time."""
    times = [
        (BEGIN_NS + number * 10**9 // rate + late, topic)
        for late, (topic, (_, rate)) in enumerate(TOPICS.items())
        for number in range(seconds * rate)
    ]
    return iter(sorted(times))


def message(types: Any, topic: str, time_ns: int, *, ros1: bool) -> object:  # noqa: ANN401 - the library's types
    """Return the message of a topic at a time."""
    x = (time_ns - BEGIN_NS) * 1e-9
    if topic == SCALING:
        return types["std_msgs/msg/Float64"](data=float(int(x / 5) % 5) / 4)
    stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **({"seq": 0} if ros1 else {}))
    if topic == JOINTS:
        angles = np.sin(x + np.arange(6.0))
        values = {"position": angles, "velocity": np.cos(x + np.arange(6.0)), "effort": angles * 3}
        return types["sensor_msgs/msg/JointState"](header=header, name=NAMES, **values)
    place = types["geometry_msgs/msg/Point"](x=np.sin(x), y=np.cos(x), z=0.5)
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=np.sin(x / 2), w=np.cos(x / 2))
    pose = types["geometry_msgs/msg/Pose"](position=place, orientation=turn)
    return types["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)


def write(folder: Path, seconds: int) -> None:
    """Write the recording in every container."""
    for ros1 in (False, True):
        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        writers: list[Any] = []
        if ros1:
            writers = [Writer1(folder / BAGS["ros1"]), Writer1(folder / BAGS["ros1-lz4"])]
            writers[1].set_compression(Writer1.CompressionFormat.LZ4)
        else:
            kinds = {"mcap": StoragePlugin.MCAP, "mcap-zstd": StoragePlugin.MCAP, "db3": StoragePlugin.SQLITE3}
            writers = [Writer2(folder / BAGS[name], version=9, storage_plugin=kind) for name, kind in kinds.items()]
            writers[1].set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for writer in writers:
            writer.open()
        connections = [
            {topic: writer.add_connection(topic, kind, typestore=store) for topic, (kind, _) in TOPICS.items()}
            for writer in writers
        ]
        for time_ns, topic in moments(seconds):
            kind = TOPICS[topic][0]
            said = message(store.types, topic, time_ns, ros1=ros1)
            raw = store.serialize_ros1(said, kind) if ros1 else store.serialize_cdr(said, kind)
            for writer, known in zip(writers, connections, strict=True):
                writer.write(known[topic], time_ns, raw)
        for writer in writers:
            writer.close()


def by_rosbags(path: Path) -> list[np.ndarray[Any, Any]]:
    """Return receive times, angles, speeds, positions and scalings, read with the rosbags library."""
    times: dict[str, list[int]] = {topic: [] for topic in TOPICS}
    angles, speeds, places, scalings = [], [], [], []
    with AnyReader([path]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in TOPICS]
        for connection, time_ns, raw in reader.messages(wanted):
            said: Any = reader.deserialize(raw, connection.msgtype)
            times[connection.topic].append(time_ns)
            if connection.topic == JOINTS:
                angles.append(said.position)
                speeds.append(said.velocity)
            elif connection.topic == POSE:
                place = said.pose.position
                places.append((place.x, place.y, place.z))
            else:
                scalings.append(said.data)
    return [*map(np.array, times.values()), *map(np.array, (angles, speeds, places, scalings))]


def by_groups(path: Path) -> list[np.ndarray[Any, Any]]:
    """Return the same arrays, read by the vectorised reader."""
    from cyclekit_adapters.rosbag.container import opened

    parts: dict[str, list[np.ndarray[Any, Any]]] = {name: [] for name in (*TOPICS, "q", "qd", "xyz", "scaling")}
    with opened(path) as bag:
        for arrived in bag.messages(set(TOPICS)):
            group = arrived.group
            parts[arrived.topic].append(group.receive_ns)
            if arrived.topic == JOINTS:
                parts["q"].append(group.numbers("position"))
                parts["qd"].append(group.numbers("velocity"))
            elif arrived.topic == POSE:
                parts["xyz"].append(np.stack([group.numbers("pose", "position", axis) for axis in "xyz"], axis=1))
            else:
                parts["scaling"].append(group.numbers("data"))
    return [np.concatenate(part) for part in parts.values()]


def whole(path: Path) -> list[np.ndarray[Any, Any]]:
    """Read the same recording with the adapter; return the number of rows."""
    from cyclekit.adapter import ReadOptions
    from cyclekit_adapters.rosbag import ADAPTER

    return [np.array(ADAPTER.read(path, ReadOptions()).rows_read)]


READ = {"rosbags": by_rosbags, "vectorised": by_groups, "adapter": whole}


def once(way: str, short: Path, path: Path) -> None:
    """Read one bag in one way; print wall time, CPU time, s, and a checksum of the numbers."""
    READ[way](short)  # imports happen before the measurement
    begin, cpu = time.perf_counter(), time.process_time()
    arrays = READ[way](path)
    seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
    print(seconds, cpu, repr(sum(float(array.sum()) for array in arrays)))


def main() -> None:
    """Write the bags, read them alternately, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--seconds", type=int, default=180, help="length of the recording")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--once", nargs=3, metavar=("WAY", "SHORT", "BAG"), help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.once:
        once(asked.once[0], *map(Path, asked.once[1:]))
        return
    table = Table(title=f"{asked.seconds} s of JointState 500 Hz, PoseStamped 125 Hz, Float64 100 Hz")
    ratios = ["rosbags / vectorised", "rosbags / adapter"]
    ratios += [f"{name}, cpu" for name in ratios]
    for name in ("container", "MB", *(f"{way} s" for way in WAYS), *ratios, "same"):
        table.add_column(name, justify="right")
    with tempfile.TemporaryDirectory() as folder:
        for part, seconds in (("short", 1), ("long", asked.seconds)):
            Path(folder, part).mkdir()
            write(Path(folder, part), seconds)
        for name, file in BAGS.items():
            short, bag = Path(folder, "short", file), Path(folder, "long", file)
            size = sum(part.stat().st_size for part in ([bag] if bag.is_file() else bag.iterdir()))
            found: dict[str, list[tuple[float, float, str]]] = {way: [] for way in WAYS}
            for _ in range(asked.repeats + 1):
                for way in WAYS:
                    call = [sys.executable, __file__, "--once", way, str(short), str(bag)]
                    said = subprocess.run(call, check=True, capture_output=True, text=True).stdout.split()
                    found[way].append((float(said[0]), float(said[1]), said[2]))
            wall, cpu = ({way: statistics.median(row[k] for row in found[way][1:]) for way in WAYS} for k in (0, 1))
            same = found["rosbags"][0][2] == found["vectorised"][0][2]
            row = [f"{wall[way]:.3f}" for way in WAYS]
            row += [f"{times['rosbags'] / times[way]:.1f}" for times in (wall, cpu) for way in WAYS[1:]]
            table.add_row(name, f"{size / 1e6:.0f}", *row, "yes" if same else "NO")
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
