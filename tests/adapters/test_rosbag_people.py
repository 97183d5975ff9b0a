"""What people trackers of ROS say, each by its own numbering, and what they only predict."""

import math

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from cyclekit.adapter import ReadOptions
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_adapters.rosbag import ADAPTER

T0 = 1_700_000_000.0
RULE = "=" * 80

TRACKED_PERSONS = f"""std_msgs/Header header
spencer_tracking_msgs/TrackedPerson[] tracks
{RULE}
MSG: spencer_tracking_msgs/TrackedPerson
uint64 track_id
bool is_occluded
bool is_matched
geometry_msgs/PoseWithCovariance pose
"""
PEOPLE = f"""std_msgs/Header header
people_msgs/Person[] people
{RULE}
MSG: people_msgs/Person
string name
geometry_msgs/Point position
"""
MEASUREMENTS = f"""people_msgs/PositionMeasurement[] people
{RULE}
MSG: people_msgs/PositionMeasurement
std_msgs/Header header
string object_id
geometry_msgs/Point pos
float64 reliability
float64[9] covariance
"""
OBJECTS = f"""std_msgs/Header header
PACKAGE/Object[] objects
{RULE}
MSG: PACKAGE/Object
string label
int16 label_id
float32[3] position
int8 tracking_state
bool skeleton_available
int8 body_format
PACKAGE/Skeleton3D skeleton_3d
{RULE}
MSG: PACKAGE/Skeleton3D
PACKAGE/Keypoint3D[70] keypoints
{RULE}
MSG: PACKAGE/Keypoint3D
float32[3] kp
"""


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


def define(writer, kind, text):
    """Register the types that this store does not know yet."""
    found = get_types_from_msg(text, kind)
    writer.store.register({name: fields for name, fields in found.items() if name not in writer.store.types})


def point(writer, x, y, z=0.0):
    return writer.type("geometry_msgs/msg/Point")(x=x, y=y, z=z)


def rows(log):
    return log.people.select("person", "x_m", "y_m", "z_m").rows()


