"""The operator model against the logged tracks: where cycles beside it differ beyond chance, the tracks are used."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.operator.operator_model import OperatorModel
from cyclekit.estimate.operator.tracks import ENTRIES, LoggedTrack, operator_tracks, phase_is_free
from cyclekit.estimate.plan import Jobs, plan
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.check import check_rollout
from cyclekit.estimate.whatif import Change, what_if

AND_BACK = TaskSequence("and back", ("place_1", "place_2", "place_1"))
THERE = TaskSequence("there", ("place_1", "place_2"))
EXECUTIONS = 12


def operators(hand_made: Any, steps_up_s: tuple[float, float]) -> Dataset:
    """A robot that drives 1 m, stands, and drives back; an operator who steps up to it for half a second.

    He waits somewhere else in each execution, and steps up between these two times.
    """
    rng, sessions = np.random.default_rng(5), {}
    for number in range(EXECUTIONS):
        x_m, y_m = rng.uniform(3.6, 10.0), rng.uniform(-2.0, 2.0)
        up_s = rng.uniform(*steps_up_s)
        at_s = [0.0, up_s, up_s + 0.01, up_s + 0.5, up_s + 0.51, 20.0]
        where = [(x_m, y_m)] * 2 + [(1.0, 0.7)] * 2 + [(x_m, y_m)] * 2
        sessions[f"run_{number:02}"] = ([0.0], dict(zip(at_s, where, strict=True)))
    return hand_made(sessions)


def entered_anywhere(dataset: Dataset) -> bool:
    """Whether his positions tell nothing of when he steps up, with so few executions."""
    return len(operator_tracks(dataset, horizon_s=6.0, anywhere=1.0).executions) == ENTRIES * EXECUTIONS


def test_where_cycles_differ_the_logged_tracks_are_used_and_it_is_said(hand_made: Any, staircase: Any):
    """He steps up while the robot stands and it loses nothing; entered at any instant he would be in its way."""
    following = operators(hand_made, (2.65, 2.65))
    assert entered_anywhere(following)
    (found,) = estimate(staircase, following, [AND_BACK])
    assert found.check is not None
    assert found.check.operator is not None
    assert found.check.operator.as_logged
    assert found.check.to_dict()["operator"]["as_logged"] is True
    assert found.check.anywhere == 0.0
    assert found.tracks == EXECUTIONS
    assert found.safety_loss_s < 0.01
    assert "they start where their executions do" in "".join(found.warnings)


def test_who_comes_near_in_the_second_half_is_not_near_in_an_order_half_as_long(hand_made: Any, staircase: Any):
    """The whole order meets all of him wherever it begins in his log, so only its first half shows when he comes."""
    late = operators(hand_made, (3.6, 5.0))
    assert entered_anywhere(late)
    (found,) = estimate(staircase, late, [THERE])
    tasks = late.tasks().filter(agent="robot", index=0)
    logged_s = float((tasks["end_s"] - tasks["start_s"]).mean())  # nobody was near
    assert found.check is not None
    assert found.expected_s / found.check.factor == pytest.approx(logged_s, rel=0.02)
    assert found.tracks == EXECUTIONS


def test_a_change_and_a_plan_rest_on_the_same_tracks_as_the_estimate(hand_made: Any, staircase: Any):
    following = operators(hand_made, (2.65, 2.65))
    check = check_rollout(staircase, following)
    change = Change("slower", (0.0, 0.5), (1.2,))
    (changed,) = what_if(staircase, following, [AND_BACK], [change], check=check)
    assert changed.before.tracks == changed.after.tracks == EXECUTIONS
    jobs = Jobs(("place_2", "place_1"), "place_1", before=(("place_2", "place_1"),))
    for given in (check, None):
        planned = plan(staircase, following, jobs, check=given)
        assert planned.expected_s == changed.before.expected_s


def test_what_cannot_be_told_apart_is_covered(hand_made: Any, staircase: Any):
    """An operator who steps up at any time: tracks start anywhere, and the interval holds the logged ones' mean too."""
    roaming = operators(hand_made, (0.0, 6.0))
    check = check_rollout(staircase, roaming)
    (found,) = estimate(staircase, roaming, [AND_BACK], check=check)
    assert check.operator is not None
    assert check.anywhere > 0.5
    assert found.tracks == ENTRIES * EXECUTIONS
    assert "they start where" not in "".join(found.warnings)
    (unchecked,) = estimate(staircase, roaming, [AND_BACK], validate=False)
    assert unchecked.tracks == EXECUTIONS  # nothing is assumed that was not shown
    shown = replace(check, operator=replace(check.operator, z=9.0))
    (as_logged,) = estimate(staircase, roaming, [AND_BACK], check=shown)
    assert found.expected_low_s < as_logged.expected_s < found.expected_high_s
    (narrow,) = estimate(
        staircase, roaming, [AND_BACK], check=replace(check, operator=replace(check.operator, bias=0.0))
    )
    assert narrow.expected_low_s - found.expected_low_s == pytest.approx(check.operator.departure * found.expected_s)


@pytest.mark.parametrize(("z", "share"), [(0.0, 1.0), (-1.0, 1.0), (2.0, 0.25), (-4.0, 0.0)])
def test_an_estimate_departs_from_what_was_logged_by_one_standard_error_at_most(z: float, share: float) -> None:
    found = OperatorModel(bias=0.01 * z, z=z)
    assert found.anywhere == pytest.approx(share)
    assert found.departure <= 0.01 + 1e-12


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
