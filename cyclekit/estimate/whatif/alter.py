"""The inputs of a rollout after a change: the safety function, the nominal motions, the operator's tracks.

Approximations: for a moved place, the logged motion is shifted by a share that grows along it, and its time is scaled
with the path length; the controller would plan a new motion. For an operator who comes more or less often, the logged
times away are shortened or stretched; his visits are unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.dataset.cards import TrainingCard
from cyclekit.errors import EstimateError, UnknownName
from cyclekit.estimate.cycle.transit import cells_of
from cyclekit.estimate.robot.safety import (
    Classifier,
    Dynamics,
    OnStates,
    SafetyModel,
    around,
    is_fast,
    likeliest_of,
    scaling_of,
)
from cyclekit.estimate.whatif.signals import SAME_LEVEL, with_other_signals
from cyclekit.learning.networks.kinds import is_classifier
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.rules.samples.quantities import RulePlace, quantities, shifted
from cyclekit.text.numbers import compact, given, percent

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.estimate.whatif.change import Change, LimitChange
    from cyclekit.schema import Vector

AWAY = 0.99
"""Share of the maximum scaling that must be allowed at all robot positions for the operator to count as away."""
LOOKED_AT = 60
"""Number of robot positions at which the operator's effect is evaluated."""
SPOT_M, NOWHERE_M = 0.1, 1000.0
"""Grid of operator positions for this, m; value in place of an unknown coordinate."""


@dataclass(frozen=True)
class DefinedSafety:
    """A safety function defined in a file: a staircase over ||x_r - x_h||, zones on the floor, or the lower of both.

    At its thresholds and zones the robot slows down; `margin_m` moves them outwards. `fast` is copied from the model
    it is compared with, so that both are rolled out in the same steps.
    """

    change: Change
    margin_m: float = 0.0
    problem: str = "now"
    card: TrainingCard = field(default_factory=TrainingCard)
    known_everywhere: bool = True
    fast: bool = False

    @property
    def levels(self) -> tuple[float, ...]:
        """The levels, ascending."""
        return self.change.levels

    def moved_outwards(self, margin_m: float) -> DefinedSafety:
        """Return the function that must allow a level before s rises to it; `margin_m` is the hysteresis."""
        return replace(self, margin_m=margin_m)

    def predict(self, X: NDArray[np.floating[Any]]) -> Vector:
        """Return the scaling for rows x_r, x_h, shape (N, 6), m; shape (N,)."""
        levels, margin_m = np.array(self.change.levels), self.margin_m
        scaling = np.full(len(X), levels[-1])
        if self.change.thresholds_m:
            apart = np.linalg.norm(X[:, :3].astype(np.float64) - X[:, 3:6], axis=1)
            scaling = levels[np.searchsorted(np.array(self.change.thresholds_m) + margin_m, apart, side="left")]
        for zone in self.change.zones:
            inside = (X[:, 3] >= zone.x_m[0] - margin_m) & (X[:, 3] <= zone.x_m[1] + margin_m)
            inside &= (X[:, 4] >= zone.y_m[0] - margin_m) & (X[:, 4] <= zone.y_m[1] + margin_m)
            scaling[inside] = np.minimum(scaling[inside], zone.level)
        return np.asarray(scaling)


@dataclass(frozen=True)
class LearnedSafety:
    """A learned safety function as it applies when s falls: learned thresholds are half the hysteresis farther out."""

    model: SafetyModel
    hysteresis_m: float
    margin_m: float = 0.0
    problem: str = "now"

    @property
    def card(self) -> TrainingCard:
        """Card of the model."""
        return self.model.card

    @property
    def levels(self) -> tuple[float, ...]:
        """Levels of the model; empty if it has none."""
        return getattr(self.model, "levels", ())

    def moved_outwards(self, margin_m: float) -> LearnedSafety:
        """Return the function that must allow a level before s rises to it; `margin_m` is the hysteresis."""
        return replace(self, margin_m=margin_m)

    def predict(self, X: NDArray[np.float32]) -> Vector:
        """Return the scaling for rows x_r, x_h, shape (N, 6), m; shape (N,)."""
        outwards_m = self.margin_m - self.hysteresis_m / 2
        robot_m, human_m = X[:, :3].astype(np.float64), X[:, 3:].astype(np.float64)
        every = [human_m, *(around(robot_m, human_m, abs(outwards_m)) if outwards_m else ())]
        found = np.stack([self._level(robot_m, moved) for moved in every])
        return np.asarray(found.min(axis=0) if outwards_m > 0.0 else found.max(axis=0))

    def _level(self, robot_m: NDArray[np.float64], human_m: NDArray[np.float64]) -> Vector:
        """Return the most probable level of a classifier (uncertain within the hysteresis); else the scaling."""
        if isinstance(self.model, Classifier) and is_classifier(self.model.network):
            return likeliest_of(self.model, robot_m, human_m)[0]
        return scaling_of(self.model, robot_m, human_m)


