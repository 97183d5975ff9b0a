"""The scaling that a rollout meets: what the network says of two positions, and how s follows it in time.

A safety system answers late (latency), lets s change only so fast (ramps), and gives speed back a little farther out
than it took it (hysteresis). Where these were read from the logs they are in the dataset's card under `dynamics`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from cyclekit.dataset.unknown_height import in_plane, inputs_in_plane
from cyclekit.learning.networks.kinds import names_levels
from cyclekit.learning.rules.safety import RuleSafety

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.dataset.cards import DynamicsCard, TrainingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Floats, Ints, Singles, Vector


BLOCK = 2048
"""Rows predicted at once: a block and its layers stay in the fast cache."""


SURE = 0.99
"""A level of this probability is farther from every other than half the hysteresis."""


@runtime_checkable
class SafetyModel(Protocol):
    """What a rollout asks of a model; a staircase written down in a file has it as well."""

    @property
    def problem(self) -> str:
        """What it predicts; `now` for the scaling of the present instant."""

    @property
    def card(self) -> TrainingCard:
        """How it came about."""

    def predict(self, X: Singles, /) -> Vector:
        """Return the scaling (N,) for rows x_r, x_h (N, 6), m."""


@runtime_checkable
class Written(SafetyModel, Protocol):
    """A safety function whose thresholds are known: they are those at which s falls."""

    def moved_outwards(self, margin_m: float, /) -> SafetyModel:
        """Return it with its thresholds and zones moved outwards by the hysteresis: what s rises by."""


@runtime_checkable
class Everywhere(SafetyModel, Protocol):
    """A safety function that may hold where nothing was ever logged, as one that is written down does."""

    @property
    def known_everywhere(self) -> bool:
        """Whether it holds there."""


def holds_everywhere(model: SafetyModel) -> bool:
    """Return whether the safety function is known in positions that were never logged; a learned one is not."""
    return isinstance(model, Everywhere) and model.known_everywhere


@runtime_checkable
class Fast(SafetyModel, Protocol):
    """A safety function that may answer so fast that a rollout asks it in every step."""

    @property
    def often(self) -> bool:
        """Whether it does, and what it is compared with does too."""


def asked_often(model: SafetyModel) -> bool:
    """Return whether a rollout asks the safety function in every step; a network takes too long."""
    return isinstance(model, Fast) and model.often


class Logged(Protocol):
    """What knows which pairs of robot and operator were ever logged: cells of space, or a safety function of states."""

    def near_logged(self, robot_m: Floats, human_m: Floats, /) -> Bools:
        """Return whether the logs show the operator there, or in such a state, with the TCP there, shape (N,)."""


@runtime_checkable
class OnStates(SafetyModel, Protocol):
    """A safety function of states of the operator that stand in place of his position, which no log shows.

    A state is a row of numbers; the first one is its index into `states`.
    """

    def __hash__(self) -> int:
        """Return a hash: tracks that were made for it are kept."""

    @property
    def unseen_error(self) -> float:
        """Part of the spread of logged durations by which expected ones may be off, as nobody saw people."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""

    @property
    def why(self) -> str:
        """What an estimate with it is, in a few words."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """What makes every number from it doubtful, one sentence each."""

    @property
    def limits(self) -> tuple[str, ...]:
        """What else limits them, one sentence each."""

    def scaling_in(self, robot_m: Floats, state: Floats, /) -> Vector:
        """Return s with the TCP there, shape (N, 3), m, in states, shape (N, D); shape (N,)."""

    def near_logged(self, robot_m: Floats, state: Floats, /) -> Bools:
        """Return whether the logs show such states with the TCP there, shape (N,)."""

    def logged_states(self, dataset: Dataset, /) -> Mapping[str, tuple[Vector, Floats]]:
        """Return times (T,), s, and states (T, D) of each execution in which they are known."""


@runtime_checkable
class Classifier(SafetyModel, Protocol):
    """A network that may tell how likely each level is, if `network` says that it is a classifier."""

    @property
    def network(self) -> str:
        """Its kind."""

    @property
    def levels(self) -> tuple[float, ...]:
        """Its levels, ascending."""

    def probabilities(self, X: Singles, /) -> Vector:
        """Return the probability of every level (N, P) for rows x_r, x_h (N, 6), m."""


@dataclass(frozen=True)
class Dynamics:
    """How s follows the safety function in time; None where nothing of it was seen.

    Attributes:
        latency_s: From positions to the scaling that answers to them.
        ramp_down_per_s, ramp_up_per_s: Fastest fall and rise of s.
        hysteresis_m: How much farther away the operator must be for s to rise than for it to fall.
        hold_s: How long s must have been allowed to rise before it does.
    """

    latency_s: float | None = None
    ramp_down_per_s: float | None = None
    ramp_up_per_s: float | None = None
    hysteresis_m: float | None = None
    hold_s: float | None = None

    @classmethod
    def of(cls, card: DynamicsCard, model: SafetyModel | None = None) -> Dynamics:
        """Return what a dataset's card says, or a law of the model, which was fitted together with its response."""
        law = model.rule.law if isinstance(model, RuleSafety) else None
        if law is not None:
            return cls(law.latency_s, law.ramp_down_per_s, law.ramp_up_per_s)
        return cls(**{name: getattr(card, name) for name in cls.__dataclass_fields__})

    @property
    def none(self) -> bool:
        """Whether s follows at once."""
        return not any(vars(self).values())


