"""Writes the plots and lanes over time: scaling, distance, TCP speed, path phase, time accounting, tasks, text.

A lane shows states as coloured text, a plot shows numbers; unknown values leave a gap. `layout` arranges them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import rerun as rr

from cyclekit.dataset.lost_time import CAUSE_NAMES
from cyclekit.plots import colours
from cyclekit.replay.phase import TASK
from cyclekit.replay.time_accounting import ACCOUNTS, time_accounting
from cyclekit.replay.words import LogLine, lanes, log_lines, miss_lines, summary
from cyclekit.text.numbers import whole_percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.replay.execution import ReplayedExecution
    from cyclekit.replay.sink import Sink

MAX_JOINTS = 8
HUES = ("#3f8fe0", "#f2b53c", "#62c4b4", "#e6a4ff")
"""Colours of the curves of the first, second, ... execution on the viewer's dark background."""
HUE_NAMES = ("blue", "amber", "green", "violet")

PALE = "#c9d1da"
_LOOKS = {"nominal": "#3f8fe0", "safety": colours.SAFETY, "dwell": "#9aa5b1", "wait": "#e8ebef", "unknown": "#6b7480"}
_WORDS = {"nominal": "motion at full speed", "safety": "safety slow-down", "dwell": "dwell", "wait": "wait"}
_HUE_NAMES = {"nominal": "blue", "safety": "orange", "dwell": "grey", "wait": "white", "unknown": "dark"}


def log_curves(sink: Sink, number: int | None = None) -> None:
    """Write plots, lanes and text of one execution.

    Args:
        sink: Destination.
        number: Index of the execution, from 0; None for a single one.
    """
    run = sink.run
    who = "" if number is None else f"{run.name}: "
    hue = HUES[(number or 0) % len(HUES)]
    logged = np.where(run.inferred, np.nan, run.scaling)
    inferred = np.where(run.inferred, run.scaling, np.nan)
    predicted = "#e6a4ff" if number is None else hue
    series = [
        ("plots/scaling/logged", "logged", hue, logged, 3.0),
        ("plots/scaling/inferred", "inferred", "#62c4b4" if number is None else hue, inferred, 3.0),
        ("plots/scaling/predicted", "predicted", predicted, run.predicted, 1.5),
        ("plots/distance", "robot to operator", PALE if number is None else hue, run.distance_m, None),
        ("plots/speed", "tool speed", PALE if number is None else hue, run.speed_m_s, None),
    ]
    for path, label, colour, values, steps in series:
        if values is not None:
            _curve(sink, path, f"{who}{label}", colour, run.t_s, values, steps=steps)
    _phase(sink, who, hue)
    _accounts(sink, who, hue, alone=number is None)
    _joints(sink)
    _lanes(sink)
    sink.static("summary", rr.TextDocument(summary(run), media_type=rr.MediaType.MARKDOWN))
    _text(sink, "log", log_lines(run))
    _text(sink, "misses", miss_lines(run))


def _curve(
    sink: Sink,
    path: str,
    label: str,
    colour: str,
    t_s: NDArray[np.float64],
    values: NDArray[np.float64],
    *,
    steps: float | None = None,
) -> None:
    """Write one curve, with `steps` a step function of that line width; NaN interrupts the line.

    Leading and trailing NaN are left out, runs of NaN reduced to one.
    """
    known = np.isfinite(values)
    if not known.any():
        return
    keep = known | np.append(known[:-1], False) | np.append(False, known[:-1])
    mode: Literal["StepAfter", "Linear"] = "StepAfter" if steps else "Linear"
    paint = [colours.to_rgb(colour)]
    sink.static(path, rr.SeriesLines(colors=paint, widths=[steps or 2.0], names=[label], interpolation_mode=mode))
    sink.columns(path, t_s[keep], rr.Scalars.columns(scalars=values[keep]))


def _phase(sink: Sink, who: str, hue: str) -> None:
    if sink.phase is not None:
        _curve(sink, "plots/phase", f"{who}progress of the task", hue, sink.run.t_s, (sink.phase % TASK) / (TASK - 1))


def spent_words(run: ReplayedExecution) -> list[tuple[str, str]]:
    """Return the names of the curves of the time accounting, and the names of their colours."""
    spent = time_accounting(run)
    short = {"nominal": "full speed", "safety": "slow-down"}
    return [(short.get(name, name), _HUE_NAMES[name]) for name in ACCOUNTS if spent[name][-1] > 0]


