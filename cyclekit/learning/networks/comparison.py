"""The best staircase over the distance, and whether a simpler rival beats a model by more than chance.

Samples of one execution are correlated, so the test pairs the mean errors of both per execution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import command_line
from cyclekit.learning.networks.kinds import NETWORKS, networks_for
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.networks.weights import distance
from cyclekit.text.numbers import scientific

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards import SpecCard
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.learning.windows import Samples
    from cyclekit.schema import Floats, Ints

STAIRCASE, BOOSTED, LAST_SECOND = "distance staircase", "gradient boosting", "gradient boosting, last second"
MIN_RATIO = 1.25
"""Minimum ratio of the mean squared errors of model and rival at which the rival is reported."""
CHANCE = 0.01
"""Significance level of the paired test."""
MIN_EXECUTIONS = 3
_BINS = 4096


@dataclass(frozen=True)
class BetterRival:
    """A rival that is better than the model by more than chance.

    Attributes:
        name: Name of the rival.
        mse, model_mse: Mean squared errors of rival and model.
        executions: Number of executions compared.
        otherwise: Training options that should give a better model.
    """

    name: str
    mse: float
    model_mse: float
    executions: int
    otherwise: tuple[str, ...]

    def said(self, dataset: object, out: object) -> str:
        """Return this as one line with the command that trains again; `dataset` and `out` are paths."""
        words = ("train", dataset, "--out", out, *self.otherwise)
        return (
            f"the {self.name} is better than the model beyond chance: MSE {scientific(self.mse)} against "
            f"{scientific(self.model_mse)} on {self.executions} held-out executions; "
            f"train again: {command_line(*words)}"
        )


def _retrain_options(spec: SpecCard | None, rival: str) -> list[str]:
    """Return training options like those of `spec`, with the distance as input or, if it had that, with another seed.

    If boosting on the last second is better and available for the problem, it is chosen.
    """
    if spec is None:
        return ["--features", "distance"]
    usual = ModelSpec.of(spec.problem)
    words = [] if usual.problem == "now" else ["--problem", usual.problem, "--horizon", f"{spec.horizon_s:g}s"]
    if rival == LAST_SECOND and "boosting" in networks_for(spec.problem):
        return [*words, "--network", "boosting", *(["--seed", str(spec.seed)] if spec.seed else [])]
    for name in ("network", "norm", "balance"):
        chosen = getattr(spec, name)
        words += [] if chosen == getattr(usual, name) else [f"--{name}", chosen]
    words += ["--noise", f"{spec.noise_m:g}"] if spec.noise_m else []
    kind = NETWORKS.get(spec.network)
    back = kind is not None and kind.sees_history
    if not back:
        words += ["--features", "distance"]
    if back or spec.features == "distance":
        return [*words, "--seed", str(spec.seed + 1)]
    return [*words, "--seed", str(spec.seed)] if spec.seed else words


def staircase_if_better(model: TrainedModel, spec: ModelSpec, learn: Samples, judge: Samples) -> BetterRival | None:
    """Return the staircase over the distance, fitted to `learn`, if it is better than the model.

    Args:
        model: The model, without a finished card.
        spec: Spec of its training.
        learn: Rows to fit to; None is returned for rows in files.
        judge: Held-out rows.
    """
    if len(model.levels) < 2 or learn.in_files:
        return None
    thresholds = fit_thresholds(distance_of(learn), learn.scaling, model.levels)
    squared = (staircase_at(thresholds, model.levels, judge) - judge.scaling) ** 2
    mine = (model.predict(judge.model_inputs) - judge.scaling) ** 2
    return better_rival(spec.card(), mine, {STAIRCASE: squared}, judge.execution)


def better_rival(
    spec: SpecCard | None, model: Floats, rivals: Mapping[str, Floats], execution: Ints
) -> BetterRival | None:
    """Return the rival with the smallest error among those significantly better than the model; None if there is none.

    Args:
        spec: Spec of the model's training; None = unknown.
        model: Squared errors of the model, shape (N,).
        rivals: Squared errors of each rival on the same rows, by name.
        execution: Number of the execution of each row, shape (N,).
    """
    from scipy.special import stdtrit

    _, which, rows = np.unique(execution, return_inverse=True, return_counts=True)
    count, found = len(rows), list[BetterRival]()
    if count < MIN_EXECUTIONS:
        return None
    for name, squared in rivals.items():
        lead = np.bincount(which, model - squared) / rows
        sure = lead.mean() > stdtrit(count - 1, 1.0 - CHANCE) * lead.std(ddof=1) / count**0.5
        if sure and model.mean() > MIN_RATIO * squared.mean():
            found.append(
                BetterRival(
                    name, float(squared.mean()), float(model.mean()), count, tuple(_retrain_options(spec, name))
                )
            )
    return min(found, key=lambda better: better.mse, default=None)


def fit_thresholds(distance_m: Floats, scaling: Floats, levels: Sequence[float]) -> Floats:
    """Return the distances at which an ascending staircase of given levels fits best.

    Dynamic programming over levels and 4096 equally filled bins of distance; exact to one bin.

    Args:
        distance_m: Shape (N,), N > 0.
        scaling: Shape (N,).
        levels: Ascending, shape (P,).

    Returns:
        Thresholds, shape (P - 1,), ascending, m: level i + 1 applies from threshold i on. Minus or plus infinity at an
        end where a level is never used.
    """
    order = np.argsort(distance_m, kind="stable")
    ends = np.unique(np.linspace(0, order.size, min(_BINS, order.size) + 1).astype(np.int64))
    edges = distance_m[order][ends[:-1]]
    error = (scaling[order][:, None] - np.asarray(levels)[None, :]) ** 2
    total = np.concatenate([np.zeros((1, len(levels))), np.cumsum(error, axis=0)])[ends]  # (bins + 1, P)
    best, cut = total[:, 0], np.zeros((len(levels), len(ends)), np.int64)
    for level in range(1, len(levels)):  # best[b]: minimum error of the first b bins with levels 0..level
        ahead = best - total[:, level]
        lowest = np.minimum.accumulate(ahead)
        first = np.flatnonzero(np.diff(lowest, prepend=np.inf) < 0)
        cut[level] = first[np.searchsorted(first, np.arange(len(ends)), side="right") - 1]
        best = lowest + total[:, level]
    thresholds, stop = np.empty(len(levels) - 1), len(ends) - 1
    for level in range(len(levels) - 1, 0, -1):
        stop = int(cut[level][stop])
        thresholds[level - 1] = -np.inf if stop == 0 else np.inf if stop == len(edges) else edges[stop]
    return thresholds


def staircase_at(thresholds: Floats, levels: Sequence[float], rows: Samples) -> Floats:
    """Return the level of each row by its distance, shape (N,)."""
    return np.asarray(np.array(levels)[np.searchsorted(thresholds, distance_of(rows), side="right")])


def distance_of(rows: Samples) -> Floats:
    """Return ||x_r - x_h|| of every row, shape (N,), m; infinite without an operator."""
    return distance(rows.X, np.inf)[:, 0].astype(np.float64)
