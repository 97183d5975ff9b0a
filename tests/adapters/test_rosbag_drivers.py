"""What robot drivers of ROS say beside poses: modes, controllers' states, overrides; and which clock a bag has."""

import sqlite3

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from cyclekit.adapter import ReadOptions
from cyclekit_adapters.rosbag import ADAPTER

T0 = 1_700_000_000.0
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
POINT = "trajectory_msgs/JointTrajectoryPoint"


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


def mode(writer, topic, kind, t_s, number):
    kind = f"ur_dashboard_msgs/msg/{kind}"
    if kind not in writer.store.types:
        writer.store.register(get_types_from_msg(f"{'int8' if 'Robot' in kind else 'uint8'} mode", kind))
    writer.say(topic, kind, t_s, mode=number)


@pytest.mark.parametrize("defined", [True, False])
def test_a_robot_mode_holds_and_every_change_of_a_mode_is_an_event(tmp_path, bag, defined):
    writer = bag(tmp_path / "run", "mcap" if defined else "db3")
    for t_s, number in ((T0 - 1, 7), (T0 + 1.5, 5), (T0 + 2.5, 7), (T0 + 2.6, 7)):
        mode(writer, "/io_and_status_controller/robot_mode", "RobotMode", t_s, number)
    for t_s, number in ((T0 - 1, 1), (T0 + 1.4, 5), (T0 + 1.6, 99)):
        mode(writer, "/io_and_status_controller/safety_mode", "SafetyMode", t_s, number)
    writer.number("/speed_scaling_factor", "Float64", T0 - 1, 0.5)
    for i in range(4):
        writer.tcp(T0 + i, x=0.0)
    writer.close()
    if not defined:
        without_definitions(tmp_path / "run")
    log = read(tmp_path / "run")
    assert log.robot["state"].to_list() == [None, None, "stopped", None]
    assert log.robot["scaling"].to_list() == [0.5, 0.5, None, 0.5]
    said = {signal.rpartition("/")[2]: values for signal, values in log.events.group_by("signal").agg("value").rows()}
    assert said == {"robot_mode": ["RUNNING", "IDLE", "RUNNING"], "safety_mode": ["NORMAL", "SAFEGUARD_STOP", "99"]}


def io_states(writer, t_s, inputs, outputs):
    """Say the digital inputs and outputs of a UR controller, by pin."""
    kinds = {"Digital": "uint8 pin\nbool state", "Analog": "uint8 pin\nuint8 domain\nfloat32 state"}
    names = [f"{kind}_states" for kind in ("digital_in", "digital_out", "flag", "analog_in", "analog_out")]
    text = "\n".join(f"{'Analog' if 'analog' in name else 'Digital'}[] {name}" for name in names)
    for kind, definition in {**kinds, "IOStates": text}.items():
        if f"ur_msgs/msg/{kind}" not in writer.store.types:
            writer.store.register(get_types_from_msg(definition, f"ur_msgs/msg/{kind}"))
    digital = writer.type("ur_msgs/msg/Digital")
    told = [[digital(pin=pin, state=on) for pin, on in pins.items()] for pins in (inputs, outputs, {})]
    values = dict(zip(names, [*told, [], []], strict=True))
    writer.say("/io_and_status_controller/io_states", "ur_msgs/msg/IOStates", t_s, **values)


@pytest.mark.parametrize("defined", [True, False])
def test_the_digital_inputs_and_outputs_of_a_ur_driver_are_kept_by_bit(tmp_path, bag, defined):
    writer = bag(tmp_path / "run", "mcap" if defined else "db3")
    io_states(writer, T0 + 0.5, {0: False, 3: True, 16: True, 200: True}, {0: True})
    io_states(writer, T0 + 2.5, {0: True, 3: False}, {0: False, 1: True})
    for i in range(4):
        writer.tcp(T0 + i, x=0.0)
    writer.close()
    if not defined:
        without_definitions(tmp_path / "run")
    log = read(tmp_path / "run")
    assert log.robot["digital_in_bits"].to_list() == [None, 65544, 65544, 1]
    assert log.robot["digital_out_bits"].to_list() == [None, 1, 1, 2]


def without_definitions(folder):
    connection = sqlite3.connect(next(folder.glob("*.db3")))
    connection.execute("DELETE FROM message_definitions")
    connection.commit()
    connection.close()


def controller(writer, t_s, points, scaling=None, topic="/arm_controller/state"):
    """Say the state of a controller with exactly these points (field name: angles of elbow and wrist)."""
    if CONTROLLER not in writer.store.types:
        fields = ["std_msgs/Header header", "string[] joint_names", *(f"{POINT} {name}" for name in points)]
        fields += ["float64 speed_scaling_factor"] if scaling is not None else []
        writer.store.register(get_types_from_msg("\n".join(fields), CONTROLLER))
    nothing = np.zeros(0)
    duration = writer.type("builtin_interfaces/msg/Duration")(sec=0, nanosec=0)
    values = {
        name: writer.type("trajectory_msgs/msg/JointTrajectoryPoint")(
            positions=np.array(angles),
            velocities=np.array([0.25] * len(angles)),
            accelerations=nothing,
            effort=nothing,
            time_from_start=duration,
        )
        for name, angles in points.items()
    }
    more = {"speed_scaling_factor": scaling} if scaling is not None else {}
    header = writer.header(t_s)
    writer.say(topic, CONTROLLER, t_s, header=header, joint_names=["elbow", "wrist"], **values, **more)


