"""The cell file that belongs to the logs: the knowledge of an integrator about this cell.

It holds places, roles, frames and the offset between the clocks, but neither the safety function nor the requested
imperfections.
"""

from __future__ import annotations

from collections.abc import Iterable

from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.scenes import Scene
from cyclekit_sim.tracker import lead_s
from cyclekit_sim.write_csv import UPTIME_S
from cyclekit_sim.write_plc import trace_source

_ROBOT_RADIUS_M = 0.05


def cell_file(scene: Scene, options: SimulationOptions, events: bool, inputs: bool) -> str:
    """Return the text of cell.toml; `events`: there are event logs; `inputs`: the robot's log has digital inputs."""
    lines = [f'name = "{scene.name}"', 'ignore = ["truth/*"]']
    if options.task_list:
        return "\n".join(lines) + "\n"
    if options.people in ("tracker", "both"):
        lines.append(f'goal_signals = ["{"/operator/goal" if options.logs == "mcap" else "operator_goal"}"]')
    lines += _bag_sources() if options.logs == "mcap" else _csv_sources(scene, options, events, inputs)
    for name, xyz_m in scene.places.items():
        lines += ["", f"[places.{name}]", f"xyz_m = {_numbers(xyz_m)}", f"radius_m = {_ROBOT_RADIUS_M}"]
    tracked = options.people in ("tracker", "both")
    unknown = options.operator_log or scene.habits or not tracked  # places of people who press no buttons
    stations = {} if unknown else scene.stations
    for name, station in stations.items():
        where = f"xyz_m = {_numbers(station.xyz_m)}"
        lines += ["", f"[human_places.{name}]", where, f"radius_m = {station.radius_m}"]
    for name, (top_m, size_m) in scene.furniture.items():
        lines += ["", f"[furniture.{name}]", f"xyz_m = {_numbers(top_m)}", f"size_m = {_numbers(size_m)}"]
    return "\n".join(lines) + "\n"


def _csv_sources(scene: Scene, options: SimulationOptions, events: bool, inputs: bool) -> list[str]:
    offset = f"clock_offset_s = {UPTIME_S - lead_s(options):.3f}  # this log's time + this = the robot log's time"
    frame = f"frame = {{ xyz_m = {_numbers(options.tracker_xyz_m)}, yaw_deg = {options.tracker_yaw_deg} }}"
    names = 'time = "time", time_unit = "s", signal = "signal", value = "value"'
    how = ('role = "events"', 'adapter = "csv"', offset, f'map = {{ delimiter = ",", {names} }}')
    lines = [
        *("", "[[sources]]", 'path = "session_*/robot.csv"', 'role = "robot"'),
        *(['map = { inputs = "events" }'] if inputs else []),
    ]
    if options.plc_trace is not None:
        lines += trace_source(scene.fields, options.plc_trace)
    elif scene.plc and options.people in ("signals", "both"):
        lines += ["", "[[sources]]", 'path = "session_*/plc.csv"', 'role = "events"', 'adapter = "csv"']
        lines += ["clock_offset_s = 0.0", f'map = {{ delimiter = ",", {names} }}']
    if options.people not in ("tracker", "both"):
        return lines
    return [
        *lines,
        *("", "[[sources]]", 'path = "session_*/operator.csv"', 'role = "people"', offset, frame),
        *(("", "[[sources]]", 'path = "session_*/events.csv"', *how) if events else ()),
    ]


def _bag_sources() -> list[str]:
    return ["", "[[sources]]", 'path = "session_*/*.mcap"']


def _numbers(values: Iterable[float]) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"
