"""People in another frame than the robot's base are brought into it where the transforms of the bag lead there."""

import math

import numpy as np
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit_adapters.rosbag import ADAPTER

T0 = 1_700_000_000.0
QUARTER = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))  # a quarter turn about z
OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # a camera that looks along x: its z is forward, its y down


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


def places(table, columns=("x_m", "y_m", "z_m")):
    return table.select(columns).to_numpy()


def poses(writer, t_s, place, frame):
    header = writer.header(t_s, frame)
    writer.say("/poses", "geometry_msgs/msg/PoseArray", t_s, header=header, poses=[writer.pose(*place)])


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
@pytest.mark.parametrize("role", [None, "people"])
def test_people_seen_by_a_camera_come_into_the_base_over_a_chain_that_is_not_below_it(tmp_path, bag, kind, role):
    path = tmp_path / ("run.bag" if kind == "bag" else "run")
    writer = bag(path, kind)
    writer.transform(T0, ("world", "base", (1.0, 0.0, 0.0, *QUARTER)), topic="/tf_static")
    writer.transform(T0, ("world", "camera", (0.0, 2.0, 3.0)), topic="/tf_static")
    writer.transform(T0, ("camera", "camera_optical", (0.0, 0.0, 0.0, *OPTICAL)), topic="/tf_static")
    for i in range(3):
        writer.tcp(T0 + i, x=0.5)
        poses(writer, T0 + i, (0.0, 2.0, 4.0 + i), "/camera_optical")  # 2 m below the camera, ahead of it along world x
    writer.close()
    log = read(path, role=role)
    # In the world the person is at (4 + i, 2, 1); the base is at (1, 0, 0) there, its x along the world's y.
    assert places(log.people) == pytest.approx(np.array([[2.0, -3.0 - i, 1.0] for i in range(3)]))
    assert log.facts["people_frame"] == "transforms base <- world <- camera <- camera_optical"
    assert log.facts["base_frame"] == "base"
    assert not [said for said in log.warnings if "frame" in said]


def test_a_place_that_stands_for_nobody_is_not_taken_to_where_the_camera_stands(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("base", "camera", (0.0, 2.0, 3.0)), topic="/tf_static")
    for i, place in enumerate([(0.0, 1.0, 4.0), (0.0, 0.0, 0.0), (-1.0, -1.0, -1.0), (0.0, 1.0, 4.2)]):
        writer.tcp(T0 + i, x=0.5)
        poses(writer, T0 + i, place, "camera")
    writer.close()
    log = read(tmp_path / "run")
    assert log.people["z_m"].to_list() == pytest.approx([7.0, None, None, 7.2])
    assert log.warnings[-1].startswith("2 positions on /poses are exactly 0, 0, 0 or -1, -1, -1")
    assert not [said for said in log.warnings if "not published" in said]


def test_the_frame_in_the_headers_of_the_tcp_is_the_robots_base(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("cell", "base", (9.0, 9.0, 9.0)), topic="/tf_static")
    writer.transform(T0, ("cell", "camera", (0.0, 0.0, 1.0)), topic="/tf_static")
    pose, header = writer.pose(1.0, 0.0, 0.0), writer.header(T0, "cell")
    writer.say("/tcp_pose_broadcaster/pose", "geometry_msgs/msg/PoseStamped", T0, header=header, pose=pose)
    poses(writer, T0, (1.0, 2.0, 3.0), "camera")
    writer.close()
    assert places(read(tmp_path / "run").people).tolist() == [[1.0, 2.0, 4.0]]
    chosen = read(tmp_path / "run", map={"base_frame": "base"})
    assert places(chosen.people).tolist() == [[-8.0, -7.0, -5.0]]
    assert places(chosen.robot, TCP).tolist() == [[-8.0, -9.0, -9.0]]


UR_JOINTS = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
TCP = ("tcp_x_m", "tcp_y_m", "tcp_z_m")
HALF = (0.0, 0.0, 1.0, 0.0)


