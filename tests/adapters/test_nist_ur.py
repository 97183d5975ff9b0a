import math

import pytest
from damage import read_damaged
from hypothesis import given, settings
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError, MissingColumns, UnknownName
from cyclekit.ingest.registry import find_adapter
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats.nist_ur import ADAPTER

JOINTS = [f"J{i}" for i in range(1, 7)]
GROUPS = [
    "ROBOT_TARGET_JOINT_POSITIONS",
    "ROBOT_ACTUAL_JOINT_POSITIONS",
    "ROBOT_TARGET_JOINT_VELOCITIES",
    "ROBOT_ACTUAL_JOINT_VELOCITIES",
    "ROBOT_TARGET_JOITN_CURRENT",
    "ROBOT_ACTUAL_JOINT_CURRENT",
    "ROBOT_TARGET_JOINT_ACCELERATIONS",
    "ROBOT_TARGET_JOINT_TORQUES",
    "ROBOT_JOINT_CONTROL_CURRENT",
    "ROBOT_CARTESIAN_COORD_TOOL",
    "ROBOT_TCP_FORCE",
    "ROBOT_JOINT_TEMP",
]
PARTS = {
    "ROBOT_CARTESIAN_COORD_TOOL": ["x", "y", "z", "rx", "ry", "rz"],
    "ROBOT_TCP_FORCE": ["x", "y", "z", "rx", "ry", "rz"],
}
HEADER = ["ROBOT_TIME", *(f"{group} ({part})" for group in GROUPS for part in PARTS.get(group, JOINTS))]


def groups(t_s, q=(0.0,) * 6, qd=(0.0,) * 6, tool=(0.0,) * 6):
    values = dict.fromkeys(GROUPS, (9.0,) * 6)
    values |= {
        "ROBOT_ACTUAL_JOINT_POSITIONS": q,
        "ROBOT_ACTUAL_JOINT_VELOCITIES": qd,
        "ROBOT_CARTESIAN_COORD_TOOL": tool,
    }
    return [(t_s,), *(tuple(values[group]) for group in GROUPS)]


def table(*rows, names=HEADER, bom="\ufeff"):
    return bom + "\n".join([",".join(names), *(",".join(str(v) for g in row for v in g) for row in rows)]) + "\n"


def bare(*rows):
    return "".join("(" + ", ".join(str(list(group)) for group in row) + ")\n" for row in rows)


def write(path, text):
    path.write_text(text, encoding="utf-8", newline="")
    return path


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


SAMPLE = [groups(8.0 + i / 125, q=range(i, i + 6), qd=(0.5,) * 6, tool=(0.1 * i, -0.2, 0.3, 0, 0, 0)) for i in range(3)]


@pytest.mark.parametrize(
    "text", [table(*SAMPLE), bare(*SAMPLE), table(*SAMPLE, bom="")], ids=["table", "bare", "no bom"]
)
def test_tables_with_names_and_bracketed_rows_without_them_are_one_log(tmp_path, text):
    path = write(tmp_path / "ur5.csv", text)
    assert find_adapter(path).name == "ur-nist"
    log = read(path)
    assert log.robot["t_s"].to_list() == pytest.approx([8.0, 8.008, 8.016])
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([0.0, 0.1, 0.2])
    assert log.robot["tcp_z_m"].to_list() == [0.3] * 3
    assert log.robot["q5_rad"].to_list() == [5, 6, 7]
    assert log.robot["qd0_rad_s"].to_list() == [0.5] * 3
    assert log.robot["scaling"].null_count() == 3
    assert log.clock == "uptime"
    assert log.set_aside.is_empty()


@pytest.mark.parametrize("text", [table(*SAMPLE, bom=""), bare(*SAMPLE)], ids=["table", "bare"])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_file_saved_again_by_a_windows_editor_is_read(tmp_path, text, encoding):
    path = tmp_path / "ur5.csv"
    path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    assert ADAPTER.recognises(path)
    assert read(path).robot["q2_rad"].to_list() == [2, 3, 4]


def test_names_joined_by_an_underscore_are_the_same_names(tmp_path):
    names = [name.replace(" (", "_").replace(")", "") for name in HEADER]
    log = read(write(tmp_path / "ur5_flat.csv", table(*SAMPLE, names=names)))
    assert log.robot["q0_rad"].to_list() == [0, 1, 2]


def test_a_time_outside_of_the_brackets_is_read_alike(tmp_path):
    text = "".join(f"({row[0][0]}, " + ", ".join(str(list(group)) for group in row[1:]) + ")\n" for row in SAMPLE)
    path = write(tmp_path / "ur5.csv", text)
    assert ADAPTER.recognises(path)
    assert read(path).robot["t_s"].to_list() == pytest.approx([8.0, 8.008, 8.016])


