"""The dynamics of s: how late it follows, how fast it falls and rises, and where."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from msgspec import structs

from cyclekit.dataset.cards import DynamicsCard, TrainingCard
from cyclekit.dataset.cards.rule import LawCard, MetresCard, RuleCard
from cyclekit.estimate.cycle.walk import roll_out
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import lay_out
from cyclekit.estimate.robot.safety import Dynamics, Follower
from cyclekit.estimate.validation.check import check_rollout
from cyclekit.estimate.validation.logged import logged_sequences, with_other_tracks
from cyclekit.learning.rules.safety import RuleSafety

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset


class Sides:
    """0.2 where the operator is nearer than 2 m on the x axis, else 1."""

    problem, card = "now", TrainingCard()

    def predict(self, X: np.ndarray) -> np.ndarray:
        return np.where(np.abs(X[:, 3] - X[:, 0]) < 2.0, 0.2, 1.0)


def followed(dynamics: Dynamics, places: list[float]) -> list[float]:
    follower = Follower(Sides(), dynamics, 0.1)
    return [float(follower.advance(np.zeros((1, 3)), np.array([[x, 0.0, 0.0]]))[0]) for x in places]


def test_s_follows_late_and_on_ramps():
    steps = [3.0, 3.0, 1.0, 1.0, 1.0, 1.0, 3.0, 3.0]
    assert followed(Dynamics(), steps) == [1, 1, 0.2, 0.2, 0.2, 0.2, 1, 1]
    assert followed(Dynamics(latency_s=0.2), steps) == [1, 1, 1, 1, 0.2, 0.2, 0.2, 0.2]
    assert followed(Dynamics(ramp_down_per_s=4.0, ramp_up_per_s=2.0), steps) == pytest.approx(
        [1, 1, 0.8, 0.4, 0.2, 0.2, 0.3, 0.5]
    )


def test_a_cycle_starts_at_the_scaling_that_was_kept_but_never_above_what_is_commanded():
    dynamics = Dynamics(ramp_down_per_s=4.0, ramp_up_per_s=2.0)
    follower = Follower(Sides(), dynamics, 0.1, np.array([0.4, np.nan, 0.4]))
    people = np.array([[3.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    steps = [follower.advance(np.zeros((3, 3)), people) for _ in range(2)]
    np.testing.assert_allclose(steps, [[0.5, 1.0, 0.2], [0.7, 1.0, 0.2]])


def test_s_rises_farther_out_than_it_falls():
    way = [2.3, 2.1, 2.0, 1.85, 2.0, 2.1, 2.3]
    assert followed(Dynamics(hysteresis_m=0.4), way) == [1, 1, 1, 1, 1, 1, 1]
    way = [2.3, 1.7, 1.9, 2.1, 2.3]
    assert followed(Dynamics(hysteresis_m=0.4), way) == [1, 0.2, 0.2, 0.2, 1]


def test_what_the_card_tells_of_the_dynamics_is_used():
    assert Dynamics.of(DynamicsCard()).none
    card = DynamicsCard(latency_s=0.1, hysteresis_m=0.0)
    assert Dynamics.of(card) == Dynamics(latency_s=0.1, hysteresis_m=0.0)
    assert not Dynamics.of(card).none


def test_beside_other_operators_s_follows_as_late_as_beside_their_own(
    logged: Dataset, staircase: Any, monkeypatch: Any
):
    """Slow recovery makes every cycle longer; no operator reacts to the robot because of it."""
    at_once = check_rollout(staircase, logged)
    monkeypatch.setattr(logged, "card", structs.replace(logged.card, dynamics=DynamicsCard(ramp_up_per_s=0.3)))
    slow = check_rollout(staircase, logged)
    assert slow.own_bias > at_once.own_bias + 0.02
    assert slow.crossed_bias - slow.own_bias == pytest.approx(at_once.crossed_bias - at_once.own_bias, abs=0.01)


def test_beside_other_operators_cycles_are_walked_where_the_robot_recovers_slowly(
    logged: Dataset, staircase: Any, monkeypatch: Any
):
    slow = DynamicsCard(ramp_up_per_s=0.1, ramp_down_per_s=1.0)
    monkeypatch.setattr(logged, "card", structs.replace(logged.card, dynamics=slow))
    nominal = nominal_tasks(logged)
    sequence = logged_sequences(logged, nominal)[3]
    tracks = operator_tracks(logged, horizon_s=300.0)
    (others,) = with_other_tracks(staircase, logged, [sequence], nominal, tracks)
    program = lay_out(sequence, nominal, logged)
    walked = roll_out(staircase, program, tracks, None, dynamics=Dynamics.of(logged.card.dynamics)).duration_s
    assert np.flatnonzero(np.isnan(others)).tolist() == [tracks.executions.index(sequence.name)]
    assert others[np.isfinite(others)] == pytest.approx(walked[np.isfinite(others)])


def test_beside_other_operators_s_follows_as_the_law_does(logged: Dataset):
    """The response of a law is its own; that of the dataset's card belongs to rules with levels."""
    lengths = {name: MetresCard(value=value) for name, value in (("stop", 0.5), ("linear", 1.0), ("square", 0.5))}
    law = LawCard(distance="distance TCP to operator", latency_s=0.1, ramp_down_per_s=1.0, ramp_up_per_s=0.1, **lengths)
    model = RuleSafety(RuleCard(family="law", levels=(0.0, 1.0), law=law, explained=1.0), TrainingCard())
    nominal = nominal_tasks(logged)
    sequence = logged_sequences(logged, nominal)[3]
    tracks = operator_tracks(logged, horizon_s=300.0)
    (others,) = with_other_tracks(model, logged, [sequence], nominal, tracks)
    dynamics = Dynamics(latency_s=0.1, ramp_down_per_s=1.0, ramp_up_per_s=0.1)
    walked = roll_out(model, lay_out(sequence, nominal, logged), tracks, None, dynamics=dynamics).duration_s
    seen = np.isfinite(others)
    assert seen.any()
    assert others[seen] == pytest.approx(walked[seen])
