"""The operator model against the logged tracks: where cycles beside it differ beyond chance, the tracks are used."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.operator.tracks import ENTRIES, LoggedTrack, operator_tracks, phase_is_free
from cyclekit.estimate.plan import Jobs, plan
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.check import check_rollout
from cyclekit.estimate.whatif import Change, what_if

AND_BACK = TaskSequence("and back", ("place_1", "place_2", "place_1"))
EXECUTIONS = 12


def operators(hand_made: Any, *, follows: bool) -> Dataset:
    """A robot that drives 1 m, stands, and drives back; an operator who steps up to it for a second now and then.

    He waits somewhere else in each execution. Where he follows the cycle he steps up while the robot stands and it
    loses nothing; else at any time.
    """
    rng, sessions = np.random.default_rng(5), {}
    for number in range(EXECUTIONS):
        x_m, y_m = rng.uniform(3.6, 10.0), rng.uniform(-2.0, 2.0)
        steps_up_s = 2.65 if follows else rng.uniform(0.0, 6.0)
        at_s = [0.0, steps_up_s, steps_up_s + 0.01, steps_up_s + 0.5, steps_up_s + 0.51, 20.0]
        where = [(x_m, y_m)] * 2 + [(1.0, 0.7)] * 2 + [(x_m, y_m)] * 2
        sessions[f"run_{number:02}"] = ([0.0], dict(zip(at_s, where, strict=True)))
    return hand_made(sessions)


def test_where_the_model_gives_other_cycles_than_the_logged_tracks_these_are_used_and_it_is_said(
    hand_made: Any, staircase: Any
):
    """He loses nothing for the robot at the time he keeps; entered at any instant he would be in its way."""
    following = operators(hand_made, follows=True)
    assert operator_tracks(
        following, horizon_s=6.0
    ).phase_free  # where he is at some instants tells nothing of that with so few executions
    (found,) = estimate(staircase, following, [AND_BACK])
    assert found.check is not None
    assert found.check.operator is not None
    assert found.check.operator.as_logged
    assert found.check.operator.z > 2.6
    assert found.check.to_dict()["operator"]["as_logged"] is True
    assert found.tracks == EXECUTIONS
    assert found.safety_loss_s < 0.01
    assert "they start where their executions do" in "".join(found.warnings)
    unchecked = replace(found.check, operator=replace(found.check.operator, z=0.0))
    (model,) = estimate(staircase, following, [AND_BACK], check=unchecked)
    assert model.tracks == ENTRIES * EXECUTIONS
    assert model.safety_loss_s > 0.2
    assert "they start where" not in "".join(model.warnings)


def test_a_change_and_a_plan_rest_on_the_same_tracks_as_the_estimate(hand_made: Any, staircase: Any):
    following = operators(hand_made, follows=True)
    check = check_rollout(staircase, following)
    assert operator_tracks(following, horizon_s=6.0).phase_free
    change = Change("slower", (0.0, 0.5), (1.2,))
    (changed,) = what_if(staircase, following, [AND_BACK], [change], check=check)
    assert changed.before.tracks == changed.after.tracks == EXECUTIONS
    jobs = Jobs(("place_2", "place_1"), "place_1", before=(("place_2", "place_1"),))
    for given in (check, None):
        planned = plan(staircase, following, jobs, check=given)
        assert planned.expected_s == changed.before.expected_s


def test_an_operator_who_keeps_no_time_with_the_cycle_is_entered_at_any_instant(hand_made: Any, staircase: Any):
    roaming = operators(hand_made, follows=False)
    assert operator_tracks(roaming, horizon_s=6.0).phase_free
    (found,) = estimate(staircase, roaming, [AND_BACK])
    assert found.check is not None
    assert found.check.operator is not None
    assert not found.check.operator.as_logged
    assert found.tracks == ENTRIES * EXECUTIONS
    assert "they start where" not in "".join(found.warnings)


def who_comes_and_goes(count: int) -> dict[str, LoggedTrack]:
    """Operators who come and go at random; beside one the robot is slow, so executions with much of him are long."""
    rng, tracks = np.random.default_rng(0), {}
    for number in range(count):
        there, done_s, where = rng.random() < 0.5, 0.0, []
        while done_s < 10.0:
            for _ in range(int(rng.exponential(80)) + 1):
                where.append((*rng.normal(1.0, 0.5, 2), 0.2) if there else (np.nan,) * 3)
                done_s += 0.1 * (0.05 if there else 1.0)
                if done_s >= 10.0:
                    break
            there = not there
        xyz_m = np.array(where)
        activity = np.where(np.isnan(xyz_m[:, 0]), -1, 0)
        tracks[str(number)] = LoggedTrack(xyz_m, activity, 0.0, len(xyz_m) / 10, seen=True, away=False, followed=True)
    return tracks


def test_long_executions_do_not_make_an_operator_seem_to_start_with_the_cycle() -> None:
    assert phase_is_free(who_comes_and_goes(200))


def who_roams(count: int, seed: int) -> dict[str, LoggedTrack]:
    """Operators who stay at one of four places, or are away, for 2 to 20 s each, begun at any time."""
    rng, tracks = np.random.default_rng(seed), {}
    places = np.array([(0.5, 1.5, 0.2), (3.4, 1.6, 0.2), (2.2, -1.7, 0.2), (0.3, -1.5, 0.2), (np.nan,) * 3])
    for number in range(count):
        stays = rng.integers(20, 200, 40)
        doing = np.repeat(rng.integers(0, 5, 40), stays)[rng.integers(0, 1000) :][: rng.integers(350, 600)]
        activity = np.where(doing == 4, -1, doing)
        tracks[str(number)] = LoggedTrack(places[doing], activity, 0.0, 1.0, seen=True, away=False, followed=True)
    return tracks


def test_chance_seldom_makes_an_operator_who_roams_seem_to_start_with_the_cycle() -> None:
    assert all(phase_is_free(who_roams(20, seed)) for seed in range(100))
