"""Does a rollout give what was logged? Logged executions as their own judges, and intervals corrected by them.

Each complete execution is rolled out twice: beside its own operator, which leaves the network's error alone; and
beside the operators of all other executions, as a new sequence would be. If the operator does not react to the robot,
both agree with the log on average. Where in the second distribution the logged duration lies says how each quantile
must be shifted to hold (conformalised quantile regression: Romano, Patterson, Candès 2019; the operator's own
execution is left out). A level and its mirror move apart or together; the median stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from cyclekit.errors import EstimateError
from cyclekit.estimate.nominal import nominal_tasks
from cyclekit.estimate.program import lay_out
from cyclekit.estimate.safety import Dynamics
from cyclekit.estimate.tracks import operator_tracks
from cyclekit.estimate.transit import transit_table
from cyclekit.estimate.walk import walk
from cyclekit.sequences import TaskSequence

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset import Dataset
    from cyclekit.estimate.nominal import NominalTask
    from cyclekit.estimate.safety import SafetyModel
    from cyclekit.estimate.tracks import OperatorTracks

    Vector = NDArray[np.float64]

FEW_EXECUTIONS = 10
"""With fewer executions nothing is corrected: a 5 % quantile of them would be guessed."""
REACTS_Z = 3.0
"""So many standard errors between crossed and logged durations are no chance."""
OWN_BIAS = 0.01
"""A rollout beside the operators themselves that is off by more than this part is wrong."""


@dataclass(frozen=True)
class Check:
    """How rolled-out durations compare with logged ones; parts of the duration.

    Attributes:
        executions: How many logged executions were rolled out.
        held_out: How many of them the network had never seen.
        own_bias: Mean of rolled / logged - 1, each execution beside its own operator, on those the network had not
            seen (on all, where there are none).
        own_error: Standard error of that mean.
        crossed_bias: Mean of rolled / logged - 1 beside all other operators.
        reacts_z: Difference of the two in standard errors: far from 0, the operator reacts to the robot.
        shift: By quantile level, what is added to a quantile, as part of the mean; empty with few executions.
        coverage: Part of the logged executions between the corrected outer quantiles, each corrected by the others.
        coverage_raw: The same without correction.
        coverage_held_out: `coverage` among the executions the network had not seen; None where there are none.
        levels: The outer quantile levels of these coverages.
    """

    executions: int
    held_out: int
    own_bias: float
    own_error: float
    crossed_bias: float
    reacts_z: float
    shift: Mapping[float, float]
    coverage: float | None
    coverage_raw: float | None
    coverage_held_out: float | None
    levels: tuple[float, float]

    @property
    def model_error(self) -> float:
        """Standard deviation of the mean that the network's error stands for, as part of it."""
        return float(np.hypot(self.own_bias, self.own_error))

    @property
    def doubts(self) -> tuple[str, ...]:
        """What speaks against the rollout, one sentence each."""
        found = []
        if self.executions < FEW_EXECUTIONS:
            found.append(f"{self.executions} logged executions are too few to correct the quantiles by")
        if abs(self.own_bias) > max(OWN_BIAS, 3 * self.own_error):
            found.append(f"beside their own operators the logged executions come out {self.own_bias:+.1%} off")
        if abs(self.reacts_z) > REACTS_Z:
            found.append(
                f"beside other operators the logged executions come out {self.crossed_bias:+.1%} off: the operator "
                "seems to react to the robot, which no rollout reproduces"
            )
        return tuple(found)

    def to_json(self) -> dict[str, Any]:
        """Return the check as plain JSON values."""
        out = dict(vars(self))
        out["shift"] = {f"{level:g}": value for level, value in self.shift.items()}
        out["levels"] = list(self.levels)
        out["doubts"] = list(self.doubts)
        return out


