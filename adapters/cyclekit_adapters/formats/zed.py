"""Stereolabs ZED body tracking as JSON: 18, 34 or 38 keypoints.

The SDK's exporters write an object keyed by millisecond timestamps; others write an array of frames. The person's
position is the pelvis (keypoint 0 of BODY_34 and BODY_38, the midpoint of keypoints 8 and 11 of BODY_18), else the
SDK's `position`. The file holds neither unit nor axes, so both are inferred from the bodies: people measure 0.25 to 3 m
and are upright. An ambiguous file is refused unless the cell file gives `unit` and `axes`. Time is the host's clock; if
empty frames carry no time, only frames with bodies have one. Ids that change in every frame are ignored, and bodies are
linked by motion. A recording without any body is refused, because it does not show when the scene was empty. Skeletons,
if requested, hold the SDK's keypoints.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.text.json_parts import BrokenJson, json_pieces, parts
from cyclekit_adapters.text.text_blocks import head_of
from cyclekit_adapters.text.text_rows import SET_ASIDE
from cyclekit_adapters.tracking.joints import all_joints, joint_rows
from cyclekit_adapters.tracking.linking import link
from cyclekit_adapters.tracking.person_counts import PersonCounts, only
from cyclekit_adapters.tracking.zed_body import JOINTS, ZedBody, body_of, seconds_of
from cyclekit_adapters.tracking.zed_frame import AXES, UNITS, axes_of, metres_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_KEYED = re.compile(r'\s*\{\s*"\d{1,20}"\s*:\s*\{')
_NOBODY = re.compile(r"[\s\[\],]*")
_EMPTY = re.compile(r"\s*\[[\s\[\],]*\]\s*")
_SDK = ('"body_list"', '"is_tracked"')


@dataclass
class _Dump:
    """Content of the file, frame by frame."""

    bodies: list[ZedBody] = field(default_factory=list)
    aside: list[tuple[int, str]] = field(default_factory=list)
    frames: int = 0
    empty: int = 0


class _ZedJson:
    def recognises(self, path: Path) -> bool:
        head = head_of(path)
        if not head.lstrip("\ufeff \t\r\n").startswith(("[", "{")):
            return False
        if _KEYED.match(head):
            return any(word in head for word in _SDK)
        if _EMPTY.fullmatch(head):
            return True
        begin = _NOBODY.match(head)
        rest = head[begin.end() :] if begin else head
        if not head.lstrip().startswith("[") or (rest and not rest.startswith("{")):
            return False
        return (
            (not rest and head.count("[") > 1)
            or any(word in head for word in _SDK)
            or ('"keypoint"' in head and '"id"' in head)
        )

    def read(self, path: Path, options: ReadOptions) -> Recording:
        chosen = words(options, "ZED", {"unit": tuple(UNITS), "axes": tuple(AXES)})
        dump, cut = _dump(path, skeletons=options.skeletons)
        if not dump.bodies:
            _refuse_without_bodies(path, dump)
        dump.bodies.sort(key=lambda body: (body.t_s, body.row))
        sizes = np.array([body.size for body in dump.bodies if body.size is not None])
        metres, unit_said = metres_of(path, sizes, chosen.get("unit"))
        upward = np.array([body.upward for body in dump.bodies if body.upward is not None]).reshape(-1, 3)
        turn, up, axes_said = axes_of(path, upward, chosen.get("axes"))
        tracks = _tracks(dump.bodies, metres)
        table = _table(tracks, metres * turn)
        seen = PersonCounts()
        seen.add(table)
        seen.require(path, options.body)
        joints = sorted({body.joints for body in dump.bodies})
        return Recording(
            people=conform(only(table, options.body), PEOPLE),
            skeletons=_skeletons(tracks, metres * turn, options.body) if options.skeletons else None,
            clock=dump.bodies[0].clock,
            up=up,
            rows_are="frame",
            rows_read=dump.frames,
            set_aside=pl.DataFrame(dump.aside, schema=SET_ASIDE, orient="row"),
            warnings=(*cut, *_warnings(dump, tracks, seen, options.body)),
            facts={
                "body_format": ", ".join(f"BODY_{count}" for count in joints),
                "point": "middle of both hips, else position" if joints == [18] else "pelvis, else position",
                "unit": unit_said,
                "axes": axes_said,
                "ids": tracks.ids_from,
                "frames_without_bodies": str(dump.empty),
            },
        )


def _dump(path: Path, *, skeletons: bool) -> tuple[_Dump, list[str]]:
    """Parse the document; a truncated one gives the frames before the cut."""
    dump = _Dump()
    try:
        for key, value in parts(json_pieces(path)):
            _take_frame(path, dump, key, value, skeletons=skeletons)
            dump.frames += 1
    except BrokenJson as error:
        if not error.at:
            cause = "no JSON array or object"
            raise DamagedLog(path, cause, cure="Check how the file was written or copied.") from None
        dump.aside.append((dump.frames, str(error)))
        return dump, [f"the file is cut or garbled after {dump.frames} frames: {error}"]
    return dump, []


def _take_frame(path: Path, dump: _Dump, key: str, value: object, *, skeletons: bool) -> None:
    row = dump.frames
    if isinstance(value, dict):
        alone = [value] if "keypoint" in value else []  # a list of bodies without frames
        bodies = value.get("body_list", alone)  # the C++ exporter omits the key in empty frames
        stamp = next((value[name] for name in ("timestamp", "ts") if value.get(name) is not None), key)
        stamp = key if key.isdigit() and not stamp else stamp  # the key holds the time if the writer left it at 0
    else:
        bodies, stamp = value, key
    if not isinstance(bodies, list):
        dump.aside.append((row, "no list of bodies"))
        return
    dump.empty += not bodies
    for body in bodies:
        if not isinstance(body, dict):
            dump.aside.append((row, "a body is not a JSON object"))
            continue
        own = next((body[name] for name in ("ts", "timestamp") if body.get(name) is not None), stamp)
        time = seconds_of(own)
        if time is None:
            dump.aside.append((row, f"a body without time: {str(own)[:40]!r} is not a timestamp"))
        elif (taken := body_of(path, body, time, row, skeletons=skeletons)) is None:
            dump.aside.append((row, "a body without keypoints and position"))
        else:
            dump.bodies.append(taken)


def _refuse_without_bodies(path: Path, dump: _Dump) -> None:
    if dump.aside:
        cause = f"no usable body in {dump.frames} frames; the first reason: {dump.aside[0][1]}"
        raise DamagedLog(path, cause, cure="Check how the file was written or copied.")
    cause = f"no body in any of its {dump.frames} frames, and empty frames have no times"
    raise LogError(path, cure="If no person was in view, leave the file out. Otherwise record again.", cause=cause)


@dataclass(frozen=True)
class _Tracks:
    """Bodies that become rows, the person of each, and the origin of their ids."""

    bodies: list[ZedBody]
    people: list[str]
    ids_from: str
    linked: int = 0


def _tracks(bodies: list[ZedBody], metres: float) -> _Tracks:
    """Assign bodies to persons: by ids that persist, else by motion."""
    if _ids_are_real(bodies):
        kept = [body for body in bodies if body.here is not None or body.hidden]
        return _Tracks(kept, [body.name for body in kept], "of the tracker")
    kept = [body for body in bodies if body.here is not None]
    frames: dict[tuple[float, int], list[tuple[float, float, float]]] = {}
    for body in kept:
        x, y, z = body.here or (0.0, 0.0, 0.0)
        frames.setdefault((body.t_s, body.row), []).append((metres * x, metres * y, metres * z))
    names = [name for frame in link([t_s for t_s, _ in frames], list(frames.values())) for name in frame]
    count = len(set(names))
    how = "one person, since no frame has two" if count == 1 else "linked by motion"
    return _Tracks(kept, names, f"new in every frame; {how}", count if count > 1 else 0)


def _table(tracks: _Tracks, turn: NDArray[np.float64]) -> pl.DataFrame:
    """Return the rows of PEOPLE, null if a body was hidden; `turn` (3, 3) converts to metres and right-handed axes."""
    here = np.array([body.here or (np.nan,) * 3 for body in tracks.bodies]).reshape(-1, 3) @ turn.T
    return conform(
        pl.DataFrame(
            {
                "t_s": pl.Series([body.t_s for body in tracks.bodies], dtype=pl.Float64()),
                "person": pl.Series(tracks.people, dtype=pl.String()),
                **{
                    f"{axis}_m": pl.Series(here[:, i], dtype=pl.Float64()).fill_nan(None)
                    for i, axis in enumerate("xyz")
                },
                "source_row": pl.Series([body.row for body in tracks.bodies], dtype=pl.Int64()),
            }
        ),
        PEOPLE,
    )


def _skeletons(tracks: _Tracks, turn: NDArray[np.float64], body: str | None) -> pl.DataFrame:
    """Return the rows of SKELETONS; the number of keypoints may change within a file."""
    tables = []
    pairs = zip(tracks.bodies, tracks.people, strict=True)
    mine = [(item, who) for item, who in pairs if item.keypoints is not None and body in (None, who)]
    for count, names in JOINTS.items():
        same = [(item, who) for item, who in mine if item.joints == count]
        points = np.array([item.keypoints for item, _ in same]).reshape(-1, count, 3) @ turn.T
        t_s = pl.Series([item.t_s for item, _ in same], dtype=pl.Float64())
        row = pl.Series([item.row for item, _ in same], dtype=pl.Int64())
        tables.append(joint_rows(t_s, pl.Series([who for _, who in same], dtype=pl.String()), names, points, row))
    return all_joints(tables)


def _ids_are_real(bodies: list[ZedBody]) -> bool:
    """Return whether ids persist: seen in two frames on average, and never twice in one."""
    ids = {body.name for body in bodies}
    once = len({(body.t_s, body.row, body.name) for body in bodies}) == len(bodies)
    return once and "" not in ids and (len(bodies) == 1 or len(bodies) >= 2 * len(ids))


def _warnings(dump: _Dump, tracks: _Tracks, seen: PersonCounts, body: str | None) -> list[str]:
    found = []
    if unplaced := len(dump.bodies) - len(tracks.bodies):
        found.append(f"{unplaced} bodies have neither pelvis nor position and are left out")
    if resting := sum(item.resting for item in dump.bodies):
        found.append(f"{resting} bodies are in the SDK's rest pose, not yet fitted: their `position` is used instead")
    if hidden := sum(item.hidden for item in tracks.bodies):
        found.append(f"{hidden} bodies are searched for, not seen: their positions are unknown")
    if len({item.clock for item in dump.bodies}) > 1:
        found.append("some timestamps count from 1970 and some do not")
    if len({item.joints for item in dump.bodies}) > 1:
        found.append("the number of keypoints changes within the file")
    if tracks.linked:
        found.append(f"ids are new in every frame: bodies are linked by motion into {tracks.linked} tracks")
    if body is None and len(seen.rows) > 1:
        found.append(f"{len(seen.rows)} tracks; name the operator's with `body` if it is always the same")
    return found


ADAPTER: Adapter = _ZedJson()
