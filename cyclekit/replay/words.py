"""Describes an execution as text: its events, and the causes of slow-downs.

Makes the lines of the text log and the summary of the panel from the arrays of `execution`. Does not use rerun.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.plots import colours
from cyclekit.replay.prediction_errors import prediction_errors
from cyclekit.text.numbers import fixed, whole_percent
from cyclekit.text.plain_text import markdown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.replay.execution import ReplayedExecution

SHORTEST_S = 0.25
"""Minimum duration of a listed slow-down or absence of the operator, s."""

MAX_PERIODS = 2
"""A sample counts until the next one, but at most for this number of sampling periods."""

SHOWN = 4
"""Maximum number of slow-downs, and of waits, in the panel."""
FULL = 0.98


@dataclass(frozen=True)
class LogLine:
    """Line of the text log: time (seconds of the execution), text, level (INFO or WARN), and colour."""

    t_s: float
    text: str
    level: str = "INFO"
    colour: str = "#8b96a3"


@dataclass(frozen=True)
class Slowdown:
    """Stretch in which a motion of the robot was slowed.

    Attributes:
        start_s, end_s: Seconds of the execution.
        lowest: Minimum scaling.
        lost_s: Integral of 1 - s, s.
        nearest_m: Minimum distance to the operator, m; NaN = unknown.
        robot_task, human_task: Their most frequent tasks; None = unknown.
    """

    start_s: float
    end_s: float
    lowest: float
    lost_s: float
    nearest_m: float
    robot_task: str | None
    human_task: str | None


def slowdowns(run: ReplayedExecution) -> list[Slowdown]:
    """Return the stretches in which the moving robot was below full speed, by time."""
    slow = (run.scaling < FULL) & np.array([moving is not False for moving in run.moving], dtype=np.bool_)
    found = []
    for first, last in _stretches(slow):
        end_s = float(run.t_s[last + 1]) if last + 1 < len(run.t_s) else float(run.t_s[last])
        if end_s - run.t_s[first] < SHORTEST_S:
            continue
        part = slice(first, last + 1)
        longest_s = MAX_PERIODS * run.period_s
        until_s = np.minimum(np.append(run.t_s[first + 1 : last + 1], end_s), run.t_s[part] + longest_s)
        lost_s = float(np.sum((1.0 - run.scaling[part]) * (until_s - run.t_s[part])))
        found.append(
            Slowdown(
                float(run.t_s[first]),
                end_s,
                float(run.scaling[part].min()),
                lost_s,
                _least(run.distance_m[part]),
                _most(run.robot_task[part]),
                _most(run.human_task[part]),
            )
        )
    return found


def log_lines(run: ReplayedExecution) -> list[LogLine]:
    """Return the events of the execution, by time."""
    lines = [*_task_lines(run), *_operator_lines(run), *_slow_lines(run)]
    for start_s, end_s in run.gaps:
        lines.append(LogLine(start_s, f"Gap in the log: no samples for {fixed(end_s - start_s, 1)} s", "WARN"))
    lines.extend(LogLine(0.0, note, "WARN") for note in run.notes)
    return sorted(lines, key=lambda line: line.t_s)


def miss_lines(run: ReplayedExecution) -> list[LogLine]:
    """Return the stretches in which prediction and log differ most, by time; a click on a time jumps there."""
    lines = []
    for rank, miss in enumerate(prediction_errors(run), start=1):
        doing = f" on {run.shown(miss.robot_task)}" if miss.robot_task else ""
        text = (
            f"#{rank}: logged {whole_percent(miss.logged)}, predicted {whole_percent(miss.predicted)}{doing}, "
            f"operator {fixed(miss.distance_m, 2)} m away; off by {fixed(miss.seconds, 1)} s in "
            f"{fixed(miss.end_s - miss.start_s, 1)} s"
        )
        lines.append(LogLine(miss.t_s, text, "WARN" if rank <= 3 else "INFO", "#e6a4ff"))
    return sorted(lines, key=lambda line: line.t_s)


def summary(run: ReplayedExecution) -> str:
    """Return the panel's text, Markdown: a summary, the costliest slow-downs and waits, and missing data."""
    found, waits = slowdowns(run), _waits(run)
    lost_s = float(run.tasks["safety_loss_s"].sum() or 0.0) or sum(each.lost_s for each in found)
    known = bool(np.isfinite(run.scaling).any())
    parts = [f"{fixed(lost_s, 1)} s lost to safety slow-down"] if known else []
    parts += [f"{fixed(sum(wait.seconds for wait in waits), 1)} s wait"] if waits else []
    head = [f"## {fixed(run.duration_s, 1)} s" + (f", of which {' and '.join(parts)}" if parts else "")]
    if known and not found:
        head.append("Safety never slowed a motion of the robot.")
    if found or waits:
        slow = [_Cost(each.lost_s, each.start_s, _why(run, each)) for each in found]
        worst = [each for some in (slow, waits) for each in sorted(some, key=lambda one: -one.seconds)[:SHOWN]]
        head.append("**Where the time went**")
        head += [
            f"- **{fixed(each.seconds, 1)} s** at {_clock(each.start_s)}: {markdown(each.text)}"
            for each in sorted(worst, key=lambda one: -one.seconds)
        ]
    head.extend(f"- *{markdown(note)}*" for note in run.notes)
    if run.gaps:
        head.append(f"- *{len(run.gaps)} gap(s) in the log, left empty here.*")
    head.append("Colour is the robot's speed: red speed 0 %, amber half speed, blue full speed, grey unknown.")
    return "\n\n".join(head[:2]) + "\n" + "\n".join(head[2:-1]) + f"\n\n{head[-1]}"


