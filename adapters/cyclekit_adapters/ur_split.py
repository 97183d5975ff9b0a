"""Universal Robots: a folder of headerless CSV files, one per signal (`log_tool_vector.csv`, `log_q_actual.csv`, ...).

Each row is `seconds, six values`; metres, radians, m/s; the first column counts from the start of the recording.
The signals are put together on the time of the TCP pose, each with the row nearest in time. Loggers of this kind
are often killed while writing, so files differ in length and end inside a number: a last line without a line end is
set aside, and a signal that ended earlier is unknown from there on. The override is not logged and stays unknown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, LogError, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit_adapters.delimited import Layout, Rows, delimiter_of, read_rows
from cyclekit_adapters.text_blocks import file_encoding, head_of

if TYPE_CHECKING:
    from pathlib import Path

_POSE, _JOINTS, _JOINT_SPEEDS, _SPEED = "log_tool_vector", "log_q_actual", "log_qd_actual", "log_tcp_speed"
_AXES = tuple(f"value_{index}" for index in range(6))
_COLUMNS = {
    _POSE: ("tcp_x_m", "tcp_y_m", "tcp_z_m"),
    _SPEED: ("x_m_s", "y_m_s", "z_m_s"),
    _JOINTS: tuple(f"q{joint}_rad" for joint in range(6)),
    _JOINT_SPEEDS: tuple(f"qd{joint}_rad_s" for joint in range(6)),
}
_LAYOUT = ("t_s", *_AXES)
_NEAR_PERIODS = 0.75  # a value further away in time than this many periods of its own signal is no value


class _UrSplitFolder:
    def recognises(self, path: Path) -> bool:
        return any(_looks_right(path / f"{signal}.csv") for signal in (_POSE, _JOINTS))

    def read(self, path: Path, options: ReadOptions) -> Recording:
        for key in options.map:
            raise UnknownName("[sources.map] of a UR folder log", "key", key, [])
        if not path.is_dir():
            raise LogError(path, "is not a folder", cure="Name the folder that holds log_tool_vector.csv.")
        signals = {name: _signal(path / f"{name}.csv") for name in _COLUMNS if (path / f"{name}.csv").is_file()}
        signals = {name: rows for name, rows in signals.items() if not rows.frame.is_empty()}
        lead = next((name for name in (_POSE, _JOINTS) if name in signals), None)
        if lead is None:
            cure = "Check that the copy is whole; log_tool_vector.csv holds seconds and six values a row."
            raise DamagedLog(path, "neither log_tool_vector.csv nor log_q_actual.csv has a usable row", cure=cure)
        table = _merged(signals, lead)
        return Recording(
            robot=_robot(table),
            clock="relative",
            joint_names=tuple(f"actual_q_{joint}" for joint in range(6)) if _JOINTS in signals else (),
            rows_are="line",
            rows_read=sum(rows.rows_read for rows in signals.values()),
            set_aside=_set_aside(signals),
            warnings=tuple(_warnings(signals, lead)),
            facts={
                "time_base": f"{lead}.csv",
                "signals": ", ".join(f"{name}.csv" for name in signals),
                "start_time": head_of(path / "start_time.csv", 64).partition("\n")[0].strip() or "not logged",
            },
        )


def _looks_right(path: Path) -> bool:
    line, newline, _ = head_of(path, 512).partition("\n")
    try:
        return bool(newline) and len([float(cell) for cell in line.split(delimiter_of(line))]) == len(_LAYOUT)
    except ValueError:
        return False


def _signal(path: Path) -> Rows:
    head = head_of(path)
    layout = Layout(_LAYOUT, delimiter_of(head.partition("\n")[0]), 0, encoding=file_encoding(path) or "utf-8")
    rows = read_rows(path, layout, numbers=_LAYOUT, required=["t_s"])
    later = (rows.frame["t_s"].cum_max().shift() < rows.frame["t_s"]).fill_null(value=True)
    reason = pl.lit("its time does not go on").alias("reason")
    aside = pl.concat([rows.set_aside, rows.frame.filter(~later).select("source_row", reason)])
    return Rows(rows.frame.filter(later), rows.rows_read, aside)


def _merged(signals: dict[str, Rows], lead: str) -> pl.DataFrame:
    table = _named(signals[lead], lead)
    for name, rows in signals.items():
        if name == lead:
            continue
        period = rows.frame["t_s"].diff().median()
        near = _NEAR_PERIODS * float(str(period)) if period is not None else 0.0
        other = _named(rows, name).drop("source_row")
        table = table.join_asof(other, on="t_s", strategy="nearest", tolerance=near, check_sortedness=False)
    return table


def _named(rows: Rows, name: str) -> pl.DataFrame:
    columns = [pl.col(axis).alias(column) for axis, column in zip(_AXES, _COLUMNS[name], strict=False)]
    return rows.frame.select("t_s", "source_row", *columns)


def _robot(table: pl.DataFrame) -> pl.DataFrame:
    linear = _COLUMNS[_SPEED]
    if set(linear).issubset(table.columns):
        squares = pl.sum_horizontal([pl.col(name) ** 2 for name in linear], ignore_nulls=False)
        table = table.with_columns(tcp_speed_m_s=squares.sqrt()).drop(linear)
    return conform(table, ROBOT)


def _set_aside(signals: dict[str, Rows]) -> pl.DataFrame:
    named = [
        rows.set_aside.with_columns(reason=pl.format("{}.csv: {}", pl.lit(name), "reason"))
        for name, rows in signals.items()
    ]
    return pl.concat(named)


def _warnings(signals: dict[str, Rows], lead: str) -> list[str]:
    said = ["the speed scaling is not logged in this format"]
    ends = {name: float(rows.frame["t_s"][-1]) for name, rows in signals.items()}
    said += [
        f"{name}.csv ends at {end:.3f} s, {lead}.csv at {ends[lead]:.3f} s: unknown in between"
        for name, end in ends.items()
        if end < ends[lead] - 0.1
    ]
    return said


ADAPTER: Adapter = _UrSplitFolder()
