"""Nuitrack CSV recorder: skeletons of a depth camera.

The person's position is JOINT_WAIST, or JOINT_TORSO in rows without it. Positions are in m, y up, z away from the
camera; the direction of x is not documented, so check it when measuring the tracker's pose in the cell. `timestamp` is
in microseconds since 1970 (smaller numbers: since device start). `id` is the track; with several cameras it is
`serial/id`, each in the frame of its camera. The recorder repeats rows: a row with the same time, camera and id as the
one before counts once. A joint at exactly 0, 0, 0, the camera's position, was not seen. Skeletons, if requested, hold
all JOINT_*, without that prefix: `waist`, `left_hand`, ...
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import MissingColumns
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.text.delimited import TextLayout, TextRows, fields_of, read_blocks
from cyclekit_adapters.text.header_line import layout_below
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import head_of
from cyclekit_adapters.tracking.joints import joint_rows, points_of
from cyclekit_adapters.tracking.person_counts import PersonCounts, only

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_DELIMITERS = ",;\t"
_POINTS = ("JOINT_WAIST", "JOINT_TORSO")
_JOINT = "JOINT_"
_EPOCH_US = (9.4e14, 4.1e15)
_MICRO = 1e-6
_REPEATED = "repeats the time and id of a row before it"
_TRACK = "\x1ftrack"  # a name that no column of a file has


class _NuitrackCsv:
    def recognises(self, path: Path) -> bool:
        line = head_of(path).partition("\n")[0]
        return "timestamp" in line and any(f"{point}.x" in line for point in _POINTS)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        words(options, "Nuitrack", {})
        layout = replace(layout_below(path, _DELIMITERS), quotes=True)
        points = _points(path, layout)
        joints = _joints(layout.names) if options.skeletons else points
        tracks, seen = _Tracks(*_first_rows(path, layout)), PersonCounts()

        def make(rows: TextRows) -> Recording:
            rows = tracks.once(rows)
            people = _people(rows.frame, points)
            seen.add(people)
            seen.clock(people["t_s"], repeats=True)
            return Recording(
                people=conform(only(people, options.body), PEOPLE),
                skeletons=_skeletons(rows.frame, joints, options.body) if options.skeletons else None,
                clock="epoch" if tracks.epoch else "uptime",
                up="y",
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            seen.require(path, options.body)
            facts = {
                "point": ", else ".join(points),
                "unit": "m, defined by the recorder",
                "axes": "camera: y up, z away from it; the direction of x is not documented",
                "time": "microseconds since 1970" if tracks.epoch else "microseconds since the device started",
            }
            return replace(last, warnings=tuple(_warnings(tracks, seen, options.body)), facts=facts)

        cells = [f"{point}.{axis}" for point in joints for axis in "xyz"]
        texts = [name for name in ("serial", "id") if name in layout.names]
        blocks = read_blocks(path, layout, numbers=["timestamp", *cells], texts=texts, required=["timestamp", "id"])
        yield from in_parts(path, blocks, make, finish)


def _points(path: Path, layout: TextLayout) -> list[str]:
    """Return the joints usable as the person's position, best first."""
    names = layout.names
    if missing := {"timestamp", "id"}.difference(names):
        raise MissingColumns(path, missing, names, "Record again with Nuitrack's CSV recorder.")
    points = [point for point in _POINTS if all(f"{point}.{axis}" in names for axis in "xyz")]
    if not points:
        raise MissingColumns(path, [f"{_POINTS[0]}.{axis}" for axis in "xyz"], names, "Record the waist.")
    return points


def _joints(names: tuple[str, ...]) -> list[str]:
    stems = dict.fromkeys(name.rpartition(".")[0] for name in names if name.startswith(_JOINT))
    return [stem for stem in stems if all(f"{stem}.{axis}" in names for axis in "xyz")]


