"""Expected cycle time by rolling the learned safety function along a sequence against logged operator tracks.

The program of the sequence is a line of nominal time: motions, along which it advances at the scaling s(x_r, x_h), and
stands, along which it advances at 1. Every logged operator track is walked once beside it, all tracks at the same
time. Nothing is assumed about the shape of s; it is what the network learned. The operator is taken not to react to
the robot's order of tasks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from threadpoolctl import threadpool_limits

from cyclekit.errors import EstimateError, ModelError
from cyclekit.estimate.nominal import nominal_tasks
from cyclekit.estimate.program import Program, draw_stands, lay_out
from cyclekit.estimate.result import CycleEstimate, TaskShare
from cyclekit.estimate.support import Support
from cyclekit.estimate.tracks import OperatorTracks, operator_tracks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset import Dataset
    from cyclekit.models.saved import TrainedModel
    from cyclekit.sequences import TaskSequence

    Vector = NDArray[np.float64]

TIME_STEP_S = 0.05
"""Step of the rollout: half a sample of the operator's track."""
SUPPORT_EVERY = 4
"""Support is looked up at every so many steps."""
LEAST_SUPPORT = 0.5
"""Below this part of the cycle in logged cells the question is refused."""
FEW_TRACKS = 20
"""With fewer operator tracks the mean itself is uncertain by more than a percent in the cells seen so far."""
RESAMPLES = 1000


@dataclass(frozen=True)
class Rolled:
    """K cycles of one program.

    Attributes:
        duration_s: Shape (K,).
        stands_s: Stand at each task's goal per cycle, shape (K, tasks).
        safety_s: Safety loss per cycle and task, shape (K, tasks).
        by_activity_s: Safety loss per operator activity, mean over cycles, shape (activities + 1,), last = unknown.
        support: Part of the time in logged cells.
        spliced: Part of the time on a track that was continued beyond its own log.
    """

    duration_s: Vector
    stands_s: NDArray[np.float64]
    safety_s: NDArray[np.float64]
    by_activity_s: Vector
    support: float
    spliced: float


