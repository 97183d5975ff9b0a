"""The estimators by name: a line in ESTIMATORS adds one to `estimate` and to its explanations.

`rollout` simulates all programs together (`walk`). The others are defined in this module: `average` follows the paper,
`history` and `nominal` are usual in plants. Each returns cycles in the same form as `walk`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit.dataset.unknown_height import in_plane
from cyclekit.errors import EstimateError
from cyclekit.estimate.cycle.walk import Rolled
from cyclekit.estimate.robot.program import Program, draw_standstills, standstills_of
from cyclekit.estimate.robot.safety import BLOCK

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.schema import Floats, Ints, Vector

    Alone = Callable[[Dataset, Program, int], Rolled]
    Beside = Callable[[Any, Program, OperatorTracks, int], Rolled]


@dataclass(frozen=True)
class Estimator:
    """A method that computes the cycles of a program.

    Attributes:
        why: Why it is used, for the text of the estimate.
        needs: Problem that the model must predict; None = any.
        alone: Function of dataset, program and seed that returns the cycles, without operator tracks.
        beside: Function of model, program, tracks and seed that returns the cycles. Without this and `alone`, all
            programs are simulated together in time steps.
        goals: Whether the tracks must include the operator's goals.
    """

    why: str
    needs: str | None = None
    alone: Alone | None = None
    beside: Beside | None = None
    goals: bool = False


HISTORY_DRAWS = 1000
MIN_PROGRESS = 0.02
"""Minimum of a predicted mean scaling: at the near-zero outputs of a network a motion would never end."""


def by_average(model: TrainedModel, program: Program, tracks: OperatorTracks, seed: int = 0) -> Rolled:
    """Solve T * mean s(T) = nominal time, task by task, with the operator's state carried forward.

    The network predicts the mean scaling over its horizon from the positions and goals of robot and operator (Faroni et
    al. 2512.17579, the average problem). A motion shorter than the horizon takes nominal / mean. A longer one uses up
    one horizon; its rest is predicted again from the positions at that time.

    Raises:
        EstimateError: The logs hold no goals of the operator, which the network needs.
    """
    if tracks.goal_m is None or not np.isfinite(tracks.goal_m).any():
        msg = "the operator's goals are unknown, and the average-scaling network needs them"
        raise EstimateError(msg, cure="Log button presses or name [human_places.*] in cell.toml, or use rollout.")
    count = len(tracks.executions)
    standstills = draw_standstills(program, count, seed)
    safety = np.zeros(standstills.shape)
    activity_s = np.zeros((count, len(tracks.activities) + 1))
    time = np.zeros(count)
    for leg, task in enumerate(program.tasks):
        begin = time.copy()
        activity = tracks.activity[np.arange(count), _sample(tracks, time)]
        time = _move(model, task, tracks, time)
        safety[:, leg] = time - begin - task.nominal_s
        activity_s[np.arange(count), activity] += safety[:, leg]
        time = time + standstills[:, leg]
    end = tracks.activity.shape[1] * tracks.step_s
    duration = np.where(time < end, time, np.inf)
    spliced = np.maximum(time - tracks.logged * tracks.step_s, 0.0).sum() / time.sum()
    return Rolled(duration, standstills, safety, activity_s.mean(axis=0), float("nan"), float(spliced))


def _move(model: TrainedModel, task: NominalTask, tracks: OperatorTracks, start_s: Vector) -> Vector:
    """Return when the motion of `task` ends on each track (K,), s."""
    time, done = start_s.copy(), np.zeros(len(start_s))
    last = len(task.xyz_m) - 1
    end_s = (tracks.activity.shape[1] - 1) * tracks.step_s
    while len(going := np.flatnonzero((done < task.nominal_s - 1e-9) & (time < end_s))):
        place = np.rint(done[going] / task.nominal_s * last).astype(np.int64)
        mean = _mean_scaling(model, task.xyz_m[place], task.xyz_m[-1], tracks, going, time[going])
        left = task.nominal_s - done[going]
        spent = np.minimum(left / mean, model.horizon_s)
        done[going] = np.where(left <= mean * model.horizon_s, task.nominal_s, done[going] + mean * spent)
        time[going] += spent
    return time


def _mean_scaling(
    model: TrainedModel, robot_m: Floats, goal_m: Floats, tracks: OperatorTracks, rows: Ints, time_s: Vector
) -> Vector:
    """Return the mean scaling over the horizon (N,); if operator or goal is unknown, the one without operator."""
    at = _sample(tracks, time_s)
    human = in_plane(robot_m, tracks.xyz_m[rows, at])
    bound_for = np.full_like(human, np.nan) if tracks.goal_m is None else tracks.goal_m[rows, at]
    inputs = np.concatenate([robot_m, human, np.broadcast_to(goal_m, robot_m.shape), bound_for], axis=1)
    without = model.card.scaling_without_operator
    mean = np.full(len(rows), 1.0 if without is None else without)
    known = np.flatnonzero(np.isfinite(inputs).all(axis=1))
    for start in range(0, len(known), BLOCK):
        some = known[start : start + BLOCK]
        mean[some] = model.predict(inputs[some].astype(np.float32))
    return np.asarray(np.clip(mean, MIN_PROGRESS, 1.0))


def _sample(tracks: OperatorTracks, time_s: Vector) -> Ints:
    return np.asarray(np.minimum((time_s / tracks.step_s).astype(np.int64), tracks.activity.shape[1] - 1))


def by_history(dataset: Dataset, program: Program, seed: int = 0) -> Rolled:
    """Assemble cycles from randomly drawn logged repetitions of each task; their mean is the sum of the task means.

    This ignores the effect of the order on task durations, and the correlation of slow tasks.
    """
    rng = np.random.default_rng(seed)
    tasks = dataset.whole_tasks().filter(pl.col("safety_loss_s").is_not_null())
    logged = {str(name): rows for (name,), rows in tasks.group_by(["task"], maintain_order=True)}
    count = HISTORY_DRAWS
    safety, standstills = np.empty((count, len(program.tasks))), np.empty((count, len(program.tasks)))
    for leg, task in enumerate(program.tasks):
        rows = logged[task.task]
        drawn = rng.permutation(np.arange(count) % rows.height)
        moved = (rows["arrival_s"] - rows["start_s"]).to_numpy()
        safety[:, leg] = moved[drawn] - task.nominal_s
        logged_s = (rows["end_s"] - rows["arrival_s"]).to_numpy()[drawn]
        standstills[:, leg] = logged_s if task.group is None else standstills_of(task, count, seed, leg)
    duration = program_motion(program) + safety.sum(axis=1) + standstills.sum(axis=1)
    return Rolled(duration, standstills, safety, np.zeros(0), 1.0, 0.0)


def by_nominal(_dataset: Dataset, program: Program, _seed: int = 0) -> Rolled:
    """Return one cycle without an operator: every motion at full speed, every standstill of mean length."""
    standstills = np.array([[task.dwell_s + task.wait_s for task in program.tasks]])
    duration = np.array([program_motion(program) + float(standstills.sum())])
    return Rolled(duration, standstills, np.zeros(standstills.shape), np.zeros(0), 1.0, 0.0)


def program_motion(program: Program) -> float:
    """Return the duration of all motions of a program at scaling 1, s."""
    return sum(task.nominal_s for task in program.tasks)


ESTIMATORS: dict[str, Estimator] = {
    "rollout": Estimator("simulation of the learned safety function with every logged operator", "now"),
    "average": Estimator("task durations from predicted mean scalings", "average", beside=by_average, goals=True),
    "history": Estimator("logged durations of the same tasks", alone=by_history),
    "nominal": Estimator("time without an operator", alone=by_nominal),
}
"""Estimators by name."""