def altered_safety(change: Change, model: SafetyModel, logged: Dynamics) -> SafetyModel:
    """Return the safety function after the change; `logged` is the response of s before.

    Raises:
        EstimateError: The change is of a rule, and the model has none, or not this threshold or edge.
    """
    by_states = isinstance(model, OnStates) or bool(model.card.operator_signals)
    if by_states and _asks_positions(change):
        seen = f"change {change.name!r}: it needs the positions of people, and these logs hold none"
        cure = "Change signals, latency_s, ramp_down_per_s, ramp_up_per_s, places or frequency; or log a tracker."
        raise EstimateError(seen, cure=cure)
    if change.signals:
        return with_other_signals(change, model)
    if change.levels:
        return DefinedSafety(change, fast=is_fast(model))
    if change.limits:
        model = _with_other_limits(change, model)
    if "hysteresis_m" not in change.dynamics:
        return model
    if isinstance(model, RuleSafety) and model.rule.law is None:
        return model.with_hysteresis(change.dynamics["hysteresis_m"] or 0.0)
    return LearnedSafety(model, logged.hysteresis_m or 0.0)


def _asks_positions(change: Change) -> bool:
    """Return whether a change needs the positions of people."""
    return bool(change.levels or change.limits or change.base_m is not None or "hysteresis_m" in change.dynamics)


def _with_other_limits(change: Change, model: SafetyModel) -> RuleSafety:
    if not isinstance(model, RuleSafety):
        seen = f"change {change.name!r}: limits need a rule, and the model has none"
        cure = "Train with --model auto, which keeps the rule, or write the whole function: levels with thresholds_m."
        raise EstimateError(seen, cure=cure)
    limits, known = model.rule.limits, quantities(model.rule.limits)
    for wanted in change.limits:
        same = (limit.scaling for limit in limits if abs(limit.scaling - wanted.level) < SAME_LEVEL)
        level = next(same, wanted.level)
        for kind, edge, name, metres in _numbers(wanted):
            place = RulePlace(level, until=False, kind=kind, item=0, edge=edge)
            if place not in known or place._replace(item=1) in known:
                seen = f"change {change.name!r}: the rule has not exactly one {name} at level {given(wanted.level)}"
                raise EstimateError(seen, cure=f"Change one of these: {_has(known)}.")
            limits = shifted(limits, place, metres - known[place].value)
    return model.with_limits(limits)


def _has(known: Mapping[RulePlace, object]) -> str:
    """Return the numbers of a rule as a change names them: `level 0.3: threshold_m, x_m, y_m`."""
    names: dict[float, dict[str, None]] = {}
    for place in known:
        if place.kind in ("rectangle", "nearer"):
            axis = f"{'xy'[place.edge // 2]}_m" if place.kind == "rectangle" else "threshold_m"
            names.setdefault(place.level, {})[axis] = None
    return "; ".join(f"level {given(level)}: {', '.join(each)}" for level, each in names.items())


def _numbers(wanted: LimitChange) -> Iterator[tuple[str, int, str, float]]:
    """Yield kind and edge of each requested number, its name in the file, and its new value, m."""
    if wanted.threshold_m is not None:
        yield "nearer", 0, "threshold_m", wanted.threshold_m
    for first, name, edges in ((0, "x_m", wanted.x_m), (2, "y_m", wanted.y_m)):
        for number, metres in enumerate(edges or ()):
            if math.isfinite(metres):  # else it is of an edge that was never crossed
                yield "rectangle", first + number, name, metres


def altered_tasks(change: Change, tasks: Mapping[str, NominalTask], dataset: Dataset) -> dict[str, NominalTask]:
    """Return the nominal tasks with the moved places.

    Raises:
        UnknownName: A moved place does not exist.
    """
    places = dataset.places
    for name in change.places:
        if name not in places:
            raise UnknownName(f"change {change.name!r}", "place", name, places)
    shift = {name: np.array(xyz) - np.array(places[name].xyz_m) for name, xyz in change.places.items()}
    nowhere = np.zeros(3)
    found = {}
    for name, task in tasks.items():
        start, goal = name.split("->")
        if start in shift or goal in shift:
            task = _bent(task, shift.get(start, nowhere), shift.get(goal, nowhere))
        found[name] = task
    return found


