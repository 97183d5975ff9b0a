"""Bags of older ROS 2 carry no definitions: a layout is used only where it is the only one that fits every message."""

import sqlite3

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from cyclekit.adapter import ReadOptions
from cyclekit_adapters.rosbag import ADAPTER
from cyclekit_adapters.rosbag.definitions import types_of
from cyclekit_adapters.rosbag.known import KNOWN
from cyclekit_adapters.rosbag.payloads import Channel

T0 = 1_700_000_000.0
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
TRACKED = "spencer_tracking_msgs/msg/TrackedPersons"
LAYOUTS = [(kind, layout.name) for kind, layouts in KNOWN.items() for layout in layouts]


def forget_definitions(folder):
    """Make a db3 as Humble writes it."""
    connection = sqlite3.connect(next(folder.glob("*.db3")))
    connection.execute("DELETE FROM message_definitions")
    connection.commit()
    connection.close()


def know(writer, kind, name):
    """Let a writer know a type by one of its layouts."""
    types = types_of(Channel(1, "/t", kind, name, "known"))
    store = types.store(kind)
    for part in store.fielddefs:
        writer.store.fielddefs[part], writer.store.types[part] = store.fielddefs[part], store.types[part]
    writer.store.cache.clear()


def read(writer, **options):
    writer.close()
    forget_definitions(writer.folder)
    return ADAPTER.read(writer.folder, ReadOptions(**options))


@pytest.fixture
def db3(tmp_path, bag):
    writer = bag(tmp_path / "run", "db3")
    writer.folder = tmp_path / "run"
    writer.tcp(T0, x=1.0)
    return writer


def item_of(writer, kind):
    """The one entry that a message of a people tracker gets: person 7 at (1, 2, 3), tracked."""
    make = writer.type
    header = {"header": writer.header(T0)}
    point = make("geometry_msgs/msg/Point")(x=1.0, y=2.0, z=3.0)
    if kind.startswith("spencer"):
        pose = writer.random("geometry_msgs/msg/PoseWithCovariance", pose=writer.pose(1.0, 2.0, 3.0))
        return {"tracks": [writer.random("spencer_tracking_msgs/msg/TrackedPerson", track_id=7, pose=pose)]}
    if kind == "people_msgs/msg/People":
        return {"people": [writer.random("people_msgs/msg/Person", name="7", position=point)]}
    if kind == "people_msgs/msg/PositionMeasurementArray":
        return {"people": [writer.random("people_msgs/msg/PositionMeasurement", object_id="7", pos=point, **header)]}
    if kind == "people_msgs/msg/PositionMeasurement":
        return {"object_id": "7", "pos": point}
    if kind.startswith("zed"):
        place = np.array([1, 2, 3], np.float32)
        known = {"label_id": 7, "tracking_state": 1, "position": place}
        return {"objects": [writer.random(kind.replace("ObjectsStamped", "Object"), **known)]}
    marker = writer.random("visualization_msgs/msg/Marker", id=700, action=0, pose=writer.pose(1.0, 2.0, 3.0), **header)
    return {"markers": [marker]}


@pytest.mark.parametrize(("kind", "name"), [one for one in LAYOUTS if "people" in one[0] or "Objects" in one[0]])
@pytest.mark.parametrize("count", [1, 40])
def test_people_are_found_by_the_layout_that_fits(db3, kind, name, count):
    know(db3, kind, name)
    for i in range(count):
        more = {"header": db3.header(T0 + i)} if "Array" not in kind or "people" in kind else {}
        db3.say("/seen", kind, T0 + i, **vars(db3.random(kind, **item_of(db3, kind), **more)))
    log = read(db3)
    assert log.people.select("person", "x_m", "y_m", "z_m").unique().rows() == [("7", 1.0, 2.0, 3.0)]
    assert log.people.height == count
    said = log.facts["layout of /seen"]
    assert name in said
    assert f"fits all {count} messages" in said


@pytest.mark.parametrize("name", [name for kind, name in LAYOUTS if kind == TRACKED])
def test_tracks_of_either_layout_are_told_apart_by_their_size(db3, name):
    know(db3, TRACKED, name)
    for i in range(3):
        db3.say("/tracks", TRACKED, T0 + i, header=db3.header(T0 + i), **item_of(db3, TRACKED))
    log = read(db3)
    assert name in log.facts["layout of /tracks"]
    assert log.people["person"].to_list() == ["7"] * 3


