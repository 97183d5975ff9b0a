"""Azure Kinect body tracking as JSON, written by the offline processor.

The person's position is the joint PELVIS, else the midpoint of SPINE_NAVEL and SPINE_CHEST, found by the file's own
list of joint names. `body_id` is the track and changes after a loss. Positions are in mm in the depth camera's frame (x
right, y down, z forward); they are returned in m with y up and z towards the camera. The clock is the device's, with an
arbitrary zero. The confidence of joints is not exported, so hidden joints look like seen ones. Skeletons, if requested,
hold all joints under the file's names.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog
from cyclekit.schema import PEOPLE, conform
from cyclekit.text.numbers import count
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.text.json_parts import BrokenJson, json_pieces, number, parts, points
from cyclekit_adapters.text.text_blocks import head_of
from cyclekit_adapters.text.text_rows import SET_ASIDE
from cyclekit_adapters.tracking.joints import joint_rows
from cyclekit_adapters.tracking.person_counts import PersonCounts, only

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Points = NDArray[np.float64]

_TURNED_M = np.array([1e-3, -1e-3, -1e-3])
"""Millimetres of the depth camera to metres with y up and z towards the camera."""
_SIDES = ("CLAVICLE", "SHOULDER", "ELBOW", "WRIST", "HAND", "HANDTIP", "THUMB")
_LEGS = ("HIP", "KNEE", "ANKLE", "FOOT")
_SDK = (
    *("PELVIS", "SPINE_NAVEL", "SPINE_CHEST", "NECK"),
    *(f"{part}_{side}" for side in ("LEFT", "RIGHT") for part in _SIDES),
    *(f"{part}_{side}" for side in ("LEFT", "RIGHT") for part in _LEGS),
    *("HEAD", "NOSE", "EYE_LEFT", "EAR_LEFT", "EYE_RIGHT", "EAR_RIGHT"),
)
"""Joints in the order of the SDK."""
MAX_BODIES = 1_000_000
"""Maximum number of bodies, a size: they are held in memory as a whole, about a gigabyte (nine hours of one person)."""
_OBJECT = re.compile(r"\s*\{")


@dataclass
class _Dump:
    """Content of the file; `bodies` (time, id, joints, frame) are stored, because the joint names may follow them."""

    names: list[str] = field(default_factory=list)
    about: dict[str, str] = field(default_factory=dict)
    bodies: list[tuple[float, str, Points, int]] = field(default_factory=list)
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
        names = _names(path, dump)
        table, fallback = _table(path, dump, names)
        seen = PersonCounts()
        seen.add(table)
        seen.require(path, options.body)
        found = [*cut]
        if not dump.names:
            found.append("the file does not name its joints: order of the SDK assumed, PELVIS first")
        if len(seen.rows) > 1 and options.body is None:
            found.append(f"{len(seen.rows)} tracks; a person who is lost and found again gets a new id")
        if fallback:
            found.append(f"{fallback} of {table.height} bodies have no PELVIS: the middle of the spine is used instead")
        if unplaced := len(dump.bodies) - table.height:
            found.append(f"{unplaced} bodies have no usable joint and are left out")
        return Recording(
            people=conform(only(table, options.body), PEOPLE),
            skeletons=_skeletons(dump, names, options.body) if options.skeletons else None,
            clock="uptime",
            up="y",
            rows_are="frame",
            rows_read=dump.frames,
            set_aside=pl.DataFrame(dump.aside, schema=SET_ASIDE, orient="row"),
            warnings=tuple(found),
            facts={
                **dump.about,
                "point": "PELVIS",
                "unit": "mm, defined by the format",
                "axes": "depth camera, turned: x right, y up, z towards the camera",
                "frames_without_bodies": str(dump.empty),
            },
        )


def _dump(path: Path) -> tuple[_Dump, list[str]]:
    dump = _Dump()
    try:
        for key, value in parts(json_pieces(path), inside="frames"):
            if key == "frames":
                _take_frame(dump, value)
                dump.frames += 1
                if len(dump.bodies) > MAX_BODIES:
                    cause = f"more than {count(MAX_BODIES)} bodies, too many for the memory"
                    raise DamagedLog(path, cause, cure="Divide the recording.")
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
        dump.aside.append((row, "no list of bodies in this frame"))
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
            dump.bodies.append((micros / 1e6, str(body.get("body_id", ""))[:80], points(joints), row))
        else:
            dump.aside.append((row, "a body without joint positions"))


def _names(path: Path, dump: _Dump) -> Sequence[str]:
    """Return the joint names from the file or, if it was cut before them, from the SDK."""
    if not dump.bodies:
        reason = f"; the first reason: {dump.aside[0][1]}" if dump.aside else ""
        cause = f"no body in any of its {dump.frames} frames{reason}"
        raise DamagedLog(path, cause, cure="If no person was in view, leave the file out. Otherwise record again.")
    if not dump.names and all(len(joints) == len(_SDK) for _, _, joints, _ in dump.bodies):
        return _SDK
    if "PELVIS" not in dump.names and len(_spine(dump.names)) < 2:
        cause = "no PELVIS among its joint names" if dump.names else "no list 'joint_names' says which joint is which"
        raise DamagedLog(path, cause, cure="Process the recording again with the offline processor.")
    return dump.names


def _spine(names: Sequence[str]) -> list[int]:
    return [i for i, name in enumerate(names) if name in ("SPINE_NAVEL", "SPINE_NAVAL", "SPINE_CHEST")]


def _table(path: Path, dump: _Dump, names: Sequence[str]) -> tuple[pl.DataFrame, int]:
    """Return the rows of PEOPLE in order of time, and the number of them that use the spine."""
    pelvis = [names.index("PELVIS")] if "PELVIS" in names else []
    spine = _spine(names)
    rows, fallback = [], 0
    for t_s, person, joints, row in dump.bodies:
        here = _middle(joints, pelvis)
        if here is None:
            here = _middle(joints, spine)
            fallback += here is not None
        if here is not None:
            rows.append((t_s, person, *(here * _TURNED_M).tolist(), row))
    if not rows:
        raise DamagedLog(path, "no body has a usable PELVIS", cure="Check how the file was written or copied.")
    table = pl.DataFrame(rows, schema={name: column.dtype for name, column in PEOPLE.items()}, orient="row")
    return table.sort("t_s", maintain_order=True), fallback


def _middle(joints: Points, which: Sequence[int]) -> Points | None:
    """Return the centre of these joints; None unless all of them are known."""
    if not which or max(which) >= len(joints):
        return None
    middle: Points = joints[list(which)].mean(axis=0)
    return middle if np.isfinite(middle).all() else None


def _skeletons(dump: _Dump, names: Sequence[str], body: str | None) -> pl.DataFrame:
    bodies = sorted((item for item in dump.bodies if body in (None, item[1])), key=lambda item: item[0])
    places = np.full((len(bodies), len(names), 3), np.nan)
    for place, (_, _, joints, _) in zip(places, bodies, strict=True):
        place[: len(joints)] = joints[: len(names)]
    t_s = pl.Series([item[0] for item in bodies], dtype=pl.Float64())
    person = pl.Series([item[1] for item in bodies], dtype=pl.String())
    row = pl.Series([item[3] for item in bodies], dtype=pl.Int64())
    return joint_rows(t_s, person, [name.lower() for name in names], places * _TURNED_M, row)


ADAPTER: Adapter = _AzureKinectJson()
