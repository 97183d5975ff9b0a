"""The scaling in a rollout: the safety function of two positions, and the response of s to it over time.

A safety system has a reaction time (latency), limits the rate of change of s (ramps), and restores speed at a larger
distance than it reduces it (hysteresis). If these were found in the logs, the dataset's card has them in `dynamics`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from cyclekit.dataset.unknown_height import in_plane, inputs_in_plane
from cyclekit.learning.networks.kinds import is_classifier
from cyclekit.learning.rules.safety import RuleSafety

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.dataset.cards import DynamicsCard, TrainingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Floats, Ints, Singles, Vector


BLOCK = 2048
"""Rows predicted at once: a block and its layers fit into the processor's cache."""


SURE = 0.99
"""Minimum probability of a level for its position to count as beyond half the hysteresis from every threshold."""


@runtime_checkable
class SafetyModel(Protocol):
    """A safety function as used by a rollout: a learned model, or a staircase defined in a file."""

    @property
    def problem(self) -> str:
        """Problem that it predicts; `now` for the present scaling."""

    @property
    def card(self) -> TrainingCard:
        """How it was trained."""

    def predict(self, X: Singles, /) -> Vector:
        """Return the scaling (N,) for rows x_r, x_h (N, 6), m."""


@runtime_checkable
class HasThresholds(SafetyModel, Protocol):
    """A safety function with known thresholds, which are those at which s falls."""

    def moved_outwards(self, margin_m: float, /) -> SafetyModel:
        """Return it with thresholds and zones moved outwards by the hysteresis: at these s rises."""


@runtime_checkable
class Everywhere(SafetyModel, Protocol):
    """A safety function that may be valid where nothing was logged, such as one that is defined in a file."""

    @property
    def known_everywhere(self) -> bool:
        """Whether it is valid there."""


def holds_everywhere(model: SafetyModel) -> bool:
    """Return whether the safety function is valid in positions that were never logged; a learned one is not."""
    return isinstance(model, Everywhere) and model.known_everywhere


@runtime_checkable
class Fast(SafetyModel, Protocol):
    """A safety function that may be fast enough to be evaluated in every step of a rollout."""

    @property
    def fast(self) -> bool:
        """Whether it is fast enough, and so is the function it is compared with."""


def is_fast(model: SafetyModel) -> bool:
    """Return whether a rollout evaluates the safety function in every step; a network is too slow."""
    return isinstance(model, Fast) and model.fast


class Logged(Protocol):
    """A test for logged pairs of robot and operator: cells of space, or a safety function of states."""

    def near_logged(self, robot_m: Floats, human_m: Floats, /) -> Bools:
        """Return whether the operator's position or state was logged with the TCP near this position, shape (N,)."""


@runtime_checkable
class OnStates(SafetyModel, Protocol):
    """A safety function of states of the operator, which replace his position if that was not logged.

    A state is a row of numbers; the first is its index into `states`.
    """

    def __hash__(self) -> int:
        """Return a hash, by which tracks for this model are cached."""

    @property
    def unseen_error(self) -> float:
        """Error of expected durations because people were not seen, as a share of the spread of logged durations."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""

    @property
    def why(self) -> str:
        """Short description of an estimate made with it."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons to doubt every number from it, one sentence each."""

    @property
    def limits(self) -> tuple[str, ...]:
        """Other limits of every number from it, one sentence each."""

    def scaling_in(self, robot_m: Floats, state: Floats, /) -> Vector:
        """Return s for TCP positions, shape (N, 3), m, and states, shape (N, D); shape (N,)."""

    def near_logged(self, robot_m: Floats, state: Floats, /) -> Bools:
        """Return whether these states were logged with the TCP near these positions, shape (N,)."""

    def logged_states(self, dataset: Dataset, /) -> Mapping[str, tuple[Vector, Floats]]:
        """Return times (T,), s, and states (T, D) of each execution in which states are known."""


@runtime_checkable
class Classifier(SafetyModel, Protocol):
    """A network that predicts a probability for each level, if `network` is a classifier."""

    @property
    def network(self) -> str:
        """Kind of the network."""

    @property
    def levels(self) -> tuple[float, ...]:
        """Levels, ascending."""

    def probabilities(self, X: Singles, /) -> Vector:
        """Return the probability of every level (N, P) for rows x_r, x_h (N, 6), m."""


