"""The safety function and what it costs: read from the logs and the truth, computed again in the test."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from made_once import simulated

from cyclekit_sim import (
    SCENES,
    SimulationError,
    SimulationOptions,
    random_sequence,
    scene_places,
    simulate,
    simulate_sequence,
)

if TYPE_CHECKING:
    from simulated_cells import SimulatedCell

pytestmark = pytest.mark.slow  # of the simulator alone
HUMAN, ROBOT = [f"human_{a}_m" for a in "xyz"], [f"robot_{a}_m" for a in "xyz"]


def samples(folder: Path) -> pl.DataFrame:
    return pl.read_parquet(folder / "truth" / "samples.parquet")


def robot_log(folder: Path, session: str = "session_000") -> pl.DataFrame:
    return pl.read_csv(folder / session / "robot.csv", separator=" ")


def staircase(gamma: np.ndarray, thresholds: list[float]) -> np.ndarray:
    return np.array([0.0, 0.25, 0.5, 0.75, 1.0])[np.searchsorted(thresholds, gamma, side="left")]


def one(tmp_path: Path, executions: int = 1, scene: str = "box-picking", **options: object) -> Path:
    return simulate(scene, tmp_path / "logs", executions=executions, seed=7, options=SimulationOptions(**options))


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory, "box-picking", 12, seed=3, executions_per_session=8)


@pytest.fixture(scope="module")
def packing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory, "pick-and-package", 4, seed=3)


@pytest.fixture(scope="module")
def zones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory, "laser-zones", 6, seed=3)


@pytest.fixture(scope="module")
def visits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory, "scanner-visits", 6, seed=3)


def test_the_true_scaling_is_the_papers_staircase_of_the_true_distance(box: Path, packing: Path) -> None:
    for folder, thresholds in ((box, [1.2, 1.5, 1.9, 2.4]), (packing, [0.6, 0.8, 1.2, 1.6])):
        truth = samples(folder)
        gamma = np.linalg.norm(truth[HUMAN].to_numpy() - truth[ROBOT].to_numpy(), axis=1)
        assert np.array_equal(staircase(gamma, thresholds), truth["scaling"].to_numpy())


def test_the_robot_log_holds_the_true_sample_at_its_time(box: Path) -> None:
    log = robot_log(box).with_columns(ms=(pl.col("timestamp") * 1000).round().cast(pl.Int64))
    truth = samples(box).with_columns(ms=(pl.col("t_s") * 1000).round().cast(pl.Int64))
    mine = truth.filter(pl.col("execution") < 8)
    joined = mine.join(log, on="ms", how="inner")
    assert joined.height == mine.height
    assert joined["scaling"].equals(joined["speed_scaling"], check_names=False)
    tcp = joined[[f"actual_TCP_pose_{i}" for i in range(3)]].to_numpy()
    assert np.abs(tcp - joined[ROBOT].to_numpy()).max() < 1e-6
    assert joined["execution"].equals(joined["output_int_register_0"], check_names=False)


@pytest.mark.parametrize("scene", SCENES)
def test_a_cycle_is_motion_and_loss_and_dwell_and_wait_and_nothing_else(
    scene: str, request: pytest.FixtureRequest
) -> None:
    name = dict(zip(SCENES, ("box", "packing", "zones", "visits"), strict=True))[scene]
    folder = request.getfixturevalue(name)
    parts = pl.sum_horizontal("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
    executions = pl.read_parquet(folder / "truth" / "executions.parquet")
    tasks = pl.read_parquet(folder / "truth" / "tasks.parquet")
    assert (executions["duration_s"] - executions.select(parts).to_series()).abs().max() < 1e-3
    assert (tasks["end_s"] - tasks["start_s"] - tasks.select(parts).to_series()).abs().max() < 1e-3
    assert tasks["safety_loss_s"].min() >= 0
    # Tasks follow each other without holes.
    apart = tasks.select((pl.col("start_s").shift(-1) - pl.col("end_s")).over("execution").alias("apart"))["apart"]
    assert apart.abs().max() < 1e-9
    assert (executions["wait_s"] > 0).all() == (scene == "pick-and-package")


def test_the_safety_loss_is_what_the_log_lacks_to_full_speed_while_the_robot_moves(box: Path) -> None:
    tasks = pl.read_parquet(box / "truth" / "tasks.parquet").filter(pl.col("execution") < 8)
    log = robot_log(box).select("timestamp", "speed_scaling", execution="output_int_register_0")
    inside = log.join_asof(
        tasks.sort("start_s"), left_on="timestamp", right_on="start_s", by="execution", strategy="backward"
    )
    moving = pl.col("timestamp") < pl.col("end_s") - pl.col("dwell_s")
    lost = (
        inside.filter(moving).group_by("execution").agg(((1 - pl.col("speed_scaling")) * 0.008).sum().alias("lost_s"))
    )
    told = tasks.group_by("execution").agg(pl.col("safety_loss_s").sum()).join(lost, on="execution")
    assert (told["safety_loss_s"] - told["lost_s"]).abs().max() < 0.008 * 21


def test_a_box_picking_execution_places_ten_boxes_on_ten_different_slots(box: Path) -> None:
    executions = pl.read_parquet(box / "truth" / "executions.parquet")
    for text in executions["sequence"]:
        places = text.split(",")
        assert places[0] == places[-1] == "home"
        assert places[1:-1:2] == ["conveyor"] * 10
        assert sorted(places[2:-1:2]) == sorted(f"{side}_{i}" for side in ("left", "right") for i in range(1, 6))
    assert executions["sequence"].n_unique() > 10


def test_box_picking_has_the_size_of_the_papers_cell(box: Path) -> None:
    executions = pl.read_parquet(box / "truth" / "executions.parquet")
    assert 90 < executions["duration_s"].mean() < 110
    assert 60 < (executions["nominal_s"] + executions["dwell_s"]).mean() < 65
    assert 2 < executions["duration_s"].std() < 9
    share = samples(box)["scaling"].value_counts(normalize=True)
    assert sorted(share["scaling"]) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert share["proportion"].min() > 0.02


def test_the_logger_pauses_between_box_picking_executions_and_never_in_packing(box: Path, packing: Path) -> None:
    steps = np.diff(robot_log(box)["timestamp"].to_numpy())
    assert (steps > 5).sum() == 7
    assert np.abs(steps[steps < 5] - 0.008).max() < 1e-6
    assert np.abs(np.diff(robot_log(packing)["timestamp"].to_numpy()) - 0.008).max() < 1e-6


def test_in_laser_zones_the_floor_tells_the_scaling_and_the_distance_does_not(zones: Path) -> None:
    truth = samples(zones)
    safety = json.loads((zones / "truth" / "truth.json").read_text())["safety"]
    x, y = truth["human_x_m"].to_numpy(), truth["human_y_m"].to_numpy()
    step = np.full(len(x), 3)
    for zone in safety["zones"]:
        (x0, x1), (y0, y1) = zone["x_m"], zone["y_m"]
        step = np.where((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1), np.minimum(step, zone["step"]), step)
    assert np.array_equal(np.array(safety["levels"])[step], truth["scaling"].to_numpy())
    assert set(truth["scaling"]) == {0.0, 0.5, 0.75, 1.0}
    # Even the best function of the distance (the mean of s in each centimetre) leaves much of s unexplained.
    gamma = np.linalg.norm(truth[HUMAN].to_numpy() - truth[ROBOT].to_numpy(), axis=1)
    best = pl.DataFrame({"cm": (gamma * 100).round(), "s": truth["scaling"]}).with_columns(
        m=pl.col("s").mean().over("cm")
    )
    assert ((best["s"] - best["m"]) ** 2).mean() > 0.01


def test_an_execution_is_the_same_however_many_are_simulated(box: Path, boxes: SimulatedCell) -> None:
    few = boxes.samples
    assert few.equals(samples(box).filter(pl.col("execution") < 4))


def test_latency_makes_the_scaling_follow_the_positions_of_earlier(tmp_path: Path) -> None:
    truth = samples(one(tmp_path, latency_s=0.4, robot_rate_hz=500))
    gamma = np.linalg.norm(truth[HUMAN].to_numpy() - truth[ROBOT].to_numpy(), axis=1)
    wanted, s = staircase(gamma, [1.2, 1.5, 1.9, 2.4]), truth["scaling"].to_numpy()
    assert np.array_equal(wanted[:-4], s[4:])
    assert not np.array_equal(wanted, s)


def test_ramps_limit_how_fast_the_scaling_moves_each_way(tmp_path: Path) -> None:
    change = (
        np.diff(robot_log(one(tmp_path, ramp_down_per_s=4.0, ramp_up_per_s=1.0))["speed_scaling"].to_numpy()) / 0.008
    )
    assert change.min() == pytest.approx(-4.0, abs=1e-3)
    assert change.max() == pytest.approx(1.0, abs=1e-3)


def test_with_hysteresis_the_scaling_rises_later_than_it_falls(tmp_path: Path) -> None:
    truth = samples(one(tmp_path, executions=4, hysteresis_m=0.2))
    gamma = np.linalg.norm(truth[HUMAN].to_numpy() - truth[ROBOT].to_numpy(), axis=1)
    s, thresholds = truth["scaling"].to_numpy(), np.array([1.2, 1.5, 1.9, 2.4])
    assert np.all(s <= staircase(gamma, thresholds))
    assert np.all(s >= staircase(gamma, thresholds + 0.2))
    assert np.any(s < staircase(gamma, thresholds))


def test_without_an_operator_nothing_is_lost_and_the_tracker_sees_nobody(tmp_path: Path) -> None:
    folder = one(tmp_path, executions=2, with_operator=False)
    executions = pl.read_parquet(folder / "truth" / "executions.parquet")
    assert executions["safety_loss_s"].max() < 1e-9
    assert samples(folder)["human_x_m"].null_count() == samples(folder).height
    frames = pl.read_csv(folder / "session_000" / "operator.csv", skip_rows=7, has_header=False)
    assert frames.height > 1000
    assert all(frames[column].null_count() == frames.height for column in frames.columns[2:])


def test_fresh_executions_of_one_sequence_agree_with_its_parts(tmp_path: Path) -> None:
    places = random_sequence("box-picking", 4)
    assert places == random_sequence("box-picking", 4)
    fresh = simulate_sequence("box-picking", places, executions=6, seed=1)
    assert fresh["execution"].to_list() == list(range(6))
    parts = pl.sum_horizontal("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
    assert (fresh["duration_s"] - fresh.select(parts).to_series()).abs().max() < 1e-3
    assert fresh["duration_s"].n_unique() == 6
    assert fresh["nominal_s"].n_unique() == 1


def test_a_sequence_with_an_unknown_place_is_refused_by_its_name() -> None:
    with pytest.raises(SimulationError, match="left_9"):
        simulate_sequence("box-picking", ["home", "left_9", "home"], executions=1, seed=0)
    assert "left_5" in scene_places("box-picking")
