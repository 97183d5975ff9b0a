"""Which of its times each topic is read by, and how headers of other clocks come onto the recorder's."""

import numpy as np
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.adapter.clock_line import least_delays
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.schema import STAMPS
from cyclekit_adapters.rosbag import ADAPTER
from cyclekit_adapters.rosbag.clocks import StampSource, choose_times, simulated
from cyclekit_adapters.rosbag.envelope import PARTS, line_under

pytestmark = pytest.mark.tests_clocks

T0 = 1_700_000_000.0
TCP, POSES, SCALING = "/tcp_pose_broadcaster/pose", "/poses", "/speed_scaling_factor"


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


def walk(writer, times, stamps, delays, topic=POSES):
    """The operator is at x = seconds since T0, at each of `times` (true ones), stamped and received as given."""
    for t_s, stamp_s, delay_s in zip(times.tolist(), stamps.tolist(), delays.tolist(), strict=True):
        header, pose = writer.header(stamp_s, "base"), writer.pose(t_s - T0, 0.0, 1.0)
        writer.say(topic, "geometry_msgs/msg/PoseArray", t_s + delay_s, header=header, poses=[pose])


def robot(writer, times, ahead_s=0.0):
    for t_s in times.tolist():
        pose = writer.pose(0.5, 0.0, 0.5)
        header = writer.header(t_s + ahead_s)
        writer.say(TCP, "geometry_msgs/msg/PoseStamped", t_s + 0.001, header=header, pose=pose)


def times(seconds, rate_hz=20.0):
    return T0 + np.arange(round(seconds * rate_hz)) / rate_hz


def delays(count, least_s, seed=1):
    return least_s + np.random.default_rng(seed).exponential(0.01, count)


def errors(people):
    """How far the time of each row is from when the operator was there (x tells)."""
    return people["t_s"].to_numpy() - T0 - people["x_m"].to_numpy()


