"""The 10 Hz samples against what the simulator knows: positions, scaling, goals, tasks."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit_sim import SCENES

if TYPE_CHECKING:
    from simulated_cells import Cells, SimulatedCell

CYCLE_S = 0.008


@pytest.fixture(params=SCENES)
def cell(request: pytest.FixtureRequest, cells: Cells) -> SimulatedCell:
    return cells(request.param)


@pytest.fixture
def both(cell: SimulatedCell) -> pl.DataFrame:
    """Samples with the true sample nearest in time, at most one and a half control cycles away."""
    found = cell.dataset.samples().sort("t_s")
    truth = cell.samples.with_columns(t_s=pl.col("t_s") - cell.executions["start_s"][0]).sort("t_s")
    joined = found.join_asof(truth, on="t_s", strategy="nearest", tolerance=1.5 * CYCLE_S, suffix="_true")
    joined = joined.filter(pl.col("scaling_true").is_not_null())
    assert joined.height > 0.05 * found.height
    return joined


def apart_m(both: pl.DataFrame, who: str) -> np.ndarray:
    names = [f"{who}_{axis}_m" for axis in "xyz"]
    return np.linalg.norm(both.select(names).to_numpy() - both.select(f"{n}_true" for n in names).to_numpy(), axis=1)


def test_robot_and_operator_are_where_they_really_were(both: pl.DataFrame):
    assert np.nanmax(apart_m(both, "robot")) < 1.2 * 1.5 * CYCLE_S  # at most 1.2 m/s, as far as the times differ
    assert np.nanmax(apart_m(both, "human")) < 1.5 * 1.5 * CYCLE_S + 0.005
    assert np.nanmedian(apart_m(both, "human")) < 0.01


def test_the_scaling_is_the_true_one_except_where_it_just_changed(both: pl.DataFrame):
    same = both["scaling"] == both["scaling_true"]
    assert same.mean() > 0.98  # type: ignore[operator]
    assert both["scaling_origin"].unique().to_list() == ["logged"]


def test_the_scaling_is_that_of_the_very_positions_beside_it(cells: Cells):
    """The paper's staircase, applied to the positions of the samples, gives their scaling."""
    found = cells("box-picking").dataset.samples().drop_nulls("human_x_m")
    robot, human = (found.select(f"{who}_{axis}_m" for axis in "xyz").to_numpy() for who in ("robot", "human"))
    level = np.searchsorted([1.2, 1.5, 1.9, 2.4], np.linalg.norm(robot - human, axis=1))
    wrong = np.array([0.0, 0.25, 0.5, 0.75, 1.0])[level] - found["scaling"].to_numpy()
    assert np.mean(wrong**2) < 4e-4


def test_the_step_is_the_index_of_the_level(cell: SimulatedCell):
    found = cell.dataset.samples().filter(pl.col("step").is_not_null())
    levels = np.array(cell.dataset.levels)
    np.testing.assert_allclose(levels[found["step"].to_numpy()], found["scaling"].to_numpy(), atol=1e-6)
    assert found.height > 0.999 * cell.dataset.samples().height
    safety = json.loads((cell.logs / "truth" / "truth.json").read_text(encoding="utf-8"))["safety"]
    assert set(levels.tolist()) <= set(safety["levels"])


def test_tasks_and_goals_of_the_robot_are_the_true_ones(both: pl.DataFrame):
    known = both.filter(pl.col("robot_task_true") != "")
    assert (known["robot_task"] == known["robot_task_true"]).mean() > 0.985  # type: ignore[operator]
    right = known.filter(pl.col("robot_task") == pl.col("robot_task_true"))
    assert np.max(apart_m(right, "robot_goal")) < 2e-3


def test_the_robot_moves_between_the_start_and_the_arrival_of_a_task(cell: SimulatedCell):
    samples = cell.dataset.samples()
    moving = samples["robot_moving"].sum() / 10
    tasks = cell.dataset.tasks()
    on_the_way = (tasks["arrival_s"] - tasks["start_s"]).sum()
    assert moving == pytest.approx(on_the_way, rel=0.02)


def test_nothing_of_the_robot_is_unknown_in_a_log_without_gaps(cell: SimulatedCell):
    samples = cell.dataset.samples()
    for name in ("robot_x_m", "scaling", "robot_goal_x_m", "robot_task", "robot_moving"):
        assert samples[name].null_count() == 0
    assert samples.columns == list(schema.SAMPLES)
