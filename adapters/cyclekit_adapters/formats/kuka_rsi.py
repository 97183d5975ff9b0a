"""KUKA: CSV of RSI values (`X_RIst`, `Y_RIst`, `Z_RIst`, `IPOC`), as RSI clients write it.

RSI is a stream without a file format, so the columns depend on the client. The value names are KUKA's, and clients
combine them in several ways (`X_RIst`, `RIst.X`, `rist_x`). `RIst` is the actual position (mm, base of the RSI
configuration), `AIPos` the axis angles (degrees), `RSol` only the set point of the next cycle. The clock is `IPOC`, the
controller's millisecond count. An additional `Timestamp` is the PC's, often in whole seconds of an unnamed zone; with
`time_zone` in `[sources.map]` both stamps are stored, and the log can be aligned with logs in epoch time. RSI does not
transmit the override, which stays unknown.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import MissingColumns, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit.text.numbers import given
from cyclekit_adapters.robots.controller_time import ClockRestarts, Range
from cyclekit_adapters.robots.host_clock import HostClock
from cyclekit_adapters.text.delimited import TextRows, read_blocks
from cyclekit_adapters.text.header_line import column_names, layout_below
from cyclekit_adapters.text.in_parts import in_parts
from cyclekit_adapters.times.written_time import checked_zone

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

_PLACE = re.compile(r"([xyz])[ _.]?rist|rist[ _.]?([xyz])", re.IGNORECASE)
_AXIS = re.compile(r"a([1-6])[ _.]?aipos|aipos[ _.]?a([1-6])", re.IGNORECASE)
_AXES = 6
_TIME, _LATE = "IPOC", "Delay"
_HOST = "timestamp"
_OVERRIDES = ("OV_PRO", "OV_ROB", "OV_JOG")
_MM, _MS, _DEGREE = 1e-3, 1e-3, math.pi / 180.0
_NO_PLACE = "RIst not recorded: only joint angles are known"


@dataclass(frozen=True)
class _Columns:
    """Column names of the client: for each axis of the position, each joint, and the clock."""

    time: str | None
    place: dict[str, str]
    joints: dict[int, str]

    @staticmethod
    def among(names: Sequence[str]) -> _Columns:
        time = next((name for name in names if name.upper() == _TIME), None)
        places = {(m[1] or m[2]).lower(): name for name in names if (m := _PLACE.fullmatch(name))}
        joints = {int(m[1] or m[2]) - 1: name for name in names if (m := _AXIS.fullmatch(name))}
        return _Columns(time, places, joints if len(joints) == _AXES else {})

    def require(self, path: Path, names: Sequence[str]) -> str:
        """Return the clock's column; raise if columns are missing."""
        missing = [f"{axis.upper()}_RIst" for axis in "xyz" if axis not in self.place]
        if self.time is not None and (not missing or (not self.place and self.joints)):
            return self.time
        cure = "Let the RSI client write RIst and IPOC, and record again."
        if self.time is None:
            missing.append(_TIME)
            cure += ' A table with another clock is mapped with adapter = "csv".'
        raise MissingColumns(path, missing, names, cure)


class _KukaRsiCsv:
    def recognises(self, path: Path) -> bool:
        found = _Columns.among(column_names(path))
        return bool(found.place) or bool(found.time and found.joints)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        zone = _zone(options)
        layout = layout_below(path)
        columns = _Columns.among(layout.names)
        time = columns.require(path, layout.names)
        values = [*columns.place.values(), *columns.joints.values()]
        numbers = [time, *values, *([_LATE] if _LATE in layout.names else [])]
        restarts, late, cycles = ClockRestarts(time), Range((_LATE,)), list[float]()
        host = next((HostClock(name, zone) for name in layout.names if name.lower() == _HOST), None)

        def make(rows: TextRows) -> Recording:
            restarts.add(rows.frame)
            late.add(rows.frame)
            cycles.append(_cycle_ms(rows.frame[time]))
            stamps = None if host is None else host.stamps(rows.frame[time] * _MS, rows.frame[host.column])
            return Recording(
                robot=_robot(rows.frame, time, columns),
                joint_names=tuple(columns.joints[axis] for axis in sorted(columns.joints)),
                stamps=stamps,
                clock="uptime",
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {
                "time": "IPOC, milliseconds of the controller",
                "cycle": f"{given(cycles[0])} ms",
                "point": "RIst: the active tool in the base of the RSI configuration, mm",
            }
            messages = [
                *restarts.warnings(),
                *([] if columns.place else [_NO_PLACE]),
                *_warnings(layout.names, late.most.get(_LATE, 0.0)),
                *_unread_host(host),
            ]
            return replace(last, warnings=tuple(messages), facts=facts | _host_fact(host))

        texts = [host.column] if host else []
        blocks = read_blocks(path, layout, numbers=numbers, texts=texts, required=[time], any_of=values)
        yield from in_parts(path, blocks, make, finish)


def _zone(options: ReadOptions) -> str | None:
    """Return the time zone given in the cell file; refuse any other key."""
    where = "[sources.map] of a KUKA RSI log"
    for key in options.map:
        if key != "time_zone":
            cure = 'Known: time_zone. Columns of your own are mapped with adapter = "csv".'
            raise UnknownName(where, "key", key, ["time_zone"], cure=cure)
    return checked_zone(options.map.get("time_zone"), where)


def _unread_host(host: HostClock | None) -> list[str]:
    if host is None or host.read or not host.unread:
        return []
    if host.zone is not None:
        return [
            f"column {host.column!r} holds no date and time that can be read, such as 2024-05-01 10:00:00 or "
            "01.05.2024 10:00:00: the log is not aligned by it"
        ]
    return [
        f"column {host.column!r} is the PC's local time, and the log names no time zone: give time_zone, for example "
        '"Europe/Rome", in [sources.map] to align the log with logs in epoch time'
    ]


def _host_fact(host: HostClock | None) -> dict[str, str]:
    if host is None or not host.read:
        return {}
    zone = f" in {host.zone}" if host.zone else ""
    return {"host_clock": f"{host.column}{zone}: kept at the rows where it changes, early by up to one cycle"}


def _robot(frame: pl.DataFrame, time: str, columns: _Columns) -> pl.DataFrame:
    places = [(pl.col(name) * _MM).alias(f"tcp_{axis}_m") for axis, name in columns.place.items()]
    joints = [(pl.col(name) * _DEGREE).alias(f"q{axis}_rad") for axis, name in columns.joints.items()]
    return conform(frame.select((pl.col(time) * _MS).alias("t_s"), "source_row", *places, *joints), ROBOT)


def _warnings(names: tuple[str, ...], late: float) -> list[str]:
    messages = ["RSI does not log the speed scaling"]
    messages += [
        f'column {name!r} is not read: map it with adapter = "csv" (scaling, scaling_max = 100)'
        for name in names
        if any(override in name.upper() for override in _OVERRIDES)
    ]
    if late:
        messages.append(f"the controller counts up to {given(late)} late packets: the client was too slow there")
    return messages


def _cycle_ms(times: pl.Series) -> float:
    steps = times.diff().drop_nulls()
    value = steps.filter(steps != 0.0).median()
    return 0.0 if value is None else float(str(value))


ADAPTER: StreamingAdapter = _KukaRsiCsv()
