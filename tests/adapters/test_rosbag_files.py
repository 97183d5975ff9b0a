"""What a bag holds is read, however it is packed, split, named or ordered."""

import random
import shutil
import sqlite3
import struct
import zlib

import numpy as np
import pytest
from backports import zstd
from bag_files import (
    KINDS,
    MCAPS,
    ROS1S,
    SCALING,
    T0,
    TCP,
    expected,
    messages,
    places,
    write_db3,
    write_mcap,
    write_ros1,
)
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog
from cyclekit_adapters.rosbag import ADAPTER, mcap_file
from cyclekit_adapters.rosbag.container import opened
from cyclekit_adapters.rosbag.folder import folder_of


@pytest.mark.parametrize("form", MCAPS)
def test_every_form_of_mcap_gives_every_message_and_no_warning(tmp_path, form):
    path = write_mcap(tmp_path / "run.mcap", 200, **MCAPS[form])
    assert places(path) == (*expected(200), [], [])


@pytest.mark.parametrize("compression", ROS1S)
def test_every_form_of_ros_1_bag_gives_every_message_and_no_warning(tmp_path, compression):
    path = write_ros1(tmp_path / "run.bag", 200, ROS1S[compression])
    assert places(path) == (*expected(200), [], [])
    other_name = path.rename(tmp_path / "run")
    assert places(other_name)[:2] == expected(200)


def test_a_ros_1_recording_in_an_mcap_is_read_like_its_bag(tmp_path):
    path = write_mcap(tmp_path / "run.mcap", 100, ros1=True)
    assert places(path) == (*expected(100), [], [])
    assert ADAPTER.read(path, ReadOptions()).robot["tcp_x_m"].to_list() == [float(n) for n in range(100)]


