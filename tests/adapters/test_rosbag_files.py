"""What lies in whole chunks of a bag is read, however the bag is packed, split, cut or damaged."""

import random
import shutil
import sqlite3
import struct
import zlib

import numpy as np
import pytest
from backports import zstd
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog
from cyclekit_adapters.rosbag import ADAPTER, mcap_file
from cyclekit_adapters.rosbag.container import opened
from cyclekit_adapters.rosbag.folder import folder_of

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


@pytest.mark.parametrize("form", ["plain", "lz4", "zstd", "bag", "bag lz4"])
def test_of_a_cut_bag_every_whole_chunk_is_read_and_what_there_is_of_the_last_and_the_loss_is_said(tmp_path, form):
    if form.startswith("bag"):
        whole = write_ros1(tmp_path / "run.bag", 200, ROS1S["lz4" if "lz4" in form else "none"])
    else:
        whole = write_mcap(tmp_path / "run.mcap", 200, **MCAPS[form])
    chunks, content = list(chunks_of(whole)), whole.read_bytes()
    assert len(chunks) > 10
    chance = random.Random(form)
    for size in [chance.randrange(len(content)) for _ in range(40)]:
        path = tmp_path / f"cut{whole.suffix}"
        path.write_bytes(content[:size])
        kept = [counts for end, counts in chunks if end <= size]
        try:
            tcp, scaling, warnings, aside = places(path)
        except DamagedLog:
            assert not kept
            continue
        begun = next((counts for end, counts in chunks if end > size), {})
        for topic, found, true in ((TCP, tcp, expected(200)[0]), (SCALING, scaling, expected(200)[1])):
            least = sum(counts.get(topic, 0) for counts in kept)
            assert found == true[: len(found)]
            assert least <= len(found) <= least + begun.get(topic, 0)
        assert any("the bag is cut" in said for said in warnings)
        assert aside == []


@pytest.mark.parametrize("form", ["plain", "bag"])
def test_of_a_chunk_that_is_cut_every_whole_message_is_read(tmp_path, form):
    if form == "bag":
        whole = write_ros1(tmp_path / "run.bag", 200)
    else:
        whole = write_mcap(tmp_path / "run.mcap", 200, **MCAPS[form])
    content = whole.read_bytes()
    at = content.index(struct.pack("<d", 133.0))  # x of the pose that is not whole any more
    path = tmp_path / f"cut{whole.suffix}"
    path.write_bytes(content[:at])
    assert places(path)[0] == expected(133)[0]


@pytest.mark.parametrize("form", ["zstd", "lz4", "bag lz4"])
def test_of_a_packed_chunk_that_is_cut_as_much_is_read_as_can_be_unpacked(tmp_path, form):
    count = 6000  # a chunk of several blocks
    if form == "bag lz4":
        whole = write_ros1(tmp_path / "run.bag", count, ROS1S["lz4"], threshold=1 << 30)
    else:
        whole = write_mcap(tmp_path / "run.mcap", count, chunk_size=1 << 30, **MCAPS[form])
    (end, _), *_ = list(chunks_of(whole))
    path = tmp_path / f"cut{whole.suffix}"
    path.write_bytes(whole.read_bytes()[: int(end * 0.8)])
    tcp, _, warnings, aside = places(path)
    assert tcp == expected(count)[0][: len(tcp)]
    assert len(tcp) > 0.5 * count
    assert "the bag is cut" in warnings[0]
    assert aside == []


def _length_of_first_chunk(path):
    """Where the length of the first chunk stands."""
    if path.suffix == ".bag":
        with Reader1(path) as reader:
            return next(iter(reader.chunks.values())).datapos - 4
    with path.open("rb") as log:
        return make_reader(log).get_summary().chunk_indexes[0].chunk_start_offset + 1


@pytest.mark.parametrize("form", ["plain", "zstd", "bag", "bag lz4"])
def test_a_wrong_length_of_a_chunk_is_not_taken_for_a_cut(tmp_path, form):
    if form.startswith("bag"):
        whole = write_ros1(tmp_path / "run.bag", 200, ROS1S["lz4" if "lz4" in form else "none"])
    else:
        whole = write_mcap(tmp_path / "run.mcap", 200, **MCAPS[form])
    content = bytearray(whole.read_bytes())
    at = _length_of_first_chunk(whole)
    content[at + 3] ^= 64  # a gigabyte more
    for size, said in ((len(content), "damaged at byte"), (at + 5000, "the bag")):
        path = tmp_path / f"flipped{whole.suffix}"
        path.write_bytes(content[:size])
        with pytest.raises(DamagedLog, match=said):
            places(path)