def at_once(model: SafetyModel, dynamics: Dynamics) -> bool:
    """Return whether s depends on the positions of the instant alone."""
    return dynamics.none and not (isinstance(model, OnStates) or (isinstance(model, RuleSafety) and model.lags))


def scaling_of(model: SafetyModel, robot_m: Floats, human_m: Floats) -> Vector:
    """Return s of each pair of positions, shape (N, 3) both; without an operator, what the logs showed then.

    Of somebody whose height is unknown (NaN) it is that of the distance in the plane. For a safety function of states
    these stand in place of x_h, shape (N, D).
    """
    if human_m.shape[1] != 3 and isinstance(model, OnStates):
        return model.scaling_in(robot_m, human_m)
    scaling, inputs, present = _asked(model, robot_m, human_m)
    if len(inputs):
        blocks = range(0, len(inputs), BLOCK)
        found = [model.predict(inputs[start : start + BLOCK]) for start in blocks]
        scaling[present] = np.clip(np.concatenate(found), 0.0, 1.0)
    return scaling


def likeliest_of(model: Classifier, robot_m: Floats, human_m: Floats) -> tuple[Vector, Bools]:
    """Return the likeliest level of each pair of positions, as `scaling_of`, and whether it is SURE; (N,) each."""
    scaling, inputs, present = _asked(model, robot_m, human_m)
    sure = np.ones(len(scaling), dtype=np.bool_)
    if len(inputs):
        blocks = range(0, len(inputs), BLOCK)
        found = np.concatenate([model.probabilities(inputs[start : start + BLOCK]) for start in blocks])
        scaling[present] = np.array(model.levels)[found.argmax(axis=1)]
        sure[present] = found.max(axis=1) >= SURE
    return scaling, sure


def around(robot_m: Floats, human_m: Floats, by_m: float) -> list[Floats]:
    """Return the operators (N, 3) moved by `by_m` towards the robot, away from it, and to both sides on the floor."""
    way = human_m - robot_m
    way *= by_m / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    side = np.stack([-way[:, 1], way[:, 0], np.zeros(len(way))], axis=1)
    side *= abs(by_m) / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    return [human_m - way, human_m + way, human_m - side, human_m + side]


def _asked(model: SafetyModel, robot_m: Floats, human_m: Floats) -> tuple[Vector, Singles, Ints | slice]:
    """Return s without an operator (N,), the inputs of the pairs that are asked (M, 6), and their rows."""
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


