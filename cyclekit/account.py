"""Where every second of an execution goes: nominal motion, safety loss, process dwell, waiting.

A task is the motion from one place to the next and the stand at its goal. While it moves, the path's nominal time
advances at the scaling s, so nominal = integral of s, safety loss = integral of (1 - s); an operator's speed slider
takes its own share, and a paused program waits. A robot that has done its work at a place and is not allowed to leave
stands there at s = 0: that tail of the stand is safety loss of the next motion, as far as the stand exceeds the place's
usual dwell. When it arrived and left is the business of `stand`; which executions there are, of `segment`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cyclekit.motion import Part, moving_slider
from cyclekit.stand import fill_nearest
from cyclekit.steps import find_staircase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.motion import Run
    from cyclekit.segment import Execution
    from cyclekit.stand import Stand, Stands

    Vector = NDArray[np.float64]

LEAVING_S = 2.0
"""How soon after a departure the scaling must be known to say whether the robot left slowed."""

VARIES, BLUR_S = 6.0, 0.05
"""A stand is process while it is longer than usual by no more than so many times what short ones differ by, plus
what a stand's length is known to."""
SPARSE = 10
"""Levels are looked for in every tenth row: they are held for seconds."""


@dataclass(frozen=True)
class Leg:
    """One executed task, all times in session seconds; see table TASKS of `schema` for the split.

    Attributes:
        start_row, arrival_row: Rows of the run between which the robot was on its way.
    """

    start_place: str
    goal_place: str
    start_s: float
    arrival_s: float
    end_s: float
    nominal_s: float | None
    slider_loss_s: float | None
    safety_loss_s: float | None
    dwell_s: float
    wait_s: float
    start_row: int
    arrival_row: int


class Dwell(NamedTuple):
    """The process at a place, seconds: how long it takes, and how long at most before the rest is waiting."""

    usual_s: float
    most_s: float


def usual_dwells(executions: Sequence[Execution], stands: Stands) -> dict[str, Dwell]:
    """Return the usual dwell per place: short (the lowest tenth) among the stands that no halt prolonged.

    A stand is process and then, at times, waiting; so the process shows in the short ones, and how much it varies in
    how far they differ. The first and last stand of an execution are not counted: there the robot waits for the next
    cycle.
    """
    seen: dict[str, list[Stand]] = {}
    for execution in executions:
        for visit in execution.visits[1:-1]:
            seen.setdefault(visit.place, []).append(stands[execution.run, visit.first, visit.last])
    dwells = {}
    for place, mine in seen.items():
        unhindered = [stand.lasts_s for stand in mine if not stand.halted]
        shortest = [min(stand.lasts_s for stand in mine)]
        low, middle = np.quantile(unhindered or shortest, (0.1, 0.3)).tolist()
        dwells[place] = Dwell(low, min(low + VARIES * (middle - low) + BLUR_S, 1.5 * low + 0.2))
    return dwells


def halts_at_places(
    runs: Sequence[Run], executions: Sequence[Execution], stands: Stands, slowest: float
) -> list[list[Part]]:
    """Return where the inferred scaling of each run is 0, since a stand was prolonged by a halt and not by waiting.

    From motion alone both look alike. But who halted the robot is still near when it may leave, so it leaves at the
    lowest speed there is; a robot that waited for a part leaves at whatever speed is allowed. A cell that knows only
    halt and full speed cannot be told apart so: there the excess stays waiting.

    Args:
        runs: Runs of inferred scaling.
        executions: Their executions.
        stands: Their stands.
        slowest: Speeds below this are the lowest there is, from `slowest_speed`.

    Returns:
        Of each run, the rows at which it was halted so.
    """
    usual = usual_dwells(executions, stands)
    halts: list[list[Part]] = [[] for _ in runs]
    for execution in executions:
        run = runs[execution.run]
        for visit in execution.visits[1:-1]:
            stand = stands[execution.run, visit.first, visit.last]
            if stand.lasts_s <= usual[visit.place].most_s:
                continue
            times = [stand.arrived_s + usual[visit.place].usual_s, stand.left_s, run.time_at(visit.last) + LEAVING_S]
            begin, left, end = run.row_at(np.array(times)).tolist()
            leaving = run.window(visit.last, end).scaling
            known = leaving[np.isfinite(leaving)]
            if len(known) and float(known[0]) < slowest and begin <= left:
                none = np.zeros(left + 1 - begin)
                halts[execution.run].append(Part(begin, none, none, none.astype(np.int8)))
    return halts