@pytest.mark.parametrize("form", ["zstd", "lz4", "bag lz4"])
def test_a_cut_chunk_that_breaks_while_it_is_unpacked_is_set_aside(tmp_path, form):
    count = 6000
    if form == "bag lz4":
        whole = write_ros1(tmp_path / "run.bag", count, ROS1S["lz4"], threshold=1 << 30)
    else:
        whole = write_mcap(tmp_path / "run.mcap", count, chunk_size=1 << 30, **MCAPS[form])
    (end, _), *_ = list(chunks_of(whole))
    content = bytearray(whole.read_bytes()[: int(end * 0.8)])
    at = len(content) // 3
    content[at : at + 3000] = bytes(255 for _ in range(3000))
    path = tmp_path / f"cut{whole.suffix}"
    path.write_bytes(content)
    with pytest.raises(DamagedLog, match="cannot be unpacked"):
        places(path)


def test_the_checksum_of_a_cut_chunk_is_said_to_be_unchecked(tmp_path):
    whole = write_mcap(tmp_path / "run.mcap", 200, **MCAPS["plain"])
    path = tmp_path / "cut.mcap"
    (_, _), (end, _), *_ = list(chunks_of(whole))
    path.write_bytes(whole.read_bytes()[: end - 10])
    log = ADAPTER.read(path, ReadOptions())
    assert "checksum so cannot be checked" in " ".join(log.warnings)
    assert "checksum" not in log.facts


def test_a_cut_bag_says_until_when_it_was_recovered(tmp_path):
    whole = write_mcap(tmp_path / "run.mcap", 200)
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    log = ADAPTER.read(path, ReadOptions())
    assert 50 < log.robot.height < 150
    (said,) = [said for said in log.warnings if "cut" in said]
    last = np.datetime64(int(log.robot["t_s"].max()), "s")
    assert str(last).replace("T", " ") in said
    assert "what came after is lost (at least" in said


def test_a_cut_mcap_without_chunks_is_read_up_to_its_last_whole_message(tmp_path):
    whole = write_mcap(tmp_path / "run.mcap", 100, **MCAPS["no chunks"]).read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: whole.rindex(struct.pack("<Q", (T0 + 70) * 10**9)) + 20])
    tcp, _, warnings, _ = places(path)
    assert tcp == expected(70)[0]
    assert "the bag is cut" in warnings[0]


def test_a_ros_1_bag_that_was_never_closed_is_read(tmp_path):
    whole = write_ros1(tmp_path / "run.bag", 200)
    chunks = list(chunks_of(whole))
    content = bytearray(whole.read_bytes()[: chunks[-1][0]])
    at = content.index(b"index_pos=") + len(b"index_pos=")
    content[at : at + 8] = bytes(8)
    path = tmp_path / "active.bag"
    path.write_bytes(content)
    tcp, scaling, warnings, _ = places(path)
    assert (tcp, scaling) == expected(200)
    assert "never closed" in warnings[0]