@dataclass(frozen=True)
class Dynamics:
    """Response of s to the safety function over time; None for a parameter that was not found.

    Attributes:
        latency_s: Reaction time from positions to the scaling that results from them.
        ramp_down_per_s, ramp_up_per_s: Maximum rates of fall and rise of s.
        hysteresis_m: Difference between the distances at which s rises and falls.
        hold_s: Minimum time for which a rise must be allowed before s rises.
    """

    latency_s: float | None = None
    ramp_down_per_s: float | None = None
    ramp_up_per_s: float | None = None
    hysteresis_m: float | None = None
    hold_s: float | None = None

    @classmethod
    def of(cls, card: DynamicsCard, model: SafetyModel | None = None) -> Dynamics:
        """Return the dynamics of a dataset's card, or of the model's law, which was fitted with its response."""
        law = model.rule.law if isinstance(model, RuleSafety) else None
        if law is not None:
            return cls(law.latency_s, law.ramp_down_per_s, law.ramp_up_per_s)
        return cls(**{name: getattr(card, name) for name in cls.__dataclass_fields__})

    @property
    def none(self) -> bool:
        """Whether s follows the safety function without delay."""
        return not any(vars(self).values())


def at_once(model: SafetyModel, dynamics: Dynamics) -> bool:
    """Return whether s depends only on the positions at the same instant."""
    return dynamics.none and not (isinstance(model, OnStates) or (isinstance(model, RuleSafety) and model.lags))


def scaling_of(model: SafetyModel, robot_m: Floats, human_m: Floats) -> Vector:
    """Return s for each pair of positions, shape (N, 3) each; without an operator, the logged scaling without one.

    If the operator's height is unknown (NaN), the distance in the plane is used. For a safety function of states, these
    replace x_h, shape (N, D).
    """
    if human_m.shape[1] != 3 and isinstance(model, OnStates):
        return model.scaling_in(robot_m, human_m)
    scaling, inputs, present = _pair_inputs(model, robot_m, human_m)
    if len(inputs):
        blocks = range(0, len(inputs), BLOCK)
        found = [model.predict(inputs[start : start + BLOCK]) for start in blocks]
        scaling[present] = np.clip(np.concatenate(found), 0.0, 1.0)
    return scaling


def likeliest_of(model: Classifier, robot_m: Floats, human_m: Floats) -> tuple[Vector, Bools]:
    """Return the most probable level of each pair of positions, as `scaling_of`, and whether it is SURE; (N,) each."""
    scaling, inputs, present = _pair_inputs(model, robot_m, human_m)
    sure = np.ones(len(scaling), dtype=np.bool_)
    if len(inputs):
        blocks = range(0, len(inputs), BLOCK)
        found = np.concatenate([model.probabilities(inputs[start : start + BLOCK]) for start in blocks])
        scaling[present] = np.array(model.levels)[found.argmax(axis=1)]
        sure[present] = found.max(axis=1) >= SURE
    return scaling, sure


def around(robot_m: Floats, human_m: Floats, by_m: float) -> list[Floats]:
    """Return operators (N, 3) moved by `by_m` towards the robot, away from it, and to both sides on the floor."""
    way = human_m - robot_m
    way *= by_m / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    side = np.stack([-way[:, 1], way[:, 0], np.zeros(len(way))], axis=1)
    side *= abs(by_m) / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    return [human_m - way, human_m + way, human_m - side, human_m + side]


def _pair_inputs(model: SafetyModel, robot_m: Floats, human_m: Floats) -> tuple[Vector, Singles, Ints | slice]:
    """Return s without an operator (N,), the inputs of the pairs to evaluate (M, 6), and their rows."""
    without = model.card.scaling_without_operator
    scaling = np.full(len(robot_m), 1.0 if without is None else without)
    inputs = np.empty((len(robot_m), 6), dtype=np.float32)
    inputs[:, :3], inputs[:, 3:] = robot_m, human_m
    inputs = inputs_in_plane(inputs)
    seen = np.isfinite(inputs[:, 3] + inputs[:, 4] + inputs[:, 5])
    if seen.all() or (isinstance(model, RuleSafety) and model.slows_alone):
        return scaling, inputs, slice(None)
    present = np.flatnonzero(seen)
    return scaling, inputs[present], present


class MayMove(Protocol):
    """The robot in N cycles."""

    @property
    def may_move(self) -> Bools:
        """Which robots may move at some time of the next step, shape (N,)."""


def scaling_in_step(
    model: SafetyModel, follower: Follower | None, robots: MayMove, robot_m: Floats, human_m: Floats
) -> Vector:
    """Return s (N,) of the next step for positions (N, 3); without a follower, s follows the model at once.

    The model is not evaluated for robots at standstill throughout the step; their s is 1.
    """
    if follower is not None:
        return follower.advance(robot_m, human_m)
    scaling, matters = np.ones(len(robot_m)), np.flatnonzero(robots.may_move)
    scaling[matters] = scaling_of(model, robot_m.take(matters, axis=0), human_m.take(matters, axis=0))
    return scaling


