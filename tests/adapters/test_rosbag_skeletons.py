"""Joints of people are kept on request, and only then."""

import numpy as np
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.schema import SKELETONS
from cyclekit_adapters.rosbag import ADAPTER
from cyclekit_adapters.rosbag.definitions import types_of
from cyclekit_adapters.rosbag.joints import AZURE_KINECT, ZED, of_human
from cyclekit_adapters.rosbag.payloads import Channel

T0 = 1_700_000_000.0
OBJECTS = "zed_msgs/msg/ObjectsStamped"


def read(path, *, skeletons=True):
    return ADAPTER.read(path, ReadOptions(skeletons=skeletons))


def joints(log):
    return log.skeletons.select("person", "joint", "x_m", "y_m", "z_m").rows()


@pytest.mark.parametrize("count", [1, 40])
def test_markers_of_an_azure_kinect_are_joints_by_their_number(tmp_path, bag, count):
    writer = bag(tmp_path / "run", "mcap")
    writer.transform(T0, ("base", "depth", (0.0, 0.0, 1.0)), topic="/tf_static")
    writer.tcp(T0, x=0.0)
    for i in range(count):
        header = writer.header(T0 + i, "depth")
        numbers = [(300, 0), (303, 0), (326, 0), (426, 0), (399, 0), (327, 2)]  # 399 is none, 327 is taken away
        markers = [
            writer.random("visualization_msgs/msg/Marker", id=n, action=a, header=header, pose=writer.pose(n, i, 0.5))
            for n, a in numbers
        ]
        writer.say("/k4a/body_tracking_data", "visualization_msgs/msg/MarkerArray", T0 + i, markers=markers)
    writer.close()
    log = read(tmp_path / "run")
    assert log.skeletons.schema == {name: column.dtype for name, column in SKELETONS.items()}
    seen = [("3", "pelvis", 300), ("3", "neck", 303), ("3", "head", 326), ("4", "head", 426)]
    assert joints(log)[:4] == [(person, joint, float(n), 0.0, 1.5) for person, joint, n in seen]
    assert log.skeletons.height == 4 * count
    assert log.skeletons["source_row"].to_list()[-1] == count - 1
    assert log.people.filter(log.people["person"] == "3").height == count


def zed_object(writer, number, form, state=1, *, skeleton=True):
    places = np.zeros((70, 3), np.float32)
    places[: len(ZED[form]), 0] = np.arange(len(ZED[form]))
    places[: len(ZED[form]), 2] = 1.0
    places[4] = 0.0  # not seen
    keypoints = [writer.type("zed_msgs/msg/Keypoint3D")(kp=place) for place in places]
    body = writer.type("zed_msgs/msg/Skeleton3D")(keypoints=keypoints)
    known = {"label_id": number, "tracking_state": state, "body_format": form, "skeleton_available": skeleton}
    return writer.random("zed_msgs/msg/Object", skeleton_3d=body, **known)


def zed_bag(path, bag):
    writer = bag(path, "mcap")
    store = types_of(Channel(1, "/t", OBJECTS, "ZED SDK 5, 70 joints", "known")).store(OBJECTS)
    for part in store.fielddefs:
        writer.store.fielddefs[part], writer.store.types[part] = store.fielddefs[part], store.types[part]
    writer.store.cache.clear()
    return writer


@pytest.mark.parametrize("form", ZED)
def test_of_the_seventy_keypoints_only_those_of_the_body_format_are_joints(tmp_path, bag, form):
    writer = zed_bag(tmp_path / "run", bag)
    objects = [zed_object(writer, 7, form), zed_object(writer, 8, form, state=2)]
    objects.append(zed_object(writer, 9, form, skeleton=False))
    writer.say("/zed/body_trk/skeletons", OBJECTS, T0, header=writer.header(T0), objects=objects)
    writer.close()
    log = read(tmp_path / "run")
    rows = joints(log)
    assert [joint for _, joint, *_ in rows] == list(ZED[form])
    assert {person for person, *_ in rows} == {"7"}
    assert [x for _, _, x, *_ in rows] == [None if n == 4 else float(n) for n in range(len(ZED[form]))]