def _accounts(sink: Sink, who: str, hue: str, *, alone: bool) -> None:
    """Write cumulated seconds per account; of several executions, per task, as their orders may differ."""
    run = sink.run
    if not np.isfinite(run.scaling).any():
        return
    spent = time_accounting(run)
    for name in ACCOUNTS if alone else ():
        if spent[name][-1] > 0:
            _curve(sink, f"plots/spent/{name}", _WORDS.get(name, name), _LOOKS[name], run.t_s, spent[name])
    if not alone:
        starts = np.concatenate([run.t_s[:1], run.tasks["start_s"].to_numpy()])
        began = np.searchsorted(run.t_s, starts[np.searchsorted(starts, run.t_s, side="right") - 1])
        lost = spent["safety"] - spent["safety"][np.minimum(began, len(run.t_s) - 1)]
        _curve(sink, "plots/lost_in_task", f"{who}slow-down in this task", hue, run.t_s, lost)


def _joints(sink: Sink) -> None:
    """Plot the joints that move most, for robots without a logged TCP."""
    joints = sink.run.joints
    if joints is None or np.isfinite(sink.run.robot_m).any():
        return
    spans = {name: float(np.nanmax(v) - np.nanmin(v)) for name, v in joints.angle_rad.items()}
    most = sorted(spans, key=lambda name: -spans[name])[:MAX_JOINTS]
    for name, anchor in zip(most, np.linspace(0.0, 1.0, len(most)), strict=True):
        colour = colours.scaling_hex(float(anchor))
        _curve(sink, f"plots/joints/{name}", name, colour, joints.t_s, joints.angle_rad[name])


def _lanes(sink: Sink) -> None:
    run = sink.run
    speed = [None if np.isnan(value) else whole_percent(value) for value in run.scaling]
    shades = {
        whole_percent(value): colours.scaling_hex(round(float(value), 2)) for value in run.scaling if value == value
    }
    _lane(sink, "lanes/1_robot_speed", _with_gaps(run, speed), {**shades, GAP: "#3a4048"})
    doing = list(zip(run.robot_task, run.moving, strict=True))
    robot = [_doing(run, task, moving) for task, moving in doing]
    ways = zip(robot, doing, strict=True)
    shades = {text: "#5b6673" if task and moving is False else "#8f9cab" for text, (task, moving) in ways if text}
    _lane(sink, "lanes/2_robot", robot, shades)
    human = [None if task is None else run.shown(task) for task in run.human_task]
    if not any(human):
        human = ["seen" if seen else None for seen in np.isfinite(run.human_m[:, 0])]
    names = sorted({text for text in human if text})
    tints = ("#0f7b6c", "#1c9a86", "#0b5f58", "#3aa38f")
    _lane(sink, "lanes/3_operator", human, {name: tints[index % len(tints)] for index, name in enumerate(names)})
    lost = [None if cause is None else CAUSE_NAMES[cause] for cause in run.lost_to]
    _lane(sink, "lanes/4_lost_to", lost, {CAUSE_NAMES[cause]: colour for cause, colour in colours.CAUSES.items()})


GAP = "gap in the log"


def _with_gaps(run: ReplayedExecution, labels: list[str | None]) -> list[str | None]:
    inside = np.zeros(len(labels), dtype=np.bool_)
    for start_s, end_s in run.gaps:
        inside |= (run.t_s > start_s) & (run.t_s < end_s)
    return [GAP if gap else label for gap, label in zip(inside.tolist(), labels, strict=True)]


def _lane(sink: Sink, path: str, labels: Sequence[str | None], shades: dict[str, str]) -> None:
    if not any(labels):
        return
    changes = lanes(labels, sink.run.t_s)
    values = [value for value in shades if value in set(labels)]
    packed = np.array([int(shades[value][1:] + "ff", 16) for value in values], dtype=np.uint32)
    sink.static(path, rr.StateConfiguration(values=values, labels=values, colors=packed))
    states = [text for _, text in changes if text is not None]
    ends = [int(text is not None) for _, text in changes]  # an empty row ends a state
    columns = rr.StateChange.columns(state=states).partition(ends)
    sink.columns(path, np.array([time_s for time_s, _ in changes]), columns)


def _text(sink: Sink, path: str, lines: Sequence[LogLine]) -> None:
    if not lines:
        return
    columns = rr.TextLog.columns(
        text=[line.text for line in lines],
        level=[line.level for line in lines],
        color=np.array([int(line.colour[1:] + "ff", 16) for line in lines], dtype=np.uint32),
    )
    sink.columns(path, np.array([line.t_s for line in lines]), columns)


def _doing(run: ReplayedExecution, task: str | None, moving: bool | None) -> str | None:
    if task is None:
        return None if moving is None else ("moving" if moving else "standstill")
    return run.shown(task) if moving is not False else f"at {run.shown(task.rpartition('->')[2])}"
