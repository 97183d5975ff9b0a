"""Operators begin where their executions did, whatever these are too few to show."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.cards.rule import LimitCard, MetresCard, NearerCard, RegionCard, RuleCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.plan import Jobs, plan
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.check import check_rollout
from cyclekit.estimate.whatif import Change, what_if
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.rules.samples.distances import TO_TCP
from cyclekit_sim import SimulationOptions, simulate, simulate_sequence

if TYPE_CHECKING:
    from pathlib import Path

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


def test_who_steps_up_while_the_robot_stands_is_not_in_its_way(hand_made: Any, staircase: Any):
    (found,) = estimate(staircase, operators(hand_made, (2.65, 2.65)), [AND_BACK])
    assert found.tracks == EXECUTIONS
    assert found.safety_loss_s < 0.01


def test_who_comes_near_in_the_second_half_is_not_near_in_an_order_half_as_long(hand_made: Any, staircase: Any):
    """The whole order meets all of him wherever it begins in his log, so only its first half shows when he comes."""
    late = operators(hand_made, (3.6, 5.0))
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


def test_what_few_executions_cannot_show_is_not_assumed(hand_made: Any, staircase: Any):
    """He steps up at any time in the first half: twelve executions do not show that he keeps away from the second."""
    early = operators(hand_made, (0.0, 2.5))
    (found,) = estimate(staircase, early, [AND_BACK])
    logged = early.tasks().filter(agent="robot")
    lost_s = float(logged["safety_loss_s"].sum()) / EXECUTIONS
    assert found.tracks == EXECUTIONS
    assert found.safety_loss_s == pytest.approx(lost_s, abs=0.05)
    second = next(task for task in found.tasks if task.task == "place_2->place_1")
    assert second.safety_loss_s < 0.01


def test_an_order_half_as_long_takes_with_the_logged_people_what_it_takes_in_their_cell(tmp_path: Path):
    """They begin away and come near; the simulator runs the same people beside half of the order."""
    options = SimulationOptions(executions_per_session=1)
    logs = simulate("bench-crew", tmp_path / "logs", executions=5, seed=4, options=options)
    ingest([logs], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    places = dataset.card.executions[0].places
    known = set(dataset.tasks()["task"])
    last = next(n for n in range(10, len(places)) if f"{places[n]}->{places[-1]}" in known)
    half = (*places[:9], "conveyor", places[last], places[-1])
    limits = [
        LimitCard(scaling=level, within=RegionCard(nearer=(NearerCard(distance=TO_TCP, metres=MetresCard(value=m)),)))
        for level, m in ((0.0, 0.8), (0.3, 1.2), (0.6, 1.7))
    ]
    rule = RuleCard(family="written", levels=(0.0, 0.3, 0.6, 1.0), limits=tuple(limits), explained=1.0)
    model = RuleSafety(rule, TrainingCard(rule=rule))
    (found,) = estimate(model, dataset, [TaskSequence("half", half)], validate=False, other_cell=True)
    true = simulate_sequence("bench-crew", half, executions=5, seed=4, options=options, logged=True)
    assert found.expected_s == pytest.approx(true["duration_s"].mean(), rel=0.01)