def test_a_header_without_rows_is_refused_and_the_cure_points_at_the_rows(tmp_path):
    path = write(tmp_path / "ur5_header.csv", table())
    assert ADAPTER.recognises(path)
    with pytest.raises(DamagedLog, match="a header and no rows") as refusal:
        read(path)
    assert "needs no header" in refusal.value.cure


def test_units_that_the_cell_file_gives_are_followed(tmp_path):
    path = write(tmp_path / "ur5.csv", table(groups(1.0, q=(180,) * 6, qd=(90,) * 6, tool=(250, 0, 0, 0, 0, 0))))
    units = {"length_unit": "mm", "joint_unit": "deg", "joint_speed_unit": "deg/s"}
    row = read(path, map=units).robot.row(0, named=True)
    assert row["tcp_x_m"] == pytest.approx(0.25)
    assert row["q0_rad"] == pytest.approx(math.pi)
    assert row["qd0_rad_s"] == pytest.approx(math.pi / 2)
    assert not any("states no units" in said for said in read(path, map=units).warnings)
    assert any("states no units" in said for said in read(path).warnings)
    for wrong in ({"joint_unit": "grad"}, {"joint_unit": ["rad"]}, {"units": "deg"}):
        with pytest.raises(UnknownName):
            read(path, map=wrong)


def test_degrees_beside_radians_per_second_are_noticed(tmp_path):
    turning = [groups(1.0 + i / 125, q=(0.5 * i / 125,) * 6, qd=(0.5,) * 6) for i in range(9)]
    degrees = [groups(1.0 + i / 125, q=(math.degrees(0.5 * i / 125),) * 6, qd=(0.5,) * 6) for i in range(9)]
    assert not any("units are wrong" in said for said in read(write(tmp_path / "a.csv", table(*turning))).warnings)
    path = write(tmp_path / "b.csv", table(*degrees))
    assert any("57.3 times" in said for said in read(path).warnings)
    assert not any("units are wrong" in said for said in read(path, map={"joint_unit": "deg"}).warnings)


def test_rows_that_cannot_be_trusted_are_set_aside_with_their_reason(tmp_path):
    lines = bare(*SAMPLE, *SAMPLE[2:]).splitlines()
    lines[1] = lines[1].replace("-0.2", "-0.2.1")
    lines.insert(2, lines[2].replace("[", "[1.0, ", 1))
    log = read(write(tmp_path / "ur5.csv", "\n".join(lines)))
    assert log.robot["source_row"].to_list() == [1, 4]
    assert log.set_aside["source_row"].to_list() == [2, 3, 5]
    assert "'-0.2.1' in column 'ROBOT_CARTESIAN_COORD_TOOL (y)' is not a number" in log.set_aside["reason"][0]
    assert "74 fields where the header has 73" in log.set_aside["reason"][1]
    assert "cut" in log.set_aside["reason"][2]
    assert log.rows_read == 5


def test_a_row_without_its_time_is_set_aside_and_a_repeat_counts_once(tmp_path):
    log = examined(read(write(tmp_path / "ur5.csv", table(groups(1.0), groups("nan"), groups(1.0), groups(1.008)))))
    assert log.robot["t_s"].to_list() == [1.0, 1.008]
    assert log.set_aside["source_row"].to_list() == [3, 4]


def test_a_table_without_joints_and_tool_is_refused(tmp_path):
    path = write(tmp_path / "ur5.csv", "ROBOT_TIME,ROBOT_JOINT_TEMP (J1)\n1,30\n")
    with pytest.raises(MissingColumns, match=r"ROBOT_ACTUAL_JOINT_POSITIONS \(J1\)"):
        read(path)


def test_other_tables_and_folders_are_not_mine(tmp_path):
    assert not ADAPTER.recognises(tmp_path)
    assert not ADAPTER.recognises(write(tmp_path / "a.csv", "time,x,y\n1,2,3\n"))
    assert not ADAPTER.recognises(write(tmp_path / "a.csv", "([0.0], [1, 2, 3])\n"))
    with pytest.raises(LogError):
        read(tmp_path / "absent.csv")


@pytest.mark.parametrize("text", [table(*SAMPLE), bare(*SAMPLE)], ids=["table", "bare"])
def test_a_damaged_log_is_read_in_part_or_refused(tmp_path, text):
    path = tmp_path / "ur5.csv"
    read_damaged(ADAPTER, path, text.encode(), seed=51)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-6, 6)] * 6), min_size=1, max_size=8))
def test_any_angles_come_back_as_they_were_written(tmp_path_factory, angles):
    rows = [groups(1.0 + i / 125, q=q) for i, q in enumerate(angles)]
    path = write(tmp_path_factory.mktemp("nist") / "ur5.csv", bare(*rows))
    assert read(path).robot.select([f"q{j}_rad" for j in range(6)]).rows() == angles
