"""Universal Robots: the layout of NIST's UR5 recordings (`ROBOT_TIME`, `ROBOT_ACTUAL_JOINT_POSITIONS (J1)`, ...).

One row per controller sample: the time and twelve groups of six values. NIST publishes the column names in a separate
file and the rows without them, each group in brackets: `([0.0], [q1, ..., q6], ...)`. Others publish plain tables with
a header, with names joined by a space or an underscore. All of them are accepted. The files hold no units; those of a
UR controller are assumed (seconds since its start, m, rad, rad/s) unless the cell file gives others, and joint speeds
are compared with joint angles to detect another unit. The override is not logged and stays unknown.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import DamagedLog, MissingColumns, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit.text.numbers import compact
from cyclekit_adapters.robots.controller_time import ClockRestarts
from cyclekit_adapters.text.delimited import TextLayout, TextRows, read_blocks
from cyclekit_adapters.text.header_line import column_names, layout_below
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.text_blocks import head_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_JOINTS = tuple(f"J{joint}" for joint in range(1, 7))
_GROUPS = (  # in the order of rows without names
    ("ROBOT_TARGET_JOINT_POSITIONS", _JOINTS),
    ("ROBOT_ACTUAL_JOINT_POSITIONS", _JOINTS),
    ("ROBOT_TARGET_JOINT_VELOCITIES", _JOINTS),
    ("ROBOT_ACTUAL_JOINT_VELOCITIES", _JOINTS),
    ("ROBOT_TARGET_JOITN_CURRENT", _JOINTS),  # spelled like this in NIST's list of names
    ("ROBOT_ACTUAL_JOINT_CURRENT", _JOINTS),
    ("ROBOT_TARGET_JOINT_ACCELERATIONS", _JOINTS),
    ("ROBOT_TARGET_JOINT_TORQUES", _JOINTS),
    ("ROBOT_JOINT_CONTROL_CURRENT", _JOINTS),
    ("ROBOT_CARTESIAN_COORD_TOOL", _AXES),
    ("ROBOT_TCP_FORCE", _AXES),
    ("ROBOT_JOINT_TEMP", _JOINTS),
)
_TIME = "ROBOT_TIME"
_ALL = (_TIME, *(f"{group} ({part})" for group, parts in _GROUPS for part in parts))
_ANGLES = [f"ROBOT_ACTUAL_JOINT_POSITIONS (J{joint})" for joint in range(1, 7)]
_SPEEDS = [f"ROBOT_ACTUAL_JOINT_VELOCITIES (J{joint})" for joint in range(1, 7)]
_PLACES = [f"ROBOT_CARTESIAN_COORD_TOOL ({axis})" for axis in "xyz"]
_COLUMN = re.compile(r"(ROBOT_[A-Z_]+?)[ _]\(?(J[1-6]|r?[xyz])\)?")
_GROUP = re.compile(r"\[([^][]*)\]")
_BRACKETS = "()[] \t\r"
_DELIMITERS = ",;\t"  # names contain spaces
_UNITS: Mapping[str, Mapping[str, float]] = {
    "length_unit": {"m": 1.0, "mm": 1e-3},
    "joint_unit": {"rad": 1.0, "deg": 0.017453292519943295},
    "joint_speed_unit": {"rad/s": 1.0, "deg/s": 0.017453292519943295},
}
_FACTOR_APART = 5.0  # in consistent units, angles and speeds agree to a few percent; degrees differ by a factor of 57


class _NistUr:
    def recognises(self, path: Path) -> bool:
        return _is_bare(head_of(path)) or _TIME in column_names(path, _DELIMITERS)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        units = _units(options)
        layout = _layout(path)
        groups = [group for group in (_PLACES, _ANGLES, _SPEEDS) if set(group).issubset(layout.names)]
        if _TIME not in layout.names or (_PLACES not in groups and _ANGLES not in groups):
            missing = {_TIME, *_ANGLES}.difference(layout.names)
            raise MissingColumns(path, missing, layout.names, "Record the time, and joint angles or the tool.")
        wanted = [_TIME, *(name for group in groups for name in group)]
        restarts, turning = ClockRestarts(_TIME), _Turning(_ANGLES in groups and _SPEEDS in groups, units)

        def make(rows: TextRows) -> Recording:
            rows = _as_numbers(rows, wanted)
            restarts.add(rows.frame)
            turning.add(rows.frame)
            return Recording(
                robot=_robot(rows.frame, groups, units),
                clock="uptime",
                joint_names=tuple(_ANGLES) if _ANGLES in groups else (),
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {
                "layout": "names in the first line" if layout.header_lines else "rows in brackets, names by position",
                "units": ", ".join(str(options.map.get(key, next(iter(known)))) for key, known in _UNITS.items()),
            }
            messages = [*restarts.warnings(), *_warnings(options), *turning.warnings()]
            return replace(last, warnings=tuple(messages), facts=facts)

        blocks = read_blocks(path, layout, numbers=[], texts=wanted)
        try:
            yield from in_parts(path, blocks, make, finish)
        except DamagedLog as error:
            if error.cause != "a header and no rows":
                raise
            cure = "NIST writes the names to a separate file: read the file with the rows; it needs no header."
            raise DamagedLog(path, error.cause, cure=cure) from None


def _units(options: ReadOptions) -> dict[str, float]:
    where = "[sources.map] of a NIST UR log"
    for key, value in options.map.items():
        if key not in _UNITS:
            raise UnknownName(where, "key", key, _UNITS)
        if str(value) not in _UNITS[key]:
            raise UnknownName(where, key, str(value), _UNITS[key])
    return {key: known[str(options.map.get(key, next(iter(known))))] for key, known in _UNITS.items()}


def _is_bare(head: str) -> bool:
    """Return whether the first line is a time and twelve bracketed groups of six numbers."""
    line, newline, _ = head.partition("\n")
    groups = [group.split(",") for group in _GROUP.findall(line)]
    sizes = [len(group) for group in groups]
    if not newline or sizes not in ([1, *[6] * len(_GROUPS)], [6] * len(_GROUPS)):
        return False
    try:
        return len([float(cell.strip(_BRACKETS)) for cell in line.strip().rstrip(",").split(",")]) == len(_ALL)
    except ValueError:
        return False


def _layout(path: Path) -> TextLayout:
    layout = layout_below(path, _DELIMITERS)
    if _is_bare(head_of(path)):
        return TextLayout(_ALL, ",", 0, encoding=layout.encoding)
    names = tuple(_as_nist(name) for name in layout.names)
    if len(set(names)) < len(names):
        raise DamagedLog(path, "a column of the header is named twice", cure="Name each column once.")
    return replace(layout, names=names)


def _as_nist(name: str) -> str:
    """Return a name in NIST's spelling; other names are unchanged."""
    return f"{found[1]} ({found[2]})" if (found := _COLUMN.fullmatch(name)) else name


