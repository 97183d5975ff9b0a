"""Azure Kinect body tracking as JSON, written by the offline processor.

The person is the joint PELVIS, else the middle of SPINE_NAVEL and SPINE_CHEST, found by the file's own list of joint
names; `body_id` is the track and changes after a loss. Positions are millimetres in the depth camera's frame (x right,
y down, z forward), given here as metres turned to y up and z towards the camera. The clock is the device's, with an
arbitrary zero. How sure a joint is was not exported: hidden joints look as good as seen ones.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.json_parts import BrokenJson, json_text, number, parts, point
from cyclekit_adapters.source_map import words
from cyclekit_adapters.text_blocks import head_of

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit_adapters.json_parts import Place

_MM = 1e-3
_JOINTS = 32
_OBJECT = re.compile(r"\s*\{")
_ROW = {"t_s": pl.Float64(), "person": pl.String(), "x_m": pl.Float64(), "y_m": pl.Float64(), "z_m": pl.Float64()}
_SET_ASIDE = {"source_row": pl.Int64(), "reason": pl.String()}


@dataclass
class _Dump:
    """What was found in the file; `bodies` wait for the joint names, which may follow the frames."""

    names: list[str] = field(default_factory=list)
    about: dict[str, str] = field(default_factory=dict)
    bodies: list[tuple[float, str, list[object], int]] = field(default_factory=list)
    aside: list[tuple[int, str]] = field(default_factory=list)
    frames: int = 0
    empty: int = 0


class _AzureKinectJson:
    def recognises(self, path: Path) -> bool:
        head = head_of(path)
        if not _OBJECT.match(head):
            return False
        tracked = '"timestamp_usec"' in head and ('"bodies"' in head or '"num_bodies"' in head)
        skeleton = '"PELVIS"' in head and ('"joint_names"' in head or '"bone_list"' in head)
        return '"k4abt_sdk_version"' in head or skeleton or tracked

    def read(self, path: Path, options: ReadOptions) -> Recording:
        words(options, "Azure Kinect", {})
        dump, cut = _dump(path)
        rows, fallback, unplaced = _rows(path, dump)
        table = pl.DataFrame(rows, schema={**_ROW, "source_row": pl.Int64()}, orient="row").sort(
            "t_s", maintain_order=True
        )
        known = table["person"].unique().sort().to_list()
        if options.body is not None and options.body not in known:
            cure = f"In the file: {', '.join(known[:40])}."
            raise LogError(path, f"no body {options.body!r}", nearest=nearest(options.body, known), cure=cure)
        if options.body is not None:
            table = table.filter(pl.col("person") == options.body)
        said = [*cut]
        if not dump.names:
            said.append("the file does not name its joints: the SDK's order is taken, PELVIS first")
        if len(known) > 1 and options.body is None:
            said.append(f"{len(known)} tracks; a body that was lost comes back under another id")
        if fallback:
            said.append(f"{fallback} of {len(rows)} bodies have no PELVIS: the middle of the spine stands for it")
        if unplaced:
            said.append(f"{unplaced} bodies have no usable joint and are left out")
        return Recording(
            people=conform(table, PEOPLE),
            clock="uptime",
            up="y",
            rows_are="frame",
            rows_read=dump.frames,
            set_aside=pl.DataFrame(dump.aside, schema=_SET_ASIDE, orient="row"),
            warnings=tuple(said),
            facts={
                **dump.about,
                "point": "PELVIS",
                "unit": "mm, as the format has it",
                "axes": "depth camera, turned: x right, y up, z towards the camera",
                "frames_without_bodies": str(dump.empty),
            },
        )


def _dump(path: Path) -> tuple[_Dump, list[str]]:
    dump = _Dump()
    try:
        for key, value in parts(json_text(path), inside="frames"):
            if key == "frames":
                _take_frame(dump, value)
                dump.frames += 1
            elif key == "joint_names" and isinstance(value, list):
                dump.names = [str(name) for name in value]
            elif isinstance(value, str):
                dump.about[key] = value[:200]
    except BrokenJson as error:
        dump.aside.append((dump.frames, str(error)))
        return dump, [f"the file is cut or garbled after {dump.frames} frames: {error}"]
    return dump, []


def _take_frame(dump: _Dump, frame: object) -> None:
    row = dump.frames
    if not isinstance(frame, dict) or not isinstance(frame.get("bodies", []), list):
        dump.aside.append((row, "no frame with a list of bodies"))
        return
    micros = number(frame.get("timestamp_usec"))
    if micros is None:
        dump.aside.append((row, "no value in 'timestamp_usec'"))
        return
    bodies = frame.get("bodies", [])
    dump.empty += not bodies
    for body in bodies:
        joints = body.get("joint_positions") if isinstance(body, dict) else None
        if isinstance(joints, list):
            dump.bodies.append((micros / 1e6, str(body.get("body_id", ""))[:80], joints, row))
        else:
            dump.aside.append((row, "a body without joint positions"))


def _rows(path: Path, dump: _Dump) -> tuple[list[tuple[object, ...]], int, int]:
    """Return the rows of PEOPLE, how many stand on the spine, and how many bodies had no usable joint."""
    if not dump.bodies:
        reason = f"; the first reason: {dump.aside[0][1]}" if dump.aside else ""
        cause = f"no body in any of its {dump.frames} frames{reason}"
        raise DamagedLog(path, cause, cure="If nobody was there, leave the file out; else record again.")
    spine = [i for i, name in enumerate(dump.names) if name in ("SPINE_NAVEL", "SPINE_NAVAL", "SPINE_CHEST")]
    if not dump.names and all(len(joints) == _JOINTS for _, _, joints, _ in dump.bodies):
        return _placed(path, dump, [0], [1, 2])  # the order of the SDK; the file was cut before its names
    if "PELVIS" not in dump.names and len(spine) < 2:
        cause = "its joint names hold no PELVIS" if dump.names else "no list 'joint_names' says which joint is which"
        raise DamagedLog(path, cause, cure="Process the recording again with the offline processor.")
    return _placed(path, dump, [dump.names.index("PELVIS")] if "PELVIS" in dump.names else [], spine)


def _placed(path: Path, dump: _Dump, pelvis: list[int], spine: list[int]) -> tuple[list[tuple[object, ...]], int, int]:
    rows: list[tuple[object, ...]] = []
    fallback = 0
    for t_s, person, joints, row in dump.bodies:
        here = _middle(joints, pelvis)
        if here is None:
            here = _middle(joints, spine)
            fallback += here is not None
        if here is not None:
            rows.append((t_s, person, here[0] * _MM, -here[1] * _MM, -here[2] * _MM, row))
    if not rows:
        raise DamagedLog(path, "no body has a usable PELVIS", cure="Check how the file was written or copied.")
    return rows, fallback, len(dump.bodies) - len(rows)


def _middle(joints: list[object], which: list[int]) -> Place | None:
    found = [point(joints[index]) for index in which if index < len(joints)]
    whole = [place for place in found if place is not None]
    if not whole or len(whole) < len(which):
        return None
    x, y, z = (sum(place[axis] for place in whole) / len(whole) for axis in range(3))
    return x, y, z


ADAPTER: Adapter = _AzureKinectJson()
