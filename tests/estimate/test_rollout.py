"""Expected cycle times: right where the truth is known, exact where it can be, refused where nothing was logged."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ingested import without_checksums

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import EstimateError, ModelError, UnknownName
from cyclekit.estimate.cycle import walk as walking
from cyclekit.estimate.cycle.engine import FINE_STEP_S, TIME_STEP_S
from cyclekit.estimate.cycle.walk import Rolled
from cyclekit.estimate.entry import _shares
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.result import PARTS
from cyclekit.estimate.robot.nominal import NominalTask, nominal_tasks
from cyclekit.estimate.robot.program import Program, draw_standstills
from cyclekit.estimate.robot.support import Support
from cyclekit.estimate.rollout import estimate as estimate_validated
from cyclekit.estimate.rollout import lay_out, roll_out
from cyclekit_sim import random_sequence, simulate_sequence

if TYPE_CHECKING:
    from collections.abc import Sequence

estimate = partial(estimate_validated, validate=False)
"""The rollout itself, without what the logged executions correct."""

SHORT = TaskSequence("short", ("home", "conveyor", "left_1", "home"))


def some_route(routes: Sequence[tuple[str, ...]], length: int) -> TaskSequence:
    """A sequence of logged tasks: the first places of an execution, then the way home of another."""
    head = routes[0][: length - 2]
    last = next(route for route in routes if route[-2] != head[-1] and head[-1] == "conveyor")[-2:]
    return TaskSequence("some", (*head, *last))


@pytest.mark.parametrize(("step_s", "within_s"), [(FINE_STEP_S, 0.1), (TIME_STEP_S, 0.2)])
def test_rolled_along_its_own_track_an_execution_takes_as_long_as_it_did(
    logged: Dataset, staircase: Any, step_s: float, within_s: float
):
    """The true safety function, every logged route against its own operator: nothing is left to chance."""
    nominal, entries = nominal_tasks(logged), logged.card.executions
    tracks = operator_tracks(logged, horizon_s=200.0)
    assert list(tracks.executions) == [entry.execution for entry in entries]
    programs = [lay_out(TaskSequence("own", entry.places), nominal, logged) for entry in entries]
    stands, every = [draw_standstills(program, 1, 0) for program in programs], np.arange(len(programs))
    rolled = walking.simulate(staircase, programs, every, every, stands, tracks, fine=step_s == FINE_STEP_S)
    late = rolled.duration_s - [entry.end_s - entry.start_s for entry in entries]
    assert abs(np.mean(late)) < within_s  # of about 95 s
    assert np.quantile(np.abs(late), 0.8) < within_s
    assert np.max(np.abs(late)) < 10 * within_s  # on the edge of a threshold a cycle can take another turn


def test_a_sequence_that_never_occurred_takes_as_long_as_fresh_simulations_of_it(logged: Dataset, staircase: Any):
    route = random_sequence("box-picking", 77)
    assert route not in [list(entry.places) for entry in logged.card.executions]
    (found,) = estimate(staircase, logged, [TaskSequence("new", tuple(route))])
    fresh = simulate_sequence("box-picking", route, executions=32, seed=5)
    error = np.hypot(np.std(found.durations_s) / np.sqrt(16), fresh["duration_s"].std() / np.sqrt(32))  # type: ignore[operator]
    assert error < 2.0
    assert abs(found.expected_s - fresh["duration_s"].mean()) < 3.5 * error  # type: ignore[operator]
    assert found.nominal_s == pytest.approx(fresh["nominal_s"].mean(), rel=0.006)
    assert found.dwell_s == pytest.approx(fresh["dwell_s"].mean(), rel=0.03)
    assert abs(found.safety_loss_s - fresh["safety_loss_s"].mean()) < 3.5 * error  # type: ignore[operator]
    assert found.expected_low_s < found.expected_s < found.expected_high_s
    assert found.support > 0.8


def test_without_slow_down_a_cycle_is_its_motion_and_its_dwells(logged: Dataset, constant: Any, routes: Any):
    sequence = some_route(routes, 8)
    (found,) = estimate(constant(1.0), logged, [sequence], extrapolate=True)
    tasks = nominal_tasks(logged)
    assert found.safety_loss_s == 0.0
    assert found.nominal_s == pytest.approx(sum(tasks[task].nominal_s for task in sequence.tasks))
    assert found.expected_s == pytest.approx(found.nominal_s + found.dwell_s + found.wait_s)
    assert max(found.durations_s) - min(found.durations_s) < 0.5  # the dwells of the logs differ by some cycles


@pytest.mark.parametrize("scaling", [0.5, 0.25, 0.8])
def test_a_constant_scaling_stretches_the_motion_by_exactly_its_inverse_and_nothing_else(
    logged: Dataset, constant: Any, routes: Any, scaling: float
):
    sequence = some_route(routes, 8)
    (free,) = estimate(constant(1.0), logged, [sequence], extrapolate=True)
    (slow,) = estimate(constant(scaling), logged, [sequence], extrapolate=True)
    assert slow.safety_loss_s == pytest.approx(free.nominal_s * (1 / scaling - 1))
    assert slow.nominal_s == free.nominal_s
    assert (slow.dwell_s, slow.wait_s) == pytest.approx((free.dwell_s, free.wait_s))
    assert slow.expected_s == pytest.approx(free.nominal_s / scaling + free.dwell_s + free.wait_s)


def test_a_logged_stand_of_no_length_makes_that_cycle_shorter_by_its_dwell_and_no_more(
    logged: Dataset, constant: Any, routes: Any
):
    nominal = nominal_tasks(logged)
    first = routes[0][0] + "->" + routes[0][1]
    stands = nominal[first].standstill_s.copy()
    nominal[first] = replace(nominal[first], standstill_s=np.concatenate([[0.0, 0.0], stands[2:]]))
    program = lay_out(TaskSequence("A", routes[0][:6]), nominal, logged)
    tracks, nowhere = operator_tracks(logged, horizon_s=60.0), Support(np.zeros((1, 3)), np.zeros((1, 3)))
    rolled = roll_out(constant(1.0), program, tracks, nowhere)
    motion = sum(task.nominal_s for task in program.tasks)
    np.testing.assert_allclose(rolled.duration_s, motion + rolled.standstill_s.sum(axis=1))
    assert rolled.standstill_s[:, 0].min() < 0.1


def test_the_parts_add_up_to_the_whole_by_task_and_by_activity(logged: Dataset, staircase: Any, routes: Any):
    (found,) = estimate(staircase, logged, [TaskSequence("own", routes[3])])
    for task in found.tasks:
        parts = task.nominal_s + task.safety_loss_s + task.dwell_s + task.wait_s
        assert task.expected_s == pytest.approx(parts)
    for name in ("nominal_s", "safety_loss_s", "dwell_s", "wait_s"):
        assert getattr(found, name) == pytest.approx(sum(getattr(task, name) for task in found.tasks))
    whole = found.nominal_s + found.safety_loss_s + found.dwell_s + found.wait_s
    assert found.expected_s == pytest.approx(whole)
    assert sum(found.safety_by_activity_s.values()) == pytest.approx(found.safety_loss_s)
    assert set(found.safety_by_activity_s) <= {*logged.human_places, "unknown"}
    assert found.expected_s == pytest.approx(np.mean(found.durations_s))
    assert found.quantiles_s[0.05] <= found.quantiles_s[0.5] <= found.quantiles_s[0.95]


def test_each_task_ends_between_quantiles_of_single_cycles_and_the_last_one_with_the_cycle(
    logged: Dataset, staircase: Any, routes: Any
):
    (found,) = estimate(staircase, logged, [TaskSequence("A", routes[0])], quantiles=(0.1, 0.5, 0.8))
    ends = [(share.end_low_s, share.end_high_s) for share in found.tasks]
    assert ends[-1] == pytest.approx((found.quantiles_s[0.1], found.quantiles_s[0.8]))
    assert all(low <= high for low, high in ends)
    assert [low for low, _ in ends] == sorted(low for low, _ in ends)
    mean_s = np.cumsum([share.expected_s for share in found.tasks])
    assert all(low - 2.0 <= mean <= high + 2.0 for (low, high), mean in zip(ends, mean_s, strict=True))
    (one,) = estimate(staircase, logged, [TaskSequence("A", routes[0])], quantiles=(0.5,))
    assert one.tasks[0].end_low_s is None


def test_what_the_operator_does_over_the_cycle_adds_up_to_all_cycles(logged: Dataset, staircase: Any, routes: Any):
    (found,) = estimate(staircase, logged, [TaskSequence("A", routes[0])])
    parts = np.array(list(found.operator_at.values()))
    assert parts.shape[1] == PARTS
    assert parts.sum(axis=0) == pytest.approx(1.0, abs=0.001)
    assert set(found.safety_by_activity_s) - {"unknown"} <= set(found.operator_at)


def test_sequences_come_back_shortest_first(logged: Dataset, staircase: Any, routes: Any):
    asked = [TaskSequence(f"{len(route)} places", route) for route in (routes[0], routes[0][:7], routes[0][:13])]
    found = estimate(staircase, logged, asked)
    assert [cycle.name for cycle in found] == ["7 places", "13 places", "22 places"]
    assert [cycle.expected_s for cycle in found] == sorted(cycle.expected_s for cycle in found)


def test_the_same_question_has_the_same_answer_and_the_seed_hardly_moves_it(
    logged: Dataset, staircase: Any, routes: Any
):
    sequence = TaskSequence("q", routes[0][:7])
    first, again, other = (estimate(staircase, logged, [sequence], seed=seed)[0] for seed in (0, 0, 1))
    assert first == again
    assert other.expected_low_s != first.expected_low_s
    assert other.expected_s == pytest.approx(first.expected_s, rel=0.005)


def test_an_estimate_is_plain_json_with_quantiles_by_name(logged: Dataset, staircase: Any, routes: Any):
    import json

    (found,) = estimate(staircase, logged, [TaskSequence("q", routes[0][:5])], quantiles=(0.05, 0.9))
    read = json.loads(json.dumps(found.to_dict()))
    assert read["quantiles_s"] == {"0.05": found.quantiles_s[0.05], "0.9": found.quantiles_s[0.9]}
    assert [task["task"] for task in read["tasks"]] == list(TaskSequence("q", routes[0][:5]).tasks)


def test_a_place_that_does_not_exist_is_refused_with_the_nearest(logged: Dataset, staircase: Any):
    with pytest.raises(UnknownName) as caught:
        estimate(staircase, logged, [TaskSequence("A", ("home", "conveyer", "left_1"))])
    assert caught.value.nearest == "conveyor"
    assert "sequence 'A'" in caught.value.seen


def test_a_task_that_was_never_logged_is_refused_with_the_place_between(logged: Dataset, staircase: Any):
    with pytest.raises(EstimateError, match=r"task 'home->left_1' was never logged") as caught:
        estimate(staircase, logged, [TaskSequence("A", ("home", "left_1", "conveyor"))])
    assert caught.value.cure is not None
    assert "from home to left_1 by conveyor" in caught.value.cure
    assert "name conveyor between them" in caught.value.cure


def test_a_model_of_another_problem_is_refused(logged: Dataset, constant: Any):
    model = constant(1.0)
    model.problem = "ahead"
    with pytest.raises(ModelError, match="cyclekit train DATASET --problem now"):
        estimate(model, logged, [SHORT])


def test_logs_without_an_operator_are_refused(logged: Dataset, staircase: Any, routes: Any, tmp_path: Path):
    copy = without_checksums(Path(shutil.copytree(logged.path, tmp_path / "copy")))
    file = copy / "samples" / "session_000.parquet"
    unknown = [pl.lit(None, pl.Float64).alias(f"human_{axis}_m") for axis in "xyz"]
    pl.read_parquet(file).with_columns(unknown).write_parquet(file)
    with pytest.raises(EstimateError, match="no complete execution has an operator track") as caught:
        estimate(staircase, Dataset.open(copy), [TaskSequence("A", routes[0])])
    assert "tracker" in str(caught.value.cure)


def test_an_operator_who_never_lets_the_robot_go_on_is_told_and_not_waited_for(
    logged: Dataset, constant: Any, routes: Any
):
    with pytest.raises(EstimateError, match="100 % of the cycles do not end within"):
        estimate(constant(0.0), logged, [TaskSequence("A", routes[0][:3])])


class HaltedAt:
    """The staircase, but the robot halts for ever within 5 cm of one place."""

    problem, card = "now", TrainingCard()

    def __init__(self, staircase: Any, place: tuple[float, ...]) -> None:
        self._staircase, self._place = staircase, np.array(place)

    def predict(self, positions: np.ndarray) -> np.ndarray:
        there = np.linalg.norm(positions[:, :3] - self._place, axis=1) < 0.05
        return np.where(there, 0.0, self._staircase.predict(positions))


def test_sequences_that_cannot_be_answered_are_told_and_the_others_have_the_numbers_they_have_alone(
    logged: Dataset, staircase: Any
):
    model = HaltedAt(staircase, logged.places["right_4"].xyz_m)
    ends = TaskSequence("ends", ("home", "conveyor", "left_1", "conveyor"))
    asked = [
        TaskSequence("endless", ("home", "conveyor", "right_4", "conveyor")),
        TaskSequence("never logged", ("home", "left_1", "conveyor")),
        ends,
        TaskSequence("of nobody", ends.places, operator=("cellar",)),
    ]
    refused: dict[str, str] = {}
    found = estimate(model, logged, asked, refused=lambda sequence, why: refused.__setitem__(sequence.name, str(why)))
    (alone,) = estimate(model, logged, [ends])
    assert [entry.name for entry in found] == ["ends"]
    assert found[0].durations_s == alone.durations_s
    assert set(refused) == {"endless", "never logged", "of nobody"}
    assert "of the cycles do not end within" in refused["endless"]
    assert "task 'home->left_1' was never logged" in refused["never logged"]


@pytest.fixture
def elsewhere(logged: Dataset, tmp_path: Path) -> Dataset:
    """The same logs, but for the model the robot was somewhere else."""
    copy = without_checksums(Path(shutil.copytree(logged.path, tmp_path / "copy")))
    file = copy / "samples" / "session_000.parquet"
    pl.read_parquet(file).with_columns(pl.col("robot_x_m") + 5.0).write_parquet(file)
    return Dataset.open(copy)


def test_a_sequence_through_positions_never_logged_is_refused_unless_asked_for(
    elsewhere: Dataset, staircase: Any, routes: Any
):
    sequence = TaskSequence("A", routes[0][:5])
    with pytest.raises(EstimateError, match="only 0 % of it runs through logged positions"):
        estimate(staircase, elsewhere, [sequence])
    (found,) = estimate(staircase, elsewhere, [sequence], extrapolate=True)
    assert found.support == 0.0
    assert any("never logged" in text for text in found.warnings)


@settings(deadline=None)
@given(st.floats(0.01, 100.0), st.floats(0.01, 100.0), st.just(0.0) | st.floats(0.0, 10.0))
def test_no_part_of_a_task_is_below_zero_and_they_add_up(dwell_s: float, stand_s: float, wait_s: float):
    task = NominalTask("a->b", np.zeros((2, 3)), 1.0, dwell_s, wait_s, np.array([dwell_s]))
    one = np.array([[stand_s]])
    (share,) = _shares(
        Program((task,), np.array([1.0, 1.0 + dwell_s])), Rolled(1.0 + one[0], one, 0 * one, one[0], 1, 0)
    )
    parts = (share.nominal_s, share.safety_loss_s, share.dwell_s, share.wait_s)
    assert all(not part.startswith("-") for part in map("{:.1f}".format, parts))
    assert sum(parts) == pytest.approx(1.0 + stand_s)


def test_an_estimate_says_on_how_few_tracks_it_rests(logged: Dataset, staircase: Any, routes: Any):
    (found,) = estimate(staircase, logged, [TaskSequence("A", routes[0])])
    assert found.tracks == 16
    assert any("only 16 executions that show the operator" in text for text in found.warnings)


def test_while_nobody_is_there_the_robot_runs_at_what_the_logs_showed_without_an_operator(
    hand_made: Any, constant: Any
):
    found = hand_made({"a": ([0.0, 0.0, 0.0], {0.0: (3.0, 0.0), 1.0: (3.0, 0.0)})})  # the tracker stops after 1 s
    places = found.card.executions[0].places
    model = constant(0.1)
    (free,) = estimate(model, found, [TaskSequence("A", places)], extrapolate=True)
    model.card = TrainingCard(scaling_without_operator=0.5)
    (half,) = estimate(model, found, [TaskSequence("A", places)], extrapolate=True)
    assert free.expected_s + 2.0 < half.expected_s
