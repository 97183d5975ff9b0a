"""CSV logs: UR `record.py`, OptiTrack Motive 1.23 and the operator's buttons.

The robot CSV has one space between fields, CRLF line ends, one row per control cycle, SI units, uptime clock. The
Motive CSV has its five header rows, Y up, rotation before position, empty cells where the body is lost. The button CSV
has `time,signal,value`, in the tracker's clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from cyclekit_sim.fields import Field, events_of
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.session import RobotStates, Session
from cyclekit_sim.tracker import Frames, in_tracker_frame, tracker_time

UPTIME_S = 152.512  # s, controller's clock at the first sample
_GROUPS = ("actual_q", "actual_qd", "actual_TCP_pose", "actual_TCP_speed")
_BODY_ID = "5F1C2A9E0B7D11EFA3C20242AC120002"


def write_robot(path: Path, robot: RobotStates, options: SimulationOptions, *, inputs: bool = False) -> None:
    """Write the controller's measurements as UR's `record.py` does; `inputs`: with the digital inputs."""
    count = len(robot.t_s)
    pose = np.concatenate([robot.tcp_m, robot.rotation_vector], axis=1)
    groups = zip(_GROUPS, (robot.q_rad, robot.qd_rad_s, pose, robot.twist), strict=True)
    columns: dict[str, pl.Series] = {"timestamp": pl.Series(UPTIME_S + robot.t_s)}
    columns |= {f"{name}_{i}": pl.Series(values[:, i]) for name, values in groups for i in range(6)}
    if options.log_outputs:
        columns["actual_digital_output_bits"] = pl.Series(robot.closed)
    if inputs:
        columns["actual_digital_input_bits"] = pl.Series(robot.inputs)
    columns["robot_mode"] = pl.repeat(7, count, eager=True)
    columns["safety_status"] = pl.repeat(1, count, eager=True)
    scaling, slider = robot.scaling, robot.slider
    if options.moves_slider:
        scaling, slider = np.ones(count), np.round(scaling * slider, 2)
    if options.log_override:
        columns["speed_scaling"] = pl.Series(np.where(robot.paused, 0.0, scaling))
    if options.log_override or options.causes is not None:
        columns["target_speed_fraction"] = pl.Series(slider)
    columns["runtime_state"] = pl.Series(np.where(robot.paused, 4, 2))
    if options.log_outputs:
        columns["output_int_register_0"] = pl.Series(robot.execution)
    pl.DataFrame(columns).write_csv(path, separator=" ", line_terminator="\r\n", float_precision=7, quote_style="never")


def write_people(path: Path, bodies: Sequence[Frames], options: SimulationOptions, take: str) -> None:
    """Write a take as exported by Motive 1.23: rigid bodies, Y up."""
    t_s = bodies[0].t_s
    data, anybody = {"frame": pl.Series(np.arange(len(t_s))), "time": pl.Series(t_s)}, np.zeros(len(t_s), dtype=bool)
    for frames in bodies:
        place = in_tracker_frame(frames.xyz_m, options) * (1000.0 if options.millimetres else 1.0)
        half = 0.5 * (frames.heading_rad - np.deg2rad(options.tracker_yaw_deg))
        still, seen = np.zeros(len(half)), ~np.isnan(place[:, 0])
        cells = (still, np.sin(half), still, np.cos(half), place[:, 0], place[:, 2], -place[:, 1])
        for values in cells:
            data[str(len(data))] = pl.Series(np.where(seen, values, np.nan)).fill_nan(None)
        anybody |= seen
    rows = pl.DataFrame(data)
    if options.silent_when_empty:
        rows = rows.filter(pl.Series(anybody))
    with path.open("wb") as log:
        log.write(_motive_header(take, rows.height, options, [one.body for one in bodies]).encode())
        rows.write_csv(log, include_header=False, line_terminator="\r\n", float_precision=6)


def _motive_header(take: str, frames: int, options: SimulationOptions, bodies: Sequence[str]) -> str:
    rate, unit = f"{options.tracker_rate_hz:.6f}", "Millimeters" if options.millimetres else "Meters"
    rows = [
        f"Format Version,1.23,Take Name,{take},Take Notes,,Capture Frame Rate,{rate},Export Frame Rate,{rate},"
        f"Capture Start Time,2025-06-02 08.00.00.000 AM,Total Frames in Take,{frames},Total Exported Frames,{frames},"
        f"Rotation Type,Quaternion,Length Units,{unit},Coordinate Space,Global",
        "",
        ",Type" + ",Rigid Body" * 7 * len(bodies),
        ",Name" + "".join(f",{body}" * 7 for body in bodies),
        ",ID" + "".join(f',"{int(_BODY_ID, 16) + number:032X}"' * 7 for number in range(len(bodies))),
        "," + (",Rotation" * 4 + ",Position" * 3) * len(bodies),
        "Frame,Time (Seconds)" + ",X,Y,Z,W,X,Y,Z" * len(bodies),
    ]
    return "".join(f"{row}\r\n" for row in rows)


def write_events(path: Path, session: Session, options: SimulationOptions) -> None:
    """Write the button presses, in the tracker's clock."""
    events = session.events()
    times = tracker_time(np.array([t_s for t_s, _, _ in events], dtype=np.float64), options)
    columns = {
        "time": pl.Series(times, dtype=pl.Float64),
        "signal": pl.Series([signal for _, signal, _ in events], dtype=pl.String),
        "value": pl.Series([value for _, _, value in events], dtype=pl.String),
    }
    pl.DataFrame(columns).write_csv(path, float_precision=4)


def write_plc(path: Path, session: Session, fields: Sequence[Field]) -> None:
    """Write the signals logged by a PLC at their changes, in the robot's clock."""
    times, names, values = events_of(session, fields)
    columns = {"time": np.array(times) + UPTIME_S, "signal": names, "value": values}
    pl.DataFrame(columns).write_csv(path, float_precision=4)