def estimate(
    model: TrainedModel,
    dataset: Dataset,
    sequences: Sequence[TaskSequence],
    *,
    quantiles: Sequence[float] = (0.05, 0.5, 0.95),
    seed: int = 0,
    extrapolate: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> list[CycleEstimate]:
    """Return the expected cycle time of each sequence, shortest first.

    Args:
        model: A model of problem `now`.
        dataset: Logs that hold the tasks and the operator's tracks.
        sequences: What is asked for.
        quantiles: Levels in (0, 1) of single cycles.
        seed: Of the resampling behind the interval of the mean, and of the order in which logged stands are used.
        extrapolate: Answer although the support is below LEAST_SUPPORT; the number carries a warning.
        progress: Told fraction and text.

    Raises:
        ModelError: The model predicts something else than the present scaling.
        UnknownName: A place does not exist.
        EstimateError: A task was never logged, there is no operator track, or the support is too low.
    """
    tell = progress or (lambda fraction, text: None)
    if model.problem != "now":
        msg = f"the model predicts problem {model.problem!r}; a rollout needs the scaling of the present instant"
        raise ModelError(msg, cure="Train one: cyclekit train DATASET --problem now --out MODEL")
    nominal = nominal_tasks(dataset)
    programs = [lay_out(sequence, nominal, dataset) for sequence in sequences]
    samples = dataset.samples()
    support = Support(
        samples.select("robot_x_m", "robot_y_m", "robot_z_m").to_numpy(),
        samples.select("human_x_m", "human_y_m", "human_z_m").to_numpy(),
    )
    found = []
    for number, (sequence, program) in enumerate(zip(sequences, programs, strict=True)):
        tell(number / len(sequences), f"rolling out {sequence.name}")
        rolled, tracks = _with_enough_track(model, dataset, sequence, program, support, seed)
        if rolled.support < LEAST_SUPPORT and not extrapolate:
            seen = f"{sequence.shown}: only {rolled.support:.0%} of it runs through positions ever logged"
            raise EstimateError(seen, cure="Log this part of the cell, or ask with --extrapolate and mark the number.")
        found.append(_estimate(sequence, program, rolled, tracks, dataset, model, quantiles, seed))
    tell(1.0, "done")
    return sorted(found, key=lambda result: (result.expected_s, result.name))


def _with_enough_track(
    model: TrainedModel, dataset: Dataset, sequence: TaskSequence, program: Program, support: Support, seed: int
) -> tuple[Rolled, OperatorTracks]:
    """Roll out with tracks long enough for the slowest cycle; a cell that halts for long needs a second try."""
    horizon = 2.5 * program.length_s
    for _ in range(4):
        tracks = operator_tracks(dataset, horizon_s=horizon, operator=sequence.operator)
        with threadpool_limits(limits=1, user_api="blas"):  # thousands of tiny products: more threads only wait
            rolled = roll_out(model, program, tracks, support, seed=seed)
        if np.isfinite(rolled.duration_s).all():
            return rolled, tracks
        horizon *= 2.0
    stuck = float(np.mean(~np.isfinite(rolled.duration_s)))
    seen = f"{sequence.shown}: {stuck:.0%} of the cycles do not end within {horizon / 2:.0f} s"
    raise EstimateError(seen, cure="The operator's tracks leave the robot halted; check the tracker's frame and clock.")


def roll_out(
    model: TrainedModel, program: Program, tracks: OperatorTracks, support: Support, *, seed: int = 0
) -> Rolled:
    """Walk every track beside the program once; a cycle that does not end within its track has duration inf."""
    count, samples = tracks.activity.shape
    stands = draw_stands(program, count, seed)
    walk = _Walk(program, stands)
    duration = np.full(count, np.inf)
    activity_s = np.zeros(len(tracks.activities) + 1)
    without = model.card.get("scaling_without_operator")
    free = 1.0 if without is None else float(without)
    known = looked = spliced = 0.0
    cells_per_s = len(program.leg) / program.length_s
    for number in range(int((samples - 2) * tracks.step_s / TIME_STEP_S)):
        going = np.flatnonzero(~np.isfinite(duration))
        if not len(going):
            break
        at = np.minimum((walk.position[going] * cells_per_s).astype(np.int64), len(program.leg) - 1)
        human, sample = _human_at(tracks, going, number * TIME_STEP_S)
        robot = program.xyz_m[at]
        scaling = _scaling(model, robot, human, free)
        lost, left = walk.advance(going, scaling)
        arrives = walk.arrived[going]
        duration[going[arrives]] = (number + 1) * TIME_STEP_S - left[arrives]
        np.add.at(activity_s, tracks.activity[going, sample], lost)
        spliced += float(np.count_nonzero(sample >= tracks.logged[going]))
        if number % SUPPORT_EVERY == 0:
            known += float(np.count_nonzero(support.near_logged(robot, human)))
            looked += len(going)
    steps = max(float(np.where(np.isfinite(duration), duration, 0.0).sum()) / TIME_STEP_S, 1.0)
    return Rolled(duration, stands, walk.safety_s, activity_s / count, known / max(looked, 1.0), spliced / steps)


class _Walk:
    """K cycles on their way through one program: where each is, and what it has lost to safety per task."""

    def __init__(self, program: Program, stands_s: NDArray[np.float64]) -> None:
        """Begin K cycles with their own stands, shape (K, tasks), seconds."""
        parts = np.array([part for task in program.tasks for part in (task.nominal_s, task.dwell_s + task.wait_s)])
        self._ends = np.cumsum(parts)
        self._stand_rate = parts[1::2] / stands_s
        self._part = np.zeros(len(stands_s), dtype=np.int64)  # even: a motion, odd: the stand after it
        self.position = np.zeros(len(stands_s))
        self.safety_s = np.zeros(stands_s.shape)

    @property
    def arrived(self) -> NDArray[np.bool_]:
        """Which cycles are at their end, shape (K,)."""
        return np.asarray(self._part == len(self._ends))

    def advance(self, going: NDArray[np.int64], scaling: Vector) -> tuple[Vector, Vector]:
        """Go on by TIME_STEP_S; return the safety loss in it and what is left of it at the end, shape (len(going),).

        The step is divided where a motion or a stand ends in it: each has a rate of its own.
        """
        lost, left = np.zeros(len(going)), np.full(len(going), TIME_STEP_S)
        rows = np.arange(len(going))
        while len(rows):
            k, part = going[rows], self._part[going[rows]]
            moving, leg = part % 2 == 0, part // 2
            rate = np.where(moving, scaling[rows], self._stand_rate[k, leg])
            to_go = self._ends[part] - self.position[k]
            needs = np.where(to_go <= 1e-9, 0.0, to_go / np.maximum(rate, 1e-12))
            done, spent = needs <= left[rows], np.minimum(needs, left[rows])
            self.position[k] = np.where(done, self._ends[part], self.position[k] + rate * spent)
            self._part[k] += done
            loss = np.where(moving, (1.0 - rate) * spent, 0.0)
            self.safety_s[k, leg] += loss
            lost[rows] += loss
            left[rows] -= spent
            rows = rows[done & (part + 1 < len(self._ends))]
        return lost, left


def _human_at(tracks: OperatorTracks, rows: NDArray[np.int64], t_s: float) -> tuple[NDArray[np.float64], int]:
    sample = int(t_s / tracks.step_s + 1e-9)
    weight = t_s / tracks.step_s - sample
    here, after = tracks.xyz_m[rows, sample], tracks.xyz_m[rows, sample + 1]
    return np.where(np.isfinite(after), here * (1 - weight) + after * weight, here), sample


def _scaling(model: TrainedModel, robot_m: NDArray[np.float64], human_m: NDArray[np.float64], free: float) -> Vector:
    present = np.isfinite(human_m).all(axis=1)
    scaling = np.full(len(robot_m), free)
    if present.any():
        inputs = np.concatenate([robot_m[present], human_m[present]], axis=1).astype(np.float32)
        scaling[present] = np.clip(model.predict(inputs), 0.0, 1.0)
    return scaling


def _estimate(
    sequence: TaskSequence,
    program: Program,
    rolled: Rolled,
    tracks: OperatorTracks,
    dataset: Dataset,
    model: TrainedModel,
    quantiles: Sequence[float],
    seed: int,
) -> CycleEstimate:
    durations = rolled.duration_s
    shares = tuple(_shares(program, rolled))
    low, high = _interval_of_mean(durations, seed)
    by_activity = dict(zip([*tracks.activities, "unknown"], rolled.by_activity_s.tolist(), strict=True))
    return CycleEstimate(
        name=sequence.name,
        places=sequence.places,
        expected_s=float(durations.mean()),
        expected_low_s=low,
        expected_high_s=high,
        quantiles_s={level: float(np.quantile(durations, level)) for level in quantiles},
        nominal_s=sum(share.nominal_s for share in shares),
        safety_loss_s=sum(share.safety_loss_s for share in shares),
        dwell_s=sum(share.dwell_s for share in shares),
        wait_s=sum(share.wait_s for share in shares),
        support=rolled.support,
        tracks=len(durations),
        warnings=tuple(_warnings(rolled, tracks, dataset, model)),
        tasks=shares,
        safety_by_activity_s={name: value for name, value in by_activity.items() if value > 0.0},
        durations_s=tuple(durations.tolist()),
    )


def _shares(program: Program, rolled: Rolled) -> Iterator[TaskShare]:
    """Split the mean duration over the tasks; a step that crosses from one part to the next is shared out with it."""
    safety, stands = rolled.safety_s.mean(axis=0), rolled.stands_s.mean(axis=0)
    motion = sum(task.nominal_s for task in program.tasks) + float(safety.sum())
    stands *= (float(rolled.duration_s.mean()) - motion) / float(stands.sum())
    for task, lost, stand in zip(program.tasks, safety.tolist(), stands.tolist(), strict=True):
        usual = task.dwell_s + task.wait_s
        dwell = stand * task.dwell_s / usual if usual > 0.0 else stand
        wait = stand - dwell
        yield TaskShare(task.task, task.nominal_s + lost + stand, task.nominal_s, lost, dwell, wait)


def _interval_of_mean(durations: Vector, seed: int) -> tuple[float, float]:
    rng = np.random.default_rng(seed)
    means = durations[rng.integers(0, len(durations), (RESAMPLES, len(durations)))].mean(axis=1)
    return float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def _warnings(rolled: Rolled, tracks: OperatorTracks, dataset: Dataset, model: TrainedModel) -> list[str]:
    found = []
    if len(tracks.executions) < FEW_TRACKS:
        found.append(f"rests on {len(tracks.executions)} operator tracks only: the mean itself is uncertain")
    if rolled.support < 0.9:
        found.append(f"{1 - rolled.support:.0%} of the cycle runs through positions that were never logged")
    if rolled.spliced > 0.1:
        found.append(f"{rolled.spliced:.0%} of the time the operator's track is continued from another execution")
    samples = dataset.samples()
    absent = samples["human_x_m"].null_count() / max(samples.height, 1)
    if absent > 0.01 and model.card.get("scaling_without_operator") is None:
        found.append(f"in {absent:.0%} of the samples nobody is seen; there the robot is taken to run free")
    if samples.filter(pl.col("scaling_origin") == "inferred").height:
        found.append("the speed scaling was not logged but inferred from velocity ratios")
    if any(record["clock"]["method"] == "assumed-common-start" for record in dataset.recordings):
        found.append("the clocks of robot and tracker are only assumed to start together")
    if any(record["clock"]["method"] in ("coarse", "start-text") for record in dataset.recordings):
        found.append("the clocks of robot and tracker are aligned roughly: the reaction delay is hidden or unknown")
    return found
