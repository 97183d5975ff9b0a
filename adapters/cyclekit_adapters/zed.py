"""Stereolabs ZED body tracking as JSON: 18, 34 or 38 keypoints.

The SDK's own exporters write an object keyed by millisecond timestamps; others write an array of frames. The person is
the pelvis (keypoint 0 of BODY_34 and BODY_38, the middle of keypoints 8 and 11 of BODY_18), else the SDK's `position`.
Neither unit nor axes are in the file, so both are taken from the bodies themselves: people are 0.25 to 3 m from end to
end, and stand upright. What cannot be decided so is refused; `unit` and `axes` in the cell file decide it. Time is the
host's clock, of frames with bodies only where empty frames carry none. Ids that live one frame are no ids: those
bodies are linked by motion. A recording without any body is refused, since nothing in it says when nobody was there.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.json_parts import BrokenJson, json_text, number, parts, point
from cyclekit_adapters.linking import link
from cyclekit_adapters.source_map import words
from cyclekit_adapters.text_blocks import head_of
from cyclekit_adapters.zed_frame import AXES, UNITS, axes_of, metres_of

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.adapter import ClockKind
    from cyclekit_adapters.json_parts import Place

_KEYED = re.compile(r'\s*\{\s*"\d{1,20}"\s*:\s*\{')
_NOBODY = re.compile(r"[\s\[\],]*")
_EMPTY = re.compile(r"\s*(\[[\s\[\],]*\]|\{\s*\})\s*")
_SDK = ('"body_list"', '"is_tracked"')
_PELVIS = {18: (8, 11), 34: (0,), 38: (0,)}
_NECK = {18: 1, 34: 3, 38: 4}
_SPAN_S = (9.4e8, 4.1e9)
"""Seconds since 1970 that a log can hold: the years 2000 to 2099."""


@dataclass(frozen=True)
class _Body:
    """One body of one frame, in the file's unit and axes."""

    t_s: float
    clock: ClockKind
    row: int
    name: str
    here: Place | None
    size: float | None
    upward: Place | None
    joints: int


@dataclass
class _Dump:
    """What was found in the file, frame by frame."""

    bodies: list[_Body] = field(default_factory=list)
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
        return not rest or any(word in head for word in _SDK) or ('"keypoint"' in head and '"id"' in head)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        chosen = words(options, "ZED", {"unit": tuple(UNITS), "axes": tuple(AXES)})
        dump, cut = _dump(path)
        if not dump.bodies:
            _refuse_without_bodies(path, dump)
        dump.bodies.sort(key=lambda body: (body.t_s, body.row))
        sizes = np.array([body.size for body in dump.bodies if body.size is not None])
        metres, unit_said = metres_of(path, sizes, chosen.get("unit"))
        upward = np.array([body.upward for body in dump.bodies if body.upward is not None]).reshape(-1, 3)
        turn, up, axes_said = axes_of(path, upward, chosen.get("axes"))
        table, people_said = _people(path, dump.bodies, metres, options.body)
        place = table.select("x_m", "y_m", "z_m").to_numpy() @ turn.T
        table = table.with_columns(pl.Series(f"{axis}_m", place[:, i]).fill_nan(None) for i, axis in enumerate("xyz"))
        joints = sorted({body.joints for body in dump.bodies})
        return Recording(
            people=conform(table, PEOPLE),
            clock=dump.bodies[0].clock,
            up=up,
            rows_are="frame",
            rows_read=dump.frames,
            set_aside=pl.DataFrame(dump.aside, schema=_SET_ASIDE, orient="row"),
            warnings=(*cut, *_warnings(dump, table), *people_said[1:]),
            facts={
                "body_format": ", ".join(f"BODY_{count}" for count in joints),
                "point": "middle of both hips, else position" if joints == [18] else "pelvis, else position",
                "unit": unit_said,
                "axes": axes_said,
                "ids": people_said[0],
                "frames_without_bodies": str(dump.empty),
            },
        )


_SET_ASIDE = {"source_row": pl.Int64(), "reason": pl.String()}


def _dump(path: Path) -> tuple[_Dump, list[str]]:
    """Take the document apart; a cut one gives the frames before the cut."""
    text = json_text(path)
    if (first := text.lstrip()[:1]) not in ("[", "{") or not first:
        raise DamagedLog(path, "no JSON array or object", cure="Check how the file was written or copied.")
    dump = _Dump()
    try:
        for key, value in parts(text):
            _take_frame(path, dump, key, value)
            dump.frames += 1
    except BrokenJson as error:
        dump.aside.append((dump.frames, str(error)))
        return dump, [f"the file is cut or garbled after {dump.frames} frames: {error}"]
    return dump, []


def _take_frame(path: Path, dump: _Dump, key: str, value: object) -> None:
    row = dump.frames
    if isinstance(value, dict):
        alone = [value] if "keypoint" in value else []  # a list of bodies without frames
        bodies = value.get("body_list", alone)  # the C++ exporter leaves the key out where nobody is
        stamp = next((value[name] for name in ("timestamp", "ts") if value.get(name) is not None), key)
    else:
        bodies, stamp = value, key
    if not isinstance(bodies, list):
        dump.aside.append((row, "no list of bodies"))
        return
    dump.empty += not bodies
    for body in bodies:
        if not isinstance(body, dict):
            dump.aside.append((row, "a body is no JSON object"))
            continue
        own = next((body[name] for name in ("ts", "timestamp") if body.get(name) is not None), stamp)
        time = _seconds(own)
        if time is None:
            dump.aside.append((row, f"a body without time: {str(own)[:40]!r} is no timestamp"))
        elif (taken := _body(path, body, time, row)) is None:
            dump.aside.append((row, "a body without keypoints and position"))
        else:
            dump.bodies.append(taken)


