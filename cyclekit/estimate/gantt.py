"""Estimates as a time chart: a block per sequence with the robot's tasks and, where known, the operator."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from cyclekit.estimate.result import AWAY, ELSEWHERE, MAJORITY, OF_STATES, CycleEstimate, PlannedShare, TaskShare
from cyclekit.plots import colours
from cyclekit.plots.gantt import Arrow, Bar, BarLabel, Block, Layer, TaskEnds, draw_gantt
from cyclekit.text.numbers import fixed, given, span, whole_percent
from cyclekit.text.plain_text import shown_task

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.plots.drawing import Drawing

_MOTION, _DWELL, _WAIT = "motion at full speed", "dwell", "wait"
_ROBOT, _OPERATOR, _TAKT = "robot's task", "operator's task", "takt"
_SPEEDS = (0.75, 0.5, 0.25)
"""Mean speeds whose colours the legend shows."""
SHOWN_S = 0.2
"""Minimum wait that is drawn, s."""
ALWAYS = 0.995
"""From this share of the cycles on, what ended a wait is given without the share."""
_TINTS = ("#0f7b6c", "#56aa9d", "#a3d1c9")
"""Colours of the operator's most frequent activities, in descending order; all others share one colour."""
_OTHER, _AWAY = "#d8ebe7", "#ffffff"
_REST = "other places"


class _Ended(NamedTuple):
    """End of a task, s: the mean, and its interval in single cycles."""

    name: str
    end_s: float
    low_s: float | None
    high_s: float | None


def write_gantt(path: Path, found: Sequence[CycleEstimate]) -> None:
    """Draw estimates (mean times), one sequence above the other on a common time axis.

    Args:
        path: File to write, `.svg`, `.png` or `.pdf`.
        found: The estimates.
    """
    takt_s = found[0].takt_s if found else None
    draw_gantt(path, blocks_of(found), legend_of(found, takt_s), takt_s)


def gantt_figure(found: Sequence[CycleEstimate]) -> Drawing:
    """Return the time chart of estimates as a figure."""
    from cyclekit.plots.results import chart_figure

    takt_s = found[0].takt_s if found else None
    return chart_figure(blocks_of(found), legend_of(found, takt_s), takt_s)


def legend_of(found: Sequence[CycleEstimate], takt_s: float | None = None) -> dict[str, str]:
    """Return colour by meaning for a chart of estimates, for the meanings that it shows."""
    drawn = {bar.colour for block in blocks_of(found) for bar in block.bars}
    split = any(not _of_lists(each) for each in found)
    legend = {_MOTION: colours.NOMINAL} if split else {_ROBOT: colours.NOMINAL}
    if any(share.safety_loss_s > 0.0 for each in found if not _of_lists(each) for share in each.tasks):
        first, *others = _SPEEDS
        legend[f"slow-down to a mean speed of {whole_percent(first)}"] = colours.scaling_hex(first)
        legend |= {whole_percent(speed): colours.scaling_hex(speed) for speed in others}
    known = {_DWELL: colours.DWELL, _WAIT: colours.WAIT, _OPERATOR: colours.OPERATOR}
    legend |= {text: colour for text, colour in known.items() if colour in drawn}
    known = {name: colour for name, colour in _operator_colours(found).items() if name != AWAY}
    legend |= {name if name.startswith(OF_STATES) else f"operator at {name}": known[name] for name in known}
    return legend | ({f"{_TAKT} {given(takt_s)} s": colours.SCALING_ANCHORS[0][1]} if takt_s is not None else {})


def blocks_of(found: Sequence[CycleEstimate]) -> list[Block]:
    """Return the blocks of a time chart of estimates."""
    tints = _operator_colours(found)
    return [_of_plan(each, tints) if each.plan else _of_tasks(each, tints) for each in found]


def _of_lists(each: CycleEstimate) -> bool:
    """Return whether an estimate is of task lists, without motions."""
    return bool(each.plan) and not each.tracks