def _bent(task: NominalTask, at_start: Vector, at_goal: Vector) -> NominalTask:
    share = np.linspace(0.0, 1.0, len(task.xyz_m))
    share = (share**2 * (3 - 2 * share))[:, None]
    xyz = task.xyz_m + (1 - share) * at_start + share * at_goal
    before, after = (float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in (task.xyz_m, xyz))
    longer = after / before if before > 1e-6 else 1.0
    return replace(task, xyz_m=xyz, nominal_s=task.nominal_s * longer)


def altered_tracks(
    change: Change, tracks: OperatorTracks, tasks: Mapping[str, NominalTask], safety: SafetyModel
) -> OperatorTracks:
    """Return the operator's tracks in the frame of the moved base, with longer or shorter times between visits.

    Raises:
        EstimateError: The operator is never away, or not enough to come as often as requested.
    """
    if change.base_m is not None:
        tracks = replace(tracks, xyz_m=_seen_from(change, tracks.xyz_m))
    if change.frequency is not None and change.frequency != 1.0:
        tracks = _as_often(change.name, change.frequency, tracks, tasks, safety)
    return tracks


def _seen_from(change: Change, xyz_m: NDArray[np.float64]) -> NDArray[np.float64]:
    turn = np.deg2rad(change.base_yaw_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray((xyz_m - np.array(change.base_m)) @ rotation)


def _at_most(frequency: float) -> str:
    """Return the cure: how often the operator can come, as a multiple of the logged frequency, rounded down."""
    most = int(100 * frequency) / 100
    return (
        f"At most {compact(most)} times is possible."
        if most > 1
        else "The operator is always there: ask for fewer visits."
    )


def _as_often(
    name: str, frequency: float, tracks: OperatorTracks, tasks: Mapping[str, NominalTask], safety: SafetyModel
) -> OperatorTracks:
    away = _away(tracks, tasks, safety)
    share = float(away[np.arange(away.shape[1]) < tracks.logged[:, None]].mean())
    stretch = (1 / frequency - (1 - share)) / share if share > 0 else 0.0
    if share < 0.02 or stretch <= 0:
        seen = f"change {name!r}: the operator is away {percent(share)} of the time, so the operator cannot come "
        raise EstimateError(
            f"{seen}{given(frequency)} times as often",
            cure=_at_most(1 / max(1 - share, 1e-9)),
        )
    ends = np.cumsum(np.where(away, stretch, 1.0), axis=1)
    samples = np.arange(away.shape[1])
    at = np.stack([np.minimum(np.searchsorted(row, samples, side="right"), len(samples) - 1) for row in ends])
    rows = np.arange(len(at))[:, None]
    logged = np.array([int(np.searchsorted(row, n)) for row, n in zip(at, tracks.logged, strict=True)])
    goal = None if tracks.goal_m is None else tracks.goal_m[rows, at]
    state = None if tracks.state is None else tracks.state[rows, at]
    xyz_m, activity = tracks.xyz_m[rows, at], tracks.activity[rows, at]
    return replace(tracks, xyz_m=xyz_m, activity=activity, logged=logged, goal_m=goal, state=state)


def _away(tracks: OperatorTracks, tasks: Mapping[str, NominalTask], safety: SafetyModel) -> NDArray[np.bool_]:
    """Return when the operator slows the robot at no position, shape (K, T); an unseen operator counts as away."""
    points = np.concatenate([task.xyz_m for task in tasks.values()])
    points = points[np.linspace(0, len(points) - 1, min(LOOKED_AT, len(points))).astype(np.int64)]
    if tracks.state is not None:
        code, human = cells_of(tracks)
    else:
        code, human = grid_positions(tracks.xyz_m.reshape(-1, 3))
    least = np.full(len(human), np.inf)
    for point in points:
        least = np.minimum(least, scaling_of(safety, np.broadcast_to(point, (len(human), 3)), human))
    away = (least >= AWAY * max(getattr(safety, "levels", ()), default=1.0)) | ~np.isfinite(human[:, 0])
    return np.asarray(away[code.ravel()].reshape(tracks.xyz_m.shape[:2]))


def grid_positions(xyz_m: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the spot number of each position (N, 3), and the spots (S, 3); NaN: no operator, or unknown height."""
    found, number = np.unique(np.round(np.nan_to_num(xyz_m, nan=NOWHERE_M) / SPOT_M), axis=0, return_inverse=True)
    spots = found * SPOT_M
    spots[spots > NOWHERE_M / 10] = np.nan
    return number.ravel(), spots
