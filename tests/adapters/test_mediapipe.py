"""Landmarks in a picture are refused, whatever table a script made of them; skeletons in a room are not."""

import json
import math
import random

import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import LogError
from cyclekit.ingest.registry import adapters, find_adapter
from cyclekit_adapters.formats.mediapipe import ADAPTER

LANDMARK = {"x": 0.01, "y": -0.5, "z": 0.1, "visibility": 0.99}
NAMES = ["NOSE", "LEFT_EYE_INNER", "RIGHT_EYE_INNER", "MOUTH_LEFT", "LEFT_HIP", "RIGHT_HIP", "LEFT_FOOT_INDEX"]
OBJECT = "NormalizedLandmark"
DUMPS = {
    "frames.json": json.dumps([{"timestamp": 33, "pose_world_landmarks": [LANDMARK] * 33}]),
    "camel.json": json.dumps({"poseWorldLandmarks": [LANDMARK] * 33}),
    "web.json": json.dumps([{"timestamp": 33, "landmarks": [LANDMARK] * 33, "worldLandmarks": [LANDMARK] * 33}]),
    "named.json": json.dumps([{"time": 0.0, **dict.fromkeys(NAMES, LANDMARK)}]),
    "named.csv": ",".join(["frame", *(f"{n.lower()}_{a}" for n in NAMES * 2 for a in "xyz")]) + "\n1,2,3\n",
    "numbered.csv": ",".join(["class", *(f"{a}{i}" for i in range(1, 34) for a in "xyzv")]) + "\n",
    "spelt.csv": ",".join(f"landmark_{i}_{a}" for i in range(33) for a in ("x", "y", "z", "visibility")) + "\n",
    "header_only.csv": "Frame,Landmark,X,Y,Z,Visibility\n",
    "flat.csv": "frame,landmark_0_x,landmark_0_y,landmark_0_visibility,landmark_1_x,landmark_1_y\n0,0,0,0,0,0\n",
    "face.csv": ",".join(["class", *(f"{a}{i}" for i in range(1, 502) for a in "xyzv")]) + "\n",
    "ragged.csv": "Frame,Time (ms),Landmark,X,Y,Z,Visibility\n1,33.3,0,0.1,-0.5,0.1,0.99,11,0.1,-0.4,0.1,0.98\n",
    "joints.csv": "exercise,x_joint_1,y_joint_1,x_joint_2,y_joint_2,x_joint_3,y_joint_3\n1,654.5,477,492,494,536,623\n",
    "pairs.csv": "frame,nose_x,nose_y,left_hip_x,left_hip_y\n0,0.5,0.2,0.4,0.6\n",
    "messages.csv": 'frame,NOSE\n0,"x: 0.54\ny: 0.33\nz: -0.2\nvisibility: 0.99\n"\n',
    "objects.csv": f'frame,0\n0,"{OBJECT}(x=0.5, y=0.3, z=-0.2, visibility=0.99, presence=0.9)"\n',
    "dicts.csv": f'frame,pose\n0,"[{LANDMARK}]"\n',
    "cells.csv": 'time,landmarks\n0.1,"[0.5, 0.3, -0.2, 0.99, 0.5]"\n',
    "world.csv": "timestamp_s,landmark,x_m,y_m,z_m,visibility\n0.1,NOSE,0.1,-0.5,-0.2,0.99\n",
}


@pytest.mark.parametrize("name", DUMPS)
def test_landmarks_around_the_persons_own_hips_are_refused_with_the_reason(tmp_path, name):
    path = tmp_path / name
    path.write_text(DUMPS[name])
    found = find_adapter(path)
    assert found is not None
    assert found.name == "mediapipe"
    with pytest.raises(LogError, match="middle of the person's own hips") as refusal:
        found.adapter.read(path, ReadOptions())
    assert "depth camera" in refusal.value.cure
    assert not refusal.value.cause.startswith("it is read")


@pytest.mark.parametrize(
    "other",
    [
        "t,x,y,z\n0,1,2,3\n",
        json.dumps([{"id": 1, "keypoint": [[1, 2, 3]] * 34, "ts": 1}]),
        json.dumps({"landmarks": [{"lat": 1.0}]}),
        ",".join(f"{a}{i}" for i in range(25) for a in "xyz"),
        "LEFT_EYE_INNER and LEFT_FOOT_INDEX are names of landmarks, one of x, y, z\n",
        "stamp,class_id,landmark_id,x,y,z,cov_xx\n12.3,pole,42,4.0,0.2,1.1,0.04\n12.3,pole,7,5.0,0.2,1.1,0.04\n",
        "bag_name,stamp,gt_id,x,y,z,visibility\na.bag,1.5,R001,1.65,1.35,0.0,1\na.bag,1.6,R001,1.65,1.35,0.0,1\n",
        ",".join(["1e308"] * 99) + "\n" + ",".join(["-1e308"] * 99) + "\n",
        "frame,left_hip_x,left_hip_y,left_hip_z,right_hip_x,right_hip_y,right_hip_z\n" + "0" + ",1e308,inf,-inf" * 2,
        "frame,id,x,y\n0,0,1.5,2.5\n0,1,3.5,2.5\n1,0,1.6,2.5\n1,1,3.6,2.5\n",
        "time,joint_1,joint_2,x,y,z\n0,0.1,0.2,0.3,0.4,0.5\n",
        "time,joint_1_x,joint_1_y,joint_1_z,joint_2_x,joint_2_y,joint_2_z,joint_3_x,joint_3_y,joint_3_z\n" + "0," * 10,
        "time,elbow_x,elbow_y,wrist_1_x,wrist_1_y\n0,0.1,0.2,0.3,0.4\n",
        "0.1 0.2 0.3 0.4\n" * 40,
        "x,y,z\n0.1,0.2,0.3\n" * 40,
    ],
)
def test_other_files_are_not_taken_for_landmarks(tmp_path, other):
    path = tmp_path / "a"
    path.write_text(other)
    assert not ADAPTER.recognises(path)


