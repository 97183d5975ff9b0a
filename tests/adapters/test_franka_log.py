import math

import numpy as np
import pytest
from damage import read_damaged
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError, MissingColumns, UnknownName
from cyclekit.ingest.registry import find_adapter
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats.franka_log import ADAPTER
from cyclekit_adapters.robots.panda_arm import flange_position_m

GROUPS = [
    *((f"state.{name}", 7) for name in ("q", "q_d", "dq", "dq_d", "tau_J", "tau_ext_hat_filtered")),
    *(("cmd.q_d", 7), ("cmd.dq_d", 7), ("cmd.O_T_EE_d", 16), ("cmd.O_dP_EE_d", 6), ("cmd.tau_J_d", 7)),
]
COLUMNS = ["time", "success_rate", *(f"{name}[{i}]" for name, size in GROUPS for i in range(size))]
IDENTITY = {f"cmd.O_T_EE_d[{i}]": 1 for i in (0, 5, 10, 15)}


def line(time_ms, q=(0,) * 7, dq=(0,) * 7, **other):
    values = dict.fromkeys(COLUMNS, 0) | {"time": time_ms, "success_rate": 1} | IDENTITY | other
    values |= {f"state.q[{i}]": angle for i, angle in enumerate(q)}
    values |= {f"state.dq[{i}]": speed for i, speed in enumerate(dq)}
    return ",".join(str(values[name]) for name in COLUMNS)


def write(path, *lines, columns=COLUMNS):
    path.write_text("\n".join([",".join(columns), *lines]) + "\n", encoding="utf-8", newline="")
    return path


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


def test_stretched_upwards_the_flange_is_where_the_link_lengths_put_it(tmp_path):
    path = write(tmp_path / "log.csv", line(1000), line(1001, q=(math.pi / 2, 0, 0, 0, 0, 0, 0)))
    assert find_adapter(path).name == "franka-log"
    log = read(path)
    up_m = 0.333 + 0.316 + 0.384 - 0.107  # base, upper arm, forearm; the flange hangs down at the wrist's 0.088
    places = log.robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").to_numpy()
    assert places == pytest.approx(np.array([[0.088, 0, up_m], [0, 0.088, up_m]]), abs=1e-12)


def test_with_a_bent_elbow_the_forearm_reaches_forward(tmp_path):
    # The elbow stands at x 0.0825, z 0.333 + 0.316; from it the flange is 0.384 - 0.107 ahead and 0.088 - 0.0825 down.
    log = read(write(tmp_path / "log.csv", line(1, q=(0, 0, 0, -math.pi / 2, 0, 0, 0))))
    row = log.robot.row(0, named=True)
    assert (row["tcp_x_m"], row["tcp_z_m"]) == pytest.approx((0.0825 + 0.277, 0.649 - 0.0055))
    assert row["tcp_y_m"] == pytest.approx(0.0, abs=1e-12)


def test_the_makers_ready_pose_is_30_cm_ahead_of_the_base(tmp_path):
    ready = (0, -math.pi / 4, 0, -3 * math.pi / 4, 0, math.pi / 2, math.pi / 4)
    row = read(write(tmp_path / "log.csv", line(1, q=ready))).robot.row(0, named=True)
    # Known for the hand: (0.307, 0, 0.487); its tip is 0.1034 below the flange, which points down here.
    assert (row["tcp_x_m"], row["tcp_z_m"]) == pytest.approx((0.307, 0.487 + 0.1034), abs=5e-4)


def test_time_is_in_milliseconds_of_the_robot_and_joint_speeds_are_read(tmp_path):
    log = read(write(tmp_path / "log.csv", *(line(1000 + t, q=range(7), dq=(0.1,) * 7) for t in range(3))))
    assert log.robot["t_s"].to_list() == pytest.approx([1.0, 1.001, 1.002])
    assert log.robot["q6_rad"].to_list() == [6, 6, 6]
    assert log.robot["qd3_rad_s"].to_list() == [0.1] * 3
    assert log.clock == "uptime"
    assert log.joint_names == tuple(f"state.q[{i}]" for i in range(7))


def test_the_commanded_pose_is_never_taken_for_the_measured_one(tmp_path):
    far = {"cmd.O_T_EE_d[12]": 9, "cmd.O_T_EE_d[13]": 9, "cmd.O_T_EE_d[14]": 9}
    log = read(write(tmp_path / "log.csv", line(1, **far)))
    assert log.robot["tcp_x_m"][0] == pytest.approx(0.088)
    assert log.robot["scaling"].null_count() == 1
    assert "flange" in log.facts["tcp"]
    assert any("no hand and no tool" in said for said in log.warnings)


