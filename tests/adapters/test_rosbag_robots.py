import tomllib

import pytest

from cyclekit import draft_cell
from cyclekit.adapter import ReadOptions
from cyclekit.errors import LogError
from cyclekit.ingest.validate.validate import examined_parts
from cyclekit_adapters.rosbag import ADAPTER

T0 = 1_700_000_000.0
ARM = ["pan", "lift", "elbow"]
SCALING = "speed_scaling_state_broadcaster/speed_scaling"


def read(path, **options):
    assert ADAPTER.recognises(path)
    return ADAPTER.read(path, ReadOptions(**options))


def cell_of_two(writer, *, poses=True):
    """Robots in the namespaces /left and /right: at x = 1 and 2, turned by 0.1 and 0.2, slowed to 50 and 20 %."""
    for side, x, percent in (("left", 1.0, 50.0), ("right", 2.0, 20.0)):
        writer.number(f"/{side}/{SCALING}", "Float64", T0, percent)
        writer.number(f"/{side}/io_and_status_controller/robot_program_running", "Bool", T0, side == "left")
        for i in range(3):
            writer.joints(T0 + 0.1 * i, ARM, [x / 10] * 3, topic=f"/{side}/joint_states")
            if poses:
                writer.tcp(T0 + 0.1 * i, x, topic=f"/{side}/tcp_pose_broadcaster/pose")
    writer.poses(T0, [(5.0, 0.0, 1.0)])
    writer.close()


def test_of_two_robots_none_is_taken_by_chance(tmp_path, bag):
    cell_of_two(bag(tmp_path / "run", "mcap"))
    with pytest.raises(LogError, match="2 robots, in the namespaces /left, /right") as refusal:
        read(tmp_path / "run")
    assert "tcp" in str(refusal.value)
    assert read(tmp_path / "run", role="people").people["x_m"].to_list() == [5.0]


@pytest.mark.parametrize(
    "chosen",
    [
        {"tcp": "/left/tcp_pose_broadcaster/pose"},
        {"joints": "/left/joint_states"},
        {"scaling": f"/left/{SCALING}"},
    ],
)
def test_a_topic_that_is_named_brings_the_others_of_its_robot(tmp_path, bag, chosen):
    cell_of_two(bag(tmp_path / "run", "mcap"))
    log = read(tmp_path / "run", map=chosen)
    assert log.robot.select("tcp_x_m", "q0_rad", "scaling", "state").unique().rows() == [(1.0, 0.1, 0.5, "playing")]
    assert log.people["x_m"].to_list() == [5.0]


def test_the_only_pose_tells_whose_scaling_counts(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0 + 0.5, 2.0, topic="/right/tcp_pose_broadcaster/pose")
    cell_of_two(writer, poses=False)
    log = read(tmp_path / "run")
    assert log.facts["speed_scaling"] == f"/right/{SCALING} / 100"
    assert log.facts["joints"] == "/right/joint_states"
    assert log.robot["scaling"].to_list() == [None]  # its program does not run
    assert f"/left/{SCALING}" in log.facts["skipped_topics"]


def test_overrides_of_two_robots_do_not_multiply(tmp_path, bag):
    writer = bag(tmp_path / "run.bag", "bag")
    for name, percent in (("/speed_ovr", 50), ("/safe_ovr_1", 40), ("/b/speed_ovr", 10), ("/b/safe_ovr_1", 10)):
        writer.number(name, "Int64", T0, percent)
    writer.tcp(T0 + 1, 0.0)
    writer.close()
    assert read(tmp_path / "run.bag").robot["scaling"].to_list() == pytest.approx([0.2])
    assert read(tmp_path / "run.bag", map={"scaling": ["/b/speed_ovr"]}).robot["scaling"].to_list() == [0.1]