def _of_tasks(each: CycleEstimate, tints: Mapping[str, str]) -> Block:
    bars, labels, at_s, ended = list[Bar](), list[BarLabel](), 0.0, list[_Ended]()
    for number, share in enumerate(each.tasks, start=1):
        parts = _parts(share, 0, at_s, at_s + share.expected_s, f"{number} {shown_task(share.task)}")
        end_s = max((bar.end_s for bar in parts), default=at_s)
        labels.append(BarLabel(0, at_s, end_s, _texts(share.task, number)))
        bars += parts
        ended.append(_Ended(shown_task(share.task), end_s, share.end_low_s, share.end_high_s))
        at_s = end_s
    layers = _layers(each, tints)
    return Block(_titles(each), ("robot",), tuple(bars), tuple(labels), (), _course(ended), layers, "operator")


def _parts(share: TaskShare, lane: int, start_s: float, end_s: float, row: str) -> list[Bar]:
    """Return the bars of a robot task: motion, slow-down in the colour of the mean speed, dwell, wait."""
    motion_s = share.nominal_s + share.safety_loss_s
    speed = share.nominal_s / motion_s if motion_s > 0.0 else 1.0
    slow = colours.scaling_hex(min(max(speed, 0.0), 1.0))
    parts = [
        (share.nominal_s, colours.NOMINAL, "motion at full speed"),
        (share.safety_loss_s, slow, f"slow-down (mean speed {whole_percent(speed)})"),
        (share.dwell_s, colours.DWELL, _DWELL),
        (share.wait_s, colours.WAIT, _WAIT),
    ]
    whole_s = sum(max(part_s, 0.0) for part_s, _, _ in parts)
    bars, at_s = list[Bar](), start_s
    for part_s, colour, what in parts:
        if part_s > 0.0:
            long_s = (end_s - start_s) * part_s / whole_s
            tip = f"{row}: {what} {fixed(part_s, 1)} s ({whole_percent(part_s / whole_s)} of the task)"
            bars.append(Bar(lane, at_s, at_s + long_s, colour, colour == colours.WAIT, tip, row))
            at_s += long_s
    return bars


def _of_plan(each: CycleEstimate, tints: Mapping[str, str]) -> Block:
    agents = _agents(each.plan)
    lane = {agent: number for number, agent in enumerate(agents)}
    layers = _layers(each, tints)
    lane |= {"operator": len(agents)} if layers else {}
    bars, arrows, labels = list[Bar](), list[Arrow](), list[BarLabel]()
    shares, turn, rests = _shares_of(each), Counter[str](), _rests(each.plan)
    for number, task in enumerate(each.plan):
        turn[task.agent] += not task.rest
        at, row = lane[task.agent], f"{task.agent}: {turn[task.agent]} {shown_task(task.task)}"
        if task.wait_s > SHOWN_S:
            bars.append(_wait(task, at, row))
            if arrow := _arrow(task, each, lane):
                arrows.append(arrow)
            else:
                labels.append(BarLabel(at, task.start_s - task.wait_s, task.start_s, _until(task, lane)))
        if number in shares:
            bars += _parts(shares[number], at, task.start_s, task.end_s, row)
        else:
            colour = colours.NOMINAL if task.kind == "robot" else colours.OPERATOR
            tip = f"{row}: {span(task.start_s, task.end_s, 1)} s"
            bars.append(Bar(at, task.start_s, task.end_s, colour, tip=tip, row=row))
        if not task.rest:
            end_s = each.plan[rests[number]].end_s if number in rests else task.end_s
            labels.append(BarLabel(at, task.start_s, end_s, _texts(task.task, turn[task.agent])))
    ends = [
        _Ended(f"{one.agent}: {shown_task(one.task)}", one.end_s, one.end_low_s, one.end_high_s)
        for number, one in enumerate(each.plan)
        if number not in rests
    ]
    parts = tuple(bars), tuple(labels), tuple(arrows), _course(ends), layers
    return Block(_titles(each), tuple(agents), *parts, "operator")


def _rests(plan: Sequence[PlannedShare]) -> dict[int, int]:
    """Return, of each task in which the agent waits on its way, the number of its rest in the plan."""
    last, found = dict[str, int](), dict[int, int]()
    for number, task in enumerate(plan):
        if task.rest:
            found[last[task.agent]] = number
        last[task.agent] = number
    return found


