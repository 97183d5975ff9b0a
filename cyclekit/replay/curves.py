"""The plots and lanes on the same timeline: scaling, distance, tool speed, level, tasks.

A lane says in words and colours what held when; a plot says how much. Unknown is a hole in either. The order on the
screen is the business of `layout`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import rerun as rr

from cyclekit import colours
from cyclekit.replay.words import lanes, log_lines, spell, summary

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from cyclekit.replay.execution import Execution

    Times = Callable[[NDArray[np.float64]], list[rr.TimeColumn]]

MOST_JOINTS = 8


def log_curves(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    """Put plots, lanes and text of one execution into `stream`.

    Returns:
        Values written, over all entities.
    """
    rows = 0
    pale = "#c9d1da"
    logged = np.where(run.inferred, np.nan, run.scaling)
    inferred = np.where(run.inferred, run.scaling, np.nan)
    series = [
        ("plots/scaling/logged", "logged", "#3f8fe0", logged),
        ("plots/scaling/inferred", "inferred", "#62c4b4", inferred),
        ("plots/scaling/predicted", "predicted", "#e6a4ff", run.predicted),
        ("plots/distance", "robot to operator", pale, run.distance_m),
        ("plots/speed", "tool speed", pale, run.speed_m_s),
    ]
    for path, label, colour, values in series:
        if values is not None:
            stepped = "scaling" in path
            rows += _log_curve(stream, path, label, colour, run.t_s, values, times, stepped=stepped)
    rows += _log_joints(stream, run, times)
    rows += _log_lanes(stream, run, times)
    return rows + _log_text(stream, run, times)


def _log_curve(
    stream: rr.RecordingStream,
    path: str,
    label: str,
    colour: str,
    t_s: NDArray[np.float64],
    values: NDArray[np.float64],
    times: Times,
    *,
    stepped: bool = False,
) -> int:
    """One curve; NaN breaks the line. Leading and trailing unknowns are left out, runs of them thinned to one."""
    known = np.isfinite(values)
    if not known.any():
        return 0
    keep = known | np.append(known[:-1], False) | np.append(False, known[:-1])
    mode: Literal["StepAfter", "Linear"] = "StepAfter" if stepped else "Linear"
    look = rr.SeriesLines(
        colors=[colours.to_rgb(colour)],
        widths=[1.5 if "predicted" in path else 3.0 if stepped else 2.0],
        names=[label],
        interpolation_mode=mode,
    )
    stream.log(path, look, static=True)
    stream.send_columns(path, times(t_s[keep]), rr.Scalars.columns(scalars=values[keep]))
    return int(keep.sum())


def _log_joints(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    """Without a tool position the joints are all there is of the robot: plot those that move most."""
    if run.joints is None or np.isfinite(run.robot_m).any():
        return 0
    spans = {name: float(np.nanmax(v) - np.nanmin(v)) for name, v in run.joints.angle_rad.items()}
    most = sorted(spans, key=lambda name: -spans[name])[:MOST_JOINTS]
    rows = 0
    for name, anchor in zip(most, np.linspace(0.0, 1.0, len(most)), strict=True):
        colour = colours.scaling_hex(float(anchor))
        rows += _log_curve(
            stream, f"plots/joints/{name}", name, colour, run.joints.t_s, run.joints.angle_rad[name], times
        )
    return rows


def _log_lanes(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    speed = [None if np.isnan(value) else _percent(value) for value in run.scaling]
    shades = {_percent(value): colours.scaling_hex(round(float(value), 2)) for value in run.scaling if value == value}
    robot = [_phase(task, moving) for task, moving in zip(run.robot_task, run.moving, strict=True)]
    human = [None if task is None else spell(task) for task in run.human_task]
    if not any(human):
        human = ["seen" if seen else None for seen in np.isfinite(run.human_m[:, 0])]
    rows = _log_lane(stream, "lanes/1_robot_speed", speed, run.t_s, times, shades)
    robot_shades = {text: "#5b6673" if text.startswith("at ") else "#8f9cab" for text in set(robot) - {None} if text}
    rows += _log_lane(stream, "lanes/2_robot", robot, run.t_s, times, robot_shades)
    names = sorted({text for text in human if text})
    tints = ("#0f7b6c", "#1c9a86", "#0b5f58", "#3aa38f")
    human_shades = {name: tints[index % len(tints)] for index, name in enumerate(names)}
    return rows + _log_lane(stream, "lanes/3_operator", human, run.t_s, times, human_shades)


def _log_lane(
    stream: rr.RecordingStream,
    path: str,
    labels: Sequence[str | None],
    t_s: NDArray[np.float64],
    times: Times,
    shades: dict[str, str],
) -> int:
    if not any(labels):
        return 0
    changes = lanes(labels, t_s)
    values = list(shades)
    packed = np.array([int(shades[value][1:] + "ff", 16) for value in values], dtype=np.uint32)
    stream.log(path, rr.StateConfiguration(values=values, labels=values, colors=packed), static=True)
    at = times(np.array([time_s for time_s, _ in changes]))
    states: Any = [text for _, text in changes]  # None ends a state; rerun's types do not know that it may
    stream.send_columns(path, at, rr.StateChange.columns(state=states))
    return len(changes)


def _log_text(stream: rr.RecordingStream, run: Execution, times: Times) -> int:
    stream.log("summary", rr.TextDocument(summary(run), media_type=rr.MediaType.MARKDOWN), static=True)
    lines = log_lines(run)
    if not lines:
        return 0
    at = times(np.array([line.t_s for line in lines]))
    columns = rr.TextLog.columns(
        text=[line.text for line in lines],
        level=[line.level for line in lines],
        color=np.array([int(line.colour[1:] + "ff", 16) for line in lines], dtype=np.uint32),
    )
    stream.send_columns("log", at, columns)
    return len(lines)


def _percent(scaling: float) -> str:
    return "halted" if scaling < 0.02 else f"{100 * scaling:.0f} %"


def _phase(task: str | None, moving: bool | None) -> str | None:
    if task is None:
        return None if moving is None else ("moving" if moving else "standing")
    return spell(task) if moving is not False else f"at {task.rpartition('->')[2]}"