POSE = [
    *["nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer"],
    *["left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow"],
    *["right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index"],
    *["left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle"],
    *["left_heel", "right_heel", "left_foot_index", "right_foot_index"],
]
HEIGHT_M = [1.6] + [1.65] * 6 + [1.62] * 2 + [1.57] * 2 + [1.45] * 2 + [1.15] * 2 + [0.95] * 8 + [0.93] * 2
HEIGHT_M += [0.5] * 2 + [0.08] * 2 + [0.04] * 2 + [0.02] * 2
BODY = ["nose", "left_shoulder", "right_shoulder", "left_elbow", "left_hip", "right_hip", "left_knee", "right_knee"]


def _across(name):
    return {"l": 0.17, "r": -0.17}.get(name[0], 0.0) if name != "nose" else 0.0


def picture(frame, turn, *, world):
    """Return 33 landmarks (x, y, z, visibility) of one frame, as MediaPipe gives them: y down, z from the hips."""
    found = []
    for name, height_m in zip(POSE, HEIGHT_M, strict=True):
        across, front = _across(name), 0.12 if height_m > 1.5 else 0.0
        x, z = across * math.cos(turn) + front * math.sin(turn), across * math.sin(turn) - front * math.cos(turn)
        y = 0.93 - height_m
        place = (x, y) if world else (0.45 + 0.3 * x + 0.002 * frame, 0.55 + 0.4 * y)
        found.append((*place, z * (1.0 if world else 0.3), 0.999 - 0.01 * abs(across)))
    return found


def room(frame, turn, *, up):
    """Return the same body as a camera in a room sees it, 2.5 m away, in metres."""
    found = []
    for x, y, z, _ in picture(frame, turn, world=True):
        height = 0.93 - y if up != "image" else y
        place = (x + 0.8 + 0.01 * frame, height, z + 2.5)
        found.append((place[0], place[2], place[1]) if up == "z" else place)
    return found


LANDMARKS = {
    "number": lambda i: f"{i}",
    "from one": lambda i: f"{i + 1}",
    "L0": lambda i: f"L{i}",
    "lmk0": lambda i: f"lmk{i}",
    "landmark_0": lambda i: f"landmark_{i}",
    "pose_landmark_0": lambda i: f"pose_landmark_{i}",
    "landmark 00": lambda i: f"landmark_{i:02d}",
    "NOSE": lambda i: POSE[i].upper(),
    "nose": lambda i: POSE[i],
    "leftEyeInner": lambda i: POSE[i].title().replace("_", ""),
    "left eye inner": lambda i: POSE[i].replace("_", " "),
}
COORDINATES = [("x", "y", "z", "visibility"), ("x", "y", "z", "v"), ("x", "y", "z", "vis"), ("x", "y", "z"), ("x", "y")]
SPELT = {
    "after": lambda name, axis: f"{name}_{axis}",
    "before": lambda name, axis: f"{axis}_{name}",
    "close": lambda name, axis: f"{axis}{name}" if name[0].isdigit() else f"{name}{axis.upper()}",
    "point": lambda name, axis: f"{name}.{axis}",
    "coord": lambda name, axis: f"{axis}{'' if name.isdigit() else '_'}{name}_coord",
}
LEADS = {
    "none": ([], lambda frame: []),
    "frame": (["frame"], lambda frame: [frame]),
    "index": (["", "frame"], lambda frame: [frame, frame]),
    "time": (["timestamp_s", "label"], lambda frame: [1740941743.8 + frame / 30, "squat"]),
}


