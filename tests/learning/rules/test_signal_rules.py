"""Rules on signals that tell of people: which field counts where on the robot's path."""

from __future__ import annotations

import numpy as np

from cyclekit.dataset.cards import OperatorSignalCard, TrainingCard
from cyclekit.dataset.cards.rule import LimitCard, MetresCard, RectangleCard, RegionCard, RuleCard, SignalCard
from cyclekit.learning.rules.safety import RuleSafety

WARNING = OperatorSignalCard(name="warning", signal="digital-input 2", occupied="1")
PROTECTIVE = OperatorSignalCard(name="protective", signal="digital-input 3", occupied="0")


def test_a_rule_on_signals_answers_by_the_bits_and_the_place_of_the_robot() -> None:
    left = RectangleCard(along=(None, None), across=(MetresCard(value=0.2), None))
    stop = RegionCard(signals=(SignalCard(signal="protective", value="0", robot=left),))
    slow = RegionCard(signals=(SignalCard(signal="warning", value="1"),))
    limits = (LimitCard(scaling=0.0, within=stop), LimitCard(scaling=0.5, within=slow))
    rule = RuleCard(family="signals", levels=(0.0, 0.5, 1.0), limits=limits, explained=1.0)
    safety = RuleSafety(rule, TrainingCard(operator_signals=(WARNING, PROTECTIVE)))
    at_m = np.array([[0.0, 0.5, 0.1], [0.0, 0.5, 0.1], [0.0, 0.5, 0.1], [0.0, -0.5, 0.1]])
    assert safety.predict_signals(at_m, np.array([0, 1, 3, 3])).tolist() == [1.0, 0.5, 0.0, 0.5]
