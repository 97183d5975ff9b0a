"""What a key of the map may say beside a name: a number, a pattern, one number of a list; and times in two parts."""

import math

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog, LogError, MissingColumns
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats import ur_rtde
from cyclekit_adapters.formats.mapped_csv import ADAPTER
from cyclekit_adapters.text.list_cells import ListCells
from cyclekit_adapters.text.text_rows import SET_ASIDE, TextRows

PLACE = {"time": "t", "x": "x", "y": "y", "z": "z"}


def read(path, text, role="robot", rate_hz=None, **mapping):
    path.write_text(text, encoding="utf-8")
    return ADAPTER.read(path, ReadOptions(role=role, map=mapping, rate_hz=rate_hz))


def test_a_column_is_meant_by_its_number_where_names_repeat_or_are_none(tmp_path):
    text = "t,X,,X\n0,1,2,3\n1,4,5,6\n"
    log = read(tmp_path / "log.csv", text, time="t", x="#2", y="#3", z="#4")
    assert log.robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").rows() == [(1, 2, 3), (4, 5, 6)]
    with pytest.raises(DamagedLog, match="two columns are called 'X'") as refusal:
        read(tmp_path / "log.csv", text, time="t", x="X", y="#3", z="#4")
    assert refusal.value.cure == 'Name it by its number: "#2" or "#4".'
    with pytest.raises(MissingColumns, match="#5"):
        read(tmp_path / "log.csv", text, time="t", x="#5", y="#3")


def test_a_log_that_was_continued_with_its_header_goes_on_though_names_repeat(tmp_path):
    text = "t,X,X\n0,1,2\nt,X,X\n1,3,4\n"
    log = read(tmp_path / "log.csv", text, time="t", x="#2", y="#3")
    assert log.robot["tcp_y_m"].to_list() == [2, 4]
    assert log.set_aside.rows() == [(3, "the header is repeated")]


def test_a_name_goes_before_what_it_could_stand_for(tmp_path):
    log = read(tmp_path / "log.csv", "t,#1,q[0],q*\n0,1,2,3\n", time="t", x="#1", y="q[0]", z="q*")
    assert log.robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").rows() == [(1, 2, 3)]


@pytest.mark.parametrize("joints", ["joint_*", "joint_?", "#2..#4", ["joint_1", "#3", "joint_3"]])
def test_one_entry_takes_many_columns_in_the_order_of_the_header(tmp_path, joints):
    log = read(tmp_path / "log.csv", "t,joint_1,joint_2,joint_3\n0,1,2,3\n", time="t", joints=joints)
    assert log.robot.select("q0_rad", "q1_rad", "q2_rad").rows() == [(1, 2, 3)]
    assert log.joint_names == ("joint_1", "joint_2", "joint_3")


def test_a_column_of_lists_named_as_joints_stands_for_all_its_numbers(tmp_path):
    text = 't;actual_q;pose\n0;"[1, 2, 3]";"[4, 5, 6]"\n1;"[2, 3, 4]";"[5, 6, 7]"\n'
    log = read(tmp_path / "log.csv", text, time="t", joints=["actual_q"], x="pose[0]", y="pose[1]")
    assert log.robot.select("q0_rad", "q1_rad", "q2_rad", "tcp_x_m").rows() == [(1, 2, 3, 4), (2, 3, 4, 5)]
    with pytest.raises(ConfigError, match="x = 'pose', but that column holds lists of 3 numbers"):
        read(tmp_path / "log.csv", text, time="t", x="pose", y="pose[1]")


def test_written_times_need_no_unit_and_no_format_where_only_one_is_possible(tmp_path):
    rows = "".join(f"2024-05-14 06:30:{2 * i:02},{0.1 * i},0\n" for i in range(20))
    log = read(tmp_path / "log.csv", f"t,x,y\n{rows}", time="t", x="x", y="y")
    assert log.robot["t_s"][-1] - log.robot["t_s"][0] == 38.0
    assert not any("time_unit" in said for said in examined(log).warnings)
    with pytest.raises(LogError, match="are written") as refusal:
        read(tmp_path / "log.csv", f"t,x,y\n{rows}", time="t", time_unit="s", x="x", y="y")
    assert 'time_format = "iso"' in refusal.value.cure
    with pytest.raises(LogError, match="are written") as refusal:
        read(tmp_path / "log.csv", "t,x,y\n01/02/2024 10:00:00,1,2\n", time="t", x="x", y="y")
    assert "%m/%d/%Y" in refusal.value.cure


def test_brackets_in_names_are_no_pattern(tmp_path):
    log = read(
        tmp_path / "log.csv", "t,J1 [deg],J2 [deg],Jd\n0,180,90,5\n", time="t", joints="J* [deg]", joint_unit="deg"
    )
    assert log.robot.row(0, named=True)["q1_rad"] == pytest.approx(math.pi / 2)
    assert log.joint_names == ("J1 [deg]", "J2 [deg]")