@st.composite
def dialects(draw):
    """Draw a table of landmarks as some script would write it."""
    frames = [picture(i, draw(st.floats(0.5, 1.2)), world=draw(st.booleans())) for i in range(draw(st.integers(1, 3)))]
    axes = draw(st.sampled_from(COORDINATES))
    columns, cells = LEADS[draw(st.sampled_from(sorted(LEADS)))]
    mark = draw(st.sampled_from([",", ",", ";", "\t"]))
    layout = draw(st.sampled_from(["wide", "long", "stacked", "bare", "lists"]))
    numbers = [[[f"{number:.6f}" for number in point[: len(axes)]] for point in pose] for pose in frames]
    if layout in ("wide", "lists"):
        name, spell = LANDMARKS[draw(st.sampled_from(sorted(LANDMARKS)))], SPELT[draw(st.sampled_from(sorted(SPELT)))]
        names = [[spell(name(i), axis) for axis in axes] for i in range(33)]
        rows = [[cell for point in pose for cell in point] for pose in numbers]
        if layout == "lists":
            names, mark = [[name(i)] for i in range(33)], ","
            rows = [[f'"[{", ".join(point)}]"' for point in pose] for pose in numbers]
        header = [*columns, *(cell for point in names for cell in point)]
        table = [header, *([*map(str, cells(i)), *row] for i, row in enumerate(rows))]
    elif layout == "long":
        word = draw(st.sampled_from(["landmark", "landmark_id", "LandmarkID", "landmark_index", "landmark_name", "id"]))
        named = word != "id" and draw(st.booleans())
        axes = axes if word != "id" or len(axes) > 3 else COORDINATES[0]
        kept = [point[: len(axes)] for pose in frames for point in pose]
        header = [*columns, word, *(axis.title() if word == "LandmarkID" else axis for axis in axes)]
        which = [POSE[i] if named else str(i) for _ in frames for i in range(33)]
        rows = [[*map(str, cells(at // 33)), which[at], *(f"{n:.6f}" for n in kept[at])] for at in range(len(which))]
        table = [header, *rows]
    else:
        axes = axes if layout == "bare" or len(axes) > 2 else COORDINATES[3]
        numbers = [[[f"{number:.6f}" for number in point[: len(axes)]] for point in pose] for pose in frames]
        table = [[cell for point in pose for cell in point] for pose in numbers]
        if layout == "stacked":
            table = [point for pose in numbers for point in pose]
        if draw(st.booleans()):
            table = [[*map(str, cells(i)), *row] for i, row in enumerate(table)]
        elif layout == "bare" and draw(st.booleans()):  # as pandas writes columns without names, and a label
            table = [[*map(str, range(len(table[0]))), "label"], *([*row, "tree"] for row in table)]
    return "".join(mark.join(row) + "\n" for row in table)


@at_most(120)
@given(text=dialects())
def test_every_dialect_of_landmarks_has_one_reader_that_refuses_it(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any_landmarks.csv"
    path.write_text(text)
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["mediapipe"]
    with pytest.raises(LogError, match="do not give the person's position"):
        ADAPTER.read(path, ReadOptions())


@given(
    turn=st.floats(0.5, 1.2),
    up=st.sampled_from(["y", "z", "image"]),
    name=st.sampled_from([str, str.upper, lambda text: text.title().replace("_", "")]),
    spell=st.sampled_from([SPELT["after"], SPELT["before"], SPELT["point"]]),
    kept=st.sampled_from([BODY, BODY[:3], BODY[1:]]),
    sure=st.sampled_from(["", "confidence", "score"]),
)
def test_skeletons_in_a_room_are_no_landmarks(tmp_path_factory, turn, up, name, spell, kept, sure):
    path = tmp_path_factory.getbasetemp() / "any_skeleton.csv"
    axes = ["x", "y", "z", *([sure] if sure else [])]
    lines = [",".join(["time", *(spell(name(point), axis) for point in kept for axis in axes)])]
    for frame in range(5):
        body = room(frame, turn, up=up)
        cells = [f"{n:.4f}" for point in kept for n in (*body[POSE.index(point)], *([0.9] if sure else []))]
        lines.append(",".join([f"{frame / 30:.4f}", *cells]))
    path.write_text("\n".join([*lines, ""]))
    assert not ADAPTER.recognises(path)


@given(st.text(alphabet="xyzv0123456789_,.-\n\"'[]{}:landmrkid", max_size=200))
def test_any_text_has_an_answer(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any_text.csv"
    path.write_text(text)
    assert ADAPTER.recognises(path) in (True, False)


@given(
    seed=st.integers(0, 10_000),
    noise=st.sampled_from([0.0, 1e-4, 0.01]),
    speed=st.floats(-0.05, 0.05),
    names=st.sampled_from(["x,y,z", "t,x,y,z", "0.1,0.2,0.3", "x,y,z,qx,qy,qz,qw"]),
)
def test_the_path_of_a_robot_around_zero_is_no_body(tmp_path_factory, seed, noise, speed, names):
    path = tmp_path_factory.getbasetemp() / "any_path.csv"
    chance = random.Random(seed)
    width = names.count(",") + 1
    rows = [[f"{speed * i + noise * chance.gauss(0, 1):.6f}" for _ in range(width)] for i in range(-40, 40)]
    path.write_text("\n".join([names, *map(",".join, rows), ""]))
    assert not ADAPTER.recognises(path)