def _wait(task: PlannedShare, lane: int, row: str) -> Bar:
    """Return the bar of the wait before a task, or on the way of one."""
    cause, share = task.ended_by or ("", 0.0)
    until = f", until {shown_task(cause)}" if cause else ""
    until += f" (in {whole_percent(share)} of the cycles)" if 0.0 < share < ALWAYS else ""
    where = "on the way to" if task.rest else "before"
    name = shown_task(task.task.rpartition("->")[2] if task.rest else task.task)
    tip = f"{task.agent} waits {fixed(task.wait_s, 1)} s {where} {name}{until}"
    return Bar(lane, task.start_s - task.wait_s, task.start_s, colours.WAIT, waits=True, tip=tip, row=row)


def _until(task: PlannedShare, lane: Mapping[str, int]) -> tuple[str, ...]:
    """Return the label of a wait whose end no arrow shows: the signal, or the planned start."""
    cause, _ = task.ended_by or ("", 0.0)
    agent, _, name = cause.rpartition(": ")
    return (f"until {name}",) if cause and agent not in lane else ()


def _arrow(task: PlannedShare, each: CycleEstimate, lane: Mapping[str, int]) -> Arrow | None:
    """Return the arrow from what ended a wait; None if no lane shows it.

    If the tasks of the other agent have no times of their own, it comes from his lane, at the end of the wait.
    """
    cause, share = task.ended_by or ("", 0.0)
    agent = cause.partition(": ")[0]
    if agent not in lane or agent == task.agent:
        return None
    ended_s = _ended_s(task, each.plan, leaves=not _of_lists(each))
    seldom = share < MAJORITY
    return Arrow(lane[agent], lane[task.agent], min(ended_s or task.start_s, task.start_s), task.start_s, seldom)


def _agents(plan: Sequence[PlannedShare]) -> list[str]:
    """Return the agents of a plan, robots first."""
    kinds = {task.agent: task.kind for task in plan}
    return sorted(kinds, key=lambda agent: kinds[agent] != "robot")


def _shares_of(each: CycleEstimate) -> dict[int, TaskShare]:
    """Return the known splits of the robot's tasks by number in the plan, without waits.

    If the robot waits on its way, the motion until then and the rest have the mean speed of the task; dwell is of the
    rest.
    """
    found, turn, rests = dict[int, TaskShare](), Counter[str](), _rests(each.plan)
    for number, task in enumerate(each.plan):
        mine = [share for share in each.tasks if share.task == task.task]
        if task.kind != "robot" or task.rest or not mine or _of_lists(each):
            continue
        share = mine[min(turn[task.task], len(mine) - 1)]
        turn[task.task] += 1
        motion_s = share.nominal_s + share.safety_loss_s
        if motion_s <= 0.0:
            continue
        part = min((task.end_s - task.start_s) / motion_s, 1.0) if number in rests else 1.0
        found[number] = _moving(share, part, 0.0 if number in rests else share.dwell_s)
        if number in rests:
            found[rests[number]] = _moving(share, 1.0 - part, share.dwell_s)
    return found


def _moving(share: TaskShare, part: float, dwell_s: float) -> TaskShare:
    """Return a part of the motion of a task, with a dwell."""
    return TaskShare(share.task, 0.0, part * share.nominal_s, part * share.safety_loss_s, dwell_s, 0.0)


def _ended_s(task: PlannedShare, plan: Sequence[PlannedShare], *, leaves: bool) -> float | None:
    """Return when the other agent's task that ended a wait was done, or left, s; None if the plan has no such task.

    It is the last of that name that had ended by then, else the last that had begun. With `leaves` the agents wait at
    places: one that has to wait after a task leaves much later than it is done, and that it left ended the wait. In
    task lists the end of the task does.
    """
    cause, _ = task.ended_by or ("", 0.0)
    rests = _rests(plan)
    able = [n for n, one in enumerate(plan) if f"{one.agent}: {one.task}" == cause and n not in rests]
    until_s = task.start_s + SHOWN_S
    ended = [n for n in able if plan[n].end_s <= until_s] or [n for n in able if plan[n].start_s < task.start_s]
    last = max(ended, key=lambda n: plan[n].end_s, default=None)
    if last is None:
        return None
    if not leaves:
        return plan[last].end_s
    left_s = next((one.start_s for one in plan[last + 1 :] if one.agent == plan[last].agent), None)
    return plan[last].end_s if left_s is None or left_s > until_s else left_s