def test_a_key_of_one_column_refuses_a_pattern_that_means_several(tmp_path):
    with pytest.raises(ConfigError, match="x_1, x_2"):
        read(tmp_path / "log.csv", "t,x_1,x_2,y\n0,1,2,3\n", time="t", x="x_*", y="y")


def test_numbers_of_a_list_in_one_cell(tmp_path):
    text = 't,pose,q\n0,"[0.1, -0.2, 0.3, 0, 0, 0]","[1.0 2.0]"\n1,"[0.4, 0.5, 6e-1, 0, 0, 0]",\n'
    pose = {axis: f"pose[{place}]" for place, axis in enumerate("xyz")}
    log = read(tmp_path / "log.csv", text, time="t", joints="q[*]", **pose)
    assert log.robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").rows() == [(0.1, -0.2, 0.3), (0.4, 0.5, 0.6)]
    assert log.robot.select("q0_rad", "q1_rad").rows() == [(1.0, 2.0), (None, None)]
    assert log.joint_names == ("q[0]", "q[1]")


@pytest.mark.parametrize(
    ("cell", "reason"),
    [
        ('"[0.1, 0.2]"', "does not have 3 numbers"),
        ('"[0.1, 0.2, 0.3, 0.4]"', "does not have 3 numbers"),
        ('"[0.1, oops, 0.3]"', "holds a value that is not a number"),
        ('"0.1, 0.2, 0.3"', "is not a list of numbers"),
        ('"[0.1, 0.2, 0.3"', "is not a list of numbers"),
        ("[0.1 0.2 0.", "is not a list of numbers"),
    ],
)
def test_a_list_that_is_cut_or_garbled_sets_its_line_aside(tmp_path, cell, reason):
    text = f't,pose\n0,"[1, 2, 3]"\n1,{cell}\n2,"[4, 5, 6]"\n'
    log = read(tmp_path / "log.csv", text, time="t", x="pose[0]", y="pose[1]", z="pose[2]")
    assert log.robot["tcp_z_m"].to_list() == [3, 6]
    assert log.set_aside["source_row"].to_list() == [3]
    assert reason in log.set_aside["reason"][0]


def test_a_number_that_no_list_has_is_refused(tmp_path):
    text = 't,pose\n0,"[1, 2, 3]"\n'
    with pytest.raises(ConfigError, match="have 3 numbers"):
        read(tmp_path / "log.csv", text, time="t", x="pose[0]", y="pose[3]")
    with pytest.raises(ConfigError, match="holds no list"):
        read(tmp_path / "log.csv", text, time="t", joints="t[*]")


numbers = st.one_of(st.floats(allow_nan=False, allow_infinity=False, width=32), st.integers(-1000, 1000).map(float))


@given(
    values=st.lists(st.lists(numbers, min_size=3, max_size=3), min_size=1, max_size=5),
    between=st.sampled_from([",", ", ", " , ", ";", " ", "  "]),
    around=st.sampled_from(["[|]", "(|)", "{|}", " [ | ] ", "p[|]", "array([|])", "array([|], dtype=float32)"]),
)
def test_every_way_to_write_a_list_gives_its_numbers(values, between, around):
    cells = [around.replace("|", between.join(map(repr, row))) for row in values]
    frame = pl.DataFrame({"source_row": range(len(cells)), "v": cells})
    rows = TextRows(frame, len(cells), pl.DataFrame(schema=SET_ASIDE))
    taken = ListCells({"v": {0: "a", 1: "b", 2: "c"}}).rows(rows)
    assert taken.set_aside.is_empty()
    assert [list(row) for row in taken.frame.select("a", "b", "c").rows()] == values


def test_a_time_in_seconds_and_nanoseconds_is_one_time(tmp_path):
    text = "header.stamp.sec,header.stamp.nanosec,x,y\n1714557600,500000000,1,2\n1714557601,4000000,3,4\n"
    stamp = ["header.stamp.sec", "header.stamp.nanosec"]
    log = read(tmp_path / "log.csv", text, time=stamp, time_unit=["s", "ns"], clock="epoch", x="x", y="y")
    assert log.robot["t_s"].to_list() == pytest.approx([1714557600.5, 1714557601.004], abs=1e-6)
    assert log.clock == "epoch"


def test_a_part_of_a_second_that_is_longer_than_one_is_set_aside(tmp_path):
    text = "s,ns,x,y\n5,500000000,1,2\n6,6500000000,3,4\n7,-1,5,6\n"
    log = read(tmp_path / "log.csv", text, time=["s", "ns"], time_unit=["s", "ns"], x="x", y="y")
    assert log.robot["t_s"].to_list() == [5.5]
    assert log.set_aside["source_row"].to_list() == [3, 4]