class Markers:
    """The body tracker of an Azure Kinect: bodies by number, with the place of joint 0 (the pelvis) and joint 3."""

    topic, kind = "/k4a/body_tracking_data", "visualization_msgs/msg/MarkerArray"

    def __init__(self, writer):
        self.writer = writer

    def marker(self, t_s, number, x, action=0):
        make = self.writer.type
        duration = make("builtin_interfaces/msg/Duration")(sec=0, nanosec=0)
        return make("visualization_msgs/msg/Marker")(
            header=self.writer.header(t_s, "depth_camera_link"),
            ns="",
            id=number,
            type=2,
            action=action,
            pose=self.writer.pose(x, 0.5, 2.0),
            scale=make("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0),
            color=make("std_msgs/msg/ColorRGBA")(r=0.0, g=0.0, b=0.0, a=1.0),
            lifetime=duration,
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=make("sensor_msgs/msg/CompressedImage")(
                header=self.writer.header(0.0, ""), format="", data=np.zeros(0, np.uint8)
            ),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=make("visualization_msgs/msg/MeshFile")(filename="", data=np.zeros(0, np.uint8)),
            mesh_use_embedded_materials=False,
        )

    def say(self, t_s, bodies, topic=None):
        markers = [self.marker(t_s, body * 100 + joint, x + joint) for body, x in bodies.items() for joint in (0, 3)]
        self.writer.say(topic or self.topic, self.kind, t_s + 0.2, markers=markers)


def test_of_azure_kinect_markers_the_pelvis_counts_and_the_hundreds_are_the_person(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    markers = Markers(writer)
    markers.say(T0, {1: 1.0, 12: 3.0})
    markers.say(T0 + 1, {})
    markers.say(T0 + 2, {12: 4.0})
    writer.close()
    log = read(tmp_path / "run")
    assert rows(log) == [("1", 1.0, 0.5, 2.0), ("12", 3.0, 0.5, 2.0), ("12", 4.0, 0.5, 2.0)]
    assert log.people["t_s"].to_list() == pytest.approx([T0, T0, T0 + 2])  # stamped, although one message is empty
    assert log.people["source_row"].to_list() == [0, 0, 2]
    assert log.facts["frames"].endswith("depth_camera_link")


def of_nobody(kind, text, field, *, header=True):
    """How a tracker with a message of its own says that nobody is there."""

    def say(writer, t_s):
        define(writer, kind, text)
        stamped = {"header": writer.header(t_s)} if header else {}
        writer.say("/people", kind, t_s, **stamped, **{field: []})

    return say


def test_a_tracker_that_saw_nobody_all_day_gives_an_empty_table(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    Markers(writer).say(T0, {})
    writer.tcp(T0, x=0.0)
    writer.close()
    log = read(tmp_path / "run")
    assert log.people.is_empty()
    assert log.facts["time"] == "header stamp"


@pytest.mark.parametrize("kind", ["mcap", "bag"])
@pytest.mark.parametrize(
    "say",
    [
        lambda writer, t_s: writer.poses(t_s, []),
        lambda writer, t_s: Markers(writer).say(t_s, {}),
        of_nobody("spencer_tracking_msgs/msg/TrackedPersons", TRACKED_PERSONS, "tracks"),
        of_nobody("people_msgs/msg/People", PEOPLE, "people"),
        of_nobody("people_msgs/msg/PositionMeasurementArray", MEASUREMENTS, "people", header=False),
        of_nobody("zed_msgs/msg/ObjectsStamped", OBJECTS.replace("PACKAGE", "zed_msgs"), "objects"),
    ],
    ids=["PoseArray", "MarkerArray", "TrackedPersons", "People", "PositionMeasurementArray", "ObjectsStamped"],
)
def test_a_log_of_people_in_which_nobody_ever_is_says_so_of_the_whole_time(tmp_path, bag, kind, say):
    logs = tmp_path / "logs"
    logs.mkdir()
    for name in ("robot", "people"):
        writer = bag(logs / (f"{name}.bag" if kind == "bag" else name), kind)
        for i in range(101):
            if name == "robot":
                writer.tcp(T0 + 0.1 * i, x=0.01 * i)
            elif i >= 50:
                say(writer, T0 + 0.1 * i)
        writer.close()
    people = read(logs / ("people.bag" if kind == "bag" else "people")).people
    assert people.height == 51
    assert people["x_m"].null_count() == 51
    assert people["source_row"].to_list() == list(range(51))
    found = Dataset.open(ingest([logs], tmp_path / "dataset").dataset)
    assert found.card.not_read == ()
    gaps = dict(found.samples()["human_gap"].value_counts().rows())
    assert set(gaps) == {"outside", "absent"}  # the log of people began later
    assert gaps["absent"] == pytest.approx(51, abs=2)


def test_markers_are_read_alike_alone_and_in_bulk_and_a_deleted_one_is_nobody(tmp_path, bag):
    for count in (3, 60):
        writer = bag(tmp_path / str(count), "mcap")
        markers = Markers(writer)
        for i in range(count):
            markers.say(T0 + i, {i % 2: float(i)})
        gone = [markers.marker(T0 + count, 100, 9.0, action=2)]
        writer.say(markers.topic, markers.kind, T0 + count, markers=gone)
        writer.close()
        assert rows(read(tmp_path / str(count))) == [(str(i % 2), float(i), 0.5, 2.0) for i in range(count)]


def test_markers_drawn_for_the_eye_are_no_people(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    Markers(writer).say(T0, {1: 1.0}, topic="/planned_path")
    writer.tcp(T0, x=0.0)
    writer.close()
    assert read(tmp_path / "run").people is None
    assert rows(read(tmp_path / "run", body="planned_path")) == [("1", 1.0, 0.5, 2.0)]


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_a_planar_spencer_track_has_no_height_and_an_occluded_one_no_place(tmp_path, bag, kind):
    path = tmp_path / ("run.bag" if kind == "bag" else "run")
    writer = bag(path, kind)
    define(writer, "spencer_tracking_msgs/msg/TrackedPersons", TRACKED_PERSONS)
    tracks = []
    for number, x, height_variance, occluded in ((7, 1.0, 0.01, False), (8, 2.0, 1e6, False), (9, 3.0, 0.01, True)):
        covariance = np.zeros(36)
        covariance[14] = height_variance
        pose = writer.type("geometry_msgs/msg/PoseWithCovariance")(pose=writer.pose(x, 0.5, 0.9), covariance=covariance)
        track = writer.type("spencer_tracking_msgs/msg/TrackedPerson")
        tracks.append(track(track_id=number, is_occluded=occluded, is_matched=True, pose=pose))
    topic, header = "/spencer/perception/tracked_persons", writer.header(T0, "map")
    writer.say(topic, "spencer_tracking_msgs/msg/TrackedPersons", T0, header=header, tracks=tracks)
    writer.close()
    log = read(path)
    assert rows(log) == [("7", 1.0, 0.5, 0.9), ("8", 2.0, 0.5, None), ("9", None, None, None)]
    assert any("occluded" in said for said in log.warnings)


def test_people_msgs_name_their_people(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    define(writer, "people_msgs/msg/People", PEOPLE)
    person = writer.type("people_msgs/msg/Person")
    for t_s, names in ((T0, ["ann", ""]), (T0 + 1, ["bob"])):
        people = [person(name=name, position=point(writer, i + 1.0, 2.0)) for i, name in enumerate(names)]
        writer.say("/people", "people_msgs/msg/People", t_s, header=writer.header(t_s), people=people)
    writer.close()
    assert rows(read(tmp_path / "run")) == [("1", 2.0, 2.0, 0.0), ("ann", 1.0, 2.0, 0.0), ("bob", 1.0, 2.0, 0.0)]


def test_a_leg_detector_stamps_each_person(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    define(writer, "people_msgs/msg/PositionMeasurementArray", MEASUREMENTS)
    one = writer.type("people_msgs/msg/PositionMeasurement")
    parts = {"reliability": 1.0, "covariance": np.zeros(9)}
    legs = [
        one(header=writer.header(T0), object_id=f"leg{i}", pos=point(writer, i + 1.0, 2.0), **parts) for i in (0, 1)
    ]
    topic = "/people_tracker_measurements"
    writer.say(topic, "people_msgs/msg/PositionMeasurementArray", T0 + 0.5, people=legs)
    alone = {"header": writer.header(T0), "object_id": "leg2", "pos": point(writer, 5.0, 2.0), **parts}
    writer.say("/single", "people_msgs/msg/PositionMeasurement", T0 + 0.5, **alone)
    writer.close()
    people = read(tmp_path / "run", body=topic).people
    assert people.select("t_s", "person", "x_m").rows() == [(T0, "leg0", 1.0), (T0, "leg1", 2.0)]
    assert rows(read(tmp_path / "run", body="/single")) == [("leg2", 5.0, 2.0, 0.0)]


@pytest.mark.parametrize("package", ["zed_msgs", "zed_interfaces"])
def test_of_zed_objects_the_pelvis_counts_and_only_a_person_who_is_tracked(tmp_path, bag, package):
    writer = bag(tmp_path / "run", "mcap")
    define(writer, f"{package}/msg/ObjectsStamped", OBJECTS.replace("PACKAGE", package))

    def person(number, state, joints=None, form=0, skeleton=True):
        places = np.zeros((70, 3), np.float32)
        for joint, place in (joints or {}).items():
            places[joint] = place
        keypoints = [writer.type(f"{package}/msg/Keypoint3D")(kp=place) for place in places]
        return writer.type(f"{package}/msg/Object")(
            label="Person",
            label_id=number,
            position=np.array([1.0, 2.0, 0.5], np.float32),
            tracking_state=state,
            skeleton_available=skeleton and joints is not None,
            body_format=form,
            skeleton_3d=writer.type(f"{package}/msg/Skeleton3D")(keypoints=keypoints),
        )

    objects = [
        person(3, 1),
        person(4, 2),
        person(5, 1, joints={0: (4.0, 5.0, 0.75)}, form=2),
        person(7, 1, joints={0: (9.0, 9.0, 9.0)}, form=1, skeleton=False),
        person(6, 1, joints={0: (9.0, 9.0, 9.0), 8: (1.0, 1.0, 1.0), 11: (2.0, 1.0, 1.0)}, form=0),
    ]
    kind = f"{package}/msg/ObjectsStamped"
    writer.say("/zed/body_trk/skeletons", kind, T0, header=writer.header(T0), objects=objects)
    writer.close()
    log = read(tmp_path / "run")
    tracked = [("3", 1.0, 2.0, 0.5), ("4", None, None, None), ("5", 4.0, 5.0, 0.75), ("6", 1.5, 1.0, 1.0)]
    assert rows(log) == [*tracked, ("7", 1.0, 2.0, 0.5)]
    assert any("1 positions" in said and "tracking state" in said for said in log.warnings)


def humans(writer):
    """A camera at (1, 0, 2), turned a quarter about z; body ab1 walks along the camera's x, its face is elsewhere."""
    quarter = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))
    writer.number("/humans/bodies/tracked", "String", T0, "ab1")
    writer.transform(T0, ("base", "camera", (1.0, 0.0, 2.0, *quarter)), topic="/tf_static")
    for i in range(3):
        writer.transform(T0 + i, ("camera", "body_ab1", (float(i), 0.0, -1.0)))
        writer.transform(T0 + i, ("camera", "person_ab1", (99.0, 0.0, 0.0)))


@pytest.mark.parametrize("with_pose", [False, True])
def test_a_ros4hri_body_is_found_through_the_transforms_and_the_face_is_not_mixed_in(tmp_path, bag, with_pose):
    writer = bag(tmp_path / "run", "mcap")
    humans(writer)
    if with_pose:
        writer.tcp(T0, x=0.25)
    writer.close()
    log = read(tmp_path / "run")
    assert log.people["person"].to_list() == ["ab1"] * 3
    places = log.people.select("x_m", "y_m", "z_m").to_numpy()
    assert places == pytest.approx(np.array([[1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [1.0, 2.0, 1.0]]))
    assert (log.robot is not None) == with_pose
    people = read(tmp_path / "run", role="people")
    assert people.robot is None
    assert people.people.height == 3


def test_bodies_without_a_way_to_the_base_stay_in_the_frame_of_the_camera_and_are_named(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("camera", "body_ab1", (0.5, 0.0, 1.0)))
    writer.tcp(T0, x=0.0)
    writer.close()
    assert read(tmp_path / "run").people is None  # nobody speaks ROS4HRI here: `body_link` may be a part of a robot
    log = read(tmp_path / "run", map={"people": "/tf"})
    assert rows(log) == [("ab1", 0.5, 0.0, 1.0)]
    assert any("in frame 'camera'" in said for said in log.warnings)