def check_rollout(
    model: SafetyModel,
    dataset: Dataset,
    *,
    levels: Sequence[float] = (0.05, 0.5, 0.95),
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Check:
    """Roll out the logged executions and compare.

    Args:
        model: A model of problem `now`.
        dataset: The logs.
        levels: Quantile levels that will be asked for.
        seed: Of the order in which logged stands are used.
        progress: Told fraction and text.

    Raises:
        EstimateError: No complete execution has an operator track and tasks of known scaling.
    """
    nominal = nominal_tasks(dataset)
    sequences = _logged_sequences(dataset, nominal)
    if not sequences:
        msg = f"{dataset.path}: no complete execution of tasks with known scaling, so nothing can be checked"
        raise EstimateError(msg, cure="See what the logs lack: cyclekit inspect DATASET")
    longest = max(sum(nominal[task].nominal_s + nominal[task].dwell_s for task in s.tasks) for s in sequences)
    with threadpool_limits(limits=1, user_api="blas"):
        tracks = operator_tracks(dataset, horizon_s=3.0 * longest, phases=1)
        sequences = [sequence for sequence in sequences if sequence.name in tracks.executions]
        own = _beside_own(model, dataset, sequences, nominal, tracks)
        asked = {task: nominal[task] for sequence in sequences for task in sequence.tasks}
        crossed = transit_table(model, asked, tracks, progress=progress).durations(
            [sequence.tasks for sequence in sequences], seed=seed
        )
    logged = _logged_durations(dataset, sequences)
    column = np.array([tracks.executions.index(sequence.name) for sequence in sequences])
    crossed[np.arange(len(sequences)), column] = np.nan  # its own operator is left out
    unseen = set((model.card.get("split") or {}).get("test", ()))
    held_out = np.array([sequence.name in unseen for sequence in sequences])
    return compare(logged, own, np.where(np.isfinite(crossed), crossed, np.nan), held_out, levels)


def compare(
    logged_s: Vector,
    own_s: Vector,
    crossed_s: NDArray[np.float64],
    held_out: NDArray[np.bool_],
    levels: Sequence[float],
) -> Check:
    """Compare rolled with logged durations.

    Args:
        logged_s: Durations in the log, shape (E,).
        own_s: Rolled out beside their own operators, shape (E,).
        crossed_s: Beside each of K operators, shape (E, K); NaN is left out.
        held_out: Which executions the network never saw, shape (E,).
        levels: Quantile levels in (0, 1).
    """
    good = np.isfinite(own_s) & np.isfinite(crossed_s).any(axis=1)
    logged_s, own_s, crossed_s, held_out = logged_s[good], own_s[good], crossed_s[good], held_out[good]
    count = len(logged_s)
    mean = np.nanmean(crossed_s, axis=1)
    own, cross = own_s / logged_s - 1, mean / logged_s - 1
    judged = own[held_out] if held_out.sum() >= 3 else own
    reacts = (mean - own_s) / logged_s
    z = float(reacts.mean() / max(reacts.std(ddof=1) / np.sqrt(count), 1e-9)) if count > 2 else 0.0
    scores = {p: _scores(logged_s, crossed_s, mean, p) for p in levels if p != 0.5}
    outer = min(min(levels), 1 - max(levels))
    enough = count >= FEW_EXECUTIONS
    widest = _scores(logged_s, crossed_s, mean, outer)
    inside = _inside(widest, 1 - 2 * outer) if enough else np.zeros(0, dtype=bool)
    return Check(
        executions=count,
        held_out=int(held_out.sum()),
        own_bias=float(judged.mean()),
        own_error=float(judged.std() / np.sqrt(len(judged))),
        crossed_bias=float(cross.mean()),
        reacts_z=z,
        shift={p: _shift(scores[p], p) if p != 0.5 else 0.0 for p in levels} if enough else {},
        coverage=float(inside.mean()) if enough else None,
        coverage_raw=float(np.mean(widest <= 0)) if enough else None,
        coverage_held_out=float(inside[held_out].mean()) if enough and held_out.any() else None,
        levels=(outer, 1 - outer),
    )


def _scores(logged_s: Vector, crossed_s: NDArray[np.float64], mean_s: Vector, level: float) -> Vector:
    """How far each execution lies outside of the interval between a level and its mirror, part of the mean; (E,)."""
    low, high = (np.nanquantile(crossed_s, p, axis=1) for p in (min(level, 1 - level), max(level, 1 - level)))
    return np.asarray(np.maximum(low - logged_s, logged_s - high) / mean_s)


def _margin(scores: Vector, covers: float) -> float:
    """Return the conformal quantile of the scores: rounded up, so that it holds for one execution more."""
    count = len(scores)
    rank = int(np.clip(np.ceil((count + 1) * covers), 1, count))
    return float(np.sort(scores)[rank - 1])


def _shift(scores: Vector, level: float) -> float:
    margin = _margin(scores, abs(1 - 2 * level))
    return margin if level > 0.5 else -margin


def _inside(scores: Vector, covers: float) -> NDArray[np.bool_]:
    """Tell which executions lie in the interval that all others correct, shape (E,)."""
    every = np.arange(len(scores))
    return np.array([scores[e] <= _margin(scores[every != e], covers) for e in every])


def _logged_sequences(dataset: Dataset, nominal: Mapping[str, NominalTask]) -> list[TaskSequence]:
    found = []
    for entry in dataset.card["executions"]:
        if entry["complete"] and len(entry["places"]) > 1:
            sequence = TaskSequence(entry["execution"], tuple(entry["places"]))
            if all(task in nominal for task in sequence.tasks):
                found.append(sequence)
    return found


def _logged_durations(dataset: Dataset, sequences: Sequence[TaskSequence]) -> Vector:
    durations = dict(dataset.executions.select("execution", "duration_s").iter_rows())
    return np.array([durations[sequence.name] for sequence in sequences])


def _beside_own(
    model: SafetyModel,
    dataset: Dataset,
    sequences: Sequence[TaskSequence],
    nominal: Mapping[str, NominalTask],
    tracks: OperatorTracks,
) -> Vector:
    """Roll out each execution beside its own operator and with its own stands, shape (E,), s."""
    programs = [lay_out(sequence, nominal, dataset) for sequence in sequences]
    by_execution = dataset.tasks().sort("execution", "index").group_by(["execution"], maintain_order=True)
    stands = {str(name): (rows["dwell_s"] + rows["wait_s"]).to_numpy() for (name,), rows in by_execution}
    own = [np.maximum(stands[sequence.name][: len(sequence.tasks)], 1e-3)[None, :] for sequence in sequences]
    track = np.array([tracks.executions.index(sequence.name) for sequence in sequences])
    walked = walk(model, programs, np.arange(len(programs)), track, own, tracks, dynamics=Dynamics.of(dataset.card))
    return walked.duration_s
