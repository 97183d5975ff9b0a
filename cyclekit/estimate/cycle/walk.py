"""Simulation of programs of the robot alone, each beside every operator track; the operator does not react to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.cycle.engine import AT_ONCE, FINE_STEP_S, TIME_STEP_S, RobotLine, SimulatedCycles, simulate_robot
from cyclekit.estimate.robot.program import Program, draw_standstills
from cyclekit.estimate.robot.safety import Dynamics, Logged, SafetyModel, at_once, is_fast

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.schema import Floats, Ints, Vector


ROWS = 4096
"""Number of cycles simulated at once: a step and its layers fit into the cache."""


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
        beyond: How much less and more the mean is if all people stay as they are at the ends of logs, or all go on as
            elsewhere, as shares of it: at most and at least 0.
    """

    duration_s: Vector
    standstill_s: Floats
    safety_s: Floats
    by_activity_s: Vector
    support: float
    spliced: float
    simulated: bool = True
    own_s: Floats | None = None
    beyond: tuple[float, float] = (0.0, 0.0)

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
        fine: Use steps of FINE_STEP_S and single cycles in any case.
    """
    step_s = TIME_STEP_S if at_once(model, dynamics) and not fine else FINE_STEP_S
    own_s = np.zeros((len(which), max(len(program.tasks) for program in programs)))
    for number, stands in enumerate(standstill_s):
        own_s[which == number, : stands.shape[1]] = stands
    orders = [[(task.xyz_m, task.nominal_s) for task in program.tasks] for program in programs]
    asks_after = 1 if fine or is_fast(model) else round(TIME_STEP_S / step_s)
    return simulate_robot(
        model,
        RobotLine(orders, which, own_s, step_s),
        _OnTracks(tracks, track),
        steps=int((tracks.activity.shape[1] - 2) * tracks.step_s / step_s) - asks_after + 1,
        step_s=step_s,
        dynamics=dynamics,
        support=support,
        often=fine,
        start=None if tracks.scaling is None else tracks.scaling[track],
        known_until_s=np.asarray(tracks.logged[track] * tracks.step_s, np.float64),
    )


class _OnTracks:
    """Operators on their tracks: the positions (or states) of all at an instant are contiguous."""

    def __init__(self, tracks: OperatorTracks, track: Ints) -> None:
        self.activities, self._track, self._step_s = tracks.activities, track, tracks.step_s
        self._moves = tracks.state is None
        where = tracks.xyz_m if tracks.state is None else tracks.state
        self._where = np.ascontiguousarray(where.transpose(1, 0, 2))
        self._activity = np.ascontiguousarray(tracks.activity.T) % (len(tracks.activities) + 1)  # unknown is last

    def at(self, t_s: float, line: RobotLine, _gone: Vector, /) -> tuple[Floats, Ints]:
        """Return the position (N, 3) or state (N, D) of the operators of the rows under way, and their activity."""
        sample, mine = int(t_s / self._step_s + 1e-9), self._track[line.row]
        here = self._where[sample]
        if self._moves:
            after = self._where[sample + 1]
            between = here + (after - here) * (t_s / self._step_s - sample)
            here = np.where(np.isnan(between), here, between)
        return here.take(mine, axis=0), self._activity[sample][mine]


def _of_one(
    simulated: SimulatedCycles, mine: slice, program: Program, standstill_s: Floats, tracks: OperatorTracks
) -> Rolled:
    duration = simulated.duration_s[mine]
    time_s = max(float(np.where(np.isfinite(duration), duration, 0.0).sum()), 1e-9)
    looked = float(simulated.looked[mine].sum())
    known_s, own_loss_s = tracks.logged * tracks.step_s, simulated.own_loss_s[mine]
    own_base_s = np.maximum(np.minimum(duration, known_s) - own_loss_s, 0.0)
    spliced_s = np.where(np.isfinite(duration), np.maximum(duration - known_s, 0.0), 0.0)
    beyond = np.zeros(1)
    if tracks.stays is not None:
        lost_s = np.where(spliced_s > 0.0, simulated.robot.lost_s[mine].sum(axis=1) - own_loss_s, 0.0)
        free_s = spliced_s - lost_s
        groups = [some for some in (tracks.stays, ~tracks.stays) if free_s[some].any()]
        rates = np.array([lost_s[some].sum() / free_s[some].sum() for some in groups])
        beyond = np.append(rates * free_s.sum() - lost_s.sum(), 0.0) / time_s
    return Rolled(
        duration,
        standstill_s,
        simulated.robot.lost_s[mine, : len(program.tasks)],
        simulated.activity_s[mine].mean(axis=0),
        float(simulated.known[mine].sum()) / looked if looked else float("nan"),
        float(spliced_s.sum()) / time_s,
        own_s=np.stack([own_base_s, own_loss_s], axis=1),
        beyond=(float(beyond.min()), float(beyond.max())) if len(beyond) > 2 else (0.0, 0.0),
    )
