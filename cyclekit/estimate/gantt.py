"""Estimates as a time chart: one lane for the robot of each sequence, and one for the operator of a plan for both."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.plots import colours
from cyclekit.plots.gantt import Arrow, Bar, draw_gantt

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.estimate.result import CycleEstimate, PlannedShare

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
    draw_gantt(path, lanes, bars, arrows, PLAN_LEGEND if any(each.plan for each in found) else LEGEND)


def chart_of(found: Sequence[CycleEstimate]) -> tuple[list[str], list[Bar], list[Arrow]]:
    """Return lanes, bars and arrows of a time chart of estimates."""
    lanes: list[str] = []
    bars: list[Bar] = []
    arrows: list[Arrow] = []
    for each in found:
        if each.plan:
            some, more = _plan(each.plan, len(lanes))
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


def _plan(plan: Sequence[PlannedShare], first: int) -> tuple[list[Bar], list[Arrow]]:
    lane = {agent: first + number for number, agent in enumerate(_agents(plan))}
    bars, arrows = [], []
    for task in plan:
        at = lane[task.agent]
        if task.wait_s > SHOWN_S:
            bars.append(Bar(at, task.start_s - task.wait_s, task.start_s, colours.WAIT, waits=True))
            cause = max(task.decided, key=lambda name: task.decided[name])
            ended = [one for one in plan if f"{one.agent}: {one.task}" == cause and one.end_s <= task.start_s + SHOWN_S]
            if ended:
                last = max(ended, key=lambda one: one.end_s)
                arrows.append(Arrow(lane[last.agent], at, last.end_s, task.start_s))
        colour = colours.NOMINAL if task.kind == "robot" else colours.OPERATOR
        bars.append(Bar(at, task.start_s, task.end_s, colour, task.task))
    return bars, arrows