@pytest.mark.parametrize(
    ("points", "scaling"),
    [
        ({"desired": [9.0, 9.0], "actual": [1.0, 2.0]}, None),
        ({"reference": [9.0, 9.0], "feedback": [1.0, 2.0]}, None),
        ({"reference": [9.0, 9.0], "feedback": [1.0, 2.0]}, 0.75),
        ({"desired": [9.0, 9.0], "actual": [1.0, 2.0], "reference": [], "feedback": []}, None),
        ({"desired": [9.0, 9.0], "actual": [8.0, 8.0], "reference": [9.0, 9.0], "feedback": [1.0, 2.0]}, None),
    ],
)
@pytest.mark.parametrize("count", [3, 40])
def test_a_controller_state_is_read_by_the_fields_it_has(tmp_path, bag, points, scaling, count):
    writer = bag(tmp_path / "run", "mcap")
    for i in range(count):
        controller(writer, T0 + i * 0.1, points, scaling)
    writer.close()
    log = read(tmp_path / "run")
    assert log.joint_names == ("elbow", "wrist")
    assert log.robot.select("q0_rad", "q1_rad", "qd1_rad_s").unique().rows() == [(1.0, 2.0, 0.25)]
    assert log.robot["scaling"].unique().to_list() == [scaling]
    assert log.facts["time"] == "header stamp"


def test_measured_joints_beat_a_controller_and_its_scaling_beats_a_command(tmp_path, bag):
    for name, scaling, expected in (("jazzy", 0.75, 0.75), ("humble", None, 0.5)):
        writer = bag(tmp_path / name, "mcap")
        controller(writer, T0, {"feedback": [9.0, 9.0]}, scaling)
        writer.number("/speed_scaling_factor", "Int32", T0, 50)
        writer.joints(T0 + 0.1, ["elbow", "wrist"], [1.0, 2.0])
        writer.close()
        log = read(tmp_path / name)
        assert log.robot.select("q0_rad", "q1_rad", "scaling").rows() == [(1.0, 2.0, expected)]
        assert any("commanded" in said for said in log.warnings) == (scaling is None)


def test_of_fanuc_the_command_and_the_safety_clamp_multiply(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.number("/speed_scaling_factor", "Int32", T0, 40)
    writer.number("/fanuc_gpio_controller/collaborative_speed_scaling", "Bool", T0, True)
    writer.tcp(T0 + 1, x=0.0)
    writer.number("/fanuc_gpio_controller/collaborative_speed_scaling", "Bool", T0 + 1.5, False)
    writer.tcp(T0 + 2, x=0.0)
    writer.close()
    log = read(tmp_path / "run")
    assert log.robot["scaling"].to_list() == [0.4, 0.0]
    assert log.events is None


def test_three_overrides_multiply_each_clamped_and_counted_once(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.number("/speed_ovr", "Int64", T0, 50)
    writer.number("/safe_ovr_1", "Int64", T0, 40)
    writer.number("/safe_ovr_1_float64", "Float64", T0, 40.0)
    writer.number("/safe_ovr_2", "Int64", T0, 120)
    writer.tcp(T0 + 1, x=0.0)
    writer.close()
    assert read(tmp_path / "run").robot["scaling"].to_list() == pytest.approx([0.2])


def test_the_choice_of_the_clock_is_recorded_with_its_reason(tmp_path, bag):
    for name, scaled in (("stamped", False), ("received", True)):
        writer = bag(tmp_path / name, "mcap")
        writer.tcp(T0, x=0.0)
        if scaled:
            writer.number("/speed_scaling_factor", "Float64", T0, 1.0)
        writer.close()
    facts = {name: read(tmp_path / name).facts for name in ("stamped", "received")}
    assert facts["stamped"]["time_because"] == "every topic in use has a header time"
    assert facts["received"]["time_because"] == "no header time on /speed_scaling_factor"
    assert facts["stamped"]["simulated_time"] == "no sign of it"


def test_a_bag_of_a_simulation_says_that_its_clocks_may_differ(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    time = writer.type("builtin_interfaces/msg/Time")(sec=12, nanosec=0)
    writer.say("/clock", "rosgraph_msgs/msg/Clock", T0, clock=time)
    pose = writer.pose(1.0, 0.0, 0.0)
    topic = "/tcp_pose_broadcaster/pose"
    writer.say(topic, "geometry_msgs/msg/PoseStamped", T0, header=writer.header(12.0), pose=pose)
    writer.close()
    log = read(tmp_path / "run")
    assert log.clock == "relative"
    assert log.facts["simulated_time"] == "yes"
    assert [said for said in log.warnings if said.startswith("/clock: time was simulated") and "header stamps" in said]
