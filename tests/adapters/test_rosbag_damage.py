"""Of a bag that is cut, damaged or a bomb, what is whole is read, nothing is made up, and the rest is named."""

import random
import struct

import numpy as np
import pytest
from backports import zstd
from bag_files import (
    MCAPS,
    ROS1S,
    SCALING,
    T0,
    TCP,
    chunk_record,
    chunks_of,
    expected,
    places,
    write_db3,
    write_mcap,
    write_ros1,
)
from mcap.reader import make_reader
from rosbags.rosbag1 import Reader as Reader1

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog
from cyclekit_adapters.rosbag import ADAPTER, mcap_file


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
    assert "checksum of that chunk cannot be checked" in " ".join(log.warnings)
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
    assert "later ones are lost (at least" in said


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
    assert "end at byte 9000 of 100000" in aside[0]