def test_an_unknown_angle_makes_the_place_unknown_and_keeps_the_row(tmp_path):
    log = read(write(tmp_path / "log.csv", line(1, q=(0, "nan", 0, 0, 0, 0, 0)), line(2)))
    assert log.robot["tcp_z_m"].to_list() == [None, pytest.approx(0.926)]
    assert log.robot["q1_rad"].to_list() == [None, 0.0]


def test_a_space_behind_each_comma_of_the_header_changes_nothing(tmp_path):
    path = write(tmp_path / "log.csv", line(1))
    path.write_text(path.read_text().replace(",state", ", state", 10), encoding="utf-8")
    assert read(path).robot.height == 1


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_file_saved_again_by_a_windows_editor_is_read(tmp_path, encoding):
    path = write(tmp_path / "log.csv", line(1), line(2))
    path.write_bytes(path.read_text(encoding="utf-8").encode(encoding))
    assert ADAPTER.recognises(path)
    assert read(path).robot["t_s"].to_list() == pytest.approx([0.001, 0.002])


def test_repeats_and_a_cut_last_row_are_set_aside(tmp_path):
    path = write(tmp_path / "log.csv", line(1), line(1), line(2), line(3))
    path.write_bytes(path.read_bytes()[:-3])
    log = examined(read(path))
    assert log.robot["source_row"].to_list() == [2, 4]
    assert sorted(log.set_aside["source_row"]) == [3, 5]


def test_a_log_without_a_joint_a_row_or_a_known_key_is_refused(tmp_path):
    path = write(tmp_path / "log.csv", "1,2", columns=["time", "state.q[0]"])
    assert ADAPTER.recognises(path)
    with pytest.raises(MissingColumns, match=r"state\.q\[1\]"):
        read(path)
    with pytest.raises(DamagedLog, match="a header and no rows"):
        read(write(tmp_path / "log.csv"))
    with pytest.raises(UnknownName, match="tool"):
        read(path, map={"tool": 1})


def test_other_tables_and_folders_are_not_mine(tmp_path):
    assert not ADAPTER.recognises(tmp_path)
    assert not ADAPTER.recognises(write(tmp_path / "a.csv", "1,2", columns=["time", "x"]))
    with pytest.raises(LogError):
        read(tmp_path / "absent.csv")


def test_a_damaged_log_is_read_in_part_or_refused(tmp_path):
    path = write(tmp_path / "log.csv", *(line(t, q=(0.1 * t,) * 7) for t in range(6)))
    read_damaged(ADAPTER, path, path.read_bytes(), seed=31)


def link(a, d, alpha, theta):
    ca, sa, ct, st_ = math.cos(alpha), math.sin(alpha), math.cos(theta), math.sin(theta)
    return np.array(
        [[ct, -st_, 0, a], [st_ * ca, ct * ca, -sa, -d * sa], [st_ * sa, ct * sa, ca, d * ca], [0, 0, 0, 1]]
    )


@at_most(60)
@given(st.lists(st.floats(-3.1, 3.1), min_size=7, max_size=7))
def test_the_flange_is_the_product_of_the_seven_link_matrices(q):
    h = math.pi / 2
    table = [(0, 0.333, 0), (0, 0, -h), (0, 0.316, h), (0.0825, 0, h), (-0.0825, 0.384, -h), (0, 0, h), (0.088, 0, h)]
    pose = np.eye(4)
    for (a, d, alpha), theta in zip(table, q, strict=True):
        pose = pose @ link(a, d, alpha, theta)
    pose = pose @ link(0, 0.107, 0, 0)
    assert flange_position_m(np.array([q]))[0] == pytest.approx(pose[:3, 3], abs=1e-12)


def test_seconds_of_another_logger_are_not_taken_for_milliseconds(tmp_path):
    path = write(tmp_path / "log.csv", line(0.0), line(0.001), line(0.002))
    with pytest.raises(DamagedLog, match=r"0\.002 is not a whole number of milliseconds") as refusal:
        read(path)
    assert 'adapter = "csv"' in str(refusal.value)
    log = read(write(tmp_path / "log.csv", line(1), line(2), line(2.5), line(3)))
    assert log.robot["t_s"].to_list() == pytest.approx([0.001, 0.002, 0.003])
    assert log.set_aside["source_row"].to_list() == [4]