def _as_numbers(rows: TextRows, names: Sequence[str]) -> TextRows:
    """Remove the brackets; a row with a word instead of a number, or without a time, is set aside."""
    texts = rows.frame.with_columns(pl.col(names).str.strip_chars(_BRACKETS).replace("", None))
    frame = texts.with_columns(pl.col(names).cast(pl.Float64, strict=False))
    aside, numbers = [rows.set_aside], frame
    for name in names:
        word = (texts[name].is_not_null() & numbers[name].is_null()).alias("word")
        if not word.any():
            continue
        bad = texts.filter(word).filter(pl.col("source_row").is_in(frame["source_row"].implode()))
        reason = pl.format("'{}' in column '{}' is not a number", pl.col(name).str.slice(0, 40), pl.lit(name))
        aside.append(bad.select("source_row", reason.alias("reason")))
        frame = frame.filter(~pl.col("source_row").is_in(bad["source_row"].implode()))
    frame = frame.with_columns(pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in names)
    timeless = pl.lit(f"no value in column {_TIME!r}").alias("reason")
    aside.append(frame.filter(pl.col(_TIME).is_null()).select("source_row", timeless))
    return TextRows(frame.drop_nulls(_TIME), rows.rows_read, pl.concat(aside).sort("source_row"))


def _robot(frame: pl.DataFrame, groups: Sequence[Sequence[str]], units: Mapping[str, float]) -> pl.DataFrame:
    canonical = [
        (_PLACES, "length_unit", [f"tcp_{axis}_m" for axis in "xyz"]),
        (_ANGLES, "joint_unit", [f"q{joint}_rad" for joint in range(6)]),
        (_SPEEDS, "joint_speed_unit", [f"qd{joint}_rad_s" for joint in range(6)]),
    ]
    columns = [
        (pl.col(name) * units[unit]).alias(column)
        for group, unit, named in canonical
        if group in groups
        for name, column in zip(group, named, strict=True)
    ]
    return conform(frame.select(pl.col(_TIME).alias("t_s"), "source_row", *columns), ROBOT)


def _warnings(options: ReadOptions) -> list[str]:
    messages = ["the speed scaling is not logged in this format"]
    if unsaid := [key for key in _UNITS if key not in options.map]:
        messages.append(f"the file states no units: s, m, rad and rad/s assumed; check {', '.join(unsaid)}")
    return messages


@dataclass
class _Turning:
    """Total joint rotation, and the rotation implied by joint speeds, so far."""

    known: bool
    units: Mapping[str, float]
    turned_rad: float = 0.0
    expected_rad: float = 0.0

    def add(self, frame: pl.DataFrame) -> None:
        if not self.known or frame.height < 2:
            return
        steps = frame[_TIME].diff()
        near = (steps > 0) & (steps < 1.0)
        turned = sum(float(frame[name].diff().abs().filter(near).sum()) for name in _ANGLES)
        run = sum(float((frame[name].abs() * steps).filter(near).sum()) for name in _SPEEDS)
        self.turned_rad += turned * self.units["joint_unit"]
        self.expected_rad += run * self.units["joint_speed_unit"]

    def warnings(self) -> list[str]:
        ratio = self.turned_rad / self.expected_rad if self.expected_rad > 0 else 1.0
        if 1 / _FACTOR_APART < ratio < _FACTOR_APART:
            return []
        return [
            f"the joints turn {compact(ratio, 3)} times as far as their speeds imply: the units are wrong; "
            "set joint_unit and joint_speed_unit"
        ]


ADAPTER: StreamingAdapter = _NistUr()
