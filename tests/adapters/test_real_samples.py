"""Logs that real loggers wrote; expected values were read off the files' own bytes.

The files are not part of the project: the environment variable CYCLEKIT_SAMPLES names the folder that holds them.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog
from cyclekit.ingest.registry import find_adapter
from cyclekit_adapters import rosbag
from cyclekit_adapters.formats import mapped_csv

FOLDER = Path(os.environ.get("CYCLEKIT_SAMPLES", "absent"))
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="CYCLEKIT_SAMPLES names no folder")


def read(name, adapter):
    path = FOLDER / name
    found = find_adapter(path)
    assert found is not None
    assert found.name == adapter
    return found.adapter.read(path, ReadOptions())


def test_a_paused_ur_robot_is_no_slow_one():
    log = read("ur-rtde-paused/robot_data.csv", "ur-rtde")
    assert log.robot.height == log.rows_read == 256
    first = log.robot.row(0, named=True)
    assert first["t_s"] == pytest.approx(4029.539)
    assert (first["tcp_x_m"], first["tcp_z_m"]) == pytest.approx((-0.001076, 1.080296), abs=1e-6)
    assert set(log.robot["state"]) == {"paused"}
    assert set(log.robot["slider"]) == {1.0}
    assert log.robot["scaling"].null_count() == 256
    assert log.robot["t_s"].diff().median() == pytest.approx(0.1, abs=1e-3)


def test_a_ur5_in_motion_moves_as_fast_as_it_says():
    log = read("ur5-split-no8", "ur-split")
    assert log.robot.height == 1964
    row = log.robot.row(999, named=True)
    assert row["t_s"] == 7.992
    assert (row["tcp_x_m"], row["tcp_y_m"], row["tcp_z_m"]) == (0.190368, 0.810815, 0.100053)
    assert row["q0_rad"] == 1.512657
    speed = log.robot["tcp_speed_m_s"].to_numpy()
    assert speed.max() == pytest.approx(0.454644, abs=1e-6)
    place = log.robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").to_numpy()
    derived = np.linalg.norm(np.diff(place, axis=0), axis=1) / np.diff(log.robot["t_s"].to_numpy())
    assert np.corrcoef(derived, speed[1:])[0, 1] > 0.99
    assert derived.mean() == pytest.approx(speed.mean(), rel=0.02)


def test_a_logger_killed_while_writing_leaves_whole_rows_only():
    log = read("ur5-split-no9-truncated", "ur-split")
    assert log.robot.height == 2666
    assert log.robot["t_s"].max() == 21.32
    known = log.robot.filter(log.robot["q0_rad"].is_not_null())
    assert known["t_s"].max() == pytest.approx(20.984)
    assert known["q5_rad"][-1] == 1.082529
    assert log.set_aside.height == 4
    assert all("cut" in reason for reason in log.set_aside["reason"])


def test_a_motive_take_is_where_its_rigid_body_was():
    log = read("motive/Take 2022-07-01 11_07_07 (5974).csv", "motive")
    assert log.people.height == 10460
    assert log.people.row(0) == (0.0, "RigidBody", 0.047597, 0.607298, 0.329784, 8)
    assert log.people.row(10459)[2:] == (-0.065706, 0.730724, 0.312436, 10467)
    assert log.people.row(5000)[:5] == (5000 / 240, "RigidBody", -0.055315, 0.631462, 0.358502)
    assert log.people["t_s"][-1] == pytest.approx(10459 / 240)
    assert log.up == "y"


def test_a_hand_edited_take_is_read_by_its_time_column_and_says_so():
    log = read("motive/Pretend take (1315).csv", "motive")
    assert log.people["t_s"].to_list() == [0.0, 0.5]
    assert log.people.row(1)[2:5] == (-0.051253, 0.702758, 0.205539)
    assert "Time column is used" in log.warnings[0]


def test_a_ros_1_bag_whose_definitions_are_of_2010_is_read_whole():
    log = read("ros1-pr2/joint_states_indexed.bag", "rosbag")
    assert log.robot.height == log.rows_read == 1598
    assert log.clock == "relative"
    assert log.robot["t_s"][0] == pytest.approx(291.566)
    tilt = log.joint_names.index("head_tilt_joint")
    assert log.robot[f"q{tilt}_rad"][0] == pytest.approx(1.04676294)
    assert log.robot[f"qd{tilt}_rad_s"][0] == pytest.approx(-0.149284571)


@pytest.mark.parametrize("name", ["test_bag_mcap", "test_bag_mcap/test_bag_mcap.mcap"])
def test_a_bag_of_94_types_gives_the_joints_and_skips_the_rest(name):
    log = read(f"ros2-all-types/{name}", "rosbag")
    assert log.joint_names == ("joint1", "joint2", "joint3")
    assert log.robot.select("q0_rad", "q1_rad", "q2_rad").rows() == [(0.1, 0.2, 0.3)] * 2
    assert log.people is None
    assert "/test/sensor_msgs/point_cloud2" in log.facts["skipped_topics"]


def test_a_git_lfs_pointer_is_called_one():
    path = FOLDER / "nasty-lfs-pointer/test_rs.bag"
    assert find_adapter(path) is None
    with pytest.raises(DamagedLog, match="git lfs pull"):
        rosbag.ADAPTER.read(path, ReadOptions())


def test_nists_list_of_names_is_recognised_and_refused_because_it_has_no_rows():
    with pytest.raises(DamagedLog, match="a header and no rows"):
        read("nist-ur5-header-only/ur5_header.csv", "ur-nist")


def test_a_header_without_rows_is_refused_by_the_adapter_it_is_forced_on():
    path = FOLDER / "nist-ur5-header-only/ur5_header.csv"
    mapping = {"time": "ROBOT_TIME", "joints": ["ROBOT_ACTUAL_JOINT_POSITIONS (J1)"]}
    with pytest.raises(DamagedLog, match="a header and no rows"):
        mapped_csv.ADAPTER.read(path, ReadOptions(role="robot", map=mapping))


@pytest.mark.parametrize(
    ("name", "rows"),
    [("ros1-pr2/joint_states_indexed.bag", 2 * 365), ("ros2-all-types/test_bag_mcap/test_bag_mcap.mcap", 2)],
)
def test_of_a_real_bag_cut_in_half_the_whole_chunks_are_read_and_the_loss_is_said(tmp_path, name, rows):
    whole = (FOLDER / name).read_bytes()
    path = tmp_path / Path(name).name
    path.write_bytes(whole[: len(whole) // 2])
    found = find_adapter(path)
    log = found.adapter.read(path, ReadOptions())
    assert log.robot.height == rows
    assert "the bag is cut" in log.warnings[0]
