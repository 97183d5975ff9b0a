"""ROS 2 bag (mcap): the output of `ros2 bag record` in a cell with the UR ROS 2 driver and a people tracker.

It holds joints by name in another order, TCP pose, speed scaling in 0..100, a latched "program running", the people as
poses in the base frame, and the operator's goal at each button press. Log times are the recorder's; the header stamps
of the people are the tracker's, with its clock errors. Messages of one kind differ only in their numbers, so each kind
is serialised once and the numbers are written into copies.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from cyclekit_sim.arm import JOINT_NAMES, Array
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.session import RobotStates, Session
from cyclekit_sim.tracker import Frames, lead_s

if TYPE_CHECKING:
    from rosbags.typesys.store import Msg

BAG_EPOCH_S = 1_750_000_000.0  # s, recorder's clock at the first robot sample of a session
_ORDER = (2, 1, 0, 3, 4, 5)  # joint_state_broadcaster sorts by name: elbow first
_FRAME = "base"
_MARK = 7.0e300  # sentinel that can be found in a serialised template
Bytes = NDArray[np.uint8]
Message = tuple[int, str, bytes]
_TYPES = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tcp_pose_broadcaster/pose": "geometry_msgs/msg/PoseStamped",
    "/speed_scaling_state_broadcaster/speed_scaling": "std_msgs/msg/Float64",
    "/io_and_status_controller/robot_program_running": "std_msgs/msg/Bool",
    "/poses": "geometry_msgs/msg/PoseArray",
    "/operator/goal": "std_msgs/msg/String",
}


def write_bag(path: Path, session: Session, robot: RobotStates, frames: Frames, options: SimulationOptions) -> None:
    """Write a session as one mcap file; `robot` holds the controller's measurements."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    messages = [*_robot(store, robot, options), *_people(store, frames, options), *_signals(store, session)]
    messages.sort(key=lambda message: message[:2])
    topics = [topic for topic in _TYPES if any(message[1] == topic for message in messages)]
    with path.open("wb") as file:
        bag = Writer(file, chunk_size=1024 * 1024, compression=CompressionType.ZSTD)
        bag.start(profile="ros2", library="")
        channels = {}
        for topic in topics:
            text, _ = store.generate_msgdef(_TYPES[topic], ros_version=2)
            schema = bag.register_schema(_TYPES[topic], "ros2msg", text.encode())
            channels[topic] = bag.register_channel(topic, "cdr", schema)
        for sequence, (t_ns, topic, data) in enumerate(messages):
            bag.add_message(channels[topic], t_ns, data, t_ns, sequence)
        bag.finish()  # type: ignore[no-untyped-call]


def _robot(store: Typestore, robot: RobotStates, options: SimulationOptions) -> Iterator[Message]:
    at = _nanoseconds(robot.t_s)
    order = list(_ORDER)
    joints = np.concatenate([robot.q_rad[:, order], robot.qd_rad_s[:, order]], axis=1)
    poses = np.concatenate([robot.tcp_m, robot.quaternion], axis=1)
    kinds: list[tuple[str, Msg, Array]] = [
        ("/joint_states", _joint_state(store), joints),
        ("/tcp_pose_broadcaster/pose", _pose_stamped(store), poses),
    ]
    if options.log_override:
        scaling = store.types["std_msgs/msg/Float64"](data=_MARK)
        kinds.append(("/speed_scaling_state_broadcaster/speed_scaling", scaling, 100.0 * robot.scaling[:, None]))
    for topic, template, numbers in kinds:
        for t_ns, data in zip(at.tolist(), _fill(store, topic, template, numbers, at), strict=True):
            yield t_ns, topic, data.tobytes()


def _people(store: Typestore, frames: Frames, options: SimulationOptions) -> Iterator[Message]:
    types, topic = store.types, "/poses"
    told_s = frames.t_s - lead_s(options)
    stamps, at = _nanoseconds(told_s), _nanoseconds(frames.session_s)
    pose = _pose(store, _MARK)
    header = _header(store)
    seen = ~np.isnan(frames.xyz_m[:, 0])
    half = 0.5 * frames.heading_rad[:, None]
    numbers = np.concatenate([frames.xyz_m, 0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
    pose_array = types["geometry_msgs/msg/PoseArray"]
    for mask, template, columns in (
        (seen, pose_array(header=header, poses=[pose]), numbers),
        (~seen, pose_array(header=header, poses=[]), numbers[:, :0]),
    ):
        filled = _fill(store, topic, template, columns[mask], stamps[mask])
        for t_ns, data in zip(at[mask].tolist(), filled, strict=True):
            yield t_ns, topic, data.tobytes()


def _signals(store: Typestore, session: Session) -> Iterator[Message]:
    goal, running = "/operator/goal", "/io_and_status_controller/robot_program_running"
    for press in session.presses():
        text = store.types["std_msgs/msg/String"](data=press.goal)
        yield int(_nanoseconds(np.array([press.t_s]))[0]), goal, bytes(store.serialize_cdr(text, _TYPES[goal]))
    ends = [b + trace.duration_s for b, trace in zip(session.begins_s, session.traces, strict=True)]
    for times, plays in ((session.begins_s, True), (tuple(ends), False)):
        flag = bytes(store.serialize_cdr(store.types["std_msgs/msg/Bool"](data=plays), _TYPES[running]))
        yield from ((int(t_ns), running, flag) for t_ns in _nanoseconds(np.array(times)))


def _fill(store: Typestore, topic: str, template: Msg, numbers: Array, stamps_ns: NDArray[np.int64]) -> Bytes:
    """Return messages (N, L) bytes: copies of the template with numbers (N, D) instead of its sentinels, and stamps."""
    raw = bytes(store.serialize_cdr(template, _TYPES[topic]))
    messages = np.repeat(np.frombuffer(raw, np.uint8)[None], len(numbers), axis=0)
    at = raw.find(np.float64(_MARK).tobytes())
    for i in range(numbers.shape[1]):
        messages[:, at : at + 8] = np.ascontiguousarray(numbers[:, i]).view(np.uint8).reshape(-1, 8)
        at = raw.find(np.float64(_MARK).tobytes(), at + 8)
    if hasattr(template, "header"):
        seconds, rest = np.divmod(stamps_ns, 1_000_000_000)
        stamp = np.stack([seconds, rest], axis=1).astype("<u4")
        messages[:, 4:12] = stamp.view(np.uint8).reshape(-1, 8)
    return messages


def _joint_state(store: Typestore) -> Msg:
    marks = np.full(6, _MARK)
    names = [JOINT_NAMES[i] for i in _ORDER]
    kind = store.types["sensor_msgs/msg/JointState"]
    return kind(header=_header(store), name=names, position=marks, velocity=marks, effort=np.empty(0))


def _pose_stamped(store: Typestore) -> Msg:
    return store.types["geometry_msgs/msg/PoseStamped"](header=_header(store), pose=_pose(store, _MARK))


def _pose(store: Typestore, value: float) -> Msg:
    types = store.types
    point = types["geometry_msgs/msg/Point"](x=value, y=value, z=value)
    turn = types["geometry_msgs/msg/Quaternion"](x=value, y=value, z=value, w=value)
    return types["geometry_msgs/msg/Pose"](position=point, orientation=turn)


def _header(store: Typestore) -> Msg:
    time = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=_FRAME)


def _nanoseconds(session_s: Array) -> NDArray[np.int64]:
    return np.int64(BAG_EPOCH_S) * 1_000_000_000 + np.rint(session_s * 1e9).astype(np.int64)
