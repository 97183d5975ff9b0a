"""Time account of an execution: nominal motion, safety loss, process dwell, wait.

A task is the motion from one place to the next and the standstill at its goal. In motion, the path's nominal time
advances at the scaling s, so nominal = integral of s and safety loss = integral of (1 - s); the operator's speed slider
is accounted separately, and a paused program counts as wait. If a robot has finished its process but is not allowed to
leave (s = 0), the part of the standstill beyond the usual dwell is safety loss of the next motion; unless it was
already waiting when it was stopped: then it is a wait. Arrival and departure come from `arrivals`, executions from
`executions`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.segmentation.arrivals import BLOCKED, PlaceStandstills, fill_nearest, pauses_within
from cyclekit.segmentation.dwell import Dwell
from cyclekit.segmentation.motion import moving_slider

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.segmentation.executions import Execution, Visit
    from cyclekit.segmentation.stored_run import Run


HALTED_S = 0.2
"""Maximum stop by the safety system, s, at the end of a wait short of a place for its times to be known."""


@dataclass(frozen=True)
class ExecutedTask:
    """One executed task, all times in session seconds; see table TASKS of `schema` for the split.

    `wait_s` includes `pause_s`, the time in which the program was paused or stopped, and the wait short of the goal,
    from `reached_s` to `went_on_s`; these are None without such a waiting position, or after a stop there. `cut`: the
    robot stood at least so long, as the log or the execution ends; without an arrival it stood short of the goal.
    """

    start_place: str
    goal_place: str
    start_s: float
    arrival_s: float | None
    end_s: float
    nominal_s: float | None
    slider_loss_s: float | None
    safety_loss_s: float | None
    dwell_s: float
    wait_s: float
    pause_s: float
    reached_s: float | None = None
    went_on_s: float | None = None
    cut: bool = False

    @property
    def moves_until_s(self) -> float:
        """When it arrives; without an arrival, when the log ends."""
        return self.end_s if self.arrival_s is None else self.arrival_s


def time_account(
    run: Run, execution: Execution, standstills: PlaceStandstills, dwells: Mapping[str, Dwell]
) -> list[ExecutedTask]:
    """Return the tasks of one execution, in order, without gaps between them.

    It ends with the process at its last place; if the end of the log cuts it, with the log: the robot stood at least so
    long.
    """
    visits = execution.visits
    mine = [standstills[execution.run, visit.first, visit.last] for visit in visits]
    tasks = []
    departure, home = mine[0].left_s, visits[0].place
    for number, (before, visit) in enumerate(pairwise(visits), 1):
        final, standstill = visit is visits[-1] and not execution.cut, mine[number]
        lasts_s = 0.0 if final else standstill.lasts_s
        process = dwells.get(visit.place, Dwell(lasts_s, lasts_s)).of(execution)
        usual, most = process.usual_s, process.max_s
        arrival, left = standstill.times(0.0) if final else standstill.times(usual, process.ready_s(standstill))
        if process.excess_from_s(standstill._replace(left_s=standstill.departed_earliest_s)) is not None:
            left = standstill.left_s  # it was waiting when it was stopped, and the wait may have continued
        arrival = max(departure, arrival)
        stood = max(left - arrival, 0.0)
        dwell, wait = (stood, 0.0) if stood <= most else (usual, stood - usual)
        if final:
            dwell, wait = 0.0 if visit.place == home else min(stood, usual), 0.0
        short = _short_of(run, visit)
        motion = motion_time(run, departure, arrival, short)
        tasks.append(
            ExecutedTask(
                start_place=before.place,
                goal_place=visit.place,
                start_s=departure,
                arrival_s=arrival,
                end_s=arrival + dwell + wait,
                nominal_s=motion.nominal_s,
                slider_loss_s=motion.slider_loss_s,
                safety_loss_s=motion.safety_loss_s,
                dwell_s=dwell,
                wait_s=wait + motion.paused_s + motion.waited_s,
                pause_s=motion.paused_s + min(wait, paused_time(run, arrival, arrival + stood)),
                reached_s=short.reached_s if short is not None and not short.halted else None,
                went_on_s=short.went_on_s if short is not None and not short.halted else None,
                cut=final or visit.last == run.rows - 1,
            )
        )
        departure = arrival + dwell + wait
    if execution.waits is not None:
        place, first, last = execution.waits
        reached_s, end_s = run.time_at(first), run.time_at(last)
        waited_s, paused_s = end_s - reached_s, paused_time(run, reached_s, end_s)
        unknown = (None, end_s, None, None, None, 0.0)  # how long the motion to the goal takes
        tasks.append(
            ExecutedTask(visits[-1].place, place, departure, *unknown, waited_s, paused_s, reached_s, cut=True)
        )
    return tasks


def paused_time(run: Run, start_s: float, end_s: float) -> float:
    """Return the time within `start_s` to `end_s` in which the program was paused or stopped, s."""
    spans = pauses_within(run, *run.row_at(np.array([start_s, end_s])).tolist())
    return sum(max(0.0, min(last, end_s) - max(first, start_s)) for first, last in spans)


@dataclass(frozen=True)
class Motion:
    """Time of a motion at full speed and its losses, s; None if the scaling is mostly unknown."""

    nominal_s: float | None
    slider_loss_s: float | None
    safety_loss_s: float | None
    paused_s: float
    waited_s: float = 0.0


class _Short(NamedTuple):
    """A standstill short of a place: start, end, and whether the safety system stopped the robot at the end."""

    reached_s: float
    went_on_s: float
    halted: bool


def _short_of(run: Run, visit: Visit) -> _Short | None:
    """Return the robot's wait on its way to a place, without a stop by the safety system at its end."""
    if visit.reached is None:
        return None
    first, last = visit.reached
    reached_s = run.time_at(first)
    if last == first:
        return _Short(reached_s, reached_s, False)
    part = run.window(first, last)
    free = np.flatnonzero(~(part.scaling <= BLOCKED))
    went_on_s = float(part.t_s[free[-1]]) + run.period_s if len(free) else reached_s
    return _Short(reached_s, went_on_s, run.time_at(last) - went_on_s > HALTED_S)


