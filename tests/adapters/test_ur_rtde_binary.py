import struct

import numpy as np
import polars as pl
import pytest
from damage import read_damaged
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, MissingColumns
from cyclekit.ingest.registry import find_adapter
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats.ur_rtde import ADAPTER

TYPES = {  # per column of the text form; the writer spells vectors out
    "actual_digital_output_bits": ("UINT64", "Q"),
    "output_int_register_0": ("INT32", "i"),
    "output_int_register_3": ("INT32", "i"),
    "runtime_state": ("UINT32", "I"),
}


def binary(rows):
    columns = list(rows[0])
    kinds = [TYPES.get(name, ("DOUBLE", "d")) for name in columns]
    head = " ".join(columns) + "\n" + " ".join(word for word, _ in kinds) + "\n"
    form = ">" + "".join(code for _, code in kinds)
    values = [[int(row[c]) if form[1 + i] in "QiI" else float(row[c]) for i, c in enumerate(columns)] for row in rows]
    return head.encode() + b"".join(struct.pack(form, *row) for row in values)


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


def sample(ur):
    return [
        ur.row(
            152.512 + i / 500, actual_TCP_pose_0=0.1 * i, actual_q_5=-i, actual_TCP_speed_1=0.25, runtime_state=state
        )
        | {"speed_scaling": 0.5, "actual_digital_output_bits": 2**17 + 5, "output_int_register_3": -7}
        for i, state in enumerate([1, 2, 2, 4])
    ]


def test_a_long_recording_is_mapped_block_by_block(tmp_path, ur, monkeypatch):
    path = tmp_path / "a.bin"
    path.write_bytes(binary([ur.row(1.0 + number / 125) for number in range(10)]))
    whole = read(path)
    monkeypatch.setattr("cyclekit_adapters.robots.rtde_binary._ROWS", 4)
    mapped, at_once = [], np.memmap
    monkeypatch.setattr(np, "memmap", lambda *words: mapped.append(words[-1][0]) or at_once(*words))
    assert read(path).robot.equals(whole.robot)
    assert mapped == [4, 4, 2]


def test_a_binary_recording_gives_the_same_tables_as_its_text_form(tmp_path, ur):
    (tmp_path / "a.bin").write_bytes(binary(sample(ur)))
    (tmp_path / "b.csv").write_text(ur.text(sample(ur)), newline="")
    assert find_adapter(tmp_path / "a.bin").name == "ur-rtde"
    options = {"map": {"register": "output_int_register_3"}}
    packed, text = read(tmp_path / "a.bin", **options), read(tmp_path / "b.csv", **options)
    assert packed.robot.drop("source_row").equals(text.robot.drop("source_row"))
    assert (packed.robot["source_row"][0], packed.rows_are) == (0, "row")
    assert (text.robot["source_row"][0], text.rows_are) == (2, "line")
    assert packed.set_aside.equals(text.set_aside)
    assert (packed.warnings, packed.joint_names, packed.clock) == (text.warnings, text.joint_names, text.clock)
    assert packed.rows_read == text.rows_read == 4
    assert packed.facts == dict(text.facts) | {"writer": "record.py --binary"}


def test_big_endian_values_are_what_the_controller_sent(tmp_path):
    path = tmp_path / "run.bin"
    head = b"timestamp actual_TCP_pose_0 actual_TCP_pose_1 actual_TCP_pose_2 runtime_state safe byte\n"
    head += b"DOUBLE DOUBLE DOUBLE DOUBLE UINT32 BOOL UINT8\n"
    one = bytes.fromhex("3ff8000000000000 bfe0000000000000 4000000000000000 3fd0000000000000 00000002 01 ff")
    path.write_bytes(head + one)
    row = read(path).robot.row(0, named=True)
    assert (row["t_s"], row["tcp_x_m"], row["tcp_y_m"], row["tcp_z_m"]) == (1.5, -0.5, 2.0, 0.25)
    assert row["state"] == "playing"