@given(seconds=st.integers(0, 2**31), nanoseconds=st.lists(st.integers(0, 999_999_999), min_size=1, unique=True))
def test_split_times_keep_what_a_float_holds(tmp_path_factory, seconds, nanoseconds):
    lines = [f"{seconds},{part},1,2" for part in sorted(nanoseconds)]
    path = tmp_path_factory.mktemp("split") / "log.csv"
    log = read(
        path, "\n".join(["s,ns,x,y", *lines, ""]), role="people", time=["s", "ns"], time_unit=["s", "ns"], x="x", y="y"
    )
    wanted = [seconds + part * 1e-9 for part in sorted(nanoseconds)]
    assert log.people["t_s"].to_list() == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("mark", [";", ",", "\t"])
@pytest.mark.parametrize("quoted_names", [True, False])
def test_quoted_numbers_with_decimal_commas(tmp_path, mark, quoted_names):
    names = ["t", "x", "y", "z"]
    header = mark.join(f'"{name}"' if quoted_names else name for name in names)
    rows = [("0,5", "1,25", "-2,7", "3"), ("1", "1,5", "2,75e-1", "0,125")]
    body = "".join(mark.join(f'"{cell}"' for cell in row) + "\n" for row in rows)
    log = read(tmp_path / "log.csv", f"{header}\n{body}", decimal=",", **PLACE)
    assert log.robot.select("t_s", "tcp_x_m", "tcp_y_m", "tcp_z_m").rows() == [
        (0.5, 1.25, -2.7, 3),
        (1, 1.5, 0.275, 0.125),
    ]
    assert log.set_aside.is_empty()


def test_a_point_among_quoted_decimal_commas_is_no_number(tmp_path):
    text = '"t","x","y"\n"0,5","1,25","2"\n"1,5","1.250","2"\n'
    log = read(tmp_path / "log.csv", text, decimal=",", time="t", x="x", y="y")
    assert log.robot["tcp_x_m"].to_list() == [1.25]
    assert log.set_aside["source_row"].to_list() == [3]


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=4))
def test_numbers_in_quotes_with_decimal_commas_are_those_with_points(tmp_path_factory, values):
    folder = tmp_path_factory.mktemp("comma")
    pointed = "t,x,y\n" + "".join(f"{at},{value!r},1\n" for at, value in enumerate(values))
    quoted = '"t","x","y"\n' + "".join(f'"{at}","{value!r}","1"\n'.replace(".", ",") for at, value in enumerate(values))
    one = read(folder / "a.csv", pointed, time="t", x="x", y="y")
    other = read(folder / "b.csv", quoted, time="t", x="x", y="y", decimal=",")
    assert one.robot["tcp_x_m"].to_list() == other.robot["tcp_x_m"].to_list() == values


LISTS = (
    "timestamp,actual_q,actual_TCP_pose,speed_scaling,target_speed_fraction,runtime_state\n"
    '10.0,"[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]","[0.3, -0.2, 0.5, 0, 3.14, 0]",0.5,1.0,2\n'
    '10.008,"[0.1, 0.2, 0.3, 0.4, 0.5, 0.7]","[0.31, -0.2, 0.5, 0, 3.14, 0]",1.0,1.0,2\n'
    '10.016,"[0.1, 0.2, 0.3, 0.4, 0.5]","[0.31, -0.2, 0.5, 0, 3.14, 0]",1.0,1.0,2\n'
)


def test_vectors_of_a_ur_robot_as_lists_are_read_as_its_columns_are(tmp_path):
    path = tmp_path / "ur.csv"
    path.write_text(LISTS)
    assert ur_rtde.ADAPTER.recognises(path)
    log = ur_rtde.ADAPTER.read(path, ReadOptions())
    assert log.robot.select("t_s", "tcp_x_m", "q5_rad", "scaling").rows() == [
        (10.0, 0.3, 0.6, 0.5),
        (10.008, 0.31, 0.7, 1),
    ]
    assert log.set_aside["source_row"].to_list() == [4]
    assert len(log.joint_names) == 6


def test_a_ur_log_with_quoted_decimal_commas(tmp_path):
    path = tmp_path / "ur.csv"
    pose = [f"actual_TCP_pose_{axis}" for axis in range(3)]
    path.write_text(",".join(["timestamp", *pose]) + '\n"0,5","0,1","0,2","0,3"\n"0,508","0,1","0,2","0,4"\n')
    log = ur_rtde.ADAPTER.read(path, ReadOptions())
    assert log.robot.select("t_s", "tcp_z_m").rows() == [(0.5, 0.3), (0.508, 0.4)]
