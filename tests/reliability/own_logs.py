"""One small log of every kind that is read, written here byte by byte, and how its cell file would speak of it."""

from __future__ import annotations

import importlib.util
import json
import math
import struct
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from reliability.clean_logs import KINDS

from cyclekit.adapter import ReadOptions

if TYPE_CHECKING:
    from collections.abc import Callable

ROWS = 60


@dataclass(frozen=True)
class OwnLog:
    """A log: the adapter that reads it, its files, and what it is read with.

    Attributes:
        name: Of the log.
        adapter: Name of the adapter.
        files: What is in each file; a log of several files is a folder.
        options: What the cell file says of it.
    """

    name: str
    adapter: str
    files: dict[str, bytes]
    options: ReadOptions = field(default_factory=ReadOptions)

    def write(self, folder: Path) -> Path:
        """Write it and return its path: the file, or the folder where there are several."""
        for name, data in self.files.items():
            (folder / name).write_bytes(data)
        return folder / next(iter(self.files)) if len(self.files) == 1 else folder


def own_logs(folder: Path) -> list[OwnLog]:
    """Return all of them; the bags are written in `folder` first."""
    adapters = {"mapped_csv": "csv", "ur_rtde": "ur-rtde", "kuka_rsi": "kuka-rsi", "motive": "motive"}
    mapped = [
        OwnLog(kind.name, adapters[kind.module], {"log.csv": kind.text().encode()}, kind.options())
        for kind in KINDS
    ]  # fmt: skip
    texts: dict[str, tuple[str, Callable[[], str], ReadOptions]] = {
        "nist table": ("ur-nist", _nist_table, ReadOptions()),
        "nist rows": ("ur-nist", _nist_rows, ReadOptions()),
        "franka": ("franka-log", _franka, ReadOptions()),
        "poses": ("pose-rows", _poses, ReadOptions(rate_hz=250.0)),
        "qualisys": ("qualisys", _qualisys, ReadOptions()),
        "vicon": ("vicon", _vicon, ReadOptions()),
        "vicon objects": ("vicon", _vicon_objects, ReadOptions()),
        "trc": ("trc", _trc, ReadOptions()),
        "azure kinect": ("azure-kinect", _azure_kinect, ReadOptions()),
        "zed": ("zed", _zed, ReadOptions()),
        "kinect2": ("kinect2", _kinect2, ReadOptions()),
        "nuitrack": ("nuitrack", _nuitrack, ReadOptions()),
        "pedestrian": ("pedestrian", _pedestrian, ReadOptions(rate_hz=25.0)),
        "mediapipe": ("mediapipe", _mediapipe, ReadOptions()),
        "task table": ("task-list", _task_table, ReadOptions()),
        "task json": ("task-list", _task_json, ReadOptions()),
        "xes": ("task-list", _xes, ReadOptions()),
        "safety": ("safety-log", _safety, ReadOptions()),
        "scope": ("twincat-scope", _scope, ReadOptions()),
        "trace": ("codesys-trace", _trace, ReadOptions()),
        "trace xml": ("codesys-trace", _trace_xml, ReadOptions()),
        "trace text": ("codesys-trace", _trace_text, ReadOptions()),
    }
    written = [OwnLog(name, a, {"log.txt": text().encode()}, options) for name, (a, text, options) in texts.items()]
    binary = [OwnLog("ur binary", "ur-rtde", {"log.bin": _ur_binary()}), OwnLog("c3d", "c3d", {"log.c3d": _c3d()})]
    split = {f"{name}.csv": _signal().encode() for name in ("log_tool_vector", "log_q_actual", "log_tcp_speed")}
    return [*mapped, *written, *binary, OwnLog("ur split", "ur-split", split), *_bags(folder)]


def _wave(row: int, k: float) -> float:
    return 0.5 * math.sin(0.03 * row + k)


def _table(names: list[str], rows: list[list[object]], mark: str = ",", end: str = "\n") -> str:
    return "".join(mark.join(map(str, cells)) + end for cells in [names, *rows])


def _nist_groups(row: int) -> list[list[float]]:
    return [[8.0 + row / 125], *([round(_wave(row, k + j), 6) for j in range(6)] for k in range(12))]


