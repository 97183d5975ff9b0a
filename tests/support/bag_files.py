"""Recordings of a robot that moves 1 m per message, in every container, and what a reader must find in them."""

import struct

from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore

from cyclekit_adapters.rosbag.container import opened

T0 = 1_700_000_000
TCP, SCALING = "/tcp_pose_broadcaster/pose", "/speed_scaling_factor"
KINDS = {TCP: "geometry_msgs/msg/PoseStamped", SCALING: "std_msgs/msg/Float64"}
MCAPS = {
    "plain": {"compression": CompressionType.NONE},
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
    "no index": {"compression": CompressionType.NONE, "index_types": IndexType.NONE},
    "no chunks": {"use_chunking": False},
}
ROS1S = {"none": None, "lz4": Writer1.CompressionFormat.LZ4, "bz2": Writer1.CompressionFormat.BZ2}


def messages(count, *, ros1=False):
    """(topic, time in ns, payload) of a robot that moves 1 m per message; a scaling comes with every second one."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    pack = store.serialize_ros1 if ros1 else store.serialize_cdr
    types = store.types
    for number in range(count):
        stamp = types["builtin_interfaces/msg/Time"](sec=T0 + number, nanosec=0)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **({"seq": number} if ros1 else {}))
        place = types["geometry_msgs/msg/Point"](x=float(number), y=0.5, z=0.25)
        turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
        pose = types["geometry_msgs/msg/Pose"](position=place, orientation=turn)
        said = types[KINDS[TCP]](header=header, pose=pose)
        yield TCP, (T0 + number) * 10**9, bytes(pack(said, KINDS[TCP]))
        if number % 2:
            scaling = types[KINDS[SCALING]](data=number / 1000)
            yield SCALING, (T0 + number) * 10**9 + 1, bytes(pack(scaling, KINDS[SCALING]))


def write_mcap(path, count, *, ros1=False, chunk_size=1500, **options):
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    with path.open("wb") as log:
        writer = Writer(log, chunk_size=chunk_size, **options)
        writer.start("ros1" if ros1 else "ros2", "test")
        channels = {}
        for topic, time_ns, raw in messages(count, ros1=ros1):
            if topic not in channels:
                text = store.generate_msgdef(KINDS[topic], ros_version=1 if ros1 else 2)[0].encode()
                name = KINDS[topic].replace("/msg/", "/") if ros1 else KINDS[topic]
                schema = writer.register_schema(name, "ros1msg" if ros1 else "ros2msg", text)
                channels[topic] = writer.register_channel(topic, "ros1" if ros1 else "cdr", schema)
            writer.add_message(channels[topic], time_ns, raw, time_ns)
        writer.finish()
    return path


def write_ros1(path, count, compression=None, threshold=1500):
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression:
        writer.set_compression(compression)
    writer.chunk_threshold = threshold
    with writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in KINDS.items()}
        for topic, time_ns, raw in messages(count, ros1=True):
            writer.write(connections[topic], time_ns, raw)
    return path


def write_db3(folder, bag, count):
    writer = bag(folder, "db3")
    for number in range(count):
        writer.tcp(T0 + number, x=float(number))
        if number % 2:
            writer.number(SCALING, "Float64", T0 + number, number / 1000)
    writer.close()
    return folder / f"{folder.name}.db3"


def places(path):
    """Time and place of every TCP message, and every scaling, as our reader finds them."""
    found = {TCP: [], SCALING: []}
    with opened(path) as it:
        for arrived in it.messages(set(found)):
            path_to = ("pose", "position", "x") if arrived.topic == TCP else ("data",)
            found[arrived.topic] += zip(arrived.group.receive_ns.tolist(), arrived.group.numbers(*path_to), strict=True)
        return sorted(found[TCP]), sorted(found[SCALING]), it.warnings, it.set_aside()


def expected(count):
    return (
        [((T0 + number) * 10**9, float(number)) for number in range(count)],
        [((T0 + number) * 10**9 + 1, number / 1000) for number in range(1, count, 2)],
    )


def chunks_of(path):
    """(end in the file, messages by topic) of every chunk, as the reference readers see the whole file."""
    if path.suffix == ".bag":
        with Reader1(path) as reader:
            topics = {connection.id: connection.topic for connection in reader.connections}
            for info in reader.chunk_infos:
                chunk = reader.chunks[info.pos]
                counts = {topics[number]: count for number, count in info.connection_counts.items()}
                yield chunk.datapos + chunk.datasize, counts
        return
    with path.open("rb") as log:
        summary = make_reader(log).get_summary()
        for index in summary.chunk_indexes:
            log.seek(index.chunk_start_offset)
            counts = {}
            for channel, offset in index.message_index_offsets.items():
                log.seek(offset + 11)
                topic = summary.channels[channel].topic
                counts[topic] = struct.unpack("<I", log.read(4))[0] // 16
            yield index.chunk_start_offset + index.chunk_length, counts


def chunk_record(stored, size, compression):
    """Return a chunk of an mcap."""
    body = struct.pack("<QQQI", T0 * 10**9, T0 * 10**9, size, 0)
    body += struct.pack("<I", len(compression)) + compression.encode() + struct.pack("<Q", len(stored)) + stored
    return b"\x06" + struct.pack("<Q", len(body)) + body