class Follower:
    """s of N cycles over time, with one call per step of `step_s`; it starts at `scaling` (N,) or, if lower, commanded.

    NaN or None: it starts as commanded.
    """

    def __init__(self, model: SafetyModel, dynamics: Dynamics, step_s: float, scaling: Vector | None = None) -> None:
        self._model, self._dynamics, self._step_s = model, dynamics, step_s
        # isinstance checks per step would take as long as the network for a few rows
        self._rule = model if isinstance(model, RuleSafety) else None
        self._defined = model if isinstance(model, HasThresholds) else None
        self._classifier = model if isinstance(model, Classifier) and is_classifier(model.network) else None
        self._delay = round((dynamics.latency_s or 0.0) / step_s)
        self._recent: deque[Vector] = deque(maxlen=1 + round((dynamics.hold_s or 0.0) / step_s))
        self._target = np.empty(0)
        self._seen: deque[Vector] = deque()
        self._held: Vector | None = None
        self._start, self._s = scaling, np.empty(0)
        self._began = False

    def advance(self, robot_m: Floats, human_m: Floats) -> Vector:
        """Return s (N,) of this step for positions (N, 3) at the middle of the step."""
        self._target = self._wanted(robot_m, human_m)
        return self.go_on()

    def go_on(self) -> Vector:
        """Return the mean s (N,) of one more step for the positions of the last call of `advance`."""
        self._recent.append(self._target)
        self._seen.append(np.min(self._recent, axis=0) if len(self._recent) > 1 else self._target)
        wanted = self._seen.popleft() if len(self._seen) > self._delay else self._seen[0]
        if not self._began:
            self._s = wanted if self._start is None else np.fmin(self._start, wanted)
            self._began = True
        before = self._s
        down, up = self._dynamics.ramp_down_per_s, self._dynamics.ramp_up_per_s
        lowest = -np.inf if not down else before - down * self._step_s
        highest = np.inf if not up else before + up * self._step_s
        self._s = np.clip(wanted, lowest, highest)
        rate = np.where(self._s < before, down or np.inf, up or np.inf)
        ramp_s = np.abs(self._s - before) / rate
        return np.asarray(self._s + (before - self._s) * ramp_s / (2.0 * self._step_s))

    def keep(self, going: Bools) -> None:
        """Drop all other rows."""
        self._seen, self._target = deque(wanted[going] for wanted in self._seen), self._target[going]
        self._recent = deque((wanted[going] for wanted in self._recent), self._recent.maxlen)
        self._s = self._s[going]
        self._held = None if self._held is None else self._held[going]

    def _wanted(self, robot_m: Floats, human_m: Floats) -> Vector:
        """Return the scaling of the safety function with its hysteresis."""
        lags = self._rule.lags if self._rule is not None else bool(self._dynamics.hysteresis_m)
        if not lags:
            return scaling_of(self._model, robot_m, human_m)
        rising, falling = self.bounds(robot_m, human_m)
        falling = np.maximum(falling, rising)
        self._held = falling if self._held is None else np.clip(self._held, rising, falling)
        return self._held

    def bounds(self, robot_m: Floats, human_m: Floats) -> tuple[Vector, Vector]:
        """Return the bounds up to which s may rise and down to which it must fall; the learned function lies half-way.

        Within the hysteresis a classifier is uncertain, as the logs show both levels. Its most probable level changes
        at the middle. So the minimum of the levels within half the hysteresis bounds the rise, and their maximum the
        fall.
        """
        margin_m = self._dynamics.hysteresis_m or 0.0
        if self._rule is not None:
            entering, leaving = self._rule.of_side("entering"), self._rule.of_side("leaving")
            return scaling_of(leaving, robot_m, human_m), scaling_of(entering, robot_m, human_m)
        if self._defined is not None:
            outer = self._defined.moved_outwards(margin_m)
            return scaling_of(outer, robot_m, human_m), scaling_of(self._model, robot_m, human_m)
        human_m = in_plane(robot_m, human_m)
        if self._classifier is None:
            nearer, farther, *_ = around(robot_m, human_m, margin_m / 2)
            return scaling_of(self._model, robot_m, nearer), scaling_of(self._model, robot_m, farther)
        rising, sure = likeliest_of(self._classifier, robot_m, human_m)
        falling, near = rising.copy(), np.flatnonzero(~sure)
        if len(near):  # all four in one call: the network takes as long for a few rows as for many
            moved = around(robot_m[near], human_m[near], margin_m / 2)
            robots = np.tile(robot_m[near], (len(moved), 1))
            levels = likeliest_of(self._classifier, robots, np.concatenate(moved))[0].reshape(len(moved), -1)
            rising[near] = np.minimum(rising[near], levels.min(axis=0))
            falling[near] = np.maximum(falling[near], levels.max(axis=0))
        return rising, falling
