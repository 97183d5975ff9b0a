"""A safety function of signals that detect people: the set of signals that are on is the operator's state.

Logged courses of the signals replace operator tracks. The bits are as logged; the delay of the speed after them is in
the dataset's `dynamics`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import ModelError
from cyclekit.estimate.robot.safety import BLOCK, OnStates, SafetyModel, is_fast
from cyclekit.estimate.robot.support import Support
from cyclekit.learning.signal_inputs import as_inputs
from cyclekit.segmentation.arrivals import fill_nearest

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from cyclekit.dataset.cards import TrainingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Floats, Points, Vector

ROBOT = ["robot_x_m", "robot_y_m", "robot_z_m"]
NOBODY = "no signal of people"


@dataclass(frozen=True, eq=False)
class SignalStates:
    """A safety function whose input is the number of a set of signals that are on.

    Attributes:
        model: The learned function, with the signals in place of x_h (`signal_inputs`).
        patterns: Bit field of each state, as logged.
        logged: TCP positions logged with each state.
        unseen_error: 0: people are seen as far as the safety system sees them.
        doubts: None.
    """

    model: SafetyModel
    patterns: tuple[int, ...]
    logged: Support
    unseen_error: float = 0.0
    doubts: tuple[str, ...] = ()

    @property
    def problem(self) -> str:
        """Problem that the model predicts: the present scaling."""
        return self.model.problem

    @property
    def card(self) -> TrainingCard:
        """How the model was trained."""
        return self.model.card

    @property
    def fast(self) -> bool:
        """Whether it is fast enough to be evaluated in every step of a rollout."""
        return is_fast(self.model)

    @property
    def why(self) -> str:
        """Description of an estimate made with it."""
        return "simulation of the learned safety function with every logged course of the signals of people"

    @property
    def limits(self) -> tuple[str, ...]:
        """Limits of every number from it."""
        names = ", ".join(one.name for one in self.card.operator_signals)
        return (f"people are known by signals alone ({names}), positions of people are not known",)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: the signals that are on."""
        named = [one.name for one in self.card.operator_signals]
        on = [[name for k, name in enumerate(named) if pattern >> k & 1] for pattern in self.patterns]
        return tuple(f"signals {' + '.join(names)} on" if names else NOBODY for names in on)

    def predict(self, X: NDArray[np.floating[Any]]) -> Vector:
        """Return the scaling for rows of x_r and signals, shape (N, 6); shape (N,)."""
        return self.model.predict(X.astype(np.float32))

    def scaling_in(self, robot_m: Points, state: Floats) -> Vector:
        """Return the scaling for TCP positions, shape (N, 3), m, and numbers of states, shape (N, 1)."""
        inputs = np.hstack([robot_m, self._inputs_of(state)]).astype(np.float32)
        found = [self.model.predict(inputs[start : start + BLOCK]) for start in range(0, len(inputs), BLOCK)]
        return np.asarray(np.clip(np.concatenate([np.empty(0), *found]), 0.0, 1.0))

    def near_logged(self, robot_m: Points, state: Floats) -> Bools:
        """Return whether these signals were logged with the TCP near these positions, shape (N,)."""
        return self.logged.near_logged(robot_m, self._inputs_of(state))

    def logged_states(self, dataset: Dataset) -> dict[str, tuple[Vector, Floats]]:
        """Return times (T,), s, and states (T, 1) of each execution; gaps take the state of the nearest sample."""
        frame = dataset.samples(columns=["execution", "t_s", "human_signals"])
        found = {}
        for (name,), rows in frame.group_by(["execution"], maintain_order=True):
            bits = rows["human_signals"].cast(float).fill_null(np.nan).to_numpy()
            known = np.flatnonzero(np.isfinite(bits))
            if len(known):
                number = np.searchsorted(self.patterns, fill_nearest(bits, known).astype(np.int64))
                found[str(name)] = rows["t_s"].to_numpy(), number[:, None].astype(np.float64)
        return found

    def _inputs_of(self, state: Floats) -> Floats:
        return np.asarray(self._inputs[state[:, 0].astype(np.int64)])

    @cached_property
    def _inputs(self) -> Floats:
        return as_inputs(np.array(self.patterns, np.int64), len(self.card.operator_signals))


def on_states_of(model: SafetyModel, dataset: Dataset) -> SafetyModel:
    """Return the model for estimates: by states if it was trained on signals, else unchanged.

    Raises:
        ModelError: The dataset has other signals than the model was trained on.
    """
    if isinstance(model, OnStates) or model.problem != "now" or not model.card.operator_signals:
        return model
    learned, here = ([one.name for one in card.operator_signals] for card in (model.card, dataset.card))
    if learned != here:
        seen = f"{dataset.path}: signals of people: {', '.join(here) or 'none'}; the model knows {', '.join(learned)}"
        raise ModelError(seen, cure="Train it on these logs: cyclekit train DATASET --out MODEL")
    frame = dataset.samples(columns=[*ROBOT, "human_signals"]).drop_nulls("human_signals")
    bits = frame["human_signals"].to_numpy()
    patterns = np.unique(bits)
    support = Support(frame.select(ROBOT).to_numpy(), as_inputs(bits, len(here)))
    return SignalStates(model, tuple(patterns.tolist()), support)
