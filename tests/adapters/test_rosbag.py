import math
import struct

import numpy as np
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog, LogError, UnknownName
from cyclekit_adapters.rosbag import ADAPTER
from cyclekit_adapters.rosbag.container import opened

T0 = 1_700_000_000.0


def read(path, **options):
    assert ADAPTER.recognises(path)
    return ADAPTER.read(path, ReadOptions(**options))


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_every_container_gives_the_same_robot_people_and_events(tmp_path, bag, kind):
    path = tmp_path / ("run.bag" if kind == "bag" else "run")
    writer = bag(path, kind)
    for i in range(5):
        writer.tcp(T0 + i * 0.1, x=float(i), z=0.5)
        writer.joints(T0 + i * 0.1, ["a", "b"], [i * 0.5, -1.0])
        writer.number("/speed_scaling_factor", "Float64", T0 + i * 0.1, 0.25)
        writer.poses(T0 + i * 0.1, [(2.0, 3.0, 1.0)])
    writer.number("/operator/goal", "String", T0 + 0.25, "left table")
    writer.close()
    log = read(path)
    assert log.robot["tcp_x_m"].to_list() == [0, 1, 2, 3, 4]
    assert log.robot["q0_rad"].to_list() == [0, 0.5, 1, 1.5, 2]
    assert log.robot["scaling"].to_list() == [0.25] * 5
    assert log.people.select("person", "x_m", "y_m", "z_m").unique().rows() == [("0", 2.0, 3.0, 1.0)]
    assert log.events.select("signal", "value").rows() == [("/operator/goal", "left table")]
    assert log.robot["t_s"][3] == pytest.approx(T0 + 0.3, abs=1e-6)
    assert (log.clock, log.joint_names, log.rows_read) == ("epoch", ("a", "b"), 21)


def test_a_bare_mcap_is_read_without_its_folder(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0, x=1.0)
    writer.close()
    assert read(tmp_path / "run" / "run.mcap").robot["tcp_x_m"].to_list() == [1.0]


@pytest.mark.parametrize(
    ("topic", "kind", "value", "fraction"),
    [
        ("/speed_scaling_state_broadcaster/speed_scaling", "Float64", 1.0, 0.01),
        ("/left/speed_scaling_state_broadcaster/speed_scaling", "Float64", 50.0, 0.5),
        ("/speed_scaling_factor", "Float64", 1.0, 1.0),
        ("/speed_scaling_factor", "Int32", 1, 0.01),
        ("/speed_ovr", "Int64", 40, 0.4),
        ("/speed_ovr", "Int16", 40, 0.4),
        ("/safe_ovr_1_float64", "Float64", 40.0, 0.4),
        ("/speed_ovr", "Int64", 130, 1.0),
        ("/my_override", "Float64", 0.5, None),
    ],
)
def test_the_unit_of_a_scaling_comes_from_its_source_never_from_its_value(tmp_path, bag, topic, kind, value, fraction):
    writer = bag(tmp_path / "run", "mcap")
    writer.number(topic, kind, T0, value)
    writer.tcp(T0 + 0.1, x=0.0)
    writer.close()
    assert read(tmp_path / "run").robot["scaling"].to_list() == [fraction]


