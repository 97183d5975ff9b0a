"""The nominal motions behind an estimate, and the operator tracks that it is rolled out against."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from ingested import without_checksums
from msgspec.structs import replace

from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import EstimateError
from cyclekit.estimate.limits import limits_of_logs
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.robot.nominal import STEP_S, nominal_tasks, slider_losses, usual_slider
from cyclekit.estimate.robot.support import Support
from cyclekit.estimate.validation.history import TaskTimes
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import write_short_cycles

if TYPE_CHECKING:
    from pathlib import Path


def test_nominal_durations_are_those_that_the_program_asks_for(logged: Dataset, truth: pl.DataFrame):
    found = nominal_tasks(logged)
    true = truth.group_by(task=pl.col("start_place") + "->" + pl.col("goal_place")).agg(
        pl.col("nominal_s", "dwell_s").median(), times=pl.len()
    )
    assert set(found) == set(true["task"])
    for row in true.iter_rows(named=True):
        task = found[row["task"]]
        assert task.nominal_s == pytest.approx(row["nominal_s"], abs=0.025)
        assert task.dwell_s == pytest.approx(row["dwell_s"], abs=0.05)


def test_a_nominal_motion_leads_from_place_to_place_at_the_speed_of_the_program(logged: Dataset):
    for name, task in nominal_tasks(logged).items():
        start, goal = (np.array(logged.places[place].xyz_m) for place in name.split("->"))
        assert np.linalg.norm(task.xyz_m[0] - start) < 0.002
        assert np.linalg.norm(task.xyz_m[-1] - goal) < 0.002
        assert len(task.xyz_m) == round(task.nominal_s / STEP_S) + 1
        speed = np.linalg.norm(np.diff(task.xyz_m, axis=0), axis=1) / STEP_S
        assert 0.4 < speed.max() < 1.5
        assert speed[len(speed) // 3 : -len(speed) // 3].min() > 0.1  # no halt is left in the middle of it


def test_only_the_wanted_nominal_motions_are_looked_for_if_all_of_them_were_logged(logged: Dataset):
    every = nominal_tasks(logged)
    some = sorted(every)[:3]
    for found in (nominal_tasks(logged, some), nominal_tasks(Dataset.open(logged.path), some)):
        assert list(found) == [name for name in every if name in some]
        for name in some:
            np.testing.assert_array_equal(found[name].xyz_m, every[name].xyz_m)
    for dataset in (logged, Dataset.open(logged.path)):
        assert list(nominal_tasks(dataset, [*some, "home->nowhere"])) == list(every)


def test_nominal_motions_are_read_once_from_a_dataset_that_stays_as_it_is(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
):
    dataset, reads = Dataset.open(logged.path), list[str]()
    native_robot = dataset.native_robot
    monkeypatch.setattr(
        dataset, "native_robot", lambda name, columns: reads.append(name) or native_robot(name, columns)
    )
    every = nominal_tasks(dataset)
    once = len(reads)
    assert once > 0
    nominal_tasks(dataset).clear()
    assert list(nominal_tasks(dataset)) == list(every)
    assert len(reads) == once
    dataset.card = replace(dataset.card, warnings=())
    nominal_tasks(dataset)
    assert len(reads) == 2 * once


def test_tracks_hold_goals_where_these_are_asked_for(logged: Dataset):
    plain, told = operator_tracks(logged, horizon_s=50.0), operator_tracks(logged, horizon_s=50.0, goals=True)
    assert plain.goal_m is None
    assert told.goal_m is not None
    assert told.goal_m.shape == told.xyz_m.shape
    assert np.isfinite(told.goal_m).any()
    np.testing.assert_array_equal(plain.xyz_m, told.xyz_m)


def test_a_task_logged_without_scaling_has_no_nominal_motion(hand_made: Any):
    found = hand_made({"a": ([0.0, 0.0], {0.0: (3.0, 0.0), 15.0: (3.0, 0.0)})})
    assert set(nominal_tasks(found)) == {"place_1->place_2", "place_2->place_1"}
    found = Dataset.open(without_checksums(found.path))
    unknown = found.tasks().with_columns(nominal_s=pl.lit(None, pl.Float64))
    unknown.write_parquet(found.path / "tasks.parquet")
    assert nominal_tasks(found) == {}


def test_a_speed_slider_is_undone_like_the_scaling_where_the_dataset_tells_it_apart(hand_made: Any):
    """1 m in 2 s as logged, the half below 0.5 m at a quarter of the speed: 1.25 s, half of which lead to 0.6875 m."""
    found = hand_made({"a": ([0.0, 0.0], {0.0: (3.0, 0.0), 15.0: (3.0, 0.0)})})
    found = Dataset.open(without_checksums(found.path))
    told = found.tasks().with_columns(nominal_s=pl.lit(1.25), lost_slider_s=pl.lit(0.75))
    told.write_parquet(found.path / "tasks.parquet")
    file = next((found.path / "recordings").glob("*/robot.parquet"))
    slider = pl.when(pl.col("tcp_x_m") < 0.5).then(0.25).otherwise(1.0)
    native = pl.read_parquet(file, glob=False).with_columns(slider=slider)
    native.with_columns(scaling=pl.col("scaling") * slider).write_parquet(file)  # logged is what is in force
    for task in nominal_tasks(found).values():
        assert task.xyz_m[len(task.xyz_m) // 2, 0] == pytest.approx(0.6875, abs=0.02)
    assert usual_slider(found) == pytest.approx(0.625)
    assert slider_losses(found) == pytest.approx(dict.fromkeys(found.executions["execution"], 0.0))


HALTED = {
    # Each operator stays where one can tell them apart; `short` has no halt, the others take 6 s longer.
    "short": ([0.0], {0.0: (2.0, 0.0), 7.0: (2.0, 0.0)}),
    "near": ([6.0], {0.0: (2.2, 0.0), 6.0: (2.2, 0.0), 8.0: (4.0, 0.0), 11.0: (4.0, 0.0)}),
    "far": ([6.0], {0.0: (9.0, 0.0), 11.0: (9.0, 0.0)}),
}


def test_a_track_is_the_logged_one_for_as_long_as_its_execution_was(hand_made: Any):
    found = hand_made(HALTED)
    tracks = operator_tracks(found, horizon_s=3.0)
    samples = found.samples()
    assert tracks.executions == tuple(found.executions["execution"])
    for k, name in enumerate(tracks.executions):
        x = samples.filter(pl.col("execution") == name)["human_x_m"].to_numpy()
        count = min(len(x), tracks.xyz_m.shape[1])
        np.testing.assert_allclose(tracks.xyz_m[k, :count, 0], x[:count])
        assert tracks.logged[k] == len(x)


def test_a_short_track_goes_on_as_another_that_was_near_did_and_not_by_standing_still(hand_made: Any):
    found = hand_made(HALTED)
    tracks = operator_tracks(found, horizon_s=9.0)
    short, near = (
        tracks.executions.index(next(n for n in tracks.executions if n.startswith(s))) for s in ("short", "near")
    )
    own = tracks.logged[short]
    assert own < 60
    np.testing.assert_allclose(tracks.xyz_m[short, own - 1], [2.0, 0.0, 0.2], atol=1e-6)
    x = tracks.xyz_m[short, own - 1 :, 0]
    assert np.abs(np.diff(x)).max() < 1.5 * np.abs(np.diff(tracks.xyz_m[near, :, 0])).max()  # he walks there
    assert x[-1] == pytest.approx(4.0)  # as the one beside him did, and not the one far away


def test_where_the_log_runs_on_the_track_is_what_the_operator_really_did_next(hand_made: Any):
    found = hand_made({"a": ([0.0] * 4, {0.0: (2.0, 0.0), 25.0: (7.0, 0.0)})})
    assert found.executions.height == 4
    tracks = operator_tracks(found, horizon_s=8.0)
    t_s = found.executions["start_s"][1] + np.arange(tracks.xyz_m.shape[1]) / 10
    np.testing.assert_allclose(tracks.xyz_m[1, :80, 0], 2.0 + 5.0 * t_s[:80] / 25.0, atol=0.02)


def test_an_operator_who_was_hidden_for_a_moment_went_straight_on_and_one_who_was_away_was_not_there(hand_made: Any):
    nowhere = (float("nan"), float("nan"))
    walk = {0.0: (2.0, 1.0), 3.0: (2.0, 1.0), 3.02: nowhere, 4.98: nowhere, 5.0: (4.0, 2.0), 6.0: (4.0, 2.0)}
    away = {6.02: nowhere, 12.98: nowhere, 13.0: (4.0, 2.0), 20.0: (4.0, 2.0)}
    found = hand_made({"a": ([10.0], walk | away)})
    x, y, _ = operator_tracks(found, horizon_s=20.0).xyz_m[0, :140].T
    t_s = found.executions["start_s"][0] + np.arange(140) / 10
    hidden, gone = (t_s > 3.1) & (t_s < 4.9), (t_s > 6.1) & (t_s < 12.9)
    assert hidden.sum() > 10
    way = (t_s[hidden] - 3.0) / 2.0
    np.testing.assert_allclose(x[hidden], 2.0 + 2.0 * way, atol=0.02)
    np.testing.assert_allclose(y[hidden], 1.0 + way, atol=0.02)
    assert gone.sum() > 60
    assert np.isnan(x[gone]).all()


def test_an_execution_that_the_tracker_left_off_in_is_no_track(hand_made: Any):
    whole, cut = {0.0: (2.0, 0.0), 30.0: (2.0, 0.0)}, {0.0: (3.0, 0.0), 4.0: (3.0, 0.0)}
    tracks = operator_tracks(hand_made({"whole": ([10.0], whole), "cut": ([10.0], cut)}), horizon_s=3.0)
    assert [name.partition(".")[0] for name in tracks.executions] == ["whole"]


def test_logs_in_which_the_tracker_always_left_off_are_refused(hand_made: Any):
    found = hand_made({"cut": ([10.0], {0.0: (3.0, 0.0), 4.0: (3.0, 0.0)})})
    with pytest.raises(EstimateError, match="no complete execution has an operator track of its full length"):
        operator_tracks(found, horizon_s=3.0)


def test_tracks_can_be_those_of_an_operator_who_begins_in_a_certain_order(logged: Dataset):
    every = operator_tracks(logged, horizon_s=50.0)
    orders = {}
    for k, name in enumerate(every.executions):
        doing = every.activity[k, : every.logged[k]]
        changes = np.flatnonzero(np.diff(doing, prepend=-2))
        orders[name] = tuple(every.activities[i] for i in doing[changes] if i >= 0)
    wanted = orders[every.executions[0]][:2]
    some = operator_tracks(logged, horizon_s=50.0, operator=wanted)
    assert set(some.executions) == {name for name, order in orders.items() if order[:2] == wanted}
    assert 0 < len(some.executions) < len(every.executions)


def test_an_order_that_no_operator_ever_followed_is_refused(logged: Dataset):
    with pytest.raises(EstimateError, match="no execution has an operator who begins with rest, rest") as caught:
        operator_tracks(logged, horizon_s=50.0, operator=("rest", "rest"))
    assert "out_left_1" in str(caught.value.cure)


def test_support_knows_the_pairs_of_positions_that_were_logged_and_no_others():
    robot, human = np.array([[0.5, 0.0, 0.3], [0.0, 0.5, 0.3]]), np.array([[2.0, 0.0, 0.2], [0.0, 2.0, 0.2]])
    support = Support(robot, human)
    assert support.near_logged(robot, human).all()
    assert support.near_logged(robot + 0.01, human + 0.01).all()
    assert not support.near_logged(robot, human[::-1]).any()
    assert not support.near_logged(robot + 2.0, human).any()
    assert support.near_logged(robot, human * np.nan).all()  # nobody there: the robot runs free
    assert not Support(robot * np.nan, human).near_logged(robot, human).any()


def one_who_stays_away(hand_made: Any) -> Dataset:
    nowhere = (float("nan"), float("nan"))
    left = {0.0: (4.0, 2.0), 0.5: (4.0, 2.0), 0.52: nowhere, 60.0: nowhere}
    return hand_made({"there": ([10.0], {0.0: (2.0, 0.0), 60.0: (2.0, 0.0)}), "away": ([10.0], left)})


def test_a_cycle_to_which_the_operator_never_came_counts_as_one_without_him(hand_made: Any):
    tracks = operator_tracks(one_who_stays_away(hand_made), horizon_s=20.0)
    found = {name.partition(".")[0]: xyz for name, xyz in zip(tracks.executions, tracks.xyz_m, strict=True)}
    assert sorted(found) == ["away", "there"]
    assert np.isnan(found["away"]).all()
    assert np.isfinite(found["there"]).all()


def meant_to_be_alone(found: Dataset) -> Dataset:
    """Return the dataset with its executions without an operator marked as runs meant to be so."""
    marked = (replace(one, reference=one.execution.startswith("away")) for one in found.card.executions)
    return Dataset(found.path, replace(found.card, executions=tuple(marked)))


def test_a_run_recorded_without_operator_on_purpose_is_no_track(hand_made: Any):
    found = meant_to_be_alone(one_who_stays_away(hand_made))
    tracks = operator_tracks(found, horizon_s=20.0)
    assert [name.partition(".")[0] for name in tracks.executions] == ["there"]


@pytest.mark.parametrize("meant", [False, True])
def test_the_estimate_says_how_many_cycles_had_no_operator(hand_made: Any, meant: bool):
    found = one_who_stays_away(hand_made)
    found = meant_to_be_alone(found) if meant else found
    model: Any = SimpleNamespace(card=TrainingCard(scaling_without_operator=1.0))
    said = [each for each in limits_of_logs(found, model) if "no operator was seen" in each]
    assert [each.partition(":")[0] for each in said] == ([] if meant else ["in 1 of 2 executions no operator was seen"])


def test_an_estimate_of_both_agents_uses_no_execution_without_an_operator(hand_made: Any):
    found = one_who_stays_away(hand_made)
    model: Any = SimpleNamespace(card=TrainingCard(scaling_without_operator=None))
    both = [one.execution for one in found.card.executions if one.execution.startswith("there")]
    everyone = limits_of_logs(found, model)
    assert [each for each in everyone if "full speed assumed" in each]
    said = limits_of_logs(found, model, both)
    assert [each for each in said if "full speed assumed" in each] == []
    assert "in 1 of 2 executions no operator was seen: they are not used" in said


@pytest.mark.parametrize("executions", [20, pytest.param(60, marks=pytest.mark.slow)])
def test_waits_that_the_ends_of_logs_cut_are_as_long_as_they_are(tmp_path: Path, robot_log: Any, executions: int):
    """One file each; the robot waits 1 to 30 s at a place; the recorder of half of them stops at any time."""
    rng, waits_s = np.random.default_rng(0), list[float]()
    for number in range(executions):
        mine = [1.0 + min(rng.exponential(8.0), 29.0) for _ in range(2)]
        there = [step for s in mine for step in (("move", 0.5), ("stand", 0.6), ("move", 1.0), ("stand", s))]
        doing = [("stand", 1.0), *there, ("move", 0.0), ("stand", 0.5)]
        log = robot_log(tmp_path / "logs" / f"{number:03d}.csv", doing)
        waits_s += mine
        if number % 2:
            lines = log.read_bytes().splitlines(keepends=True)
            log.write_bytes(b"".join(lines[: round(rng.uniform(4.0, 40.0) * 125.0)]))
    ingest([tmp_path / "logs"], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    task = next(one for one in nominal_tasks(dataset).values() if one.standstill_s.max() > 5.0)
    assert task.dwell_s + task.wait_s == pytest.approx(np.mean(waits_s), rel=0.05)


def test_a_process_that_the_end_of_a_log_cuts_does_not_make_processes_short(tmp_path: Path):
    """The log ends 0.2 s after the robot has reached a place, where its process takes a second."""
    logs = tmp_path / "logs"
    logs.mkdir()
    write_short_cycles(logs, 24, "tracker")
    rows = pl.read_csv(logs / "robot.csv", separator=" ")
    tcp_m = rows.select(pl.col("^actual_TCP_pose_[012]$")).to_numpy()
    arrives = np.flatnonzero(np.diff(np.linalg.norm(np.diff(tcp_m, axis=0), axis=1) == 0.0, prepend=False))[::2]
    rows.head(int(arrives[-2]) + 5).write_csv(logs / "robot.csv", separator=" ", float_precision=5)
    ingest([logs], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    cut = dataset.tasks().filter(agent="robot").row(-1, named=True)
    assert cut["dwell_s"] < 0.5
    assert nominal_tasks(dataset)[cut["task"]].standstill_s.min() == pytest.approx(1.0, abs=0.1)
    times = TaskTimes(dataset)
    assert times.sum_s([cut["task"]]) > nominal_tasks(dataset)[cut["task"]].nominal_s + 0.9
