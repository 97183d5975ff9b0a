"""One log of each kind, as long as wanted, with gaps where trackers have them: for tests over all adapters."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def _lines(path: Path, lines: list[str], end: str = "\n") -> Path:
    path.write_text(end.join([*lines, ""]), newline="")
    return path


def motive(folder: Path, frames: int = 4) -> Path:
    bones, axes = ["Ann:Hip", "Ann:LHand", "Bo:Hip", "Bo:LHand"], ["X", "Y", "Z", "W", "X", "Y", "Z"]
    parts = ["Rotation"] * 4 + ["Position"] * 3
    head = [
        "Format Version,1.24,Take Name,walk,Capture Frame Rate,100,Export Frame Rate,100,Length Units,Meters",
        "",
        ",".join([",Type", *("Bone" for _ in bones for _ in axes)]),
        ",".join([",Name", *(bone for bone in bones for _ in axes)]),
        ",".join([",", *(part for _ in bones for part in parts)]),
        ",".join(["Frame,Time (Seconds)", *(axis for _ in bones for axis in axes)]),
    ]
    rows = []
    for i in range(frames):
        cells = [f"0,0,0,1,{0.01 * i + k:.2f},{0.9 + k},{-k}" if (i + k) % 7 else "," * 6 for k in range(len(bones))]
        rows.append(",".join([str(i), f"{i / 100:.6f}", *cells]))
    return _lines(folder / "take.csv", head + rows, "\r\n")


def qualisys(folder: Path, frames: int = 4) -> Path:
    names = ["Ann:LASI", "Ann:RASI", "Ann:HEAD", "box:1"]
    head = [f"NO_OF_FRAMES\t{frames}", "NO_OF_MARKERS\t4", "FREQUENCY\t100", "DATA_INCLUDED\t3D"]
    head += [
        "\t".join(["MARKER_NAMES", *names]),
        "\t".join(["Frame", "Time", *(f"{n} {a}" for n in names for a in "XYZ")]),
    ]
    rows = []
    for i in range(frames):
        places = [(10 * i + k, 200 * k, 900) if (i + k) % 7 else (0, 0, 0) for k in range(len(names))]
        rows.append("\t".join([str(i + 1), f"{i / 100:.5f}", *(f"{v:.3f}" for place in places for v in place)]))
    return _lines(folder / "walk.tsv", head + rows, "\r\n")


def vicon(folder: Path, frames: int = 4) -> Path:
    names = ["Ann:LASI", "Ann:RASI", "Ann:HEAD"]
    lines = [
        "Devices",
        "1000",
        ",,EMG",
        "Frame,Sub Frame,1",
        ",,V",
        *(f"{1 + i // 10},{i % 10},0.1" for i in range(20)),
        "",
    ]
    lines += ["Trajectories", "100", ",," + ",".join(f"{name},," for name in names)]
    lines += ["Frame,Sub Frame" + ",X,Y,Z" * len(names), "," + ",mm,mm,mm" * len(names)]
    for i in range(frames):
        cells = [f"{10 * i + k},{200 * k},900" if (i + k) % 7 else ",," for k in range(len(names))]
        lines.append(",".join([f"{i + 1},0", *cells]))
    lines += ["", "Joints", "100", ",,LHip,,", "Frame,Sub Frame,RX,RY,RZ", ",,deg,deg,deg", "1,0,1,2,3"]
    return _lines(folder / "trial.csv", lines, "\r\n")


def trc(folder: Path, frames: int = 4) -> Path:
    names = ["RHip", "LHip", "Head", "LHeel"]
    keys = [
        "DataRate",
        "CameraRate",
        "NumFrames",
        "NumMarkers",
        "Units",
        "OrigDataRate",
        "OrigDataStartFrame",
        "OrigNumFrames",
    ]
    lines = ["PathFileType\t4\t(X/Y/Z)\twalk.trc", "\t".join(keys), f"100\t100\t{frames}\t4\tm\t100\t0\t{frames}"]
    lines += ["Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t", "\t\t" + "\t".join("X1\tY1\tZ1" for _ in names)]
    for i in range(frames):
        places = [f"{0.01 * i:.2f}\t{0.5 * k:.2f}\t-1.25" if (i + k) % 7 else "\t\t" for k in (2, 2, 3, 0)]
        lines.append("\t".join([str(i), f"{i / 100:.4f}", *places]))
    return _lines(folder / "walk.trc", lines)


def nuitrack(folder: Path, frames: int = 4) -> Path:
    joints = ["JOINT_WAIST", "JOINT_TORSO", "JOINT_LEFT_HAND"]
    lines = [",".join(["timestamp,serial,id", *(f"{joint}.{axis}" for joint in joints for axis in "xyz")])]
    for i in range(frames):
        for who in (1, 2):
            places = ",".join(
                f"{0.01 * i + who:.2f},{0.3 * k},2.0" if (i + k) % 7 else ",," for k in range(len(joints))
            )
            row = f"{1_715_151_474_879_921 + 33_333 * i},CAM1,{who},{places}"
            lines += [row, row] if i % 2 else [row]
    return _lines(folder / "nui.csv", lines)


def kinect2(folder: Path, frames: int = 4) -> Path:
    lines = []
    for i in range(frames):
        for body in range(1 if i < frames // 2 else 2):
            cells = [f"{0.01 * i + 2 * body:.2f},{0.1 * k:.1f},2.0,{(i + k) % 3}" for k in range(25)]
            lines.append(",".join([str(10_000_000 + 333_333 * i), *cells]))
    return _lines(folder / "joints.csv", lines)


def pedestrian(folder: Path, frames: int = 4) -> Path:
    rows = [f"{i} {who} {0.05 * i + who:.2f} {2.5 * who}" for i in range(frames) for who in (1, 2)]
    return _lines(folder / "crowd.txt", ["# framerate: 25", *rows])


def pose_rows(folder: Path, frames: int = 4) -> Path:
    return _lines(folder / "poses.csv", ["x,y,z", *(f"{0.001 * i:.3f},0.2,0.3" for i in range(frames))])


def ur_split(folder: Path, frames: int = 4) -> Path:
    folder = folder / "ur"
    folder.mkdir()
    late = {"log_tool_vector": 0.0, "log_tcp_speed": 0.001, "log_q_actual": -0.002, "log_qd_actual": 0.003}
    for name, seconds in late.items():
        count = frames - 3 if name == "log_q_actual" else frames
        rows = [f"{1 + 0.008 * i + seconds:.4f}, {0.01 * i:.2f}, 0.5, 0.2, 0, 3.14, 0" for i in range(count)]
        _lines(folder / f"{name}.csv", rows)
    return folder


def events(folder: Path, frames: int = 4) -> Path:
    rows = [f"{0.5 * i:.1f},goal,place_{i % 3}" for i in range(frames)]
    return _lines(folder / "buttons.csv", ["time_s,signal,value", *rows])


def inputs(folder: Path, frames: int = 4) -> Path:
    rows = [f"{10 * i},{i % 2},{i // 2 % 2}" for i in range(frames)]
    return _lines(folder / "inputs.csv", ["time_ms,DI0,DI1", *rows])


def ur_rtde(folder: Path, frames: int = 4) -> Path:
    names = ["timestamp", *(f"actual_q_{i}" for i in range(6)), "runtime_state"]
    rows = [" ".join([f"{0.008 * (i + 1):.3f}", *["0"] * 6, "1"]) for i in range(frames)]
    return _lines(folder / "robot_data.csv", [" ".join(names), *rows], "\r\n")


def ur_nist(folder: Path, frames: int = 4) -> Path:
    names = ["ROBOT_TIME", *(f"ROBOT_ACTUAL_JOINT_POSITIONS (J{i})" for i in range(1, 7))]
    return _lines(folder / "ur5.csv", [",".join(names), *(f"{i}" + ",0" * 6 for i in range(frames))])


def kuka_rsi(folder: Path, frames: int = 4) -> Path:
    rows = [f"2024-09-24 14:05:15,{i},0,1,{1000 + 12 * i}" for i in range(frames)]
    return _lines(folder / "rsi.csv", ["Timestamp,X_RIst,Y_RIst,Z_RIst,IPOC", *rows])


def franka_log(folder: Path, frames: int = 4) -> Path:
    rows = [f"{i}" + f",{i % 2}" * 7 for i in range(frames)]
    return _lines(folder / "franka.csv", ["time," + ",".join(f"state.q[{i}]" for i in range(7)), *rows])


def mediapipe(folder: Path, frames: int = 4) -> Path:
    names = ["time", *(f"{axis}{i}" for i in range(33) for axis in ("x", "y", "z", "visibility"))]
    return _lines(
        folder / "pose.csv", [",".join(names), *(",".join([str(i), *["0", "1"] * 66]) for i in range(frames))]
    )


def zed(folder: Path, frames: int = 4) -> Path:
    body = {"id": 1, "keypoint": [[0.1, 0.04 * i, -2.0] for i in range(34)]}
    ms = 1_700_000_000_000
    dump = {str(ms + 33 * i): {"is_tracked": True, "timestamp": (ms + 33 * i) * 10**6} for i in range(frames)}
    return dumped(folder / "bodies.json", {key: frame | {"body_list": [body]} for key, frame in dump.items()})


def azure_kinect(folder: Path, frames: int = 4) -> Path:
    bodies = [{"body_id": 1, "joint_positions": [[1.0, 2.0, 3.0]] * 2}]
    found = [{"timestamp_usec": 33_000 * i, "num_bodies": 1, "bodies": bodies} for i in range(frames)]
    about = {"bone_list": [["SPINE_NAVEL", "PELVIS"]], "frames": found, "joint_names": ["PELVIS", "SPINE_NAVEL"]}
    return dumped(folder / "out.json", about | {"k4abt_sdk_version": "1.1.2"})


def task_list(folder: Path, frames: int = 4) -> Path:
    rows = [f"1,{('human', 'ur5')[i % 2]},t{i},{i}.5,{i}.75" for i in range(frames)]
    return _lines(folder / "tasks.csv", ["run,agent,task,start_s,end_s", *rows])


def planner(folder: Path, frames: int = 4) -> Path:
    return dumped(
        folder / "tasks.json",
        [{"agent": "r", "name": "t", "t_start": i + 0.5, "t_end": i + 1.0} for i in range(frames)],
    )


def safety_log(folder: Path, frames: int = 4) -> Path:
    return _lines(
        folder / "ovr.csv", [",Timestamp [s],Safe_Ovr", *(f"{i},{i}.500000,{100 - i}.000" for i in range(frames))]
    )


WRITERS: dict[str, Callable[[Path, int], Path]] = {
    "motive": motive,
    "qualisys": qualisys,
    "vicon": vicon,
    "trc": trc,
    "nuitrack": nuitrack,
    "kinect2": kinect2,
    "pedestrian": pedestrian,
    "pose-rows": pose_rows,
    "ur-split": ur_split,
    "events": events,
    "safety-log": safety_log,
}
"""Adapter -> writer of a log of that many frames, for those whose logs may be larger than memory."""

ALL_WRITERS: list[tuple[str, Callable[[Path, int], Path]]] = [
    *WRITERS.items(),
    ("events", inputs),
    ("ur-rtde", ur_rtde),
    ("ur-nist", ur_nist),
    ("kuka-rsi", kuka_rsi),
    ("franka-log", franka_log),
    ("task-list", task_list),
    ("task-list", planner),
    ("mediapipe", mediapipe),
    ("zed", zed),
    ("azure-kinect", azure_kinect),
]


def dumped(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path