def _first_rows(path: Path, layout: TextLayout) -> tuple[bool, frozenset[str]]:
    """Return whether the first rows count from 1970, and their cameras; both apply to the whole log."""
    times, cameras = [], set()
    for line in head_of(path).split("\n")[1:-1]:
        row = dict(zip(layout.names, fields_of(line, layout.delimiter), strict=False))
        try:
            times.append(float(row.get("timestamp", "")))
        except ValueError:
            continue
        cameras.add(row.get("serial", "").strip())
    middle = sorted(times)[len(times) // 2] if times else 0.0
    return _EPOCH_US[0] <= middle <= _EPOCH_US[1], frozenset(cameras)


@dataclass
class _Tracks:
    """Assigns rows to persons and finds repeated rows, block after block.

    Attributes:
        epoch: Times count from 1970.
        first: Cameras in the first rows; if there is only one, its bodies are named by `id` alone.
        cameras: Cameras so far.
    """

    epoch: bool
    first: frozenset[str]
    cameras: set[str] = field(default_factory=set)
    _last: dict[str, float] = field(default_factory=dict)

    def once(self, rows: TextRows) -> TextRows:
        """Return the rows with `person`; repeated rows are set aside."""
        frame = rows.frame
        serial = frame["serial"].fill_null("") if "serial" in frame.columns else pl.Series([""] * frame.height)
        self.cameras |= set(serial.unique().to_list())
        track = pl.concat_str(serial.alias("serial"), "id", separator="/")
        alone = (
            serial.is_in(list(self.first))
            if len(self.first) == 1
            else pl.repeat(value=False, n=len(serial), eager=True)
        )
        frame = frame.with_columns(track.alias(_TRACK)).with_columns(
            person=pl.when(alone).then(pl.col("id")).otherwise(pl.col(_TRACK).str.strip_chars_start("/"))
        )
        before = pl.col("timestamp").shift(1).over(_TRACK)
        carried = pl.col(_TRACK).replace_strict(self._last, default=None, return_dtype=pl.Float64)
        again = frame.select((pl.col("timestamp") == before.fill_null(carried)).fill_null(value=False)).to_series()
        self._last |= dict(frame.group_by(_TRACK).agg(pl.col("timestamp").last()).iter_rows())
        return replace(rows, frame=frame).without(again, _REPEATED)


def _people(frame: pl.DataFrame, points: list[str]) -> pl.DataFrame:
    at = [[pl.col(f"{point}.{axis}") for axis in "xyz"] for point in points]
    known = [pl.all_horizontal(axis.is_not_null() for axis in axes) for axes in at]
    whole = [seen & pl.any_horizontal(axis != 0.0 for axis in axes) for seen, axes in zip(known, at, strict=True)]
    places = {
        f"{axis}_m": pl.coalesce(
            pl.when(seen).then(pl.col(f"{point}.{axis}")) for seen, point in zip(whole, points, strict=True)
        )
        for axis in "xyz"
    }
    return frame.select((pl.col("timestamp") * _MICRO).alias("t_s"), "person", "source_row", **places)


def _skeletons(frame: pl.DataFrame, joints: list[str], body: str | None) -> pl.DataFrame:
    frame = only(frame, body)
    points = points_of(frame, [f"{joint}.{axis}" for joint in joints for axis in "xyz"])
    points[(points == 0.0).all(axis=2)] = np.nan
    names = [joint.removeprefix(_JOINT).lower() for joint in joints]
    return joint_rows(frame["timestamp"] * _MICRO, frame["person"], names, points, frame["source_row"])


def _warnings(tracks: _Tracks, seen: PersonCounts, body: str | None) -> list[str]:
    messages = []
    if len(tracks.cameras) > 1:
        count = len(tracks.cameras)
        messages.append(f"{count} cameras, each in its own frame: name one body with `body`, or split the file")
    if body is None and len(seen.rows) > 1:
        messages.append(f"{len(seen.rows)} tracks; a person who is lost and found again gets a new id")
    people = seen.rows if body is None else {body: seen.rows.get(body, 0)}
    if hidden := sum(seen.unseen.get(person, 0) for person in people):
        messages.append(f"no position in {hidden} of {sum(people.values())} rows")
    if seen.back:
        messages.append(f"time steps back {seen.back} time(s)")
    return messages


ADAPTER: StreamingAdapter = _NuitrackCsv()