def motion_time(run: Run, start_s: float, end_s: float, short: _Short | None = None) -> Motion:
    """Return the time account of a motion from `start_s` to `end_s`; the parts add up to its duration.

    The values of a row hold until the next row. Unknown scaling is filled with the nearest known one. While the program
    is paused, nothing is lost to slow-downs. A motion at scaling s and slider f advances by s f: the loss to safety is
    the integral of 1 - s, the loss to the slider that of s (1 - f).
    """
    first, last = run.row_at(np.array([start_s, end_s])).tolist()
    part = run.window(first, last)
    lasts = np.diff(np.append(part.t_s, end_s))
    lasts[0] -= start_s - part.t_s[0]
    paused = np.zeros(len(lasts), np.bool_)
    for halt in run.halts:
        paused[max(halt.first - first, 0) : max(halt.last + 1 - first, 0)] = True
    paused_s, waited_s = float(lasts[paused].sum()), 0.0
    if short is not None:
        waits = ~paused & (part.t_s >= short.reached_s) & (part.t_s < short.went_on_s - 1e-9)
        waited_s = float(lasts[waits].sum())
        paused |= waits
    s, lasts = part.scaling[~paused], lasts[~paused]
    known = np.flatnonzero(np.isfinite(s))
    if len(s) == 0 or len(known) < 0.5 * len(s):
        return Motion(None, None, None, paused_s, waited_s)
    s = fill_nearest(s, known)
    slider = moving_slider(run.slider_at(first, last), last + 1 - first)[~paused]
    slider_loss = float((s * (1.0 - slider)) @ lasts)
    safety_loss = float((1.0 - s) @ lasts)
    nominal_s = end_s - start_s - paused_s - waited_s - slider_loss - safety_loss
    return Motion(nominal_s, slider_loss, safety_loss, paused_s, waited_s)