def test_a_namespace_of_one_robot_changes_nothing(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.number(f"/{SCALING}", "Float64", T0, 50.0)
    writer.joints(T0 + 1, ["finger"], [0.0], topic="/gripper/joint_states")
    writer.joints(T0 + 1, ARM, [0.5, 0.0, 0.0])
    writer.tcp(T0 + 1, 1.0, topic="/ur/tcp_pose_broadcaster/pose")
    writer.close()
    assert read(tmp_path / "run").robot.select("q0_rad", "scaling").rows() == [(0.5, 0.5)]


def test_of_two_arms_in_the_transforms_the_cell_file_names_one(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    for i in range(3):
        writer.transform(T0 + i * 0.1, ("base_link", "left_tool0", (1.0 + i, 0.0, 0.0)))
        writer.transform(T0 + i * 0.1, ("base_link", "right_tool0", (2.0 + i, 0.0, 0.0)))
    writer.close()
    with pytest.raises(LogError, match="several arms \\(left_tool0, right_tool0\\)") as refusal:
        read(tmp_path / "run")
    assert "tool_frame" in str(refusal.value)
    assert read(tmp_path / "run", map={"tool_frame": "right_tool0"}).robot["tcp_x_m"].to_list() == [2.0, 3.0, 4.0]


def test_a_prefix_of_the_tool_is_that_of_its_base(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("world", "ur5e_base_link", (9.0, 0.0, 0.0)), ("world", "base_link", (0.0, 0.0, 0.0)))
    for i in range(3):
        writer.transform(T0 + i * 0.1, ("ur5e_base_link", "ur5e_tool0", (1.0 + i, 0.0, 0.0)))
    writer.close()
    log = read(tmp_path / "run")
    assert log.robot["tcp_x_m"].to_list() == [1.0, 2.0, 3.0]
    assert log.facts["base_frame"] == "ur5e_base_link"


def test_a_tool_without_prefix_beats_one_of_another_thing(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    for i in range(2):
        writer.transform(
            T0 + i * 0.1, ("base", "tool0", (1.0 + i, 0.0, 0.0)), ("tool0", "brush_tool0", (0.0, 0.0, 0.5))
        )
    writer.close()
    assert read(tmp_path / "run").robot["tcp_z_m"].to_list() == [0.0, 0.0]


def test_people_on_two_topics_may_be_the_same_people(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.poses(T0, [(1.0, 0.0, 1.0)])
    writer.poses(T0, [(1.1, 0.0, 1.0)], topic="/humans")
    writer.close()
    log = read(tmp_path / "run")
    assert log.people["person"].to_list() == ["/humans 0", "/poses 0"]
    assert any("/poses, /humans" in said and "`body`" in said for said in log.warnings)
    one = read(tmp_path / "run", body="/humans")
    assert not any("same people" in said for said in one.warnings)


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"map": {"tcp": "/poses"}}, "PoseArray"),
        ({"map": {"joints": "/tcp_pose_broadcaster/pose"}}, "PoseStamped"),
        ({"map": {"scaling": "/joint_states", "scaling_max": 1}}, "JointState"),
        ({"map": {"running": "/level"}}, "Float64"),
        ({"map": {"people": ["/poses", "/level"]}}, "Float64"),
        ({"map": {"events": "/level"}}, "Float64"),
        ({"body": "/joint_states"}, "JointState"),
    ],
)
def test_a_topic_that_is_named_for_what_it_cannot_tell_is_refused_and_not_read_as_nobody(tmp_path, bag, options, kind):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0, 1.0)
    writer.joints(T0, ARM, [0.0] * 3)
    writer.poses(T0, [(1.0, 0.0, 1.0)])
    writer.number("/level", "Float64", T0, 0.5)
    writer.close()
    with pytest.raises(LogError, match=f"{kind}, from which") as refusal:
        read(tmp_path / "run", **options)
    assert "it must be" in str(refusal.value)
    scaled = read(tmp_path / "run", map={"scaling": "/level", "scaling_max": 1})
    assert scaled.robot["scaling"].to_list() == [0.5]


def test_the_fingers_of_a_gripper_are_no_joints_of_the_arm_and_a_missing_tcp_is_said(tmp_path, bag):
    names = [*ARM, "panda_finger_joint1", "panda_finger_joint2"]
    writer = bag(tmp_path / "run", "mcap")
    for i in range(20):
        writer.joints(T0 + 0.1 * i, names[::-1], [0.04, 0.04, 0.3, 0.2, 0.1 * i])
    writer.close()
    (log,) = examined_parts([read(tmp_path / "run")])
    angles = [name for name in log.robot.columns if name.endswith("_rad")]
    assert len(angles) == len(log.joint_names) == len(ARM)
    assert log.robot["q0_rad"].max() == pytest.approx(0.3)  # the order is that of the message
    assert any("panda_finger_joint2" in said and "left out" in said for said in log.warnings)
    assert any("no TCP" in said for said in log.warnings)


@pytest.mark.parametrize(
    ("joint", "count", "model"), [("fr3_joint{}", 7, "FR3"), ("panda_joint{}", 7, "Panda"), ("joint_{}", 6, None)]
)
def test_the_names_of_joints_draft_the_arm_of_a_log_without_a_tcp(tmp_path, bag, joint, count, model):
    names = [joint.format(1 + axis) for axis in range(count)]
    writer = bag(tmp_path / "run", "mcap")
    for i in range(3):
        writer.joints(1_700_000_000.0 + i, names, [0.1 * i] * count)
    writer.close()
    rows = [",".join([f"{0.01 * i:.2f}", *[f"{0.01 * i + 0.3:.4f}"] * count]) for i in range(60)]
    (tmp_path / "arm.csv").write_text("\n".join([",".join(["t_s", *names]), *rows, ""]))
    for log in (tmp_path / "run", tmp_path / "arm.csv"):
        robot = tomllib.loads(draft_cell(log).cell).get("robot", {})
        assert robot.get("model") == model
