"""Cycles walked step by step: every operator track beside every program, all at the same time.

The program advances along nominal time, in motion at the scaling s(x_r, x_h), while standing at 1. Nothing is assumed
about the shape of s; it is what the network learned. The operator is taken not to react to the robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.program import Program, draw_stands
from cyclekit.estimate.safety import Dynamics, Follower, SafetyModel, scaling_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.estimate.support import Support
    from cyclekit.estimate.tracks import OperatorTracks

    Vector = NDArray[np.float64]
    Whole = NDArray[np.int64]

TIME_STEP_S = 0.1
"""Step of the walk; positions are taken at its middle."""
SUPPORT_EVERY = 4
"""Support is looked up at every so many steps."""
ROWS = 4096
"""Cycles walked at once: a step and its layers stay in the cache."""
AT_ONCE = Dynamics()


@dataclass(frozen=True)
class Rolled:
    """K cycles of one program.

    Attributes:
        duration_s: Shape (K,).
        stands_s: Stand at each task's goal per cycle, shape (K, tasks).
        safety_s: Safety loss per cycle and task, shape (K, tasks).
        by_activity_s: Safety loss per operator activity, mean over cycles, shape (activities + 1,), last = unknown.
        support: Part of the time in logged cells; NaN where it was not asked for.
        spliced: Part of the time on a track that was continued beyond its own log.
        looked_closely: False where it comes from the table of arrivals: `stands_s` and `safety_s` are then means, shape
            (1, tasks), and the activities are not known.
    """

    duration_s: Vector
    stands_s: NDArray[np.float64]
    safety_s: NDArray[np.float64]
    by_activity_s: Vector
    support: float
    spliced: float
    looked_closely: bool = True


def roll_out(
    model: SafetyModel,
    program: Program,
    tracks: OperatorTracks,
    support: Support | None,
    *,
    seed: int = 0,
    dynamics: Dynamics = AT_ONCE,
) -> Rolled:
    """Walk every track beside the program once; a cycle that does not end within its track has duration inf."""
    return next(roll_all(model, [program], tracks, support, seed=seed, dynamics=dynamics))


def roll_all(
    model: SafetyModel,
    programs: Sequence[Program],
    tracks: OperatorTracks,
    support: Support | None,
    *,
    seed: int = 0,
    dynamics: Dynamics = AT_ONCE,
) -> Iterator[Rolled]:
    """Walk every track beside every program, as many programs at once as `ROWS` allows; yield them in order."""
    count = len(tracks.executions)
    at_once = max(1, ROWS // count)
    for first in range(0, len(programs), at_once):
        some = programs[first : first + at_once]
        stands = [draw_stands(program, count, seed) for program in some]
        track = np.tile(np.arange(count), len(some))
        walked = walk(model, some, np.repeat(np.arange(len(some)), count), track, stands, tracks, support, dynamics)
        for number, (program, stand) in enumerate(zip(some, stands, strict=True)):
            yield _of_one(walked, slice(number * count, (number + 1) * count), program, stand, tracks)


@dataclass(frozen=True)
class Walked:
    """N rows, each one program beside one track: duration (N,), loss per task (N, tasks) and activity, looks, splices.

    `known` counts the looks into logged cells, `looked` all looks, `spliced` the steps on continued tracks.
    """

    duration_s: Vector
    safety_s: NDArray[np.float64]
    activity_s: NDArray[np.float64]
    known: Vector
    looked: Vector
    spliced: Vector


def walk(
    model: SafetyModel,
    programs: Sequence[Program],
    which: Whole,
    track: Whole,
    stands_s: Sequence[NDArray[np.float64]],
    tracks: OperatorTracks,
    support: Support | None = None,
    dynamics: Dynamics = AT_ONCE,
) -> Walked:
    """Walk N rows to their ends.

    Args:
        model: The safety function.
        programs: What is run.
        which: Program of each row, shape (N,), ascending.
        track: Track of each row, shape (N,).
        stands_s: Per program, the stands of its rows, shape (rows, tasks), s.
        tracks: The operators.
        support: Where logged positions lie; None leaves `known` and `looked` empty.
        dynamics: How s follows the safety function.
    """
    lines = _Lines(programs, which, stands_s)
    count, samples = len(which), tracks.activity.shape[1]
    duration = np.full(count, np.inf)
    activity_s = np.zeros((count, len(tracks.activities) + 1))
    known, looked, spliced = np.zeros(count), np.zeros(count), np.zeros(count)
    follower = None if dynamics.none else Follower(model, dynamics, count, TIME_STEP_S)
    every, last_s = np.arange(count), np.ones(count)
    for number in range(int((samples - 2) * tracks.step_s / TIME_STEP_S)):
        going = np.flatnonzero(~np.isfinite(duration))
        if not len(going):
            break
        asked = going if follower is None else every
        robot = lines.robot_at(asked, last_s[asked] * TIME_STEP_S / 2)
        human, sample = _human_at(tracks, track[asked], (number + 0.5) * TIME_STEP_S)
        scaling = _follow(model, follower, lines, asked, robot, human)
        last_s[asked] = scaling
        lost, left = lines.advance(going, last_s[going])
        arrives = lines.arrived(going)
        duration[going[arrives]] = (number + 1) * TIME_STEP_S - left[arrives]
        activity_s[going, tracks.activity[track[going], sample]] += lost
        spliced[going] += sample >= tracks.logged[track[going]]
        if support is not None and number % SUPPORT_EVERY == 0:
            known[asked] += support.near_logged(robot, human)
            looked[asked] += 1
    return Walked(duration, lines.safety_s, activity_s, known, looked, spliced)


def _follow(
    model: SafetyModel,
    follower: Follower | None,
    lines: _Lines,
    asked: Whole,
    robot_m: NDArray[np.float64],
    human_m: NDArray[np.float64],
) -> Vector:
    if follower is not None:
        return follower.advance(robot_m, human_m)
    scaling = np.ones(len(asked))
    matters = lines.may_move(asked)  # where a robot stands all through a step nothing is asked
    scaling[matters] = scaling_of(model, robot_m[matters], human_m[matters])
    return scaling


class _Lines:
    """Programs side by side, one row per cycle: where each row is, and what it has lost to safety per task."""

    def __init__(self, programs: Sequence[Program], which: Whole, stands_s: Sequence[NDArray[np.float64]]) -> None:
        legs = max(len(program.tasks) for program in programs)
        ends, rates = np.full((len(programs), 2 * legs + 1), np.inf), np.ones((len(which), legs + 1))
        self._last = np.array([2 * len(program.tasks) for program in programs])[which]
        for number, program in enumerate(programs):
            parts = [part for task in program.tasks for part in (task.nominal_s, task.dwell_s + task.wait_s)]
            ends[number, : len(parts)] = np.cumsum(parts)
            mine = which == number
            rates[mine, : len(program.tasks)] = np.array(parts[1::2]) / stands_s[number]
        self._ends, self._rates, self._which = ends, rates, which
        self._part = np.zeros(len(which), dtype=np.int64)  # even: a motion, odd: the stand after it
        self._at = np.zeros(len(which))
        self.safety_s = np.zeros((len(which), legs))
        self._xyz = np.concatenate([program.xyz_m for program in programs])
        cells = np.array([len(program.xyz_m) for program in programs])
        self._first = (np.cumsum(cells) - cells)[which]
        self._cells = cells[which]
        self._per_s = (cells / np.array([program.length_s for program in programs]))[which]

    def arrived(self, rows: Whole) -> NDArray[np.bool_]:
        """Which rows are at their end."""
        return np.asarray(self._part[rows] == self._last[rows])

    def may_move(self, rows: Whole) -> NDArray[np.bool_]:
        """Which rows are in motion at some time of the next step."""
        part, at = self._part[rows], self._at[rows]
        rest = (self._ends[self._which[rows], part] - at) / np.maximum(self._rates[rows, part // 2], 1e-12)
        return np.asarray((part % 2 == 0) | (rest < TIME_STEP_S))

    def robot_at(self, rows: Whole, ahead_s: Vector) -> NDArray[np.float64]:
        """TCP (N, 3) where the rows will be when their nominal time has advanced by `ahead_s` (N,)."""
        place = np.minimum(self._at[rows] + ahead_s, self._ends[self._which[rows], self._part[rows]])
        cell = np.minimum((place * self._per_s[rows]).astype(np.int64), self._cells[rows] - 1)
        return np.asarray(self._xyz[self._first[rows] + cell])

    def advance(self, going: Whole, scaling: Vector) -> tuple[Vector, Vector]:
        """Go on by TIME_STEP_S; return the safety loss in it and what is left of it at the end, shape (len(going),).

        The step is divided where a motion or a stand ends in it: each has a rate of its own.
        """
        lost, left = np.zeros(len(going)), np.full(len(going), TIME_STEP_S)
        rows = np.arange(len(going))
        while len(rows):
            k, part = going[rows], self._part[going[rows]]
            moving, leg = part % 2 == 0, part // 2
            rate = np.where(moving, scaling[rows], self._rates[k, leg])
            end = self._ends[self._which[k], part]
            to_go = end - self._at[k]
            needs = np.where(to_go <= 1e-9, 0.0, to_go / np.maximum(rate, 1e-12))
            done, spent = needs <= left[rows], np.minimum(needs, left[rows])
            self._at[k] = np.where(done, end, self._at[k] + rate * spent)
            self._part[k] += done
            loss = np.where(moving, (1.0 - rate) * spent, 0.0)
            self.safety_s[k, leg] += loss
            lost[rows] += loss
            left[rows] -= spent
            rows = rows[done & (part + 1 < self._last[k])]
        return lost, left


def _human_at(tracks: OperatorTracks, rows: Whole, t_s: float) -> tuple[NDArray[np.float64], int]:
    sample = int(t_s / tracks.step_s + 1e-9)
    weight = t_s / tracks.step_s - sample
    here, after = tracks.xyz_m[:, sample], tracks.xyz_m[:, sample + 1]
    between = here + (after - here) * weight
    return np.where(np.isnan(between), here, between)[rows], sample


def _of_one(
    walked: Walked, mine: slice, program: Program, stands_s: NDArray[np.float64], tracks: OperatorTracks
) -> Rolled:
    duration = walked.duration_s[mine]
    steps = max(float(np.where(np.isfinite(duration), duration, 0.0).sum()) / TIME_STEP_S, 1.0)
    looked = float(walked.looked[mine].sum())
    return Rolled(
        duration,
        stands_s,
        walked.safety_s[mine, : len(program.tasks)],
        walked.activity_s[mine].mean(axis=0),
        float(walked.known[mine].sum()) / looked if looked else float("nan"),
        float(walked.spliced[mine].sum()) / steps,
    )