def _seconds(stamp: object) -> tuple[float, ClockKind] | None:
    """Return a timestamp in seconds: since 1970 if it is that in s, ms, us or ns, else taken as the SDK's ns."""
    if isinstance(stamp, str):
        if len(stamp) > 20 or not stamp.strip().isascii() or not stamp.strip().isdigit():
            return None
        stamp = int(stamp)
    value = number(stamp)
    if value is None or not 0.0 <= value < 1e19:
        return None
    for scale in (1, 10**3, 10**6, 10**9):
        if _SPAN_S[0] <= value / scale <= _SPAN_S[1]:
            return (stamp if isinstance(stamp, int) else value) / scale, "epoch"
    return value / 10**9, "uptime"


def _body(path: Path, body: dict[str, object], time: tuple[float, ClockKind], row: int) -> _Body | None:
    raw = body.get("keypoint")
    keypoints = [_seen(item) for item in raw] if isinstance(raw, list) else []
    if keypoints and len(keypoints) not in _PELVIS:
        cause = f"a body of {len(keypoints)} keypoints: ZED writes 18, 34 or 38"
        raise DamagedLog(path, cause, cure='Map the table with adapter = "csv" if this is another skeleton.')
    position = _seen(body.get("position"))
    if not keypoints and position is None:
        return None
    hips = [keypoints[index] for index in _PELVIS.get(len(keypoints), ())]
    whole = [hip for hip in hips if hip is not None]
    pelvis = _mean(whole) if whole and len(whole) == len(hips) else None
    neck = keypoints[_NECK[len(keypoints)]] if keypoints else None
    upward = (neck[0] - pelvis[0], neck[1] - pelvis[1], neck[2] - pelvis[2]) if neck and pelvis else None
    seen = np.array([item for item in keypoints if item is not None])
    size = float((seen.max(axis=0) - seen.min(axis=0)).max()) if len(seen) >= _ENOUGH else None
    name = str(body.get("id", ""))[:80]
    return _Body(*time, row, name, pelvis or position, size, upward, len(keypoints))


_ENOUGH = 5  # keypoints that show how large a body is


def _seen(value: object) -> Place | None:
    place = point(value)
    return None if place == (0.0, 0.0, 0.0) else place  # senders without NaN write zeros


def _mean(places: list[Place]) -> Place:
    x, y, z = (sum(place[axis] for place in places) / len(places) for axis in range(3))
    return x, y, z


def _refuse_without_bodies(path: Path, dump: _Dump) -> None:
    if dump.aside:
        cause = f"no usable body in {dump.frames} frames; the first reason: {dump.aside[0][1]}"
        raise DamagedLog(path, cause, cure="Check how the file was written or copied.")
    cause = f"an empty recording: {dump.frames} frames and no body in any; empty frames do not say when they were"
    raise LogError(path, cure="If nobody was there, leave the file out; else record again.", cause=cause)


def _people(path: Path, bodies: list[_Body], metres: float, body: str | None) -> tuple[pl.DataFrame, list[str]]:
    """Return one row per body, still in the file's axes, and what the ids are; warnings follow."""
    kept = [item for item in bodies if item.here is not None]
    frames: dict[tuple[float, int], list[int]] = {}
    for index, item in enumerate(kept):
        frames.setdefault((item.t_s, item.row), []).append(index)
    here = [(metres * x, metres * y, metres * z) for x, y, z in (item.here for item in kept if item.here)]
    rows = [(item.t_s, item.name, *place, item.row) for item, place in zip(kept, here, strict=True)]
    table = pl.DataFrame(rows, schema=_ROW, orient="row")
    said = ["of the tracker"]
    if _ids_are_real(kept):
        known = table["person"].unique().sort().to_list()
    else:
        places = [[here[i] for i in frame] for frame in frames.values()]
        linked = link([t_s for t_s, _ in frames], places)
        table = table.with_columns(pl.Series("person", [name for frame in linked for name in frame], dtype=pl.String()))
        known = table["person"].unique().sort().to_list()
        one = "one person, since no frame has two" if len(known) == 1 else "linked by motion"
        said = [f"new in every frame; {one}"]
        if len(known) > 1:
            said.append(f"ids are new in every frame: bodies are linked by motion into {len(known)} tracks")
    if body is not None:
        table = table.filter(pl.col("person") == body)
        if table.is_empty():
            cure = f"In the file: {', '.join(known[:40])}."
            raise LogError(path, f"no body {body!r}", nearest=nearest(body, known), cure=cure)
    elif len(known) > 1:
        said.append(f"{len(known)} tracks; `body` names the operator's, if it is always the same")
    return table, said


_ROW = {
    "t_s": pl.Float64(),
    "person": pl.String(),
    "x_m": pl.Float64(),
    "y_m": pl.Float64(),
    "z_m": pl.Float64(),
    "source_row": pl.Int64(),
}


def _ids_are_real(bodies: list[_Body]) -> bool:
    """Tell whether an id means the same body later: seen in two frames on average, and never twice in one."""
    ids = {body.name for body in bodies}
    once = len({(body.t_s, body.row, body.name) for body in bodies}) == len(bodies)
    return once and "" not in ids and (len(bodies) == 1 or len(bodies) >= 2 * len(ids))


def _warnings(dump: _Dump, table: pl.DataFrame) -> list[str]:
    said = []
    if unplaced := len(dump.bodies) - table.height:
        said.append(f"{unplaced} bodies have neither pelvis nor position, or are not the one named, and are left out")
    if len({body.clock for body in dump.bodies}) > 1:
        said.append("some timestamps are since 1970 and some are not")
    if len({body.joints for body in dump.bodies}) > 1:
        said.append("the number of keypoints changes within the file")
    return said


ADAPTER: Adapter = _ZedJson()