def test_a_scaling_of_unknown_unit_is_named_with_its_cure(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.number("/cell_3/speed_scaling", "Float64", T0, 0.5)
    writer.number("/battery", "Float64", T0, 0.5)
    writer.tcp(T0 + 0.1, x=0.0)
    writer.close()
    (said,) = [text for text in read(tmp_path / "run").warnings if "no speed scaling" in text]
    assert said.endswith('[sources.map] scaling = "/cell_3/speed_scaling" and scaling_max = 1 or 100')


def test_joints_are_put_in_order_from_the_base(tmp_path, bag):
    """Drivers of ROS publish them by name or by chance; the arm's kinematics need their order."""
    names = ["elbow", "shoulder_lift", "finger", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3"]
    writer = bag(tmp_path / "run", "mcap")
    writer.joints(T0, [f"{name}_joint" for name in names], [2.0, 1.0, 9.0, 0.0, 3.0, 4.0, 5.0])
    writer.close()
    log = read(tmp_path / "run")
    assert [log.robot[f"q{i}_rad"].item() for i in range(6)] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert log.joint_names[:3] == ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")


def test_the_overrides_of_one_controller_multiply_and_a_copy_counts_once(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.number("/speed_ovr", "Int64", T0, 50)
    writer.number("/safe_ovr_1", "Int64", T0, 50)
    writer.number("/safe_ovr_1_float", "Float32", T0, 50.0)
    writer.tcp(T0 + 0.1, x=0.0)
    writer.number("/safe_ovr_2", "Int64", T0 + 0.2, 0)
    writer.tcp(T0 + 0.3, x=0.0)
    writer.close()
    assert read(tmp_path / "run").robot["scaling"].to_list() == [0.25, 0.0]


def test_a_scaling_holds_until_the_next_one_and_is_unknown_before_the_first(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    for i in range(4):
        writer.tcp(T0 + i, x=0.0)
    writer.number("/speed_scaling_factor", "Float64", T0 + 0.5, 0.5)
    writer.number("/speed_scaling_factor", "Float64", T0 + 2.5, 1.0)
    writer.close()
    assert read(tmp_path / "run").robot["scaling"].to_list() == [None, 0.5, 0.5, 1.0]


def test_a_latched_program_state_holds_and_hides_the_scaling_of_a_stopped_program(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.number("/io_and_status_controller/robot_program_running", "Bool", T0 - 1, True)
    writer.number("/speed_scaling_factor", "Float64", T0 - 1, 0.5)
    writer.tcp(T0, x=0.0)
    writer.number("/io_and_status_controller/robot_program_running", "Bool", T0 + 0.5, False)
    writer.tcp(T0 + 1, x=0.0)
    writer.close()
    robot = read(tmp_path / "run").robot
    assert robot["state"].to_list() == ["playing", "stopped"]
    assert robot["scaling"].to_list() == [0.5, None]


def test_joints_are_taken_by_name_and_a_gripper_on_the_same_topic_is_left_out(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.joints(T0, ["shoulder", "elbow"], [1.0, 2.0])
    writer.joints(T0 + 0.05, ["finger"], [9.0])
    writer.joints(T0 + 0.1, ["elbow", "shoulder"], [2.5, 1.5])
    writer.joints(T0 + 0.2, ["shoulder", "elbow"], [3.0, 4.0])
    writer.close()
    log = read(tmp_path / "run")
    assert log.joint_names == ("shoulder", "elbow")
    assert log.robot.select("q0_rad", "q1_rad").rows() == [(1.0, 2.0), (1.5, 2.5), (3.0, 4.0)]
    assert any("other joints" in said for said in log.warnings)


def test_without_a_pose_the_tool_is_found_through_the_transforms(tmp_path, bag):
    quarter = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("wrist", "tool0", (0.5, 0.0, 0.0)), topic="/tf_static")
    for i in range(3):
        writer.transform(T0 + i, ("base", "wrist", (float(i), 0.0, 1.0, *quarter)))
    writer.close()
    robot = read(tmp_path / "run").robot
    assert robot["tcp_x_m"].to_list() == pytest.approx([0, 1, 2], abs=1e-12)
    assert robot["tcp_y_m"].to_list() == pytest.approx([0.5] * 3)
    assert robot["tcp_z_m"].to_list() == pytest.approx([1.0] * 3)


def test_each_topic_is_timed_by_its_header_or_else_by_the_moment_of_recording(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    pose = writer.pose(1.0, 0.0, 0.0)
    topic, kind = "/tcp_pose_broadcaster/pose", "geometry_msgs/msg/PoseStamped"
    for i in range(3):
        writer.say(topic, kind, T0 + i + 0.04, header=writer.header(T0 + i), pose=pose)
    writer.number("/speed_scaling_factor", "Float64", T0 + 0.9, 0.25)
    writer.number("/speed_scaling_factor", "Float64", T0 + 1.02, 0.5)  # after the second pose was measured
    writer.close()
    log = read(tmp_path / "run")
    assert log.robot["t_s"].to_list() == pytest.approx([T0, T0 + 1, T0 + 2])
    assert log.robot["scaling"].to_list() == [None, 0.25, 0.5]
    assert log.facts["time"] == "header stamp and receive time"
    assert log.facts[f"time of {topic}"].startswith(
        "header stamp (of the recorder's clock, received at least 0.040 s later"
    )


def test_an_array_with_fewer_people_has_people_not_seen(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.poses(T0, [(1.0, 0, 0), (2.0, 0, 0)])
    writer.poses(T0 + 1, [(1.5, 0, 0)])
    writer.close()
    people = read(tmp_path / "run").people
    assert people.select("person", "x_m").rows() == [("0", 1.0), ("1", 2.0), ("0", 1.5), ("1", None)]


def test_a_role_keeps_only_its_part(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0, x=0.0)
    writer.poses(T0, [(1.0, 0, 0)])
    writer.close()
    assert read(tmp_path / "run", role="people").robot is None
    assert read(tmp_path / "run", role="robot").people is None


def test_the_cell_file_names_topics_and_beats_every_rule(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0 + 0.1, x=7.0, topic="/arm/pose")
    writer.number("/my_override", "Float64", T0, 50.0)
    writer.close()
    chosen = {"tcp": "/arm/pose", "scaling": "my_override", "scaling_max": 100}
    robot = read(tmp_path / "run", map=chosen).robot
    assert robot.select("tcp_x_m", "scaling").rows() == [(7.0, 0.5)]
    with pytest.raises(ConfigError, match="unit"):
        read(tmp_path / "run", map={"scaling": "/my_override"})
    with pytest.raises(LogError) as refusal:
        read(tmp_path / "run", map={"tcp": "/arm/pos"})
    assert refusal.value.nearest == "/arm/pose"
    with pytest.raises(UnknownName):
        read(tmp_path / "run", map={"pose": "/arm/pose"})


def test_a_flag_is_an_event_when_it_changes_and_a_robot_description_is_none(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    for i, pressed in enumerate([False, False, True, True, False]):
        writer.number("/button", "Bool", T0 + i, pressed)
    writer.number("/robot_description", "String", T0, "<robot/>")
    writer.close()
    assert read(tmp_path / "run").events["value"].to_list() == ["false", "true", "false"]


def test_a_bag_of_nothing_we_need_is_refused_with_the_topics_found(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.number("/temperature", "Float64", T0, 20.0)
    writer.close()
    with pytest.raises(DamagedLog, match="/temperature"):
        read(tmp_path / "run")


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_a_bag_cut_within_its_first_chunk_is_read_up_to_there_and_before_any_message_refused(tmp_path, bag, kind):
    path = tmp_path / ("run.bag" if kind == "bag" else "run")
    writer = bag(path, kind)
    for i in range(300):
        writer.joints(T0 + i, [f"joint_{j}" for j in range(6)], [float(i)] * 6)
    writer.close()
    file = path if kind == "bag" else next(path.glob(f"*.{kind}"))
    content = file.read_bytes()
    file.write_bytes(content[: content.index(struct.pack("<6d", *[150.0] * 6)) + 20])
    log = ADAPTER.read(file, ReadOptions())
    assert log.robot["q5_rad"].to_list() == [float(i) for i in range(150)]
    assert any("the bag is cut" in said for said in log.warnings)
    file.write_bytes(content[: content.index(struct.pack("<6d", *[0.0] * 6)) + 20])
    with pytest.raises(DamagedLog) as refusal:
        ADAPTER.read(file, ReadOptions())
    assert refusal.value.cure


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n", "Git LFS pointer"),
        (b"", "empty"),
        (b"once upon a time", "not a ROS 1 bag"),
    ],
)
def test_what_only_is_named_a_bag_is_refused_by_its_content(tmp_path, content, said):
    for name in ("run.bag", "run.mcap", "run.db3"):
        path = tmp_path / name
        path.write_bytes(content)
        assert not ADAPTER.recognises(path)
        with pytest.raises(DamagedLog, match=said):
            ADAPTER.read(path, ReadOptions())


def test_a_message_that_cannot_be_decoded_is_set_aside_and_the_others_are_read(tmp_path, bag):
    path = tmp_path / "run"
    writer = bag(path, "mcap")
    writer.tcp(T0, x=1.0)
    writer.writer.write(writer.connections["/tcp_pose_broadcaster/pose"], round((T0 + 1) * 1e9), b"\0\1\0\0\7")
    writer.tcp(T0 + 2, x=2.0)
    writer.close()
    log = read(path)
    assert log.robot["tcp_x_m"].to_list() == [1.0, 2.0]
    assert log.set_aside["source_row"].to_list() == [1]


def test_asking_a_bag_for_no_topic_reads_no_message(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0, x=1.0)
    writer.close()
    with opened(tmp_path / "run") as it:
        assert list(it.messages(set())) == []


def test_velocities_are_read_where_the_driver_sends_them(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    values = {"position": np.array([1.0]), "velocity": np.array([0.5]), "effort": np.array([])}
    writer.say("/joint_states", "sensor_msgs/msg/JointState", T0, header=writer.header(T0), name=["a"], **values)
    writer.joints(T0 + 1, ["a"], [2.0])
    writer.close()
    assert read(tmp_path / "run").robot["qd0_rad_s"].to_list() == [0.5, None]