def lanes(labels: Sequence[str | None], t_s: NDArray[np.float64]) -> list[tuple[float, str | None]]:
    """Return times and new values at which a label changes; the last entry ends the lane."""
    changes: list[tuple[float, str | None]] = []
    last: str | None = None
    for time_s, label in zip(t_s.tolist(), labels, strict=True):
        if label != last or not changes:
            changes.append((time_s, label))
            last = label
    if changes:
        changes.append((float(t_s[-1]), None))
    return changes


class _Cost(NamedTuple):
    """What took time: seconds, when it began, and why."""

    seconds: float
    start_s: float
    text: str


def _waits(run: ReplayedExecution) -> list[_Cost]:
    """Return the robot's waits at a place, or before it."""
    found = []
    for row in run.tasks.iter_rows(named=True):
        wait_s = row["wait_s"] or 0.0
        if wait_s < SHORTEST_S:
            continue
        before = row["reached_s"] is not None and row["end_s"] - row["arrival_s"] < wait_s
        start_s = row["reached_s"] - run.start_s if before else row["end_s"] - wait_s
        until = f" until {row['waited_for']}" if row["waited_for"] else ""
        text = f"robot waits {'before' if before else 'at'} {run.shown(row['goal_place'])}{until}"
        found.append(_Cost(wait_s, start_s, text))
    return found


def _why(run: ReplayedExecution, slow: Slowdown) -> str:
    speed = f"robot at {whole_percent(slow.lowest)} speed"
    where = f" on {run.shown(slow.robot_task)}" if slow.robot_task else ""
    near = "" if np.isnan(slow.nearest_m) else f", operator {fixed(slow.nearest_m, 2)} m away"
    doing = f" ({run.shown(slow.human_task)})" if slow.human_task else ""
    return f"{speed}{where}{near}{doing}"


def _slow_lines(run: ReplayedExecution) -> Iterator[LogLine]:
    for slow in slowdowns(run):
        text = f"SLOWED for {fixed(slow.end_s - slow.start_s, 1)} s, {fixed(slow.lost_s, 1)} s lost: {_why(run, slow)}"
        yield LogLine(slow.start_s, text, "WARN", colours.scaling_hex(max(slow.lowest, 0.25)))
        yield LogLine(slow.end_s, "Full speed again", "INFO", "#5b97d8")


def _task_lines(run: ReplayedExecution) -> Iterator[LogLine]:
    for row in run.tasks.iter_rows(named=True):
        yield LogLine(row["start_s"], f"Robot starts {run.shown(row['task'])}")
        took = row["arrival_s"] - row["start_s"]
        loss = row["safety_loss_s"]
        lost = "" if loss is None else f", {fixed(loss, 1)} s of it slow-down" if loss >= 0.05 else ", no slow-down"
        yield LogLine(
            row["arrival_s"], f"Robot arrives at {run.shown(row['goal_place'])} after {fixed(took, 1)} s{lost}"
        )


def _operator_lines(run: ReplayedExecution) -> Iterator[LogLine]:
    changes = lanes(run.human_task, run.t_s)[:-1]
    for time_s, task in changes:
        if task is not None:
            yield LogLine(time_s, f"Operator: {run.shown(task)}", colour="#2ba08d")
    unseen = np.isnan(run.human_m[:, 0])
    if unseen.all():
        return
    for first, last in _stretches(unseen):
        length_s = float(run.t_s[min(last + 1, len(run.t_s) - 1)] - run.t_s[first])
        if length_s >= SHORTEST_S:
            yield LogLine(float(run.t_s[first]), f"Operator absent or not seen for {fixed(length_s, 1)} s", "WARN")


def _stretches(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of every run of True."""
    out, at = [], 0
    for value, group in itertools.groupby(flags.tolist()):
        length = sum(1 for _ in group)
        if value:
            out.append((at, at + length - 1))
        at += length
    return out


def _least(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else float("nan")


def _most(labels: Sequence[str | None]) -> str | None:
    known = [label for label in labels if label is not None]
    return max(set(known), key=lambda label: (known.count(label), label)) if known else None


def _clock(t_s: float) -> str:
    return f"{fixed(t_s, 1)} s" if t_s < 60 else f"{int(t_s // 60)} min {fixed(t_s % 60, 0)} s"
