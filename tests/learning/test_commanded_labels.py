"""Samples are labelled with the level that the safety system heads for, and a rollout follows it as the cell does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from staircases import LEVELS, commanded, followed

from cyclekit.dataset.cards import DynamicsCard
from cyclekit.estimate.robot.safety import Dynamics, Follower
from cyclekit.learning.labelling import commanded_in_time, with_commands

RATE_HZ = 10.0


def logged(response: DynamicsCard) -> Any:
    return SimpleNamespace(card=SimpleNamespace(dynamics=response), rate_hz=RATE_HZ)


def samples(scaling: np.ndarray) -> pl.DataFrame:
    return pl.DataFrame({"execution": "a", "t_s": np.arange(len(scaling)) / RATE_HZ, "scaling": scaling})


def test_samples_on_slow_ramps_are_on_the_level_that_was_commanded():
    _, level = commanded(RATE_HZ, seconds=600, shortest_s=4.0)
    frame = samples(followed(level, RATE_HZ, 0.3, 1.0, 0.1))
    response = DynamicsCard(latency_s=0.3, ramp_down_per_s=1.0, ramp_up_per_s=0.1)
    found = with_commands(logged(response), frame, LEVELS)["scaling"].fill_null(np.nan).to_numpy()
    known = np.isfinite(found)
    assert known.mean() > 0.5
    assert (found[known] == np.asarray(LEVELS)[level[known]]).mean() > 0.98
    before = np.isin(frame["scaling"].to_numpy(), LEVELS)
    assert (frame["scaling"].to_numpy()[before] == np.asarray(LEVELS)[level[before]]).mean() < 0.96  # answered late


@pytest.mark.parametrize("response", [DynamicsCard(), DynamicsCard(latency_s=0.02, hysteresis_m=0.1)])
def test_where_no_response_was_read_samples_stay_as_they_are(response: DynamicsCard):
    frame = samples(np.ones(50))
    assert with_commands(logged(response), frame, LEVELS) is frame


class _Distance:
    """Full speed from 1 m on."""

    problem = "now"
    card = SimpleNamespace(scaling_without_operator=None)

    def predict(self, X: np.ndarray, /) -> np.ndarray:
        return (np.abs(X[:, 3] - X[:, 0]) > 1.0).astype(float)


def test_a_rollout_rises_only_when_the_hold_time_is_over():
    follower = Follower(_Distance(), Dynamics(latency_s=0.2, hold_s=0.5), 0.1)
    robot, near, far = np.zeros((1, 3)), np.array([[0.5, 0.0, 0.0]]), np.array([[2.0, 0.0, 0.0]])
    steps = [far] * 3 + [near] * 3 + [far] * 12
    found = np.array([follower.advance(robot, human)[0] for human in steps])
    assert found.tolist() == [1.0] * 5 + [0.0] * 8 + [1.0] * 5  # falls 0.2 s late, rises 0.2 + 0.5 s late


def test_a_ramp_that_people_did_not_cause_shows_the_level_to_which_it_leads():
    """It passes a level on its way down; without people who move, only the robot's place changed the level."""
    scaling = np.array([0.5] * 6 + [0.35, 0.2, 0.05] + [0.0] * 6)
    response, levels = DynamicsCard(ramp_down_per_s=1.5, ramp_up_per_s=1.5), (0.0, 0.25, 0.5, 1.0)
    same = np.ones(15, np.int64)
    came = np.where(np.arange(15) < 7, 1, 3)
    for people, expected in ((None, [-1, -1]), (same, [0, 0]), (came, [-1, -1])):
        found = commanded_in_time(logged(response), samples(scaling), levels, response, sure_s=0.03, people=people)
        assert found[1:5].tolist() == [2] * 4
        assert found[6:8].tolist() == expected
        assert found[8:14].tolist() == [0] * 6
