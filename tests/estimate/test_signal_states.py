"""Signals that tell of people in place of positions: the states, the speed in each, and changes of single signals."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.dataset.cards import OperatorSignalCard, TrainingCard
from cyclekit.dataset.cards.rule import LimitCard, RegionCard, RuleCard, SignalCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import EstimateError, ModelError
from cyclekit.estimate.robot.safety import Dynamics, OnStates, at_once
from cyclekit.estimate.robot.signal_states import NOBODY, SignalStates, on_states_of
from cyclekit.estimate.robot.support import Support
from cyclekit.estimate.whatif.alter import altered_safety
from cyclekit.estimate.whatif.change import Change, SignalChange
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.signal_inputs import as_inputs

SIGNALS = tuple(OperatorSignalCard(name=name, signal=name, occupied="1") for name in ("warning", "stop"))
NEAR, FAR = (0.5, 0.0, 0.1), (-0.5, 0.0, 0.1)


def _limit(scaling: float, name: str) -> LimitCard:
    return LimitCard(scaling=scaling, within=RegionCard(signals=(SignalCard(signal=name, value="1"),)))


RULE = RuleSafety(
    RuleCard(
        family="table of signals",
        levels=(0.0, 0.5, 1.0),
        limits=(_limit(0.0, "stop"), _limit(0.5, "warning")),
        explained=1.0,
    ),
    TrainingCard(operator_signals=SIGNALS),
)


def states_of(rule: RuleSafety) -> SignalStates:
    """The rule asked by states 0 (nobody), 1 (warning), 2 (both); the second was logged at NEAR alone."""
    seen = np.array([NEAR, NEAR, FAR, NEAR]), as_inputs(np.array([0, 1, 0, 3]), 2)
    return SignalStates(rule, (0, 1, 3), Support(*seen))


def speeds(rule: RuleSafety, *places: tuple[float, float, float]) -> list[list[float]]:
    """The speed at places, by state."""
    model = states_of(rule)
    return [model.scaling_in(np.array(places), np.full((len(places), 1), float(n))).tolist() for n in range(3)]


def test_each_state_has_its_name_its_speed_and_its_support() -> None:
    model = states_of(RULE)
    assert model.states == (NOBODY, "signals warning on", "signals warning + stop on")
    assert speeds(RULE, NEAR, FAR) == [[1.0, 1.0], [0.5, 0.5], [0.0, 0.0]]
    both = np.array([NEAR, FAR])
    assert model.near_logged(both, np.ones((2, 1))).tolist() == [True, False]
    assert isinstance(model, OnStates)
    assert not at_once(model, Dynamics())


def test_a_signal_gets_another_level_or_counts_in_a_rectangle_of_the_tcp_only() -> None:
    faster = altered_safety(Change("a", signals=(SignalChange("warning", level=0.8),)), RULE, Dynamics())
    assert isinstance(faster, RuleSafety)
    assert speeds(faster, NEAR) == [[1.0], [0.8], [0.0]]
    inside = SignalChange("stop", x_m=(0.0, 1.0), y_m=(-1.0, 1.0))
    partly = altered_safety(Change("b", signals=(inside,)), RULE, Dynamics())
    assert isinstance(partly, RuleSafety)
    assert speeds(partly, NEAR, FAR) == [[1.0, 1.0], [0.5, 0.5], [0.0, 0.5]]


def test_what_a_signal_cannot_be_changed_to_is_refused() -> None:
    with pytest.raises(EstimateError, match="does not use signal 'door'"):
        altered_safety(Change("c", signals=(SignalChange("door", level=0.8),)), RULE, Dynamics())
    with pytest.raises(EstimateError, match="needs the positions of people"):
        altered_safety(Change("d", levels=(0.0, 1.0), thresholds_m=(1.0,)), RULE, Dynamics())
    with pytest.raises(ValueError, match="give level, x_m or y_m"):
        SignalChange("warning")


def test_a_dataset_with_other_signals_is_refused(logged: Dataset) -> None:
    with pytest.raises(ModelError, match="signals of people: none; the model knows warning, stop"):
        on_states_of(RULE, logged)
