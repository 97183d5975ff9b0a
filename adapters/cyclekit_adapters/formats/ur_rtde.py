"""Universal Robots: RTDE fields as UR's `record.py` (text or `--binary`) and `ur_rtde` write them.

One row per controller sample; `record.py` separates by a space, `ur_rtde` by a comma, with the same column names. A
binary recording differs only in the packing of its rows (`rtde_binary`). Users' programs based on `ur_rtde` write a
vector as one list, `"[0.1, -0.2, ...]"` in a column `actual_q`, which is split into the usual columns. Units are m, rad
and seconds since controller start; users' programs may write the PC's time instead. The override is the product of two
columns: the trajectory limiter (`speed_scaling`) and the slider (`target_speed_fraction`). It describes the speed only
while the program plays (`runtime_state` 2). During a pause the limiter is 0, which is no safety slow-down: there, and
if a factor was not recorded, the scaling stays unknown.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import MissingColumns, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit_adapters.robots.controller_time import ClockRestarts, Range
from cyclekit_adapters.robots.rtde_binary import BinaryLayout, binary_layout, is_binary, read_binary_rows
from cyclekit_adapters.robots.written_clock import WrittenClock
from cyclekit_adapters.tasks.input_events import InputEvents
from cyclekit_adapters.text.delimited import TextLayout, TextRows, read_blocks
from cyclekit_adapters.text.header_line import column_names, layout_below
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.text.list_cells import ListCells
from cyclekit_adapters.text.text_blocks import head_lines, head_of
from cyclekit_adapters.text.text_layout import fields_of
from cyclekit_adapters.times.coarse_stamps import spread_of
from cyclekit_adapters.times.written_time import checked_zone

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

_FIELD = re.compile(r"(actual|target)_(q|qd|qdd|current|moment|TCP_pose|TCP_speed|TCP_force)_[0-5]")
_VECTORS = {"actual_q": 6, "actual_qd": 6, "actual_TCP_pose": 6, "actual_TCP_speed": 6}
_SCALARS = {"speed_scaling", "target_speed_fraction", "runtime_state", "safety_status", "safety_mode"}
_STATES = {0: "stopped", 1: "stopped", 2: "playing", 3: "paused", 4: "paused", 5: "paused"}
_PLAYING = 2
_POSITION = [f"actual_TCP_pose_{axis}" for axis in range(3)]
_SPEED = [f"actual_TCP_speed_{axis}" for axis in range(3)]
_FRACTIONS = ["speed_scaling", "target_speed_fraction"]
_OUTPUTS, _INPUTS = "actual_digital_output_bits", "actual_digital_input_bits"
_RECORD_IT = "Add the field to record_configuration.xml (or to the list of variables) and record again."
_MAP = "[sources.map] of a UR RTDE log"
_KEYS = ["inputs", "register", "time_zone"]
_LOOKED_AT = 20  # rows, to find the kind of time
_SLACK = 1e-3  # tolerance for fractions rounded to above 1


class _UrRtdeCsv:
    def recognises(self, path: Path) -> bool:
        names = column_names(path)
        typical = len(_SCALARS.intersection(names)) > 1 or any(_FIELD.fullmatch(name) for name in names)
        return typical or ("timestamp" in names and not set(_VECTORS).isdisjoint(names))

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        layout = _layout(path)
        lists = ListCells(_lists(layout.names))
        names = (*layout.names, *(name for made in lists.wanted.values() for name in made.values()))
        register = _register(path, layout, options)
        joints = _joints(names)
        _require(path, names, joints)
        inputs = _inputs(path, layout, options)
        needed = [_INPUTS] if inputs is not None else []
        wanted = list(dict.fromkeys([*_fields(register, joints, options.columns), *needed]))
        clock = _clock(path, layout, options)
        restarts, seen = ClockRestarts("timestamp"), _Seen()
        blocks = partial(_blocks, path, layout, wanted, tuple(lists.wanted), clock)
        spread = None
        if clock.coarse:
            stamped = (clock.seconds(lists.rows(block)) for block in blocks())
            moving = [name for name in wanted if name.startswith(("actual_TCP_pose_", "actual_q_")) and name in names]
            spread = spread_of(path, stamped, moving, rate_hz=options.rate_hz, time="timestamp")

        def make(rows: TextRows) -> Recording:
            rows = clock.seconds(lists.rows(rows))
            rows = spread.rows(rows) if spread else rows
            restarts.add(rows.frame)
            seen.add(rows.frame)
            return Recording(
                robot=_robot(rows.frame, register, joints),
                events=None if inputs is None else inputs.changes(rows.frame),
                clock=clock.kind,
                joint_names=tuple(name for name in joints if name.startswith("actual_q_")),
                rows_are="row" if isinstance(layout, BinaryLayout) else "line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {
                "writer": _writer(layout),
                "register": register if register in layout.names else "not recorded",
                "time": clock.fact(),
                "speed_scaling": "speed_scaling * target_speed_fraction while runtime_state is 2 (playing)",
            }
            said = [*clock.warnings(), *([spread.said] if spread else []), *restarts.warnings(), *seen.warnings(names)]
            return replace(last, warnings=tuple(said), facts=facts)

        yield from in_parts(path, blocks(), make, finish)


def _blocks(
    path: Path,
    layout: TextLayout | BinaryLayout,
    wanted: Sequence[str],
    lists: Sequence[str],
    clock: WrittenClock,
) -> Iterator[TextRows]:
    present = [name for name in wanted if name in layout.names]
    if isinstance(layout, BinaryLayout):
        return read_binary_rows(path, layout, numbers=present, time="timestamp")
    some = [*lists, *(name for name in present if name != "timestamp")]
    texts = [*lists, *(["timestamp"] if clock.is_text else [])]
    numbers = [name for name in present if name not in texts]
    return read_blocks(path, layout, numbers=numbers, texts=texts, required=["timestamp"], any_of=some)


def _clock(path: Path, layout: TextLayout | BinaryLayout, options: ReadOptions) -> WrittenClock:
    if isinstance(layout, BinaryLayout) or "timestamp" not in layout.names:
        return WrittenClock("timestamp", "uptime")
    at = layout.names.index("timestamp")
    rows = [fields_of(line, layout.delimiter) for line in head_lines(path, layout.header_lines + _LOOKED_AT)]
    cells = [row[at].strip().strip('"') for row in rows[layout.header_lines :] if len(row) > at]
    return WrittenClock.from_cells(cells, "timestamp", checked_zone(options.map.get("time_zone"), _MAP))


def _lists(names: Sequence[str]) -> dict[str, dict[int, str]]:
    """Return the columns of lists, with the usual column name for each of their numbers."""
    return {
        name: {place: f"{name}_{place}" for place in range(length)}
        for name, length in _VECTORS.items()
        if name in names and f"{name}_0" not in names
    }


def _layout(path: Path) -> TextLayout | BinaryLayout:
    return binary_layout(path) if is_binary(head_of(path)) else layout_below(path)


def _writer(layout: TextLayout | BinaryLayout) -> str:
    if isinstance(layout, BinaryLayout):
        return "record.py --binary"
    return "record.py (space)" if layout.delimiter == " " else f"delimiter {layout.delimiter!r}"


def _register(path: Path, layout: TextLayout | BinaryLayout, options: ReadOptions) -> str:
    for key in options.map:
        if key not in _KEYS:
            raise UnknownName(_MAP, "key", key, _KEYS)
    if "register" not in options.map:
        return "output_int_register_0"
    register = str(options.map["register"])
    if register not in layout.names:
        raise MissingColumns(path, [register], layout.names, _RECORD_IT)
    return register


def _inputs(path: Path, layout: TextLayout | BinaryLayout, options: ReadOptions) -> InputEvents | None:
    """Return the detector of digital input changes, if the cell file requests them as events."""
    wanted = options.map.get("inputs", "no")
    if wanted not in ("events", "no"):
        raise UnknownName(_MAP, "inputs", str(wanted), ["events", "no"])
    if wanted == "no":
        return None
    if _INPUTS not in layout.names:
        raise MissingColumns(path, [_INPUTS], layout.names, _RECORD_IT)
    return InputEvents(_INPUTS, "timestamp")


def _joints(names: tuple[str, ...]) -> dict[str, str]:
    """Return the joint columns present and their names in the canonical table."""
    angles = {f"actual_q_{joint}": f"q{joint}_rad" for joint in range(6)}
    speeds = {f"actual_qd_{joint}": f"qd{joint}_rad_s" for joint in range(6)}
    return {name: column for name, column in (angles | speeds).items() if name in names}


def _fields(register: str, joints: dict[str, str], columns: Sequence[str]) -> list[str]:
    """Return the fields needed for some canonical columns; for all of them if `columns` is empty."""
    made_of = {f"tcp_{axis}_m": _POSITION for axis in "xyz"} | {
        "tcp_speed_m_s": _SPEED,
        "scaling": [*_FRACTIONS, "runtime_state"],
        "slider": ["target_speed_fraction"],
        "state": ["runtime_state"],
        "digital_in_bits": [_INPUTS],
        "digital_out_bits": [_OUTPUTS],
        "register": [register],
    }
    made_of |= {column: [name] for name, column in joints.items()}
    return list(dict.fromkeys(["timestamp", *(f for c in columns or made_of for f in made_of.get(c, []))]))


def _require(path: Path, names: tuple[str, ...], joints: dict[str, str]) -> None:
    missing = {"timestamp"}.difference(names)
    if not all(f"actual_q_{joint}" in joints for joint in range(6)):
        missing |= set(_POSITION).difference(names)
    if missing:
        raise MissingColumns(path, missing, names, _RECORD_IT)


def _robot(frame: pl.DataFrame, register: str, joints: dict[str, str]) -> pl.DataFrame:
    """Return the rows in the canonical columns; numpy is faster than a polars query on a small log."""
    have = set(frame.columns)
    named = {"source_row": "source_row", "timestamp": "t_s"}
    if have.issuperset(_POSITION):
        named |= {name: f"tcp_{axis}_m" for name, axis in zip(_POSITION, "xyz", strict=True)}
    columns = [frame.get_column(n).alias(c) for n, c in (named | joints).items() if n in have]
    if have.issuperset(_SPEED):
        x, y, z = (frame.get_column(name).to_numpy() for name in _SPEED)
        with np.errstate(over="ignore"):  # a garbled binary log
            columns.append(_series("tcp_speed_m_s", np.sqrt(x * x + y * y + z * z)))
    if "target_speed_fraction" in have:
        columns.append(_series("slider", _fraction(frame, "target_speed_fraction")))
    if "runtime_state" in have:
        code = np.trunc(frame.get_column("runtime_state").to_numpy())
        columns.append(_states(code))
        if have.issuperset(_FRACTIONS):
            product = _fraction(frame, "speed_scaling") * _fraction(frame, "target_speed_fraction")
            columns.append(_series("scaling", np.where(code == _PLAYING, product, np.nan)))
    whole = {_INPUTS: "digital_in_bits", _OUTPUTS: "digital_out_bits", register: "register"}
    columns += [frame.get_column(n).cast(pl.Int64, strict=False).alias(c) for n, c in whole.items() if n in have]
    return conform(pl.DataFrame(columns), ROBOT)


def _series(name: str, values: Vector) -> pl.Series:
    return pl.Series(name, values, nan_to_null=True)


def _states(code: Vector) -> pl.Series:
    """Return the program states of codes (N,), NaN = unknown."""
    if len(code) and 0 <= code[0] < len(_STATES) and (code == code[0]).all():
        return pl.Series("state", [_STATES[int(code[0])]]).new_from_index(0, len(code))
    known = (code >= 0) & (code < len(_STATES))
    index = pl.Series(np.where(known, code, np.nan), nan_to_null=True).cast(pl.UInt32)
    return pl.Series("state", list(_STATES.values())).gather(index)


def _fraction(frame: pl.DataFrame, name: str) -> Vector:
    """Return a column with NaN where it is no fraction: percent is not guessed."""
    value = frame.get_column(name).to_numpy()
    return np.where((value >= 0.0) & (value <= 1.0 + _SLACK), np.minimum(value, 1.0), np.nan)


@dataclass
class _Seen:
    """Observations of the speed scaling so far.

    Attributes:
        played: Whether the program played in any row; None = the field is not read.
    """

    played: bool | None = None
    spread: Range = field(default_factory=lambda: Range(tuple(_FRACTIONS)))

    def add(self, frame: pl.DataFrame) -> None:
        if "runtime_state" in frame.columns:
            self.played = self.played or bool((frame["runtime_state"] == _PLAYING).any())
        self.spread.add(frame)

    def warnings(self, recorded: Sequence[str]) -> list[str]:
        messages = []
        if absent := [name for name in (*_FRACTIONS, "runtime_state") if name not in recorded]:
            messages.append(f"{', '.join(absent)} not recorded: this log holds no speed scaling")
        elif self.played is False:
            messages.append("the program runs in no row (runtime_state is never 2): this log holds no speed scaling")
        messages += [
            f"{name} exceeds 1 in some rows: unknown there"
            for name in _FRACTIONS
            if self.spread.most.get(name, 0.0) > 1.0 + _SLACK
        ]
        if not set(_POSITION).issubset(recorded):
            messages.append("actual_TCP_pose not recorded: only joint angles are known")
        return messages


ADAPTER: StreamingAdapter = _UrRtdeCsv()