def test_joint_frames_of_ros4hri_are_joints_and_frames_of_rotation_are_not(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.number("/humans/bodies/tracked", "String", T0, "ab1")
    writer.transform(T0, ("base", "camera", (1.0, 0.0, 0.0)), topic="/tf_static")
    for i in range(3):
        writer.transform(
            T0 + i,
            ("camera", "body_ab1", (float(i), 0.0, 1.0)),
            ("body_ab1", "l_y_shoulder_ab1", (0.0, 0.25, 0.5)),
            ("l_y_shoulder_ab1", "l_shoulder_ab1", (0.0, 0.0, 0.0)),
            ("l_shoulder_ab1", "l_elbow_ab1", (0.0, 0.0, -0.25)),
            ("camera", "person_ab1", (9.0, 9.0, 9.0)),
        )
    writer.close()
    log = read(tmp_path / "run")
    assert sorted(joints(log))[:2] == [("ab1", "l_elbow", 1.0, 0.25, 1.25), ("ab1", "l_elbow", 2.0, 0.25, 1.25)]
    assert set(log.skeletons["joint"]) == {"l_elbow", "l_shoulder"}
    assert log.people["person"].to_list() == ["ab1"] * 3


@pytest.mark.parametrize("form", ["markers", "zed", "humans"])
def test_without_being_asked_for_no_joint_is_kept(tmp_path, bag, form):
    writer = zed_bag(tmp_path / "run", bag)
    if form == "zed":
        header = writer.header(T0)
        writer.say("/skeletons", OBJECTS, T0, header=header, objects=[zed_object(writer, 7, 2)])
    elif form == "humans":
        writer.number("/humans/bodies/tracked", "String", T0, "ab1")
        writer.transform(T0, ("base", "body_ab1", (0.0, 0.0, 1.0)), ("body_ab1", "head_ab1", (0.0, 0.0, 0.5)))
    else:
        marker = writer.random("visualization_msgs/msg/Marker", id=100, action=0, header=writer.header(T0, "base"))
        writer.say("/body_tracking_data", "visualization_msgs/msg/MarkerArray", T0, markers=[marker])
    writer.close()
    assert read(tmp_path / "run", skeletons=False).skeletons is None
    assert read(tmp_path / "run", skeletons=False).people.height == 1
    assert read(tmp_path / "run").skeletons.height > 0


def test_a_bag_without_people_has_no_skeletons(tmp_path, bag):
    writer = bag(tmp_path / "run", "mcap")
    writer.tcp(T0, x=0.0)
    writer.close()
    assert read(tmp_path / "run").skeletons is None


def test_the_joints_have_the_numbers_of_their_makers():
    assert (len(AZURE_KINECT), len(set(AZURE_KINECT))) == (32, 32)
    assert [AZURE_KINECT[n] for n in (0, 3, 4, 10, 11, 18, 22, 25, 26, 31)] == [
        *("pelvis", "neck", "clavicle_left", "thumb_left", "clavicle_right", "hip_left", "hip_right", "foot_right"),
        *("head", "ear_right"),
    ]
    assert {form: len(set(names)) for form, names in ZED.items()} == {0: 18, 1: 34, 2: 38, 3: 70}
    assert [ZED[0][n] for n in (0, 2, 7, 8, 11, 14, 17)] == [
        *("nose", "right_shoulder", "left_wrist", "right_hip", "left_hip", "right_eye", "left_ear"),
    ]
    assert [ZED[1][n] for n in (0, 4, 11, 18, 22, 26, 33)] == [
        *("pelvis", "left_clavicle", "right_clavicle", "left_hip", "right_hip", "head", "right_heel"),
    ]
    assert [ZED[2][n] for n in (5, 10, 19, 29, 30, 33, 37)] == [
        *("nose", "left_clavicle", "right_hip", "right_heel", "left_hand_thumb_4", "right_hand_index_1"),
        "right_hand_pinky_1",
    ]
    assert (ZED[3][30], ZED[3][49], ZED[3][69]) == ("left_hand_thumb_1", "left_hand_pinky_4", "right_hand_pinky_4")


@pytest.mark.parametrize(
    ("frame", "joint"),
    [
        ("head_ab1", "head"),
        ("/humans/r_elbow_ab1", "r_elbow"),
        ("y_head_ab1", None),
        ("l_p_hip_ab1", None),
        ("body_ab1", None),
        ("head_ab2", None),
        ("tool0", None),
    ],
)
def test_a_frame_is_a_joint_of_the_body_whose_id_it_ends_in(frame, joint):
    assert of_human(frame, "ab1") == joint