def test_the_parts_of_a_split_recording_are_read_as_one(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    whole = write_mcap(tmp_path / "whole.mcap", 100)
    rows = list(messages(100))
    store = get_typestore(Stores.ROS2_HUMBLE)
    for part, name in enumerate(("run_0.mcap", "run_1.mcap")):
        with (folder / name).open("wb") as log:
            writer = Writer(log)
            writer.start("ros2", "test")
            ours = rows[: len(rows) // 2] if part == 0 else rows[len(rows) // 2 :]
            channels = {}
            for topic in sorted({topic for topic, _, _ in ours}, reverse=bool(part)):
                text = store.generate_msgdef(KINDS[topic], ros_version=2)[0].encode()
                schema = writer.register_schema(KINDS[topic], "ros2msg", text)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            for topic, time_ns, raw in ours:
                writer.add_message(channels[topic], time_ns, raw, time_ns)
            writer.finish()
    text = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  compression_mode: ''\n"
    (folder / "metadata.yaml").write_text(f"{text}  relative_file_paths: [run_1.mcap, run_0.mcap]\n")
    shutil.copy(whole, folder / "of another recording.mcap")
    one, other = (ADAPTER.read(path, ReadOptions()) for path in (folder, whole))
    assert one.robot.equals(other.robot)
    assert one.warnings == other.warnings
    assert one.facts["message_index"] == "within its topic from 0, file by file in the order of time"
    assert one.facts[f"messages of {TCP}"] == "run_0.mcap 0 to 49, run_1.mcap 50 to 99"
    assert one.facts[f"messages of {SCALING}"] == "run_0.mcap 0 to 24, run_1.mcap 25 to 49"
    assert one.facts["rows of robot"] == f"messages of {TCP}"
    (folder / "run_1.mcap").unlink()
    cut = ADAPTER.read(folder, ReadOptions())
    assert any("run_1.mcap" in said for said in cut.warnings)
    assert 0 < cut.robot.height < 100


def test_the_index_of_a_message_counts_through_one_file_after_the_other_even_where_their_times_overlap(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    store = get_typestore(Stores.ROS2_HUMBLE)
    rows = [row for row in messages(60) if row[0] == TCP]
    for name, ours in (("run_1.mcap", rows[25:]), ("run_0.mcap", rows[:30])):  # five messages are in both
        with (folder / name).open("wb") as log:
            writer = Writer(log)
            writer.start("ros2", "test")
            text = store.generate_msgdef(KINDS[TCP], ros_version=2)[0].encode()
            schema = writer.register_schema(KINDS[TCP], "ros2msg", text)
            channel = writer.register_channel(TCP, "cdr", schema)
            for _, time_ns, raw in ours:
                writer.add_message(channel, time_ns, raw, time_ns)
            writer.finish()
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  relative_file_paths: [run_1.mcap, run_0.mcap]\n"
    )
    log = ADAPTER.read(folder, ReadOptions())
    assert log.facts[f"messages of {TCP}"] == "run_0.mcap 0 to 29, run_1.mcap 30 to 64"
    by_index = dict(log.robot.select("source_row", "tcp_x_m").rows())
    assert by_index[10] == 10.0
    assert by_index[64] == 59.0  # the 35th of the second file, which begins with the 25th pose
    assert log.robot["tcp_x_m"].to_list() == [float(number) for number in range(60)]


def test_a_db3_of_an_older_ros_2_without_definitions_is_read_by_the_well_known_ones(tmp_path, bag):
    path = write_db3(tmp_path / "run", bag, 50)
    before = places(path)
    with sqlite3.connect(path) as db:
        db.execute("DROP TABLE message_definitions")
        db.execute("DROP TABLE schema")
    db.close()
    assert places(path) == before
    assert len(before[0]) == 50


def test_messages_come_in_the_order_of_time_whatever_the_order_in_the_file(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    order = list(range(100))
    random.Random(1).shuffle(order)
    for number in order:
        writer.tcp(T0 + number, x=float(number))
    writer.writer.write(writer.connections[TCP], round((T0 + 49.5) * 1e9), b"\0\1\0\0\7")
    writer.close()
    log = ADAPTER.read(tmp_path / "run", ReadOptions())
    assert log.robot["tcp_x_m"].to_list() == [float(number) for number in range(100)]
    assert log.robot["source_row"].to_list() == [*range(50), *range(51, 101)]
    assert log.set_aside["source_row"].to_list() == [50]
    assert log.rows_read == 101


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_the_raw_messages_are_those_that_the_library_hands_out(tmp_path, bag, kind):
    path = tmp_path / ("run.bag" if kind == "bag" else "run")
    writer = bag(path, kind)
    for number in range(300):
        writer.tcp(T0 + number * 0.01, x=float(number))
        writer.joints(T0 + number * 0.01, ["a", "b"][: 1 + number % 2], [1.0, 2.0][: 1 + number % 2])
    writer.close()
    with AnyReader([path]) as reader:
        theirs = sorted((connection.topic, t, bytes(raw)) for connection, t, raw in reader.messages())
    ours = []
    with opened(path) as it:
        for file in it.files:
            for block in file.blocks(set(file.channels)):
                for number, payloads in block.items():
                    topic = file.channels[number].topic
                    rows = range(payloads.size.size)
                    ours += [(topic, int(payloads.receive_ns[row]), payloads.one(row)) for row in rows]
    assert sorted(ours) == theirs
    assert zlib.crc32(b"".join(raw for _, _, raw in theirs))


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_folder_compressed_once_more_is_read_too(tmp_path, mode, plugin):
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer2(tmp_path / "run", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in KINDS.items()}
        for topic, time_ns, raw in messages(60):
            writer.write(connections[topic], time_ns, raw)
    assert places(tmp_path / "run") == (*expected(60), [], [])


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("version", [8, 9])
def test_what_was_compressed_once_more_is_read_by_its_content_without_metadata(tmp_path, mode, version):
    """A bag before version 9 in sqlite3 holds no definitions, so that they are found by the messages."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.SQLITE3
    with Writer2(tmp_path / "run", version=version, storage_plugin=plugin) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in KINDS.items()}
        for topic, time_ns, raw in messages(60):
            stored = zstd.compress(raw) if mode is CompressionMode.MESSAGE else raw
            writer.write(connections[topic], time_ns, stored)
    (file,) = (tmp_path / "run").glob("*.db3")
    if mode is CompressionMode.FILE:
        file = file.rename(f"{file}.zstd")
        file.write_bytes(zstd.compress(file.read_bytes()))
    alone = tmp_path / file.name
    file.rename(alone)
    assert ADAPTER.recognises(alone)
    read = ADAPTER.read(alone, ReadOptions())
    assert read.robot["tcp_x_m"].to_list() == [place for _, place in expected(60)[0]]
    assert read.set_aside.is_empty()


def test_a_bag_without_its_write_ahead_log_says_that_it_holds_no_message(tmp_path):
    with Writer2(tmp_path / "run", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for topic, kind in KINDS.items():
            writer.add_connection(topic, kind, typestore=get_typestore(Stores.ROS2_HUMBLE))
    (file,) = (tmp_path / "run").glob("*.db3")
    with pytest.raises(DamagedLog, match="holds no message") as caught:
        ADAPTER.read(file, ReadOptions())
    assert f"{file.name}-wal" in caught.value.cure


METADATA = """rosbag2_bagfile_information:
  version: 5
  topics_with_message_count:
    - topic_metadata:
        name: /a
        offered_qos_profiles: "- history: 3\\n  relative_file_paths: x"
      message_count: 1
  compression_format: ""
  compression_mode: {mode}
  relative_file_paths:
{files}
  storage_identifier: mcap
"""


@pytest.mark.parametrize(
    ("files", "mode", "names"),
    [
        ("    - run_0.mcap\n    - run_1.mcap", '""', ["run_0.mcap", "run_1.mcap"]),
        ("  - 'my run_0.mcap'", "FILE", ["my run_0.mcap"]),
        ('  - "run_0.mcap"', "none", ["run_0.mcap"]),
        ('  - "r\\u00e9_0.mcap"', "''", ["ré_0.mcap"]),  # only a parser of YAML reads this
        ("  - other/run_0.mcap   # a comment", "NONE", ["run_0.mcap"]),
        ("    [run_0.mcap, run_1.mcap]", '""', ["run_0.mcap", "run_1.mcap"]),
    ],
)
@pytest.mark.parametrize("last", [True, False])
def test_metadata_names_the_files_however_its_yaml_is_written(tmp_path, files, mode, names, last):
    for name in names:
        (tmp_path / name).touch()
    text = METADATA.format(files=files, mode=mode)
    if last:
        text = text.replace("  storage_identifier: mcap\n", "")
    (tmp_path / "metadata.yaml").write_text(text, encoding="utf-8")
    folder = folder_of(tmp_path)
    assert [file.name for file in folder.files] == names
    assert folder.warnings == []


@pytest.mark.parametrize(
    "text", ["rosbag2_bagfile_information: [", "a: 1", "rosbag2_bagfile_information:\n  version: 5\n"]
)
def test_metadata_that_cannot_be_read_is_done_without(tmp_path, text):
    (tmp_path / "run_0.mcap").touch()
    (tmp_path / "metadata.yaml").write_text(text, encoding="utf-8")
    folder = folder_of(tmp_path)
    assert [file.name for file in folder.files] == ["run_0.mcap"]
    assert "cannot be read" in folder.warnings[0]


OLD_JOINTS = """Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: roslib/Header
uint32 seq
time stamp
string frame_id
"""


def test_a_bag_of_2010_whose_headers_are_those_of_roslib_is_read(tmp_path):
    store, path = get_typestore(Stores.ROS1_NOETIC), tmp_path / "run.bag"
    kind = "sensor_msgs/msg/JointState"
    with Writer1(path) as writer:
        md5sum = "3066dcd76a6cfaef579bd0f34173e9fd"
        connection = writer.add_connection("/joint_states", kind, msgdef=OLD_JOINTS, md5sum=md5sum)
        for number in range(50):
            stamp = store.types["builtin_interfaces/msg/Time"](sec=T0 + number, nanosec=250_000_000)
            header = store.types["std_msgs/msg/Header"](seq=number, stamp=stamp, frame_id="")
            angles = np.array([number / 10, -1.0])
            said = store.types[kind](
                header=header, name=["a", "b"], position=angles, velocity=angles * 2, effort=angles
            )
            writer.write(connection, (T0 + number) * 10**9 + 300_000_000, bytes(store.serialize_ros1(said, kind)))
    assert b"roslib/Header" in path.read_bytes()
    log = ADAPTER.read(path, ReadOptions())
    assert log.robot["q0_rad"].to_list() == [number / 10 for number in range(50)]
    assert log.robot["t_s"].to_list() == [T0 + number + 0.25 for number in range(50)]
    assert log.facts["time"] == "header stamp"


@pytest.mark.parametrize("foreign", [b"", b"x", bytes(40)])
def test_a_record_that_is_no_message_at_the_end_of_a_chunk_hides_none(foreign):
    message = struct.pack("<BQHIQQ", 5, 22 + 8, 7, 0, T0, T0) + b"a number"
    records = [message, message, struct.pack("<BQ", 200, len(foreign)) + foreign]
    start = np.cumsum([0, *map(len, records[:-1])])
    found = mcap_file._Records().messages(np.frombuffer(b"".join(records), np.uint8), start)
    assert found.channel.tolist() == [7, 7]
    assert found.receive_ns.tolist() == [T0, T0]
    assert found.start.tolist() == [31, 70]
    assert found.size.tolist() == [8, 8]
    assert found.other == [78]