def test_a_cut_last_row_is_set_aside(tmp_path, ur):
    path = tmp_path / "run.bin"
    path.write_bytes(binary(sample(ur))[:-3])
    log = read(path)
    assert log.robot["source_row"].to_list() == [0, 1, 2]
    assert log.rows_read == 4
    assert log.set_aside["source_row"].to_list() == [3]
    assert "cut while being written" in log.set_aside["reason"][0]


def test_a_sample_that_was_written_twice_counts_once_and_an_infinite_value_is_unknown(tmp_path, ur):
    path = tmp_path / "run.bin"
    path.write_bytes(binary([ur.row(1.0), ur.row(1.0), ur.row(1.002, actual_q_0=float("inf"))]))
    log = examined(read(path))
    assert log.robot["t_s"].to_list() == [1.0, 1.002]
    assert log.robot["q0_rad"].to_list() == [0.0, None]
    assert log.set_aside["source_row"].to_list() == [1]


def test_a_row_whose_time_no_controller_can_have_is_set_aside(tmp_path, ur):
    path = tmp_path / "run.bin"
    path.write_bytes(binary([ur.row(1.0), ur.row(1e300), ur.row(-4.0), ur.row(float("nan")), ur.row(1.002)]))
    log = read(path)
    assert log.robot["source_row"].to_list() == [0, 4]
    assert log.set_aside["source_row"].to_list() == [1, 2, 3]


def test_two_lines_and_no_rows_are_refused_with_that_reason(tmp_path, ur):
    path = tmp_path / "run.bin"
    path.write_bytes(binary(sample(ur)).split(b"UINT32")[0] + b"UINT32\n")
    with pytest.raises(DamagedLog, match="a header and no rows"):
        read(path)


@pytest.mark.parametrize(
    ("types", "cause"),
    [
        (b"DOUBLE DOUBLE", "2 types for 3 columns"),
        (b"DOUBLE DOUBLE FLOAT", "'FLOAT' is not a type"),
        (b"DOUBLE VECTOR3D DOUBLE", "'VECTOR3D' is not a type"),
    ],
)
def test_a_line_of_types_that_does_not_fit_the_names_is_refused(tmp_path, types, cause):
    path = tmp_path / "run.bin"
    path.write_bytes(b"timestamp actual_q_0 actual_q_1\n" + types + b"\n" + bytes(48))
    assert ADAPTER.recognises(path)
    with pytest.raises(DamagedLog, match=cause):
        read(path)


def test_a_recording_cut_in_its_types_is_refused(tmp_path):
    path = tmp_path / "run.bin"
    path.write_bytes(b"timestamp actual_q_0\nDOUBLE DOU")
    with pytest.raises(DamagedLog, match="cut in its line of types"):
        read(path)


def test_a_recording_without_pose_and_joints_names_what_is_missing(tmp_path):
    path = tmp_path / "run.bin"
    path.write_bytes(b"timestamp actual_q_0\nDOUBLE DOUBLE\n" + bytes(range(256)))
    with pytest.raises(MissingColumns, match="actual_TCP_pose_0"):
        read(path)


def test_a_damaged_recording_is_read_in_part_or_refused(tmp_path, ur):
    path = tmp_path / "run.bin"
    read_damaged(ADAPTER, path, binary(sample(ur)), seed=11)


@at_most(30)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=12), st.integers(0, 400))
def test_whatever_doubles_were_sent_come_back_bit_by_bit(tmp_path_factory, values, cut):
    names = [f"actual_TCP_pose_{axis}" for axis in range(3)]
    head = " ".join(["timestamp", *names]) + "\nDOUBLE DOUBLE DOUBLE DOUBLE\n"
    rows = [struct.pack(">4d", 1.0 + i / 8, x, -x, x) for i, x in enumerate(values)]
    packed = b"".join(rows)
    cut = min(cut, len(packed) - 32)
    path = tmp_path_factory.mktemp("rtde") / "run.bin"
    path.write_bytes(head.encode() + packed[: len(packed) - cut])
    log = read(path)
    whole = (len(packed) - cut) // 32
    assert log.robot["tcp_x_m"].to_list() == values[:whole]
    assert log.robot["tcp_y_m"].to_list() == [-x for x in values[:whole]]
    assert log.set_aside.height == (1 if cut % 32 else 0)
    assert log.robot.schema["source_row"] == pl.Int64
