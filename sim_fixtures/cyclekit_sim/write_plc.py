"""A PLC's trace: one column per tag, or rows of tag, time and value, in the PLC's own clock.

The robot's gripper output is also wired to the PLC: both log it, so their clocks can be aligned.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl

from cyclekit_sim.fields import NAMES, Field
from cyclekit_sim.session import Session

PLC_S = 41.3
"""PLC's clock at the first robot sample, s."""
SHARED = "robot_gripper"
"""Tag of the robot's digital output 0."""
_DAY = datetime(2025, 6, 2, 8, 0, 0, tzinfo=UTC)


def write_trace(path: Path, session: Session, fields: Sequence[Field], form: Literal["wide", "long"]) -> None:
    """Write the trace of a session."""
    robot = session.robot
    names = {**NAMES, **{one.bit: one.name for one in fields}}
    tags = {name: (robot.inputs >> bit) & 1 for bit, name in names.items()} | {SHARED: robot.closed}
    times = robot.t_s + PLC_S
    if form == "wide":
        shown = {name: np.where(values == 1, "TRUE", "FALSE") for name, values in tags.items()}
        columns = {"Time [ms]": np.char.replace(np.char.mod("%.1f", times * 1e3), ".", ","), **shown}
        columns["belt_speed"] = np.full(len(times), "0,25")
        pl.DataFrame(columns).write_csv(path, separator=";", line_terminator="\r\n")
        return
    rows = [
        ((_DAY + timedelta(seconds=float(times[i]))).isoformat(timespec="milliseconds"), name, str(values[i]), "GOOD")
        for name, values in tags.items()
        for i in np.flatnonzero(np.diff(values, prepend=-1)).tolist()
    ]
    pl.DataFrame(sorted(rows), schema=["Timestamp", "Tag", "Value", "Quality"], orient="row").write_csv(path)


def trace_source(fields: Sequence[Field], form: Literal["wide", "long"]) -> list[str]:
    """Return the lines of the cell file for the trace."""
    if form == "wide":
        tags = ", ".join(f'"{name}"' for name in (*(one.name for one in fields), *NAMES.values(), SHARED))
        how = f'time = "Time [ms]", time_unit = "ms", clock = "uptime", decimal = ",", delimiter = ";", tags = [{tags}]'
    else:
        how = 'time = "Timestamp", time_format = "iso", signal = "Tag", value = "Value", quality = "Quality"'
        how += ', good = ["GOOD"]'
    clock = f'sync = {{ robot = "digital-output 0", other = "{SHARED}" }}'
    return [
        *("", "[[sources]]", 'path = "session_*/plc.csv"', 'role = "events"', 'adapter = "csv"'),
        *(clock, f"map = {{ {how} }}"),
    ]
