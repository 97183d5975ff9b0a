"""Simulation of cycles step by step: every operator track with every program, all at once.

The program advances along nominal time, in motion at the scaling s(x_r, x_h), at standstill at 1. Nothing is assumed
about the form of s; it is what the network learned. The operator is assumed not to react to the robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.robot.program import Program, draw_standstills
from cyclekit.estimate.robot.safety import Dynamics, Follower, Logged, SafetyModel, at_once, is_fast, scaling_in_step

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.schema import Bools, Floats, Ints, Vector


TIME_STEP_S, FINE_STEP_S = 0.2, 0.1
"""Time step of the simulation, s, and the fine one, used if s follows the safety function with delay, ramps or
hysteresis, or if single cycles count more than their mean. The safety function is evaluated at mid-step positions, once
per TIME_STEP_S; once per step if single cycles count or it is a rule, which is fast."""
SUPPORT_EVERY_S = 0.4
"""Time between evaluations of the support, s."""
ROWS = 4096
"""Number of cycles simulated at once: a step and its layers fit into the cache."""
AT_ONCE = Dynamics()


@dataclass(frozen=True)
class Rolled:
    """K cycles of one program.

    Attributes:
        duration_s: Shape (K,).
        standstill_s: Standstill time at each task's goal per cycle, shape (K, tasks).
        safety_s: Safety loss per cycle and task, shape (K, tasks).
        by_activity_s: Safety loss per operator activity, mean over cycles, shape (activities + 1,), last = unknown.
        support: Share of the time in logged cells; NaN if not requested.
        spliced: Share of the time on a track continued beyond its own log.
        simulated: False if the cycles come from the table of arrivals: `standstill_s` and `safety_s` are then means,
            shape (1, tasks), and the activities are unknown.
        own_s: Time of each cycle on the track's own log, without safety loss and the safety loss: (K, 2); None if
            unknown.
    """

    duration_s: Vector
    standstill_s: Floats
    safety_s: Floats
    by_activity_s: Vector
    support: float
    spliced: float
    simulated: bool = True
    own_s: Floats | None = None

    def resampled_means(self, weights: Floats) -> Vector:
        """Return the mean duration in each resample of the logs, shape (resamples,), s.

        Stretches of other executions that continue a track are no new evidence: the spread is that of the safety loss
        per second of undisturbed work on the tracks' own logs.

        Args:
            weights: Weights of the cycles in each resample, shape (resamples, K).
        """
        if self.own_s is None:
            return np.asarray(weights @ self.duration_s)
        base_s, loss_s = self.own_s.T
        lost = self.safety_s.sum(axis=1)
        usual = float(loss_s.sum() / max(base_s.sum(), 1e-9))
        if usual <= 0.0:
            return np.asarray(weights @ self.duration_s)
        rate = (weights @ loss_s) / np.maximum(weights @ base_s, 1e-9)
        return np.asarray(weights @ (self.duration_s - lost) + float(lost.mean()) * rate / usual)


def roll_out(
    model: SafetyModel,
    program: Program,
    tracks: OperatorTracks,
    support: Logged | None,
    *,
    seed: int = 0,
    dynamics: Dynamics = AT_ONCE,
) -> Rolled:
    """Simulate the program once with every track; a cycle that does not end within its track has duration inf."""
    return next(roll_all(model, [program], tracks, support, seed=seed, dynamics=dynamics))


def roll_all(
    model: SafetyModel,
    programs: Sequence[Program],
    tracks: OperatorTracks,
    support: Logged | None,
    *,
    seed: int = 0,
    dynamics: Dynamics = AT_ONCE,
) -> Iterator[Rolled]:
    """Simulate every program with every track, as many programs at once as `ROWS` allows; yield them in order."""
    count = len(tracks.executions)
    drawn: dict[tuple[str, int], Floats] = {}
    at_once = max(1, ROWS // count)
    for first in range(0, len(programs), at_once):
        some = programs[first : first + at_once]
        standstills = [draw_standstills(program, count, seed, drawn) for program in some]
        track = np.tile(np.arange(count), len(some))
        simulated = simulate(
            model, some, np.repeat(np.arange(len(some)), count), track, standstills, tracks, support, dynamics
        )
        for number, (program, stand) in enumerate(zip(some, standstills, strict=True)):
            yield _of_one(simulated, slice(number * count, (number + 1) * count), program, stand, tracks)


@dataclass(frozen=True)
class SimulatedCycles:
    """N simulated cycles, each one program with one track: duration (N,), safety loss per task (N, tasks) and activity.

    `known` counts support evaluations in logged cells, `looked` all of them; `spliced` is the time on continued tracks,
    s; `own_loss_s` the safety loss before that.
    """

    duration_s: Vector
    safety_s: Floats
    activity_s: Floats
    known: Vector
    looked: Vector
    spliced: Vector
    own_loss_s: Vector


def simulate(
    model: SafetyModel,
    programs: Sequence[Program],
    which: Ints,
    track: Ints,
    standstill_s: Sequence[Floats],
    tracks: OperatorTracks,
    support: Logged | None = None,
    dynamics: Dynamics = AT_ONCE,
    *,
    fine: bool = False,
) -> SimulatedCycles:
    """Simulate N cycles to their ends.

    Args:
        model: The safety function.
        programs: The programs.
        which: Program of each row, shape (N,), ascending.
        track: Track of each row, shape (N,).
        standstill_s: Per program, the standstill times of its rows, shape (rows, tasks), s.
        tracks: The operator tracks.
        support: Test for logged positions; None leaves `known` and `looked` at 0.
        dynamics: Response of s to the safety function.
        fine: Use steps of FINE_STEP_S in any case.
    """
    jumps = at_once(model, dynamics)
    step_s = TIME_STEP_S if jumps and not fine else FINE_STEP_S
    states, operators = _ProgramStates(programs, which, standstill_s, step_s), _OperatorPositions(tracks)
    count, samples, kinds = len(which), tracks.activity.shape[1], len(tracks.activities) + 1
    duration, activity_s = np.full(count, np.inf), np.zeros(count * kinds)
    known, looked, spliced, own_loss = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    start = None if tracks.scaling is None else tracks.scaling[track]
    follower = None if jumps else Follower(model, dynamics, step_s, start)
    fast = fine or is_fast(model)
    looks_after, asks_after = round(SUPPORT_EVERY_S / step_s), 1 if fast else round(TIME_STEP_S / step_s)
    rows, mine, scaling = np.arange(count), track, np.ones(count)  # of the cycles that have not ended
    for number in range(int((samples - 2) * tracks.step_s / step_s) - asks_after + 1):
        if number % asks_after == 0:
            robot = states.robot_at(scaling * asks_after * step_s / 2)
            where, doing, sample = operators.at((number + asks_after / 2) * step_s)
            human = where.take(mine, axis=0)
            scaling = scaling_in_step(model, follower, states, robot, human)
        elif follower is not None:
            scaling = follower.go_on()
        lost, left = states.advance(scaling)
        activity_s[rows * kinds + doing[mine]] += lost
        own = sample < tracks.logged[mine]
        spliced[rows] += step_s * ~own
        own_loss[rows] += lost * own
        if support is not None and number % looks_after == 0:
            known[rows] += support.near_logged(robot, human)
            looked[rows] += 1
        arrives = states.arrived
        if arrives.any():
            duration[rows[arrives]] = (number + 1) * step_s - left[arrives]
            rows, mine, scaling = rows[~arrives], mine[~arrives], scaling[~arrives]
            states.keep(~arrives)
            if follower is not None:
                follower.keep(~arrives)
            if not len(rows):
                break
    return SimulatedCycles(
        duration, states.losses(), activity_s.reshape(count, kinds), known, looked, spliced, own_loss
    )


class _ProgramStates:
    """State of all cycles under way, one row each: the position in the program, and the safety loss per task.

    The array of losses has a row for every cycle; all other arrays have one per cycle that has not ended.
    """

    def __init__(self, programs: Sequence[Program], which: Ints, standstill_s: Sequence[Floats], step_s: float) -> None:
        self._step_s = step_s
        legs = max(len(program.tasks) for program in programs)
        ends, rates = np.full((len(programs), 2 * legs + 1), np.inf), np.ones((len(which), legs + 1))
        for number, program in enumerate(programs):
            ends[number, : len(program.edges_s)] = program.edges_s
            standstills = [task.dwell_s + task.wait_s for task in program.tasks]
            rates[which == number, : len(standstills)] = np.array(standstills) / standstill_s[number]
        self._ends, self._rates = ends, rates
        paths = [program.xyz_m() for program in programs]
        self._xyz = np.concatenate(paths)
        self._safety_s = np.zeros((len(which), legs))
        cells = np.array([len(path) for path in paths])
        self._row, self._which = np.arange(len(which)), which
        self._last = np.array([2 * len(program.tasks) for program in programs])[which]
        self._first, self._cells = (np.cumsum(cells) - cells)[which], cells[which]
        self._per_s = (cells / np.array([program.length_s for program in programs]))[which]
        self._part = np.zeros(len(which), dtype=np.int64)  # even: a motion, odd: the standstill after it
        self._at, self._lost = np.zeros(len(which)), np.zeros(len(which))
        self._end, self._moving, self._rate = ends[which, 0], np.ones(len(which), dtype=np.bool_), rates[:, 0]

    @property
    def arrived(self) -> Bools:
        """Which rows have ended."""
        return np.asarray(self._part == self._last)

    @property
    def may_move(self) -> Bools:
        """Which rows move at some time of the next step."""
        rest = (self._end - self._at) / np.maximum(self._rate, 1e-12)
        return np.asarray(self._moving | (rest < self._step_s))

    def keep(self, going: Bools) -> None:
        """Drop all other rows."""
        for name in ("row", "which", "last", "first", "cells", "per_s", "part", "at", "lost", "end", "moving", "rate"):
            setattr(self, f"_{name}", getattr(self, f"_{name}")[going])

    def robot_at(self, ahead_s: Vector) -> Floats:
        """Return the TCP (N, 3) of the rows after their nominal time has advanced by `ahead_s` (N,)."""
        place = np.minimum(self._at + ahead_s, self._end)
        cell = np.minimum((place * self._per_s).astype(np.int64), self._cells - 1)
        return np.asarray(self._xyz.take(self._first + cell, axis=0))

    def advance(self, scaling: Vector) -> tuple[Vector, Vector]:
        """Advance by a step; return the safety loss in it and the time left of it after the end, shape (N,) each.

        The step is divided where a motion or a standstill ends in it, as each has its own rate.
        """
        lost, left = np.zeros(len(scaling)), np.full(len(scaling), self._step_s)
        rows: slice | Ints = slice(None)  # first all rows, then those with time left
        while True:
            end, at, moving = self._end[rows], self._at[rows], self._moving[rows]
            rate = np.where(moving, scaling[rows], self._rate[rows])
            to_go = end - at
            needs = np.where(to_go <= 1e-9, 0.0, to_go / np.maximum(rate, 1e-12))
            done, spent = needs <= left[rows], np.minimum(needs, left[rows])
            self._at[rows] = np.where(done, end, at + rate * spent)
            loss = np.where(moving, (1.0 - rate) * spent, 0.0)
            self._lost[rows] += loss
            lost[rows] += loss
            left[rows] -= spent
            ended = np.flatnonzero(done) if isinstance(rows, slice) else rows[done]
            self._next(ended)
            rows = ended[self._part[ended] < self._last[ended]]
            if not len(rows):
                return lost, left

    def losses(self) -> Floats:
        """Return the safety loss per cycle and task, shape (cycles, tasks), s, including motions under way."""
        found = self._safety_s.copy()
        found[self._row, self._part // 2] += self._lost
        return found

    def _next(self, rows: Ints) -> None:
        """Start the next motion or standstill of these rows."""
        row, leg = self._row[rows], self._part[rows] // 2
        self._safety_s[row, leg] += self._lost[rows]
        part = self._part[rows] + 1
        self._part[rows], self._lost[rows], self._moving[rows] = part, 0.0, part % 2 == 0
        self._end[rows], self._rate[rows] = self._ends[self._which[rows], part], self._rates[row, part // 2]


class _OperatorPositions:
    """Operator tracks indexed by time: the positions (or states) of all operators at an instant are contiguous."""

    def __init__(self, tracks: OperatorTracks) -> None:
        self._moves = tracks.state is None
        where = tracks.xyz_m if tracks.state is None else tracks.state
        self._where = np.ascontiguousarray(where.transpose(1, 0, 2))
        self._activity = np.ascontiguousarray(tracks.activity.T) % (len(tracks.activities) + 1)  # unknown is last
        self._step_s = tracks.step_s

    def at(self, t_s: float) -> tuple[Floats, Ints, int]:
        """Return the position (K, 3) or state (K, D) of each operator, the activity (K,), and the previous sample."""
        sample = int(t_s / self._step_s + 1e-9)
        if not self._moves:
            return self._where[sample], self._activity[sample], sample
        weight = t_s / self._step_s - sample
        here, after = self._where[sample], self._where[sample + 1]
        between = here + (after - here) * weight
        return np.where(np.isnan(between), here, between), self._activity[sample], sample


def _of_one(
    simulated: SimulatedCycles, mine: slice, program: Program, standstill_s: Floats, tracks: OperatorTracks
) -> Rolled:
    duration = simulated.duration_s[mine]
    time_s = max(float(np.where(np.isfinite(duration), duration, 0.0).sum()), 1e-9)
    looked = float(simulated.looked[mine].sum())
    own_loss_s = simulated.own_loss_s[mine]
    own_base_s = np.maximum(duration - simulated.spliced[mine] - own_loss_s, 0.0)
    return Rolled(
        duration,
        standstill_s,
        simulated.safety_s[mine, : len(program.tasks)],
        simulated.activity_s[mine].mean(axis=0),
        float(simulated.known[mine].sum()) / looked if looked else float("nan"),
        float(simulated.spliced[mine].sum()) / time_s,
        own_s=np.stack([own_base_s, own_loss_s], axis=1),
    )
