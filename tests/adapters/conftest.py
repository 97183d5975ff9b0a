"""Small logs as the vendors' loggers write them, byte by byte, so that a test shows its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

UR_COLUMNS = [
    "timestamp",
    *(f"actual_q_{i}" for i in range(6)),
    *(f"actual_qd_{i}" for i in range(6)),
    *(f"actual_TCP_pose_{i}" for i in range(6)),
    *(f"actual_TCP_speed_{i}" for i in range(6)),
    "speed_scaling",
    "target_speed_fraction",
    "actual_digital_output_bits",
    "output_int_register_0",
    "output_int_register_3",
    "runtime_state",
]


def ur_row(t_s: float, **values: object) -> dict[str, object]:
    row: dict[str, object] = dict.fromkeys(UR_COLUMNS, 0.0)
    row |= {"timestamp": t_s, "target_speed_fraction": 1.0, "speed_scaling": 1.0, "runtime_state": 2}
    return row | values


def ur_text(rows: list[dict[str, object]], delimiter: str = " ", end: str = "\r\n") -> str:
    columns = list(rows[0]) if rows else UR_COLUMNS
    lines = [delimiter.join(columns), *(delimiter.join(str(row[c]) for c in columns) for row in rows)]
    return end.join(lines) + end


def motive_text(
    bodies: dict[str, list[tuple[float, float, float] | None]],
    *,
    kind: str = "Rigid Body",
    rate_hz: float = 100.0,
    unit: str = "Meters",
    space: str = "Global",
    seconds: list[float] | None = None,
    version: str = "1.23",
    padding: int = 0,
) -> str:
    per = ["X", "Y", "Z", "W", "X", "Y", "Z"] if kind != "Marker" else ["X", "Y", "Z"]
    part = (["Rotation"] * 4 if kind != "Marker" else []) + ["Position"] * 3
    labels = ("Type", "Name", "ID") if version != "1.21" else ("", "", "")
    frames = len(next(iter(bodies.values())))
    about = {
        "Format Version": version,
        "Take Name": "morning",
        "Capture Frame Rate": f"{rate_hz:g}",
        "Export Frame Rate": f"{rate_hz:g}",
        "Total Exported Frames": str(frames),
        "Rotation Type": "Quaternion",
        "Length Units": unit,
        "Coordinate Space": space,
    }
    head = [
        ",".join(f"{k},{v}" for k, v in about.items()),
        "",
        ",".join(["", labels[0], *(kind for _ in bodies for _ in per)]),
        ",".join(["", labels[1], *(name for name in bodies for _ in per)]),
        ",".join(["", labels[2], *('"6D79"' for _ in bodies for _ in per)]),
        ",".join(["", "", *(p for _ in bodies for p in part)]),
        ",".join(["Frame", "Time (Seconds)" if version != "1.21" else "Time", *(a for _ in bodies for a in per)]),
    ]
    turn = ["0.1", "0.2", "0.3", "0.9"] if kind != "Marker" else []
    for frame in range(frames):
        cells = [str(frame), f"{(seconds[frame] if seconds else frame / rate_hz):.6f}"]
        for track in bodies.values():
            place = track[frame]
            cells += [*turn, *map(str, place)] if place is not None else [""] * len(per)
        head.append(",".join(cells))
    head[2:] = [line + "," * padding for line in head[2:]]
    return "\r\n".join(head) + "\r\n"


class BagWriter:
    """A bag under construction: `say(topic, kind, seconds, **fields)`, then `close()`."""

    def __init__(self, path: Path, kind: str) -> None:
        self.ros1 = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            text = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        plugin = StoragePlugin.SQLITE3 if kind == "db3" else StoragePlugin.MCAP
        self.writer: Any = Writer1(path) if self.ros1 else Writer2(path, version=9, storage_plugin=plugin)
        self.writer.open()
        self.connections: dict[str, Any] = {}

    def type(self, kind: str) -> Any:
        return self.store.types[kind]

    def header(self, stamp_s: float, frame: str = "base") -> Any:
        time = self.type("builtin_interfaces/msg/Time")(sec=int(stamp_s), nanosec=round(stamp_s % 1 * 1e9))
        extra = {"seq": 0} if self.ros1 else {}
        return self.type("std_msgs/msg/Header")(stamp=time, frame_id=frame, **extra)

    def pose(self, x: float, y: float, z: float) -> Any:
        place = self.type("geometry_msgs/msg/Point")(x=x, y=y, z=z)
        turn = self.type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)
        return self.type("geometry_msgs/msg/Pose")(position=place, orientation=turn)

    def say(self, topic: str, kind: str, received_s: float, **fields: object) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        message = self.type(kind)(**fields)
        raw = self.store.serialize_ros1(message, kind) if self.ros1 else self.store.serialize_cdr(message, kind)
        self.writer.write(self.connections[topic], round(received_s * 1e9), raw)

    def tcp(
        self, t_s: float, x: float, y: float = 0.0, z: float = 0.0, topic: str = "/tcp_pose_broadcaster/pose"
    ) -> None:
        pose = self.pose(x, y, z)
        self.say(topic, "geometry_msgs/msg/PoseStamped", t_s, header=self.header(t_s), pose=pose)

    def joints(self, t_s: float, names: list[str], angles: list[float], topic: str = "/joint_states") -> None:
        values = {"position": np.array(angles), "velocity": np.array([]), "effort": np.array([])}
        self.say(topic, "sensor_msgs/msg/JointState", t_s, header=self.header(t_s), name=names, **values)

    def number(self, topic: str, kind: str, t_s: float, value: float) -> None:
        self.say(topic, f"std_msgs/msg/{kind}", t_s, data=value)

    def poses(self, t_s: float, places: list[tuple[float, float, float]], topic: str = "/poses") -> None:
        poses = [self.pose(*place) for place in places]
        self.say(topic, "geometry_msgs/msg/PoseArray", t_s, header=self.header(t_s, "map"), poses=poses)

    def transform(self, t_s: float, *links: tuple[str, str, tuple[float, ...]], topic: str = "/tf") -> None:
        items = []
        for parent, child, (x, y, z, *turn) in links:
            move = self.type("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)
            a, b, c, d = turn or (0.0, 0.0, 0.0, 1.0)
            rotation = self.type("geometry_msgs/msg/Quaternion")(x=a, y=b, z=c, w=d)
            value = self.type("geometry_msgs/msg/Transform")(translation=move, rotation=rotation)
            stamped = self.type("geometry_msgs/msg/TransformStamped")
            items.append(stamped(header=self.header(t_s, parent), child_frame_id=child, transform=value))
        self.say(topic, "tf2_msgs/msg/TFMessage", t_s, transforms=items)

    def define(self, kind: str, text: str) -> None:
        """Register the types of a definition that this store does not know yet."""
        found = get_types_from_msg(text, kind)
        self.store.register({name: fields for name, fields in found.items() if name not in self.store.types})

    def random(self, kind: str, **fields: object) -> Any:
        """Return a message of a type with these fields, and of all others something that tells where it came from."""
        made = {name: self._value(name, description) for name, description in self.store.get_msgdef(kind).fields}
        return self.type(kind)(**(made | fields))

    def _value(self, name: str, description: Any) -> Any:
        kind, what = description
        if kind == Nodetype.NAME:
            return self.random(what)
        if kind == Nodetype.BASE:
            return name[:3] if what[0] == "string" else False if what[0] == "bool" else 1
        item, count = what
        count = count if kind == Nodetype.ARRAY else 0
        if item[0] == Nodetype.BASE and item[1][0] != "string":
            return np.arange(count).astype(item[1][0])
        return [self._value(name, item) for _ in range(count)]

    def close(self) -> None:
        self.writer.close()


@pytest.fixture
def bag() -> type[BagWriter]:
    return BagWriter


@pytest.fixture
def ur() -> Any:
    """`ur.row(t, ...)` and `ur.text(rows, ...)`."""

    class Ur:
        row = staticmethod(ur_row)
        text = staticmethod(ur_text)
        columns = UR_COLUMNS

    return Ur


@pytest.fixture
def motive() -> Any:
    return motive_text