def _nist_rows() -> str:
    return "".join("(" + ", ".join(map(str, _nist_groups(row))) + ")\n" for row in range(ROWS))


def _nist_table() -> str:
    names = ["ROBOT_TIME", *(f"ROBOT_ACTUAL_JOINT_POSITIONS (J{j})" for j in range(1, 7))]
    names += [f"ROBOT_CARTESIAN_COORD_TOOL ({axis})" for axis in "xyz"]
    return _table(names, [[8.0 + row / 125, *(_wave(row, k) for k in range(9))] for row in range(ROWS)])


def _franka() -> str:
    names = ["time", *(f"state.q[{j}]" for j in range(7)), *(f"state.dq[{j}]" for j in range(7))]
    return _table(names, [[row, *(_wave(row, k) for k in range(14))] for row in range(ROWS)])


def _poses() -> str:
    return _table(["x", "y", "z"], [[_wave(row, k) for k in range(3)] for row in range(ROWS)])


def _qualisys() -> str:
    markers = ["WaistL", "WaistR", "box"]
    head = [f"NO_OF_FRAMES\t{ROWS}", "NO_OF_MARKERS\t3", "FREQUENCY\t100", "DATA_INCLUDED\t3D"]
    head += ["\t".join(["MARKER_NAMES", *markers])]
    names = ["Frame", "Time", *(f"{name} {axis}" for name in markers for axis in "XYZ")]
    rows = [[row + 1, f"{row / 100:.5f}", *(f"{1000 * _wave(row, k):.3f}" for k in range(9))] for row in range(ROWS)]
    return "\r\n".join([*head, ""]) + _table(names, rows, "\t", "\r\n")


def _vicon() -> str:
    head = "Trajectories\r\n100\r\n,,S:LASI,,,S:RASI,,\r\nFrame,Sub Frame,X,Y,Z,X,Y,Z\r\n,,mm,mm,mm,mm,mm,mm\r\n"
    rows = [[row + 1, 0, *(f"{1000 * _wave(row, k):.3f}" for k in range(6))] for row in range(ROWS)]
    return head + "".join(",".join(map(str, cells)) + "\r\n" for cells in rows)


def _vicon_objects() -> str:
    axes = ",RX,RY,RZ,TX,TY,TZ" * 2
    head = f"Objects\n100\n,,Global Angle hip:hip,,,,,,Global Angle head:head,,,,,\nFrame,Sub Frame{axes}\n"
    head += "," + ",rad,rad,rad,mm,mm,mm" * 2 + "\n"
    rows = [[row + 1, 0, *(f"{1000 * _wave(row, k):.3f}" for k in range(12))] for row in range(ROWS)]
    return head + "".join(",".join(map(str, cells)) + "\n" for cells in rows)


def _trc() -> str:
    keys = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate"]
    head = ["PathFileType\t4\t(X/Y/Z)\twalk.trc", "\t".join(keys), f"100\t100\t{ROWS}\t2\tm\t100"]
    head += ["Frame#\tTime\tRHip\t\t\tLHip\t\t", "\t\tX1\tY1\tZ1\tX2\tY2\tZ2"]
    rows = [[row, f"{row / 100:.4f}", *(f"{_wave(row, k):.6f}" for k in range(6))] for row in range(ROWS)]
    return "\n".join([*head, *("\t".join(map(str, cells)) for cells in rows), ""])


def _azure_kinect() -> str:
    joints = ["PELVIS", "SPINE_NAVEL", "SPINE_CHEST", "NECK"]
    frames = [
        {
            "timestamp_usec": 33_000 * row,
            "num_bodies": 1,
            "bodies": [{"body_id": 1, "joint_positions": [[100 * _wave(row, k), 250.0 * k, 2000] for k in range(4)]}],
        }
        for row in range(ROWS)
    ]  # fmt: skip
    return json.dumps({"k4abt_sdk_version": "1.1.2", "joint_names": joints, "frames": frames})