def test_a_camera_that_counts_from_when_it_was_switched_on_is_put_on_the_clock_of_the_recorder(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    at = times(60)
    robot(writer, at)
    walk(writer, at, at - T0 + 4321.0, delays(at.size, 0.030))
    writer.close()
    log = read(tmp_path / "run")
    assert log.clock == "epoch"
    assert errors(log.people) == pytest.approx(0.030, abs=0.001)  # the least delay cannot be known
    assert log.robot["t_s"].to_numpy() == pytest.approx(at, abs=1e-6)
    fact = log.facts[f"time of {POSES}"]
    assert fact.startswith("lower-envelope: header stamp * 1.0000")
    assert "+1699995679.0" in fact
    assert "1200 messages" in fact
    (said,) = [said for said in log.warnings if said.startswith(f"{POSES} is stamped by another clock")]
    assert "behind the receive times" in said
    assert log.stamps is None


@pytest.mark.parametrize(("offset_s", "drift"), [(-3.0, 0.0), (0.35, 50e-6), (0.0, 60e-6), (3.0, 3e-3)])
def test_a_second_computer_that_is_off_or_drifts_is_put_on_the_clock_of_the_recorder(tmp_path, bag, offset_s, drift):
    writer = bag(tmp_path / "run", "mcap")
    at = times(300, 10)
    robot(writer, at)
    walk(writer, at, T0 + (at - T0) * (1 + drift) - offset_s, delays(at.size, 0.005))
    writer.close()
    log = read(tmp_path / "run")
    assert errors(log.people) == pytest.approx(0.005, abs=0.002)
    assert [said for said in log.warnings if said.startswith(f"{POSES} is stamped by another clock")]


def test_simulated_time_at_a_rate_that_no_clock_has_is_followed_and_said():
    at = T0 + np.arange(2000) / 20.0
    late = np.random.default_rng(1).exponential(0.005, at.size)
    slow = StampSource(at + late, 20.0 + (at - T0) / 1.0068)
    times = choose_times({"/a": slow, "/b": StampSource(at, at)}, {})
    assert np.abs(times.chosen["/a"].times(slow) - at).max() < 0.002
    (said,) = times.warnings
    assert "0.9932 times the recorder's speed" in said
    assert "0.9932 times" in choose_times({"/a": slow}, {}).warnings[0]


def test_a_clock_that_no_line_follows_is_not_used():
    at = T0 + np.arange(2000) / 20.0
    wandering = StampSource(at, 20.0 + (at - T0) / 1.0068 + 0.3 * np.sin((at - T0) / 10.0))
    times = choose_times({"/a": wandering}, {})
    assert times.chosen["/a"].how == "receive"
    assert "no line fits them" in times.warnings[0]
    with pytest.raises(ConfigError, match="no line fits them"):
        choose_times({"/a": wandering}, {"/a": "own-clock"})


@pytest.mark.parametrize(("least_s", "warned"), [(0.0, False), (0.12, False), (0.35, True)])
def test_a_slow_tracker_is_no_other_clock_and_its_header_tells_when_it_saw(tmp_path, bag, least_s, warned):
    writer = bag(tmp_path / "run", "mcap")
    at = times(60)
    robot(writer, at)
    walk(writer, at, at, delays(at.size, least_s))
    writer.close()
    log = read(tmp_path / "run")
    assert errors(log.people) == pytest.approx(0.0, abs=1e-6)
    assert bool([said for said in log.warnings if "a slow tracker" in said]) == warned


def test_delays_that_build_up_while_the_recorder_is_busy_are_no_clock(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    at = times(60)
    robot(writer, at)
    busy = np.interp(at - T0, [0, 20, 30, 40, 60], [0.0, 0.0, 1.5, 0.0, 0.0])
    walk(writer, at, at, delays(at.size, 0.01) + busy)
    writer.close()
    log = read(tmp_path / "run")
    assert errors(log.people) == pytest.approx(0.0, abs=1e-6)
    assert not [said for said in log.warnings if POSES in said]


@pytest.mark.parametrize("step_s", [2.0, -2.0])
def test_a_header_clock_that_was_set_while_recording_is_not_used(tmp_path, bag, step_s):
    writer = bag(tmp_path / "run", "mcap")
    at = times(60)
    robot(writer, at)
    walk(writer, at, at + np.where(at - T0 > 40, step_s, 0.0), delays(at.size, 0.01))
    writer.close()
    log = read(tmp_path / "run")
    assert errors(log.people) == pytest.approx(0.02, abs=0.1)  # the receive times, late as they are
    assert [said for said in log.warnings if POSES in said and ("set by" in said or "jump back" in said)]


def test_a_header_clock_at_another_speed_is_not_used(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    at = times(60)
    robot(writer, at)
    walk(writer, at, T0 + (at - T0) * 0.7, delays(at.size, 0.01))
    writer.close()
    log = read(tmp_path / "run")
    assert errors(log.people) == pytest.approx(0.02, abs=0.1)
    assert [said for said in log.warnings if "0.700 times the speed" in said]


@pytest.mark.parametrize(("shift_s", "clock"), [(-T0 + 500.0, "uptime"), (-7.0, "epoch")])
def test_where_all_topics_share_another_clock_the_log_keeps_it_and_both_stamps(tmp_path, bag, shift_s, clock):
    writer = bag(tmp_path / "run", "mcap")
    at = times(30)
    robot(writer, at, shift_s)
    walk(writer, at, at + shift_s, delays(at.size, 0.002))
    writer.close()
    log = read(tmp_path / "run")
    assert log.clock == clock
    assert log.robot["t_s"].to_numpy() == pytest.approx(at + shift_s, abs=1e-6)
    assert log.people["t_s"].to_numpy() == pytest.approx(at + shift_s, abs=1e-6)
    assert log.stamps.schema == {name: column.dtype for name, column in STAMPS.items()}
    assert log.stamps.height == 2 * at.size
    apart = (log.stamps["host_s"] - log.stamps["t_s"]).to_numpy()
    assert apart.min() == pytest.approx(-shift_s + 0.001, abs=1e-4)
    assert [said for said in log.warnings if "from another clock than the recorder's" in said]


def test_two_devices_with_a_clock_each_are_put_on_that_of_the_recorder(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    at = times(30)
    robot(writer, at, -T0 + 500.0)
    walk(writer, at, at - T0 + 77.0, delays(at.size, 0.002))
    writer.close()
    log = read(tmp_path / "run")
    assert (log.clock, log.stamps) == ("epoch", None)
    assert log.robot["t_s"].to_numpy() == pytest.approx(at, abs=0.002)
    assert errors(log.people) == pytest.approx(0.0, abs=0.004)


def test_a_link_of_the_transforms_has_a_clock_of_its_own(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    at = times(30)
    robot(writer, at)
    writer.number("/humans/bodies/tracked", "String", T0, "ab1")
    for t_s in at.tolist():
        stamped = writer.random("geometry_msgs/msg/TransformStamped", child_frame_id="body_ab1")
        stamped.header = writer.header(t_s - T0 + 60.0, "base")
        stamped.transform.translation.x = t_s - T0
        writer.say("/tf", "tf2_msgs/msg/TFMessage", t_s + 0.02, transforms=[stamped])
    writer.close()
    log = read(tmp_path / "run")
    assert errors(log.people) == pytest.approx(0.02, abs=0.001)
    assert [said for said in log.warnings if said.startswith("transform base -> body_ab1 on /tf is stamped by another")]


def test_in_a_simulation_a_topic_without_a_header_is_timed_by_the_clock_that_was_shown(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    for i in range(200):  # simulated time at half the speed of the recorder's
        time = writer.type("builtin_interfaces/msg/Time")(sec=100 + i // 20, nanosec=i % 20 * 50_000_000)
        writer.say("/clock", "rosgraph_msgs/msg/Clock", T0 + i / 10, clock=time)
        pose = writer.pose(float(i), 0.0, 0.0)
        header = writer.header(100 + i / 20)
        writer.say(TCP, "geometry_msgs/msg/PoseStamped", T0 + i / 10, header=header, pose=pose)
    writer.number(SCALING, "Float64", T0 + 10.04, 0.5)
    writer.close()
    log = read(tmp_path / "run")
    assert log.clock == "relative"
    assert log.robot["t_s"].to_numpy() == pytest.approx(100 + np.arange(200) / 20)
    known = log.robot.filter(log.robot["scaling"].is_not_null())
    assert known["t_s"][0] == pytest.approx(105.05)  # the first after 105.02
    assert [said for said in log.warnings if "time was simulated" in said]
    assert log.facts["simulated_time"] == "yes"


def test_the_cell_file_has_the_last_word_on_which_time_counts(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    at = times(30)
    robot(writer, at)
    walk(writer, at, at, delays(at.size, 0.3))
    writer.close()
    for how, late_s in (("header", 0.0), ("own-clock", 0.3), ("receive", 0.31)):
        log = read(tmp_path / "run", map={"time": {"poses": how}})
        assert float(np.median(errors(log.people))) == pytest.approx(late_s, abs=0.005)
        assert "as the cell file says" in log.facts[f"time of {POSES}"]
    with pytest.raises(UnknownName, match="headers"):
        read(tmp_path / "run", map={"time": {POSES: "headers"}})
    with pytest.raises(ConfigError, match="not a table"):
        read(tmp_path / "run", map={"time": "header"})


def test_a_header_that_is_missing_in_some_messages_does_not_time_the_others(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    at = times(1)
    robot(writer, at)
    walk(writer, at, np.where(np.arange(at.size) == 3, 0.0, at), delays(at.size, 0.05))
    writer.close()
    log = read(tmp_path / "run")
    assert (errors(log.people) > 0.04).all()
    assert log.facts["time_because"] == f"no header time on 1 messages on {POSES}"


@at_most(50)
@given(st.integers(0, 10**6), st.floats(-2e9, 2e9), st.floats(-4e-3, 4e-3), st.integers(2, 5000))
def test_no_message_arrives_before_the_line_and_the_line_is_the_true_one(seed, offset, drift, count):
    rng = np.random.default_rng(seed)
    device = np.sort(rng.uniform(0, 3600, count))
    receive = (1 + drift) * device + offset + 0.002 + rng.exponential(0.01, count)
    line = line_under(device, receive)
    assert (receive - line.of(device)).min() > -1e-5
    if count > 1000:
        assert np.abs(line.of(device) - (1 + drift) * device - offset - 0.002).max() < 0.003
        assert line.delay_s == pytest.approx(0.01 * np.log(2), rel=0.5)


@given(st.integers(1, 5 * PARTS), st.integers(0, 99))
def test_the_least_delay_of_each_part_is_found_the_first_of_equal_ones(count, seed):
    delays = np.random.default_rng(seed).integers(0, 3, count).astype(float)
    size = -(-count // PARTS)
    parts = [delays[begin : begin + size].tolist() for begin in range(0, count, size)]
    assert least_delays(delays, PARTS).tolist() == [k * size + part.index(min(part)) for k, part in enumerate(parts)]


def test_moments_before_and_after_the_simulated_clock_go_on_at_the_recorders_speed():
    at = simulated(np.array([-1.0, 0.0, 5.0, 10.0, 12.0]), np.array([0.0, 10.0]), np.array([100.0, 105.0]))
    assert at.tolist() == [99.0, 100.0, 102.5, 105.0, 107.0]


def test_sources_without_any_header_are_read_as_received():
    source = StampSource(np.arange(3.0), np.full(3, np.nan))
    chosen = choose_times({"/a": source}, {}).chosen["/a"]
    assert (chosen.how, chosen.why) == ("receive", "no header time")
    assert chosen.times(source).tolist() == [0.0, 1.0, 2.0]
