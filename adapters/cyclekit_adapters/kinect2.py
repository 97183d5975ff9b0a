"""Kinect v2 skeletons as headerless CSV: 100 ns ticks, then 25 joints of x, y, z and tracking state.

The person is joint 0, the base of the spine. Metres in the camera's frame: x to the sensor's left, y up (as the sensor
is tilted), z away from it, which is right-handed. State 0 is "not tracked" and means unknown, 1 is inferred by the
sensor and used, 2 is tracked. The clock is the sensor's; bodies that share a time are linked by motion, for the file
has no ids.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError, nearest
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.delimited import Layout, delimiter_of, fields_of, read_rows
from cyclekit_adapters.linking import link
from cyclekit_adapters.source_map import words
from cyclekit_adapters.text_blocks import file_encoding, head_of

if TYPE_CHECKING:
    from pathlib import Path

_JOINTS = 25
_FIELDS = 1 + 4 * _JOINTS
_TICK_S = 1e-7
_NAMES = ("ticks", *(f"{part}{joint}" for joint in range(_JOINTS) for part in ("x", "y", "z", "state")))


class _Kinect2Csv:
    def recognises(self, path: Path) -> bool:
        head = head_of(path)
        lines = [line for line in head.splitlines() if line.strip()]
        return bool(lines) and _is_row(lines[0])

    def read(self, path: Path, options: ReadOptions) -> Recording:
        words(options, "Kinect v2", {})
        head = head_of(path)
        first = next((line for line in head.splitlines() if line.strip()), "")
        if not any(_is_row(line) for line in head.splitlines()[:20]):
            cause = "none of its first rows is ticks and 25 joints of x, y, z and state"
            raise DamagedLog(path, cause, cure="Check how the file was written or copied.")
        layout = Layout(_NAMES, delimiter_of(first, ",;\t"), 0, encoding=file_encoding(path) or "utf-8")
        used = ["ticks", "x0", "y0", "z0", "state0"]
        rows = read_rows(path, layout, numbers=used, required=["ticks"]).or_refuse(path)
        frame = rows.frame.with_columns(t_s=pl.col("ticks") * _TICK_S).sort("t_s", maintain_order=True)
        inferred = int((frame["state0"] == 1).sum())
        seen = pl.col("state0").is_in([1.0, 2.0]) & pl.all_horizontal(pl.col("x0", "y0", "z0").is_not_null())
        table = frame.select(
            "t_s",
            *(pl.when(seen).then(pl.col(f"{axis}0")).alias(f"{axis}_m") for axis in "xyz"),
            "source_row",
        )
        table, said = _with_people(path, table, options.body)
        if inferred:
            said.append(f"the base of the spine is inferred, not seen, in {inferred} of {frame.height} rows")
        if hidden := table["x_m"].null_count():
            said.append(f"the base of the spine is not tracked in {hidden} of {table.height} rows")
        if not frame["source_row"].is_sorted():
            said.append("time does not increase throughout: the rows were sorted")
        return Recording(
            people=conform(table, PEOPLE),
            clock="uptime",
            up="y",
            rows_are="line",
            rows_read=rows.rows_read,
            set_aside=rows.set_aside,
            warnings=tuple(said),
            facts={
                "point": "joint 0, base of the spine",
                "unit": "m, as the SDK has it",
                "axes": "camera: x to the sensor's left, y up, z away from the sensor; right-handed",
            },
        )


def _is_row(line: str) -> bool:
    """Tell whether a line is ticks and 25 joints whose fourth number is a tracking state."""
    cells = [cell.strip() for cell in fields_of(line, delimiter_of(line, ",;\t"))]
    if len(cells) == _FIELDS + 1 and not cells[-1]:
        cells.pop()
    if len(cells) != _FIELDS or not cells[0].isascii() or not cells[0].isdigit():
        return False
    if not {_state(cell) for cell in cells[4::4]} <= {0.0, 1.0, 2.0}:
        return False
    return all(_state(cell) is not None for cell in cells)


def _state(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _with_people(path: Path, table: pl.DataFrame, body: str | None) -> tuple[pl.DataFrame, list[str]]:
    """Return the table with its column `person`: rows of equal time are different bodies."""
    said: list[str] = []
    if table["t_s"].n_unique() == table.height:
        table = table.with_columns(pl.lit("1").alias("person"))
    else:
        table = table.filter(pl.col("x_m").is_not_null())
        if table.is_empty():
            raise DamagedLog(path, "no row shows the base of the spine", cure="Check how the file was written.")
        frames = table.group_by("t_s", maintain_order=True).agg(pl.concat_list("x_m", "y_m", "z_m").alias("places"))
        places = [[(x, y, z) for x, y, z in frame] for frame in frames["places"].to_list()]
        names = [name for frame in link(frames["t_s"].to_list(), places) for name in frame]
        table = table.with_columns(pl.Series("person", names, dtype=pl.String()))
        said.append("several bodies share a time and carry no id: they are linked by motion")
    known = table["person"].unique().sort().to_list()
    if body is not None and body not in known:
        raise LogError(
            path, f"no body {body!r}", nearest=nearest(body, known), cure=f"In the file: {', '.join(known)}."
        )
    return (table.filter(pl.col("person") == body) if body is not None else table), said


ADAPTER: Adapter = _Kinect2Csv()