@pytest.mark.parametrize("has_link", [True, False])
@pytest.mark.parametrize(("asked", "sign"), [({}, 1.0), ({"base_frame": "base_link"}, -1.0)])
def test_tcp_and_people_of_a_ur_come_out_in_one_frame(tmp_path, bag, has_link, asked, sign):
    """The driver logs the TCP in `base`, which is `base_link` turned by pi; cameras are calibrated to `base_link`."""
    writer = bag(tmp_path / "run", "mcap")
    if has_link:
        writer.transform(T0, ("base_link", "base", (0.0, 0.0, 0.0, *HALF)), topic="/tf_static")
    writer.transform(T0, ("base_link", "camera", (0.0, 0.0, 1.0)), topic="/tf_static")
    for i in range(3):
        writer.tcp(T0 + i, x=0.5)
        writer.joints(T0 + i, UR_JOINTS, [0.1] * 6)
        poses(writer, T0 + i, (2.0, 1.0, 0.0), "camera")
    writer.close()
    log = read(tmp_path / "run", map=asked)
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([sign * 0.5] * 3)
    assert places(log.people) == pytest.approx(np.array([[-2.0 * sign, -1.0 * sign, 1.0]] * 3))
    assert any("half turn" in said for said in log.warnings) != has_link


def test_a_base_frame_that_no_transform_connects_with_the_tcp_is_not_used_for_people_alone(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("world", "camera", (0.0, 0.0, 1.0)), topic="/tf_static")
    writer.tcp(T0, x=0.5)
    poses(writer, T0, (2.0, 1.0, 0.0), "camera")
    writer.close()
    log = read(tmp_path / "run", map={"base_frame": "world"})
    assert log.facts["base_frame"] == "base"
    assert any("no transforms from base_frame = 'world'" in said for said in log.warnings)


@pytest.mark.parametrize(
    ("base", "tool"),
    [("fr3_link0", "fr3_hand_tcp"), ("panda_link0", "panda_link8"), ("iiwa_link_0", "iiwa_link_ee")],
)
def test_the_first_link_of_an_arm_is_its_base(tmp_path, bag, base, tool):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("world", base, (5.0, 0.0, 0.0)), ("world", "camera", (0.0, 0.0, 1.0)), topic="/tf_static")
    for i in range(3):
        writer.transform(T0 + i, (base, tool, (0.5, 0.1 * i, 0.3)))
        poses(writer, T0 + i, (2.0, 1.0, 0.0), "camera")
    writer.close()
    log = read(tmp_path / "run")
    assert log.facts["base_frame"] == base
    assert places(log.robot, TCP) == pytest.approx(np.array([[0.5, 0.1 * i, 0.3] for i in range(3)]))
    assert places(log.people).tolist() == [[-3.0, 1.0, 1.0]] * 3


def test_where_the_cell_file_says_where_the_frame_stands_the_people_stay_in_it(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("base", "camera", (0.0, 0.0, 1.0)), topic="/tf_static")
    writer.tcp(T0, x=0.5)
    poses(writer, T0, (1.0, 2.0, 3.0), "camera")
    writer.close()
    log = read(tmp_path / "run", frame_given=True)
    assert places(log.people).tolist() == [[1.0, 2.0, 3.0]]
    assert log.facts["people_frame"] == "camera"
    assert not [said for said in log.warnings if "frame" in said]


def test_people_in_a_frame_that_no_transform_leads_to_stay_there_and_that_is_said(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0, x=0.5)
    poses(writer, T0, (1.0, 2.0, 3.0), "camera")
    writer.close()
    log = read(tmp_path / "run")
    assert places(log.people).tolist() == [[1.0, 2.0, 3.0]]
    said = "no transforms from the robot's base ('base') to the people: they are in frame 'camera'"
    assert [warning for warning in log.warnings if warning.startswith(said)]


