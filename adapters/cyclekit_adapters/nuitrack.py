"""Nuitrack CSV recorder: skeletons of a depth camera.

The person is JOINT_WAIST, row by row else JOINT_TORSO. Metres, y up, z away from the camera; to which side x points
is not documented, so check it when the tracker's place in the cell is measured. `timestamp` is microseconds since 1970
(smaller numbers: since the device started); `id` is the track, and with several cameras `serial/id`, each in its own
camera's frame. The recorder repeats rows: the same time, camera and id counts once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import LogError, MissingColumns, nearest
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.delimited import Layout, Rows, delimiter_of, header_names, read_rows
from cyclekit_adapters.source_map import words
from cyclekit_adapters.text_blocks import file_encoding, head_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_HEADER_BYTES = 1 << 20
_POINTS = ("JOINT_WAIST", "JOINT_TORSO")
_EPOCH_US = (9.4e14, 4.1e15)
_MICRO = 1e-6


class _NuitrackCsv:
    def recognises(self, path: Path) -> bool:
        line = head_of(path).partition("\n")[0]
        return "timestamp" in line and any(f"{point}.x" in line for point in _POINTS)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        words(options, "Nuitrack", {})
        line = head_of(path, _HEADER_BYTES).partition("\n")[0]
        names = header_names(line, delimiter_of(line, ",;\t"))
        if missing := {"timestamp", "id"}.difference(names):
            raise MissingColumns(path, missing, names, "Record again with Nuitrack's CSV recorder.")
        points = [point for point in _POINTS if all(f"{point}.{axis}" in names for axis in "xyz")]
        if not points:
            raise MissingColumns(path, [f"{_POINTS[0]}.{axis}" for axis in "xyz"], names, "Record the waist.")
        layout = Layout(names, delimiter_of(line, ",;\t"), 1, encoding=file_encoding(path) or "utf-8", quotes=True)
        cells = [f"{point}.{axis}" for point in points for axis in "xyz"]
        texts = [name for name in ("serial", "id") if name in names]
        rows = read_rows(path, layout, numbers=["timestamp", *cells], texts=texts, required=["timestamp", "id"])
        rows = _once(rows.or_refuse(path), texts)
        table, said = _people(path, rows.frame, points, options.body)
        middle = float(str(rows.frame["timestamp"].median()))
        epoch = _EPOCH_US[0] <= middle <= _EPOCH_US[1]
        return Recording(
            people=conform(table, PEOPLE),
            clock="epoch" if epoch else "uptime",
            up="y",
            rows_are="line",
            rows_read=rows.rows_read,
            set_aside=rows.set_aside,
            warnings=tuple(said),
            facts={
                "point": ", else ".join(points),
                "unit": "m, as the recorder has it",
                "axes": "camera: y up, z away from it; the side x points to is not documented",
                "time": "microseconds since 1970" if epoch else "microseconds since the device started",
            },
        )


def _once(rows: Rows, texts: Sequence[str]) -> Rows:
    """Set aside the rows that the recorder wrote again."""
    again = ~rows.frame.select(pl.struct("timestamp", *texts).is_first_distinct()).to_series()
    reason = pl.lit("repeats the time and id of a row before it").alias("reason")
    aside = pl.concat([rows.set_aside, rows.frame.filter(again).select("source_row", reason)]).sort("source_row")
    return Rows(rows.frame.filter(~again), rows.rows_read, aside)


def _people(path: Path, frame: pl.DataFrame, points: list[str], body: str | None) -> tuple[pl.DataFrame, list[str]]:
    said = []
    cameras = frame["serial"].n_unique() if "serial" in frame.columns else 1
    person = pl.concat_str("serial", "id", separator="/", ignore_nulls=True) if cameras > 1 else pl.col("id")
    whole = [pl.all_horizontal(pl.col(f"{point}.{axis}").is_not_null() for axis in "xyz") for point in points]
    places = {
        f"{axis}_m": pl.coalesce(
            pl.when(seen).then(pl.col(f"{point}.{axis}")) for seen, point in zip(whole, points, strict=True)
        )
        for axis in "xyz"
    }
    table = frame.select((pl.col("timestamp") * _MICRO).alias("t_s"), person.alias("person"), "source_row", **places)
    known = table["person"].unique().sort().to_list()
    if body is not None and body not in known:
        cure = f"In the file: {', '.join(known[:40])}."
        raise LogError(path, f"no body {body!r}", nearest=nearest(body, known), cure=cure)
    if cameras > 1:
        said.append(f"{cameras} cameras, each in its own frame: name one body with `body`, or split the file")
    if body is None and len(known) > 1:
        said.append(f"{len(known)} tracks; a person who was lost comes back under another id")
    if body is not None:
        table = table.filter(pl.col("person") == body)
    if hidden := table["x_m"].null_count():
        said.append(f"no place in {hidden} of {table.height} rows")
    return table.sort("t_s", maintain_order=True), said


ADAPTER: Adapter = _NuitrackCsv()
