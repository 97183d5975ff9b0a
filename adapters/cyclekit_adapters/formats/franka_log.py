"""Franka (Panda, FR3): CSV of libfranka's `franka::logToCSV`, the log of a control exception.

One row per control cycle: `time` in whole milliseconds of the robot, the state of that cycle (`state.q[0..6]` rad,
`state.dq[0..6]` rad/s) and the preceding command. The log holds no measured TCP: `cmd.O_T_EE_d` is a command, and with
a joint or torque controller it stays the identity, so it is not read. The returned TCP is the flange, computed from
`state.q` (`panda_arm`); a hand or tool extends beyond it. The override is not logged and stays unknown.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import DamagedLog, MissingColumns, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit.text.numbers import given
from cyclekit_adapters.robots.controller_time import ClockRestarts
from cyclekit_adapters.robots.panda_arm import JOINTS, flange_position_m
from cyclekit_adapters.text.delimited import TextRows, read_blocks
from cyclekit_adapters.text.header_line import column_names, layout_below
from cyclekit_adapters.text.in_parts import in_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_TIME = "time"
_ANGLES = [f"state.q[{joint}]" for joint in range(JOINTS)]
_SPEEDS = [f"state.dq[{joint}]" for joint in range(JOINTS)]
_MS = 1e-3


class _FrankaLogCsv:
    def recognises(self, path: Path) -> bool:
        names = column_names(path, ",;\t")
        return _TIME in names and any(name in names for name in _ANGLES)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        for key in options.map:
            raise UnknownName("[sources.map] of a Franka log", "key", key, [])
        layout = layout_below(path, ",;\t")
        names = layout.names
        if missing := {_TIME, *_ANGLES}.difference(names):
            raise MissingColumns(path, missing, names, "Write the log with franka::logToCSV, whole.")
        speeds = [name for name in _SPEEDS if name in names]
        restarts = ClockRestarts(_TIME)

        def make(rows: TextRows) -> Recording:
            rows = _milliseconds(path, rows)
            restarts.add(rows.frame)
            return Recording(
                robot=_robot(rows.frame, speeds),
                clock="uptime",
                joint_names=tuple(_ANGLES),
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            messages = (
                *restarts.warnings(),
                "the TCP is the flange, computed from the joint angles: no hand and no tool is included",
                "the speed scaling is not logged in this format",
            )
            facts = {
                "time": "milliseconds of the robot",
                "tcp": "flange by forward kinematics of state.q, Denavit-Hartenberg parameters of Panda and FR3",
                "not_read": "cmd.O_T_EE_d: a command, the identity under a joint or torque controller",
            }
            return replace(last, warnings=messages, facts=facts)

        numbers = [_TIME, *_ANGLES, *speeds]
        blocks = read_blocks(path, layout, numbers=numbers, required=[_TIME], any_of=_ANGLES)
        yield from in_parts(path, blocks, make, finish)


def _milliseconds(path: Path, rows: TextRows) -> TextRows:
    """Return the rows with whole milliseconds; a few others are garbled, many are seconds of another logger.

    Raises:
        DamagedLog: Most times are not integers; read as milliseconds, the log would be a thousand times too slow.
    """
    odd = rows.frame[_TIME] % 1 != 0
    if 2 * odd.sum() > len(odd):
        time = given(rows.frame.filter(odd)[_TIME][-1])
        cause = f"time {time} is not a whole number of milliseconds, like most others"
        cure = 'libfranka writes whole ms; map the table of another logger with adapter = "csv" and its time_unit.'
        raise DamagedLog(path, cause, cure=cure)
    return rows.without(odd, "its time is not a whole number of milliseconds") if odd.any() else rows


def _robot(frame: pl.DataFrame, speeds: list[str]) -> pl.DataFrame:
    q_rad = frame.select(pl.col(_ANGLES).fill_null(np.nan)).to_numpy()
    place = flange_position_m(np.asarray(q_rad, dtype=np.float64))
    columns = [
        *(pl.Series(f"tcp_{axis}_m", place[:, i]).fill_nan(None) for i, axis in enumerate("xyz")),
        *(frame[name].alias(f"q{_ANGLES.index(name)}_rad") for name in _ANGLES),
        *(frame[name].alias(f"qd{_SPEEDS.index(name)}_rad_s") for name in speeds),
    ]
    return conform(frame.select((pl.col(_TIME) * _MS).alias("t_s"), "source_row").with_columns(columns), ROBOT)


ADAPTER: StreamingAdapter = _FrankaLogCsv()
