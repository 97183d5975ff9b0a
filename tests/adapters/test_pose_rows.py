import pytest
from damage import read_damaged
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog, LogError, MissingColumns, UnknownName
from cyclekit.ingest.registry import find_adapter
from cyclekit_adapters.formats.pose_rows import ADAPTER

MATRIX = [f"O_T_EE[{i}]" for i in range(16)]


def write(path, columns, *rows):
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n", encoding="utf-8")
    return path


def read(path, rate_hz=1000.0, **options):
    return ADAPTER.read(path, ReadOptions(rate_hz=rate_hz, **options))


def test_the_rate_that_the_cell_file_gives_is_the_only_clock(tmp_path):
    path = write(tmp_path / "poses.csv", "xyz", (0.5, -0.25, 0.75), (0.5, -0.25, 1.0), (0.5, 0.0, 1.0))
    assert find_adapter(path).name == "pose-rows"
    log = read(path, rate_hz=250.0)
    assert log.robot["t_s"].to_list() == pytest.approx([0, 0.004, 0.008])
    assert log.robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").row(1) == (0.5, -0.25, 1.0)
    assert log.clock == "relative"
    assert "250 Hz" in log.facts["time"]


def test_without_a_rate_the_log_is_refused_and_the_cure_names_rate_hz(tmp_path):
    path = write(tmp_path / "poses.csv", "xyz", (1, 2, 3))
    with pytest.raises(MissingColumns, match="'time'") as refusal:
        ADAPTER.read(path, ReadOptions())
    assert "rate_hz" in refusal.value.cure
    with pytest.raises(ConfigError, match="is not a rate"):
        read(path, rate_hz=0.0)


def test_the_matrix_is_column_major_so_the_place_is_its_numbers_12_to_14(tmp_path):
    row = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.4, -0.1, 0.6, 1]
    robot = read(write(tmp_path / "poses.csv", MATRIX, row)).robot
    assert robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").row(0) == (0.4, -0.1, 0.6)
    assert robot["scaling"].to_list() == [None]


@pytest.mark.parametrize("name", ["O_T_EE_{}", "state.O_T_EE[{}]"])
def test_joint_angles_beside_the_matrix_are_read(tmp_path, name):
    columns = [name.format(i) for i in range(16)] + [f"q_{i}" for i in range(7)]
    log = read(write(tmp_path / "poses.csv", columns, [*range(16), *range(7)]))
    assert log.robot["tcp_z_m"].to_list() == [14]
    assert log.robot["q6_rad"].to_list() == [6]
    assert log.joint_names == tuple(f"q_{i}" for i in range(7))


@pytest.mark.parametrize("turn", [["qx", "qy", "qz", "qw"], ["roll", "pitch", "yaw"], ["rx", "ry", "rz"]])
def test_an_orientation_beside_the_place_is_no_obstacle(tmp_path, turn):
    path = write(tmp_path / "poses.csv", ["X", "Y", "Z", *turn], [1, 2, 3, *[0] * len(turn)])
    assert ADAPTER.recognises(path)
    assert read(path).robot["tcp_y_m"].to_list() == [2]


def test_millimetres_are_metres_only_if_the_cell_file_says_so(tmp_path):
    path = write(tmp_path / "poses.csv", "xyz", (400, 0, 600))
    assert read(path, map={"length_unit": "mm"}).robot["tcp_x_m"].to_list() == [0.4]
    log = read(path)
    assert log.robot["tcp_x_m"].to_list() == [400.0]
    assert any("states no unit" in said for said in log.warnings)
    with pytest.raises(UnknownName, match="length_unit"):
        read(path, map={"length_unit": "feet"})
    with pytest.raises(UnknownName, match="lenght_unit"):
        read(path, map={"lenght_unit": "mm"})


def test_a_row_that_is_set_aside_does_not_shift_the_times_behind_it(tmp_path):
    log = read(write(tmp_path / "poses.csv", "xyz", (0, 0, 0), (1, "", 0), (1, 1), (2, 0, 0)), rate_hz=2.0)
    assert log.robot["t_s"].to_list() == [0.0, 1.5]
    assert log.set_aside["source_row"].to_list() == [3, 4]


def test_a_last_row_cut_while_being_written_is_set_aside(tmp_path):
    path = write(tmp_path / "poses.csv", "xyz", (0, 0, 0), (1, 1, 0.125))
    path.write_bytes(path.read_bytes()[:-3])
    assert read(path).robot.height == 1


@pytest.mark.parametrize(
    "columns",
    [
        ["time", "x", "y", "z"],
        ["x", "y", "z", "gripper"],
        ["x", "y"],
        ["x", "X", "y", "z"],
        MATRIX[:15],
        ["time", *MATRIX],
        ["frame", "id", "x", "y"],
    ],
)
def test_a_table_with_anything_but_poses_is_not_mine(tmp_path, columns):
    path = write(tmp_path / "a.csv", columns, [1] * len(columns))
    assert not ADAPTER.recognises(path)
    with pytest.raises(DamagedLog, match="not a table of poses") as refusal:
        read(path)
    assert 'adapter = "csv"' in refusal.value.cure


def test_people_folders_and_empty_logs_are_refused(tmp_path):
    path = write(tmp_path / "poses.csv", "xyz", (1, 2, 3))
    with pytest.raises(ConfigError, match="read as people"):
        read(path, role="people")
    assert not ADAPTER.recognises(tmp_path)
    with pytest.raises(LogError):
        read(tmp_path)
    with pytest.raises(DamagedLog, match="a header and no rows"):
        read(write(tmp_path / "poses.csv", "xyz"))


def test_a_damaged_log_is_read_in_part_or_refused(tmp_path):
    path = write(tmp_path / "poses.csv", "xyz", *((0.125 * i, -1.5, 2e-3) for i in range(12)))
    read_damaged(ADAPTER, path, path.read_bytes(), seed=41, options=ReadOptions(rate_hz=100.0))


@at_most(40)
@given(
    st.lists(st.tuples(*[st.floats(-5, 5)] * 3), min_size=1, max_size=20),
    st.floats(0.5, 2000),
    st.permutations(["x", "y", "z", "qx", "qy", "qz", "qw"]),
)
def test_any_poses_come_back_in_whatever_order_the_columns_are(tmp_path_factory, places, rate_hz, columns):
    rows = [[dict(zip("xyz", place, strict=True)).get(name, 0) for name in columns] for place in places]
    path = write(tmp_path_factory.mktemp("poses") / "poses.csv", columns, *rows)
    robot = read(path, rate_hz=rate_hz).robot
    assert robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").rows() == places
    assert robot["t_s"].to_list() == pytest.approx([i / rate_hz for i in range(len(places))])


def test_a_matrix_written_row_by_row_is_refused_and_not_read_as_the_origin(tmp_path):
    row = [1, 0, 0, 0.4, 0, 1, 0, -0.1, 0, 0, 1, 0.6, 0, 0, 0, 1]
    path = write(tmp_path / "poses.csv", MATRIX, row, row)
    with pytest.raises(DamagedLog, match="row by row") as refusal:
        read(path)
    assert 'x = "O_T_EE[3]"' in str(refusal.value)
    identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    assert read(write(tmp_path / "poses.csv", MATRIX, identity)).robot["tcp_x_m"].to_list() == [0.0]
