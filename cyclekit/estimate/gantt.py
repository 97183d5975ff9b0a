"""Estimates as a time chart: one lane for the robot of each sequence, and one for the operator of a plan for both."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.plots import colours
from cyclekit.plots.gantt import Arrow, Bar, draw_gantt

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.estimate.result import CycleEstimate, PlannedShare
    from cyclekit.plots.drawing import Drawing

LEGEND = {
    "motion at full speed": colours.NOMINAL,
    "slow-down for safety": colours.SAFETY,
    "dwell": colours.DWELL,
    "wait": colours.WAIT,
}
PLAN_LEGEND = {"robot's task": colours.NOMINAL, "operator's task": colours.OPERATOR, "wait": colours.WAIT}
SHOWN_S = 0.2
"""A shorter wait is not drawn."""


def write_gantt(path: Path, found: Sequence[CycleEstimate]) -> None:
    """Draw estimates, mean times, one sequence above the other on a common time axis.

    Args:
        path: File to write, `.svg`, `.png` or `.pdf`.
        found: What is drawn.
    """
    lanes, bars, arrows = chart_of(found)
    draw_gantt(path, lanes, bars, arrows, legend_of(found))


def gantt_figure(found: Sequence[CycleEstimate]) -> Drawing:
    """Return that chart as a figure."""
    from cyclekit.plots.results import chart_figure

    return chart_figure(*chart_of(found), legend_of(found))


def legend_of(found: Sequence[CycleEstimate]) -> dict[str, str]:
    """Return colour by meaning of a chart of estimates."""
    plain, timed, split = {}, {}, {}
    for each in found:
        if not each.plan:
            plain = LEGEND
        elif each.tracks:
            split = LEGEND | {"operator's task": colours.OPERATOR}
        else:
            timed = PLAN_LEGEND
    return plain | timed | split


def chart_of(found: Sequence[CycleEstimate]) -> tuple[list[str], list[Bar], list[Arrow]]:
    """Return lanes, bars and arrows of a time chart of estimates."""
    lanes: list[str] = []
    bars: list[Bar] = []
    arrows: list[Arrow] = []
    for each in found:
        if each.plan:
            some, more = _plan(each, len(lanes))
            arrows += more
            lanes += [f"{each.name}: {agent}" for agent in _agents(each.plan)]
        else:
            some = _tasks(each, len(lanes))
            lanes.append(each.name)
        bars += some
    return lanes, bars, arrows


def _tasks(each: CycleEstimate, lane: int) -> list[Bar]:
    bars, at = [], 0.0
    for task in each.tasks:
        parts = (task.nominal_s, task.safety_loss_s, task.dwell_s, task.wait_s)
        for part_s, colour, text in zip(parts, LEGEND.values(), (task.task, "", "", ""), strict=True):
            if part_s > 0.0:
                bars.append(Bar(lane, at, at + part_s, colour, text, waits=colour == colours.WAIT))
                at += part_s
    return bars


def _agents(plan: Sequence[PlannedShare]) -> list[str]:
    """Return the agents of a plan, robots first."""
    kinds = {task.agent: task.kind for task in plan}
    return sorted(kinds, key=lambda agent: kinds[agent] != "robot")


def _plan(each: CycleEstimate, first: int) -> tuple[list[Bar], list[Arrow]]:
    lane = {agent: first + number for number, agent in enumerate(_agents(each.plan))}
    bars, arrows = [], []
    for task in each.plan:
        at = lane[task.agent]
        if task.wait_s > SHOWN_S:
            bars.append(Bar(at, task.start_s - task.wait_s, task.start_s, colours.WAIT, waits=True))
            if ended := _ended_by(task, each.plan):
                arrows.append(Arrow(lane[ended.agent], at, min(ended.end_s, task.start_s), task.start_s))
        bars += _parts(task, each, at) if task.kind == "robot" else [_whole(task, at, colours.OPERATOR)]
    return bars, arrows


def _ended_by(task: PlannedShare, plan: Sequence[PlannedShare]) -> PlannedShare | None:
    """Return the task of another one that ended a wait: the last of its name that had ended, or had begun."""
    cause = max(task.decided, key=lambda name: task.decided[name])
    able = [one for one in plan if f"{one.agent}: {one.task}" == cause and one.agent != task.agent]
    ended = [one for one in able if one.end_s <= task.start_s + SHOWN_S]
    begun = [one for one in able if one.start_s < task.start_s]
    return max(ended or begun, key=lambda one: one.end_s, default=None)


def _whole(task: PlannedShare, lane: int, colour: str) -> Bar:
    return Bar(lane, task.start_s, task.end_s, colour, task.task)


def _parts(task: PlannedShare, each: CycleEstimate, lane: int) -> list[Bar]:
    """Return the bars of a task of the robot, split where its split is known."""
    share = next((share for share in each.tasks if share.task == task.task), None)
    parts = (share.nominal_s, share.safety_loss_s, share.dwell_s) if share else ()
    if sum(parts) <= 0.0:
        return [_whole(task, lane, colours.NOMINAL)]
    bars, at, times = [], task.start_s, (task.end_s - task.start_s) / sum(parts)
    for part_s, colour, text in zip(parts, LEGEND.values(), (task.task, "", ""), strict=False):
        if part_s > 0.0:
            bars.append(Bar(lane, at, at + times * part_s, colour, text))
            at += times * part_s
    return bars