def _course(ended: Sequence[_Ended]) -> TaskEnds | None:
    """Return the number of tasks done over time, in the order of their ends; None for a single task."""
    if len(ended) < 2:
        return None
    ended = sorted(ended, key=lambda each: each.end_s)
    low, high = (sorted(s for s in some if s is not None) for some in zip(*(each[2:] for each in ended), strict=True))
    known = len(low) == len(high) == len(ended)
    tips = []
    for done, each in enumerate(ended, start=1):
        band = f"; in single cycles {span(each.low_s, each.high_s, 1)} s" if known else ""
        tips.append(f"{done} of {len(ended)} tasks done, {each.name}: {fixed(each.end_s, 1)} s{band}")
    band_s = (tuple(low), tuple(high)) if known else ((), ())
    return TaskEnds(tuple(each.end_s for each in ended), *band_s, tuple(tips))


def _titles(each: CycleEstimate) -> tuple[str, ...]:
    mean = f"{each.name}: {fixed(each.expected_s, 1)} s"
    levels = sorted(each.quantiles_s)
    if len(levels) < 2:
        return (mean, each.name)
    low, high = levels[0], levels[-1]
    cycles = f"{whole_percent(high - low)} of cycles {span(each.quantiles_s[low], each.quantiles_s[high], 1)} s"
    return (f"{mean} ({cycles})", mean, each.name)


def _texts(task: str, number: int) -> tuple[str, ...]:
    """Return the labels of a task, longest first: number and goal, number."""
    return f"{number} {task.rpartition('->')[2]}", str(number)


def _families(each: CycleEstimate) -> dict[str, tuple[float, ...]]:
    """Return the operator's activities, with numbered tasks (`shelf_1`, `shelf_2`) merged if there are others."""
    found: dict[str, tuple[float, ...]] = {}
    stems = {
        name: re.sub(r"[ _-]?\d+$", "", name) or name for name in each.operator_at if name not in (AWAY, ELSEWHERE)
    }
    if len(set(stems.values())) < 2:
        return dict(each.operator_at)
    for name, parts in each.operator_at.items():
        stem = stems.get(name, name)
        found[stem] = tuple(map(sum, zip(found[stem], parts, strict=True))) if stem in found else parts
    return found


def _operator_colours(found: Sequence[CycleEstimate]) -> dict[str, str]:
    """Return colours of the operators' activities, the same in all blocks: most frequent first, one for the rest."""
    total = Counter[str]()
    for each in found:
        total.update({name: sum(parts) for name, parts in _families(each).items()})
    named = [name for name, _ in total.most_common() if name not in (AWAY, ELSEWHERE)]
    tints = dict(zip(named, _TINTS, strict=False))
    if len(named) > len(_TINTS) or ELSEWHERE in total:
        tints[_REST] = _OTHER
    return tints | ({AWAY: _AWAY} if AWAY in total else {})


def _layers(each: CycleEstimate, tints: Mapping[str, str]) -> tuple[Layer, ...]:
    families = _families(each)
    if not families or set(families) <= {ELSEWHERE}:
        return ()
    rest = [parts for name, parts in families.items() if name not in tints]
    merged = {name: parts for name, parts in families.items() if name in tints}
    if rest:
        merged[_REST] = tuple(map(sum, zip(*rest, strict=True)))
    said = {name: "" if name.startswith(OF_STATES) else "operator at or on the way to " for name in merged}
    part = {name: f"{whole_percent(_mean(parts))} of the time" for name, parts in merged.items()}
    return tuple(
        Layer(merged[name], each.expected_s, tint, f"{said[name]}{name}: {part[name]}")
        for name, tint in tints.items()
        if name in merged
    )


def _mean(parts: Sequence[float]) -> float:
    return sum(parts) / max(len(parts), 1)