def test_a_cut_sqlite_bag_is_read_up_to_its_first_missing_page(tmp_path, bag):
    whole = write_db3(tmp_path / "run", bag, 1500)
    content = whole.read_bytes()
    for size in (
        int(len(content) * 0.3),
        int(len(content) * 0.6),
        4096 * (len(content) // 4096 - 9),
        len(content) - 300,
    ):
        path = tmp_path / "cut.db3"
        path.write_bytes(content[:size])
        tcp, _, warnings, _ = places(path)
        assert [x for _, x in tcp] == [float(number) for number in range(len(tcp))]
        assert len(tcp) > (size / len(content) - 0.2) * 1500
        assert "cut or damaged" in warnings[0]


@pytest.mark.parametrize("form", ["plain", "lz4", "zstd", "no index"])
def test_a_chunk_whose_checksum_fails_is_set_aside_and_the_others_are_read(tmp_path, form):
    path = write_mcap(tmp_path / "run.mcap", 200, **MCAPS[form])
    with path.open("rb") as log:
        index = make_reader(log).get_summary().chunk_indexes
    content = bytearray(path.read_bytes())
    # The names of the records are the same in all forms, so the chunk's place is found by its own record.
    at = [i for i in range(len(content)) if content[i] == 6 and i > 100 and _is_chunk(content, i)][5]
    content[at + 9 + 40 + 100] ^= 4
    path.write_bytes(content)
    tcp, _, _, aside = places(path)
    assert len(aside) == 1
    assert "checksum" in aside[0] or "unpacked" in aside[0]
    assert 180 < len(tcp) < 200
    log = ADAPTER.read(path, ReadOptions())
    assert log.set_aside["reason"].to_list() == aside
    assert any("1 parts of the bag are damaged" in said for said in log.warnings)
    assert form == "no index" or index


def _is_chunk(content, at):
    size = struct.unpack_from("<Q", content, at + 1)[0]
    return 40 < size < 4000 and T0 * 10**9 <= struct.unpack_from("<Q", content, at + 9)[0] < (T0 + 1000) * 10**9


@pytest.mark.parametrize("form", ["plain", "lz4", "zstd", "no index"])
def test_where_there_are_checksums_no_flipped_bit_changes_a_value(tmp_path, form):
    whole = write_mcap(tmp_path / "run.mcap", 60, **MCAPS[form]).read_bytes()
    path, chance, noticed = tmp_path / "flipped.mcap", random.Random(form), 0
    true = [set(rows) for rows in expected(60)]
    for _ in range(150):
        content = bytearray(whole)
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        path.write_bytes(content)
        try:
            tcp, scaling, warnings, aside = places(path)
        except DamagedLog:
            noticed += 1
            continue
        assert set(tcp) <= true[0]
        assert set(scaling) <= true[1]
        assert (len(tcp), len(scaling)) == (60, 30) or warnings or aside
        noticed += bool(warnings or aside)
    assert noticed > 75


def test_an_mcap_without_chunks_whose_checksum_fails_says_so(tmp_path):
    path = write_mcap(tmp_path / "run.mcap", 50, use_chunking=False, enable_data_crcs=True)
    assert places(path)[2] == []
    content = bytearray(path.read_bytes())
    content[content.rindex(struct.pack("<d", 17.0))] ^= 1
    path.write_bytes(content)
    assert "checksum" in places(path)[2][0]


def test_an_index_that_lies_is_not_believed(tmp_path):
    path = write_mcap(tmp_path / "run.mcap", 200)
    content = bytearray(path.read_bytes())
    with path.open("rb") as log:
        indexes = make_reader(log).get_summary().chunk_indexes
    for number, index in enumerate(indexes):
        for offset in index.message_index_offsets.values():
            at = offset + 15 + 8
            lie = [3, 10**12, struct.unpack_from("<Q", content, at)[0] + 1][number % 3]
            content[at : at + 8] = struct.pack("<Q", lie)
    path.write_bytes(content)
    assert places(path)[:2] == expected(200)


def chunk_record(stored, size, compression):
    body = struct.pack("<QQQI", T0 * 10**9, T0 * 10**9, size, 0)
    body += struct.pack("<I", len(compression)) + compression.encode() + struct.pack("<Q", len(stored)) + stored
    return b"\x06" + struct.pack("<Q", len(body)) + body


@pytest.mark.parametrize(
    ("size", "said"), [(8 << 30, "announces"), (2 << 30, "announces"), (200_000, "more than the 200000 bytes")]
)
def test_a_chunk_that_would_unpack_to_gigabytes_is_not_unpacked(tmp_path, size, said):
    bomb = zstd.compress(bytes(64 << 20))
    whole = write_mcap(tmp_path / "run.mcap", 20).read_bytes()
    path = tmp_path / "bomb.mcap"
    at = whole.index(b"\x0f" + struct.pack("<Q", 4))  # the end of the data
    path.write_bytes(whole[:at] + chunk_record(bomb, size, "zstd") + whole[at:])
    tcp, _, _, aside = places(path)
    assert tcp == expected(20)[0]
    assert len(aside) == 1
    assert said in aside[0]


def test_a_chunk_of_nothing_but_empty_records_is_read_up_to_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_file, "MAX_RECORDS", 1000)
    whole = write_mcap(tmp_path / "run.mcap", 20).read_bytes()
    at = whole.index(b"\x0f" + struct.pack("<Q", 4))
    path = tmp_path / "zeros.mcap"
    path.write_bytes(whole[:at] + chunk_record(bytes(100_000), 100_000, "") + whole[at:])
    tcp, _, _, aside = places(path)
    assert tcp == expected(20)[0]
    assert "break off at byte 9000 of 100000" in aside[0]


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
    ("files", "mode", "names", "compressed"),
    [
        ("    - run_0.mcap\n    - run_1.mcap", '""', ["run_0.mcap", "run_1.mcap"], False),
        ("  - 'my run_0.mcap'", "FILE", ["my run_0.mcap"], True),
        ('  - "run_0.mcap"', "none", ["run_0.mcap"], False),
        ('  - "r\\u00e9_0.mcap"', "''", ["ré_0.mcap"], False),  # only a parser of YAML reads this
        ("  - other/run_0.mcap   # a comment", "NONE", ["run_0.mcap"], False),
        ("    [run_0.mcap, run_1.mcap]", '""', ["run_0.mcap", "run_1.mcap"], False),
    ],
)
@pytest.mark.parametrize("last", [True, False])
def test_metadata_names_the_files_however_its_yaml_is_written(tmp_path, files, mode, names, compressed, last):
    for name in names:
        (tmp_path / name).touch()
    text = METADATA.format(files=files, mode=mode)
    if last:
        text = text.replace("  storage_identifier: mcap\n", "")
    (tmp_path / "metadata.yaml").write_text(text, encoding="utf-8")
    folder = folder_of(tmp_path)
    assert [file.name for file in folder.files] == names
    assert folder.compressed == compressed
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
