"""`cyclekit simulate`: simulates a cell and writes vendor-format logs with the ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from cyclekit.cli.options import Json, OperatorLog, OperatorXyz, OperatorYaw, Quiet, vector
from cyclekit.cli.terminal import Terminal
from cyclekit.errors import command_line

EXAMPLE = """cyclekit simulate box-picking --out logs --executions 20 --seed 1

\b
Scenes:
  with a tracker     box-picking, pick-and-package, laser-zones, scanner-visits
  of regular people  bench-crew
  without a tracker  scanner-fields, light-curtain, guard-door
  with waits         shared-fixture, handover, fed-line, four-fixtures,
                     machine-tending, two-operators, repeats,
                     shared-zone, mixed-products"""
SCENES = (
    *("box-picking", "pick-and-package", "laser-zones", "scanner-visits", "bench-crew"),
    *("scanner-fields", "light-curtain", "guard-door"),
    *("shared-fixture", "handover", "fed-line", "four-fixtures", "machine-tending", "two-operators", "repeats"),
    *("shared-zone", "mixed-products"),
)
"""Names of the simulator's scenes; the simulator itself is imported only to simulate."""


def _known(scene: str) -> str:
    if scene not in SCENES:
        raise typer.BadParameter(f"{scene!r} is not one of {', '.join(SCENES)}")
    return scene


def simulate(
    scene: Annotated[str, typer.Argument(help="Which cell to simulate; see below.", metavar="SCENE", callback=_known)],
    out: Annotated[Path, typer.Option(help="Folder for the logs.", metavar="LOGS")],
    executions: Annotated[int, typer.Option(min=1, help="How many times the process runs.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
    logs: Annotated[Literal["csv", "mcap"], typer.Option(help="RTDE and Motive CSV files, or ROS 2 bags.")] = "csv",
    robot_rate: Annotated[int, typer.Option(help="Controller rate, Hz: 125 or 500.")] = 125,
    without_override: Annotated[
        bool, typer.Option("--no-override", help="Leave the speed scaling out of the robot log.")
    ] = False,
    delta: Annotated[float, typer.Option(help="Tracker noise, standard deviation per axis, m.")] = 0.0,
    dropout: Annotated[float, typer.Option(help="Share of the tracker frames that are lost, in bursts; 0 to 1.")] = 0.0,
    clock_offset: Annotated[float, typer.Option(help="How far the tracker's clock is behind the robot's, s.")] = 0.0,
    clock_drift: Annotated[float, typer.Option(help="Rate error of the tracker's clock; 50e-6 is 50 ppm.")] = 0.0,
    millimetres: Annotated[bool, typer.Option("--millimetres", help="The tracker writes millimetres.")] = False,
    silent_when_empty: Annotated[
        bool, typer.Option("--silent-when-empty", help="The tracker writes no rows while the operator is absent (CSV).")
    ] = False,
    per_session: Annotated[
        int, typer.Option("--executions-per-session", min=1, help="Executions per logging session.")
    ] = 25,
    rule: Annotated[
        Path | None, typer.Option(help="Rule file: the safety function, in place of the scene's (docs/commands.md).")
    ] = None,
    ramps: Annotated[
        float | None, typer.Option(help="Fastest change of the speed scaling, 1/s; default: the scene's.")
    ] = None,
    ramp_down: Annotated[
        float | None, typer.Option(help="Fastest fall of the speed scaling, 1/s; default: as --ramps.")
    ] = None,
    latency: Annotated[float, typer.Option(help="Reaction time of the safety system, s; 0: the scene's.")] = 0.0,
    hysteresis: Annotated[float, typer.Option(help="Extra distance before the robot speeds up again, m.")] = 0.0,
    hold: Annotated[float, typer.Option(help="For how long the robot stays slow although it may speed up, s.")] = 0.0,
    operator_log: OperatorLog = None,
    operator_xyz: OperatorXyz = None,
    operator_yaw: OperatorYaw = 0.0,
    encoder_noise: Annotated[
        float, typer.Option(help="Noise of the joint angles, standard deviation, rad; a real UR5 shows 2e-5.")
    ] = 0.0,
    pick: Annotated[float | None, typer.Option(help="Process time of picking, s, instead of the scene's.")] = None,
    place: Annotated[float | None, typer.Option(help="Process time of placing, s, instead of the scene's.")] = None,
    causes: Annotated[
        bool,
        typer.Option(
            "--causes",
            help="Also lose time to the speed slider, reduced mode, limits of the path, waits, pauses and stops (CSV).",
        ),
    ] = False,
    coupling: Annotated[
        float,
        typer.Option(min=0, max=1, help="Cells with waits: share of the joint tasks in which robot and operator wait."),
    ] = 1.0,
    pace_drift: Annotated[
        float,
        typer.Option(
            min=0, max=0.9, help="Cells with waits: share by which the operator's walks and work become shorter."
        ),
    ] = 0.0,
    without_signals: Annotated[
        bool, typer.Option("--no-signals", help="Cells with waits: leave buttons and sensors out of the logs.")
    ] = False,
    task_list: Annotated[
        bool, typer.Option("--task-list", help="Cells with waits: log starts and ends of tasks, no positions.")
    ] = False,
    without_operator: Annotated[
        bool, typer.Option("--without-operator", help="Reference run without an operator.")
    ] = False,
    people: Annotated[
        Literal["tracker", "signals", "both", "none"] | None,
        typer.Option(help="What the logs hold of people (CSV); default: the scene's."),
    ] = None,
    plc_trace: Annotated[
        Literal["wide", "long"] | None,
        typer.Option(
            help="Write the signals of people as a PLC's trace: a column per tag, or rows of tag, time and value (CSV)."
        ),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a cell and log it in vendor formats.

    Writes the cell file and the ground truth next to the logs.
    """
    from cyclekit.api.simulate import simulate_logs

    settings: dict[str, object] = {
        "logs": logs,
        "robot_rate_hz": robot_rate,
        "log_override": not without_override,
        "delta_m": delta,
        "dropout": dropout,
        "clock_offset_s": clock_offset,
        "clock_drift": clock_drift,
        "millimetres": millimetres,
        "silent_when_empty": silent_when_empty,
        "executions_per_session": per_session,
        "rule": rule,
        "ramp_down_per_s": ramps if ramp_down is None else ramp_down,
        "ramp_up_per_s": ramps,
        "latency_s": latency,
        "hysteresis_m": hysteresis,
        "hold_s": hold,
        "operator_log": operator_log,
        "operator_yaw_deg": operator_yaw,
        "with_operator": not without_operator,
        "encoder_noise_rad": encoder_noise,
        "pick_s": pick,
        "place_s": place,
        "causes": causes,
        "people": people,
        "plc_trace": plc_trace,
        "coupling": coupling,
        "pace_drift": pace_drift,
        "signals": not without_signals,
        "task_list": task_list,
    }
    if operator_xyz is not None:
        settings["operator_xyz_m"] = vector(operator_xyz)
    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress(f"simulating {scene}") as progress:
        made = simulate_logs(scene, out, executions=executions, seed=seed, settings=settings, progress=progress)
    following = command_line("ingest", made.logs, "--out", "dataset")
    terminal.done(made.to_dict(), f"{made.logs}: {executions} executions of {scene}\nnext: {following}")