def _zed() -> str:
    def body(row: int) -> dict[str, object]:
        return {"id": 3, "keypoint": [[_wave(row, 0), -0.8 + 1.6 * j / 33, -2.0] for j in range(34)]}

    times = [1_700_000_000_000 + 33 * row for row in range(ROWS)]
    return json.dumps(
        {str(ms): {"is_tracked": True, "timestamp": ms * 10**6, "body_list": [body(i)]} for i, ms in enumerate(times)}
    )


def _kinect2() -> str:
    rows = [
        ",".join([str(10_000_000 + 333_333 * row), *(f"{_wave(row, j):.4f},0.1,2.0,2" for j in range(25)), ""])
        for row in range(ROWS)
    ]
    return "\n".join([*rows, ""])


def _nuitrack() -> str:
    names = ["timestamp", "serial", "id", *(f"{j}.{axis}" for j in ("JOINT_WAIST", "JOINT_TORSO") for axis in "xyz")]
    rows: list[list[object]] = [
        [1_715_151_474_879_921 + 33_333 * row, "CAM1", who, *(f"{_wave(row, k + who):.4f}" for k in range(6))]
        for row in range(ROWS // 2)
        for who in (1, 2)
    ]
    return _table(names, rows)


def _pedestrian() -> str:
    rows = [f"{row} {who} {_wave(row, who):.4f} {2.5 * who}\n" for row in range(ROWS // 2) for who in (1, 2)]
    return "# framerate: 25\n" + "".join(rows)


def _mediapipe() -> str:
    names = ["time", *(f"{axis}{i}" for i in range(33) for axis in ("x", "y", "z", "visibility"))]
    return _table(names, [[row, *(["0.5"] * 132)] for row in range(4)])


def _tasks() -> list[list[object]]:
    agents = ("human", "ur5")
    return [[row // 6, agents[row % 2], f"t{row % 4}", row + 0.25, row + 1.75, row % 6 + 0.5] for row in range(ROWS)]


def _task_table() -> str:
    return _table(["run", "agent", "task", "start_s", "end_s", "planned_start"], _tasks())


def _task_json() -> str:
    keys = ("recipe", "agent", "name", "t_start", "t_end", "t_start_planned")
    return json.dumps([dict(zip(keys, row, strict=True)) for row in _tasks()], indent=1)


def _xes() -> str:
    def event(row: int, agent: object, task: object, which: str) -> str:
        told = {"concept:name": task, "org:resource": agent, "lifecycle:transition": which}
        texts = "".join(f'<string key="{key}" value="{value}"/>' for key, value in told.items())
        return f'<event>{texts}<date key="time:timestamp" value="2024-05-01T10:{row:02d}:00Z"/></event>\n'

    rows = "".join(
        event(row, agent, task, "start") + event(row, agent, task, "complete")
        for row, (_, agent, task, *_) in enumerate(_tasks())
    )
    return f'<log><trace><string key="concept:name" value="1"/>\n{rows}</trace></log>\n'


def _safety() -> str:
    names = ["", "Timestamp", "Safe_Ovr", "distance", "Recipe"]
    rows: list[list[object]] = [[row, 1.6e9 + row / 30, row % 101, 2.0 - row / 50, "a"] for row in range(ROWS)]
    return _table(names, rows)


def _scope() -> str:
    head = [["Name", "scope"], ["File", "scope.csv"], ["Starttime of export", 132959733843760000], [], []]
    head += [["Name", "field"], ["SymbolComment", ""], ["Data-Type", "BIT"], ["SampleTime[ms]", 1], ["Port", 851], []]
    rows: list[list[object]] = [[row, row // 7 % 2] for row in range(ROWS)]
    return "".join("\t".join(map(str, cells)) + "\n" for cells in [*head, *rows])


def _trace() -> str:
    head = ["[key]; [value]", "Version; 0x03050000", "Name; Application.Trace", "Flags; 16"]
    samples = [f"; {10 * row}; {'TRUE' if row // 7 % 2 else 'FALSE'}" for row in range(ROWS)]
    return "\n".join([*head, "0.Variable; PLC_PRG.field", "0.Class; 14", "0.Data; ", *samples]) + "\n"


def _trace_xml() -> str:
    values = ",".join("TRUE" if row // 7 % 2 else "FALSE" for row in range(ROWS))
    times = ",".join(str(10 * row) for row in range(ROWS))
    lists = f"<Values>{values}</Values>\n<Timestamps>{times}</Timestamps>"
    unit = '<TraceConfiguration><Single Name="MicroSeconds" Type="bool">False</Single></TraceConfiguration>'
    variable = f'<TraceVariable VarName="PLC_PRG.field">\n{lists}\n</TraceVariable>'
    return f"<Trace>{unit}\n<TraceData><TraceRecord>\n{variable}</TraceRecord></TraceData></Trace>\n"


def _trace_text() -> str:
    head = ["CODESYS V3.5 SP20 Trace: Trace", "C:\\Trace\\Sample.project", "Timestamp(ms) PLC_PRG.field PLC_PRG.step"]
    return "\n".join(
        [*head, *(f"{10 * row} {'TRUE' if row // 7 % 2 else 'FALSE'} {row // 9}" for row in range(ROWS)), ""]
    )


def _signal() -> str:
    rows = [[row * 0.008, *(_wave(row, k) for k in range(6))] for row in range(ROWS)]
    return "".join(", ".join(f"{value:.6f}" for value in cells) + "\n" for cells in rows)


def _ur_binary() -> bytes:
    names = [
        "timestamp",
        *(f"actual_q_{j}" for j in range(6)),
        *(f"actual_TCP_pose_{j}" for j in range(6)),
        "runtime_state",
    ]
    types = [*["DOUBLE"] * 13, "UINT32"]
    body = [struct.pack(">13dI", 152.5 + row / 500, *(_wave(row, k) for k in range(12)), 2) for row in range(ROWS)]
    return f"{' '.join(names)}\n{' '.join(types)}\n".encode() + b"".join(body)


@cache
def _c3d() -> bytes:
    """Return a C3D file of two markers, Intel floats: header, one block of parameters, then the points."""

    def entry(group: int, name: bytes, content: bytes) -> bytes:
        return struct.pack("<bb", len(name), group) + name + struct.pack("<H", len(content) + 2) + content

    def text(values: list[bytes]) -> bytes:
        width = max(map(len, values))
        shape = struct.pack("<bBBB", -1, 2, width, len(values))
        return shape + b"".join(value.ljust(width) for value in values) + b"\0"

    body = entry(-1, b"POINT", b"\0") + entry(1, b"LABELS", text([b"S:LASI", b"S:RASI"]))
    body += entry(1, b"UNITS", text([b"mm"])) + b"\0\0\0\0"
    parameters = (struct.pack("<4B", 1, 0x50, 1, 84) + body).ljust(512, b"\0")
    head = struct.pack("<BB5HfHHf", 2, 0x50, 2, 0, 1, ROWS, 10, -1.0, 3, 0, 100.0).ljust(512, b"\0")
    points = [[1000 * _wave(row, k), 200.0, 900.0, 0.0] for row in range(ROWS) for k in range(2)]
    return head + parameters + np.array(points, "<f4").tobytes()


def _bags(folder: Path) -> list[OwnLog]:
    writer = _bag_writer()
    found = []
    for kind in ("mcap", "db3", "bag"):
        path = folder / ("own.bag" if kind == "bag" else f"own_{kind}")
        bag = writer(path, kind)
        for row in range(ROWS):
            bag.tcp(1.7e9 + row / 125, x=_wave(row, 0))
            bag.joints(1.7e9 + row / 125, ["a", "b"], [_wave(row, 1), _wave(row, 2)])
            bag.number("/speed_scaling_factor", "Float64", 1.7e9 + row / 125, 1.0)
            bag.poses(1.7e9 + row / 125, [(1.0 + _wave(row, 3), 2.0, 3.0)])
        bag.transform(1.7e9, ("base", "tool0", (0.5, 0.0, 0.0)))
        bag.close()
        files = [path] if path.is_file() else sorted(path.iterdir())
        found.append(OwnLog(f"bag {kind}", "rosbag", {file.name: file.read_bytes() for file in files}))
    return found


@cache
def _bag_writer() -> Any:
    """Return the writer that the tests of the adapters use; their folder is no package."""
    place = Path(__file__).parents[1] / "adapters" / "conftest.py"
    spec = importlib.util.spec_from_file_location("bags_written_by_tests", place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.BagWriter