def slowest_speed(scaling: Sequence[NDArray[np.floating[Any]]]) -> float:
    """Return a bound between the lowest and the next level above halt; 0 where there are not two of them.

    Args:
        scaling: Scaling of stretches of motion, in the order of time.
    """
    levels = find_staircase(np.concatenate([values[::SPARSE] for values in scaling] or [np.empty(0)])).levels
    moving = [float(level) for level in levels if level > 0.02]
    return 0.5 * (moving[0] + moving[1]) if len(moving) > 1 else 0.0


def account(run: Run, execution: Execution, stands: Stands, dwells: Mapping[str, Dwell]) -> list[Leg]:
    """Return the tasks of one execution, in order; they follow each other without a gap."""
    visits = execution.visits
    mine = [stands[execution.run, visit.first, visit.last] for visit in visits]
    legs = []
    departure, home = mine[0].left_s, visits[0].place
    for number, (before, visit) in enumerate(pairwise(visits), 1):
        final, stand = visit is visits[-1], mine[number]
        usual, most = dwells.get(visit.place, (0.0, 0.0) if final else (stand.lasts_s, stand.lasts_s))
        arrival, left = stand.process(0.0 if final else usual)
        arrival = max(departure, arrival)
        stood = max(left - arrival, 0.0)
        dwell, wait = (stood, 0.0) if stood <= most else (usual, stood - usual)
        if final:
            dwell, wait = 0.0 if visit.place == home else min(stood, usual), 0.0
        start_row, arrival_row = run.row_at(np.array([departure, arrival])).tolist()
        motion = motion_time(run, departure, arrival)
        legs.append(
            Leg(
                start_place=before.place,
                goal_place=visit.place,
                start_s=departure,
                arrival_s=arrival,
                end_s=arrival + dwell + wait,
                nominal_s=motion.nominal_s,
                slider_loss_s=motion.slider_loss_s,
                safety_loss_s=motion.safety_loss_s,
                dwell_s=dwell,
                wait_s=wait + motion.paused_s,
                start_row=start_row,
                arrival_row=arrival_row,
            )
        )
        departure = arrival + dwell + wait
    return legs


@dataclass(frozen=True)
class Motion:
    """How long a motion takes at full speed and what it lost, seconds; None where the scaling is mostly unknown."""

    nominal_s: float | None
    slider_loss_s: float | None
    safety_loss_s: float | None
    paused_s: float


def motion_time(run: Run, start_s: float, end_s: float) -> Motion:
    """Return where the time of a motion went, from `start_s` to `end_s`; the parts add up to it.

    What a row says holds until the next row. Short unknown stretches take the nearest known scaling. While the program
    is paused nobody is slowed down. A motion at scaling s and slider f advances by s f: what it loses to safety is the
    integral of 1 - s, and to the slider that of s (1 - f).
    """
    first, last = run.row_at(np.array([start_s, end_s])).tolist()
    part = run.window(first, last)
    lasts = np.diff(np.append(part.t_s, end_s))
    lasts[0] -= start_s - part.t_s[0]
    paused = np.zeros(len(lasts), np.bool_)
    for halt in run.halts:
        paused[max(halt.first - first, 0) : max(halt.last + 1 - first, 0)] = True
    paused_s = float(lasts[paused].sum())
    s, lasts = part.scaling[~paused], lasts[~paused]
    known = np.flatnonzero(np.isfinite(s))
    if len(s) == 0 or len(known) < 0.5 * len(s):
        return Motion(None, None, None, paused_s)
    s = fill_nearest(s, known)
    slider = moving_slider(run.slider_at(first, last), last + 1 - first)[~paused]
    slider_loss = float((s * (1.0 - slider)) @ lasts)
    safety_loss = float((1.0 - s) @ lasts)
    return Motion(end_s - start_s - paused_s - slider_loss - safety_loss, slider_loss, safety_loss, paused_s)