@pytest.mark.parametrize("name", ["Galactic and later", "up to Foxy"])
def test_markers_of_foxy_are_shorter_than_those_of_later_distributions(tmp_path, bag, name):
    kind = "visualization_msgs/msg/MarkerArray"
    writer = bag(tmp_path / "run", "db3")
    writer.folder = tmp_path / "run"
    if "Foxy" in name:
        writer.store = get_typestore(Stores.ROS2_FOXY)
    writer.tcp(T0, x=1.0)
    for i in range(3):
        writer.say("/k4a/body_tracking_data", kind, T0 + i, **item_of(writer, kind))
    log = read(writer)
    assert log.people.select("person", "x_m", "z_m").unique().rows() == [("7", 1.0, 3.0)]
    assert name in log.facts["layout of /k4a/body_tracking_data"]


@pytest.mark.parametrize("name", [name for kind, name in LAYOUTS if kind == CONTROLLER])
def test_a_controller_state_is_read_in_every_layout_it_ever_had(db3, name):
    know(db3, CONTROLLER, name)
    writer = db3
    point = "trajectory_msgs/msg/JointTrajectoryPoint"
    place = writer.random(point, positions=np.array([1.0, 2.0]), velocities=np.array([0.5, 0.25]))
    fields = {part: place for part in ("feedback", "actual") if part in writer.type(CONTROLLER).__annotations__}
    fields |= {"speed_scaling_factor": 0.75} if "Jazzy" in name else {}
    for i in range(3):
        message = writer.random(CONTROLLER, header=writer.header(T0 + i), joint_names=["elbow", "wrist"], **fields)
        writer.say("/arm_controller/state", CONTROLLER, T0 + i, **vars(message))
    log = read(writer)
    assert log.joint_names == ("elbow", "wrist")
    assert log.robot.select("q0_rad", "q1_rad", "qd1_rad_s").row(0) == (1.0, 2.0, 0.25)
    assert log.robot["scaling"].to_list() == [0.75 if "Jazzy" in name else None]
    assert name in log.facts["layout of /arm_controller/state"]


def test_a_commanded_factor_is_read_without_a_definition(db3):
    know(db3, "control_msgs/msg/SpeedScalingFactor", "control_msgs")
    db3.say("/speed_scaling_input", "control_msgs/msg/SpeedScalingFactor", T0 - 1, factor=0.5)
    assert read(db3).robot["scaling"].to_list() == [0.5]


def test_layouts_that_say_the_same_leave_no_doubt_and_others_leave_the_topic_unread(db3):
    know(db3, TRACKED, "spencer_tracking_msgs")
    db3.say("/tracks", TRACKED, T0, header=db3.header(T0), tracks=[])  # nobody there: the same in both layouts
    log = read(db3)
    assert log.people.is_empty()
    assert "they give the same values in all 1 messages" in log.facts["layout of /tracks"]


def test_a_topic_that_two_layouts_fit_and_tell_apart_is_not_read(db3, monkeypatch):
    twice = (
        KNOWN[TRACKED][0],
        type(KNOWN[TRACKED][0])("its twin", KNOWN[TRACKED][0].text.replace("is_occ", "was_occ")),
    )
    monkeypatch.setitem(KNOWN, TRACKED, twice)
    know(db3, TRACKED, "spencer_tracking_msgs")
    for i in range(40):
        db3.say("/tracks", TRACKED, T0 + i, header=db3.header(T0 + i), **item_of(db3, TRACKED))
    log = read(db3)
    assert log.people is None
    assert [said for said in log.warnings if "several layouts" in said and "'its twin'" in said]


@pytest.mark.parametrize("count", [1, 40])
def test_a_layout_that_one_message_contradicts_is_none(db3, count):
    kind = "people_msgs/msg/People"
    know(db3, kind, "people_msgs")
    for i in range(count):
        db3.say("/people", kind, T0 + i, header=db3.header(T0 + i), **item_of(db3, kind))
    db3.writer.write(db3.connections["/people"], round((T0 + 99) * 1e9), b"\0\1\0\0" + bytes(40))
    log = read(db3)
    assert log.people is None
    assert log.robot.height == 1
    assert [said for said in log.warnings if "/people is not read" in said and "none of the known layouts" in said]