class Follower:
    """s of N cycles over time, one call per step of `step_s`."""

    def __init__(self, model: SafetyModel, dynamics: Dynamics, step_s: float) -> None:
        self._model, self._dynamics, self._step_s = model, dynamics, step_s
        # what kind of model it is takes Python as long to tell as the network takes for a few rows
        self._rule = model if isinstance(model, RuleSafety) else None
        self._written = model if isinstance(model, Written) else None
        self._classifier = model if isinstance(model, Classifier) and names_levels(model.network) else None
        self._delay = round((dynamics.latency_s or 0.0) / step_s)
        self._recent: deque[Vector] = deque(maxlen=1 + round((dynamics.hold_s or 0.0) / step_s))
        self._asked = np.empty(0)
        self._seen: deque[Vector] = deque()
        self._held: Vector | None = None
        self._s: Vector | None = None

    def advance(self, robot_m: Floats, human_m: Floats) -> Vector:
        """Return s (N,) of this step for positions (N, 3) at its middle."""
        self._asked = self._wanted(robot_m, human_m)
        return self.go_on()

    def go_on(self) -> Vector:
        """Return s (N,) of one more step for the positions that were told last."""
        self._recent.append(self._asked)
        self._seen.append(np.min(self._recent, axis=0) if len(self._recent) > 1 else self._asked)
        wanted = self._seen.popleft() if len(self._seen) > self._delay else self._seen[0]
        if self._s is not None:
            down, up = self._dynamics.ramp_down_per_s, self._dynamics.ramp_up_per_s
            lowest = -np.inf if not down else self._s - down * self._step_s
            highest = np.inf if not up else self._s + up * self._step_s
            wanted = np.clip(wanted, lowest, highest)
        self._s = wanted
        return wanted

    def keep(self, going: Bools) -> None:
        """Leave the other rows out from now on."""
        self._seen, self._asked = deque(wanted[going] for wanted in self._seen), self._asked[going]
        self._recent = deque((wanted[going] for wanted in self._recent), self._recent.maxlen)
        self._s, self._held = (None if part is None else part[going] for part in (self._s, self._held))

    def _wanted(self, robot_m: Floats, human_m: Floats) -> Vector:
        """Return what the safety function with its hysteresis asks for."""
        lags = self._rule.lags if self._rule is not None else bool(self._dynamics.hysteresis_m)
        if not lags:
            return scaling_of(self._model, robot_m, human_m)
        rising, falling = self.bounds(robot_m, human_m)
        falling = np.maximum(falling, rising)
        self._held = falling if self._held is None else np.clip(self._held, rising, falling)
        return self._held

    def bounds(self, robot_m: Floats, human_m: Floats) -> tuple[Vector, Vector]:
        """Return up to which s may rise and down to which it must fall; what was learned lies half way between.

        A classifier hesitates within the hysteresis, where s was now one level, now the other. Its likeliest level
        there is on either side of the middle; of what lies within half the hysteresis the slowest may be risen to, and
        the quickest need not be fallen below.
        """
        margin_m = self._dynamics.hysteresis_m or 0.0
        if self._rule is not None:
            entering, leaving = self._rule.of_side("entering"), self._rule.of_side("leaving")
            return scaling_of(leaving, robot_m, human_m), scaling_of(entering, robot_m, human_m)
        if self._written is not None:
            outer = self._written.moved_outwards(margin_m)
            return scaling_of(outer, robot_m, human_m), scaling_of(self._model, robot_m, human_m)
        human_m = in_plane(robot_m, human_m)
        if self._classifier is None:
            nearer, farther, *_ = around(robot_m, human_m, margin_m / 2)
            return scaling_of(self._model, robot_m, nearer), scaling_of(self._model, robot_m, farther)
        rising, sure = likeliest_of(self._classifier, robot_m, human_m)
        falling, near = rising.copy(), np.flatnonzero(~sure)
        if len(near):  # all four at once: the network takes as long for a few rows as for many
            moved = around(robot_m[near], human_m[near], margin_m / 2)
            robots = np.tile(robot_m[near], (len(moved), 1))
            levels = likeliest_of(self._classifier, robots, np.concatenate(moved))[0].reshape(len(moved), -1)
            rising[near] = np.minimum(rising[near], levels.min(axis=0))
            falling[near] = np.maximum(falling[near], levels.max(axis=0))
        return rising, falling