def test_a_camera_that_moves_is_taken_where_it_was_and_not_where_nobody_said(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    for i in range(60):
        if not 20 <= i < 40:
            writer.transform(T0 + i / 10, ("base", "camera", (i / 10, 0.0, 0.0)))
        poses(writer, T0 + i / 10, (0.0, 1.0, 1.0), "camera")
    writer.tcp(T0, x=0.5)
    writer.close()
    log = read(tmp_path / "run")
    x = log.people["x_m"].to_list()
    assert x[:20] == pytest.approx([i / 10 for i in range(20)])
    assert x[40:] == pytest.approx([i / 10 for i in range(40, 60)])
    assert x[26:34] == [None] * 8  # more than half a second from any transform
    assert [said for said in log.warnings if "/poses are unknown: a transform" in said]


def test_each_part_of_a_topic_is_in_the_frame_of_its_own_header(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("base", "left", (0.0, 10.0, 0.0)), topic="/tf_static")
    writer.tcp(T0, x=0.5)
    poses(writer, T0, (1.0, 0.0, 0.0), "left")
    poses(writer, T0 + 1, (1.0, 0.0, 0.0), "base")
    writer.close()
    assert places(read(tmp_path / "run").people).tolist() == [[1.0, 10.0, 0.0], [1.0, 0.0, 0.0]]


def test_each_marker_of_an_array_is_in_the_frame_of_its_own_header(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("base", "left", (0.0, 10.0, 0.0)), ("base", "right", (0.0, -10.0, 0.0)), topic="/tf_static")
    writer.tcp(T0, x=0.5)
    kind = "visualization_msgs/msg/Marker"
    markers = [
        writer.random(kind, id=number, action=0, header=writer.header(T0, frame), pose=writer.pose(1.0, 0.0, 0.0))
        for number, frame in ((100, "left"), (200, "right"))
    ]
    writer.say("/k4a/body_tracking_data", "visualization_msgs/msg/MarkerArray", T0, markers=markers)
    writer.close()
    people = read(tmp_path / "run").people
    assert people.select("person", "y_m").rows() == [("1", 10.0), ("2", -10.0)]


def test_a_frame_with_two_parents_is_taken_where_it_was_said_most_often_and_that_is_said(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0, x=0.5)
    for i in range(4):
        parent = "base" if i else "other_camera"
        writer.transform(T0 + i, (parent, "camera", (float(i), 0.0, 0.0)))
        poses(writer, T0 + i, (0.0, 1.0, 1.0), "camera")
    writer.close()
    log = read(tmp_path / "run")
    assert log.people["x_m"].to_list()[1:] == [1.0, 2.0, 3.0]
    assert [
        said for said in log.warnings if "'camera' has several parents" in said and "'base', the most frequent" in said
    ]


def test_a_ring_of_transforms_leads_nowhere(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0, x=0.5)
    writer.transform(T0, ("a", "b", (1.0, 0.0, 0.0)), ("b", "a", (1.0, 0.0, 0.0)))
    poses(writer, T0, (1.0, 2.0, 3.0), "a")
    writer.close()
    assert places(read(tmp_path / "run").people).tolist() == [[1.0, 2.0, 3.0]]


def test_the_tool_is_found_between_chosen_frames_in_any_direction(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("world", "table", (1.0, 0.0, 0.0, *QUARTER)), topic="/tf_static")
    for i in range(3):
        writer.transform(T0 + i, ("world", "wrist", (float(i), 2.0, 1.0)), ("wrist", "gripper", (0.0, 0.0, 0.5)))
    writer.close()
    log = read(tmp_path / "run", map={"base_frame": "table", "tool_frame": "gripper"})
    tcp = places(log.robot, ("tcp_x_m", "tcp_y_m", "tcp_z_m"))
    assert tcp == pytest.approx(np.array([[2.0, 1.0 - i, 1.5] for i in range(3)]))
    assert log.facts["tcp"] == "transforms table <- world <- wrist <- gripper"
    assert log.robot["source_row"].to_list() == [0, 1, 2]
    assert log.facts["rows of robot"] == "messages of /tf"


def test_a_row_from_the_transforms_names_the_message_that_it_was_in(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    for i in range(4):
        writer.transform(T0 + i, ("world", "something_else", (0.0, 0.0, 0.0)))
        writer.transform(T0 + i + 0.5, ("base", "tool0", (float(i), 0.0, 0.0)))
    writer.close()
    assert read(tmp_path / "run").robot["source_row"].to_list() == [1, 3, 5, 7]
