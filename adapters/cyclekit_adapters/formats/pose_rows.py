"""Robot poses without a clock: CSV of `x, y, z` or of libfranka's `O_T_EE`, one row per sample.

Scripts around libfranka often write only the pose: a position in m, possibly with an orientation, or the 16 numbers of
the matrix `O_T_EE` (column by column, so the position is in numbers 12, 13 and 14), possibly with the joint angles `q`.
The file does not give its sampling rate, which is never guessed: `rate_hz` is required. A table with a time column has
to be mapped with the adapter `csv`.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import ConfigError, DamagedLog, MissingColumns, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit.text.numbers import compact, given
from cyclekit_adapters.text.delimited import INDEX, TextRows, read_blocks
from cyclekit_adapters.text.header_line import column_names, layout_below
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import head_of
from cyclekit_adapters.tracking.landmark_tables import landmarks_in

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_WHERE = "[sources.map] of a table of poses"
_METRES = {"m": 1.0, "mm": 1e-3}
_ORIENTATIONS = ({"qx", "qy", "qz", "qw"}, {"rx", "ry", "rz"}, {"roll", "pitch", "yaw"})
_ELEMENT = re.compile(r"(?:state\.)?(O_T_EE|q|dq)(?:\[(\d{1,4})\]|_(\d{1,4}))")
_MATRIX, _PLACE, _BELOW, _JOINTS = 16, (12, 13, 14), (3, 7, 11), 7  # the row below the rotation is zero


class _PoseCsv:
    def recognises(self, path: Path) -> bool:
        return bool(_columns(column_names(path))) and not landmarks_in(head_of(path))

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        metres = _metres(options)
        layout = layout_below(path)
        columns = _columns(layout.names)
        if not columns:
            cure = 'The format holds only poses, as x, y, z or O_T_EE; map any other table with adapter = "csv".'
            raise DamagedLog(path, "not a table of poses without times", cure=cure)
        rate_hz = options.rate_hz
        if rate_hz is None:
            cure = "The rows have no times: give the rate at which they were logged in cell.toml: rate_hz = ..."
            raise MissingColumns(path, ["time"], layout.names, cure)
        below = _below(layout.names)
        places = [columns[f"tcp_{axis}_m"] for axis in "xyz"]
        values = {
            name: pl.col(source) * (metres if name.startswith("tcp") else 1.0) for name, source in columns.items()
        }

        def make(rows: TextRows) -> Recording:
            _require_columns_first(path, rows.frame, places, below)
            t_s = pl.Series("t_s", rows.frame[INDEX].to_numpy() / rate_hz)
            robot = rows.frame.select(t_s, "source_row", **values)
            return Recording(
                robot=conform(robot, ROBOT),
                clock="relative",
                joint_names=tuple(source for name, source in columns.items() if re.fullmatch(r"q\d_rad", name)),
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {
                "time": f"row / {given(rate_hz)} Hz, as the cell file says",
                "place": ", ".join(places),
                "length_unit": str(options.map.get("length_unit", "m, as libfranka writes it")),
            }
            return replace(last, warnings=tuple(_warnings(options)), facts=facts)

        blocks = read_blocks(path, layout, numbers=[*columns.values(), *below], required=places)
        yield from in_parts(path, blocks, make, finish)


def _metres(options: ReadOptions) -> float:
    for key in options.map:
        if key != "length_unit":
            raise UnknownName(_WHERE, "key", key, ["length_unit"])
    unit = str(options.map.get("length_unit", "m"))
    if unit not in _METRES:
        raise UnknownName(_WHERE, "length_unit", unit, _METRES)
    if options.role not in (None, "robot"):
        cure = 'Map people and events without times with adapter = "csv".'
        raise ConfigError(f"a table of poses cannot be read as {options.role}", cure=cure)
    if options.rate_hz is not None and not options.rate_hz > 0:
        raise ConfigError(
            f"rate_hz = {options.rate_hz!r} is not a rate", cure="Give rows per second, for example 1000."
        )
    return _METRES[unit]


def _below(names: tuple[str, ...]) -> list[str]:
    """Return the matrix elements that are zero if it was written column by column."""
    found = {(m[1], int(m[2] or m[3])): name for name in names if (m := _ELEMENT.fullmatch(name))}
    return [found["O_T_EE", element] for element in _BELOW if ("O_T_EE", element) in found]


def _require_columns_first(path: Path, frame: pl.DataFrame, places: list[str], below: list[str]) -> None:
    """Refuse a matrix written row by row: the position would be read as 0, 0, 0."""
    if not below or frame.is_empty():
        return
    if (frame.select(places) == 0.0).to_numpy().all() and (frame.select(below) != 0.0).to_numpy().any():
        cause = f"O_T_EE is written row by row: the position is in {', '.join(below)}, not where libfranka writes it"
        cure = f'Map it with adapter = "csv": x = "{below[0]}", y = "{below[1]}", z = "{below[2]}".'
        raise DamagedLog(path, cause, cure=cure)


def _columns(names: tuple[str, ...]) -> dict[str, str]:
    """Return canonical column -> column of the file; empty unless all columns of the file belong to a pose."""
    small = {name.lower(): name for name in names}
    if len(small) == len(names) and {"x", "y", "z"}.issubset(small):
        rest = set(small) - {"x", "y", "z"}
        return {f"tcp_{axis}_m": small[axis] for axis in "xyz"} if not rest or rest in _ORIENTATIONS else {}
    found = {}
    for name in names:
        if not (match := _ELEMENT.fullmatch(name)):
            return {}
        found[match[1], int(match[2] or match[3])] = name
    if not all(("O_T_EE", element) in found for element in range(_MATRIX)):
        return {}
    columns = {f"tcp_{axis}_m": found["O_T_EE", element] for axis, element in zip("xyz", _PLACE, strict=True)}
    for kind, canonical in (("q", "q{}_rad"), ("dq", "qd{}_rad_s")):
        if all((kind, joint) in found for joint in range(_JOINTS)):
            columns |= {canonical.format(joint): found[kind, joint] for joint in range(_JOINTS)}
    return columns


def _warnings(options: ReadOptions) -> list[str]:
    clock = f"times are row / {compact(options.rate_hz, 6)} Hz"
    found = [f"the log has no clock: {clock}, and a missing row shifts all later ones"]
    if "length_unit" not in options.map:
        found.append("the file states no unit: metres assumed; check length_unit in [sources.map]")
    found.append("the speed scaling is not logged in this format")
    return found


ADAPTER: StreamingAdapter = _PoseCsv()
