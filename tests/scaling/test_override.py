"""The override of a log that did not record it, against what the simulated robot really did.

What is measured: over all 10 Hz samples at which the simulator's robot is on its way and the scaling could be
inferred, the mean absolute difference to the simulator's own s at that instant.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest

from cyclekit.config import Cell
from cyclekit.dataset.cards import texts
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.scaling.infer.override import _goes as goes
from cyclekit.scaling.run_scaling import ScalingsAfterStops, halts_at_places, scalings_after_stops
from cyclekit.segmentation.arrivals import PlaceStandstill
from cyclekit.segmentation.executions import Execution, Visit
from cyclekit.segmentation.motion import RobotRun

if TYPE_CHECKING:
    from simulated_cells import Cells, SimulatedCell


@pytest.fixture(scope="module")
def silent(cells: Cells) -> SimulatedCell:
    """A packing cell whose controller does not log its override; the operator is often far away."""
    return cells("pick-and-package", log_override=False)


@pytest.fixture(scope="module")
def compared(silent: SimulatedCell, cells: Cells) -> pl.DataFrame:
    """Inferred and true scaling side by side: the sample, and that row of the log of the same cell that says it."""
    found = silent.dataset.samples().select("t_s", "scaling", "scaling_origin", "scaling_sd", "robot_moving")
    told = cells.logs("pick-and-package")
    log = pl.read_csv(told / "session_000" / "robot.csv", separator=" ")
    truth = log.select(t_s=pl.col("timestamp") - log["timestamp"][0], true="speed_scaling")
    return found.sort("t_s").join_asof(truth, on="t_s", strategy="nearest", tolerance=0.001)


def test_the_inferred_override_is_near_the_true_one_while_the_robot_moves(compared: pl.DataFrame):
    known = compared.filter(pl.col("robot_moving") & pl.col("scaling").is_not_null())
    assert known.height > 0.9 * compared.filter("robot_moving").height
    error = (known["scaling"] - known["true"]).abs()
    assert error.mean() < 0.006  # type: ignore[operator]
    assert (error < 0.05).mean() > 0.98  # type: ignore[operator]


def test_an_inferred_override_says_so(silent: SimulatedCell, compared: pl.DataFrame):
    known = compared.filter(pl.col("scaling").is_not_null())
    assert known["scaling_origin"].unique().to_list() == ["inferred"]
    assert (
        compared.filter(pl.col("scaling").is_null())["scaling_origin"].null_count() == compared["scaling"].null_count()
    )
    assert silent.dataset.card.scaling_origin == "inferred"
    assert "inferred from velocity ratios" in texts(silent.dataset.card.warnings)[0]


def test_where_the_robot_dwells_the_override_is_unknown_not_zero(compared: pl.DataFrame):
    standing = compared.filter(~pl.col("robot_moving"))
    assert standing.height > 100
    assert standing["scaling"].null_count() > 0.97 * standing.height


def test_the_levels_of_the_staircase_show_in_the_inferred_override(silent: SimulatedCell):
    for level in (0.25, 0.5, 0.75, 1.0):
        assert min(abs(level - found) for found in silent.dataset.levels) < 0.01


def test_safety_loss_without_a_logged_override_is_near_the_truth(silent: SimulatedCell):
    found = silent.dataset.tasks()["safety_loss_s"].sum()
    assert found == pytest.approx(silent.tasks["safety_loss_s"].sum(), rel=0.08)


def test_a_run_with_nobody_in_the_cell_is_the_reference_where_there_is_one(tmp_path: Path, robot_log: Any):
    def round_trip(pause_s: float) -> list[tuple[str, float]]:
        halt = [("halt", pause_s)] if pause_s else []
        return [("stand", 1.0), ("move", 0.5), *halt, ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 1.0)]

    for number in range(4):
        robot_log(tmp_path / "logs" / f"run_{number}.csv", round_trip(3.0), scaling=False)
    alone = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "alone").dataset)
    robot_log(tmp_path / "logs" / "empty.csv", round_trip(0.0), scaling=False)
    cell = Cell(reference=("empty.csv",))
    with_reference = Dataset.open(ingest([tmp_path / "logs"], tmp_path / "with", cell=cell).dataset)
    lost = with_reference.tasks().filter(pl.col("task") == "place_1->place_2")["safety_loss_s"]
    assert sorted(lost.to_list()) == pytest.approx([0.0, 3.0, 3.0, 3.0, 3.0], abs=0.1)
    assert "runs without the operator" in texts(with_reference.card.warnings)[0]
    # Without it, a halt that every repetition has cannot be told from the program.
    assert alone.tasks()["safety_loss_s"].abs().max() < 0.1


def test_a_standstill_tells_no_scaling_where_nobody_was_logged(tmp_path: Path):
    """Motions at two speeds, and one stand of 14 s before a slow motion: who knows whether that was a halt."""
    x, times = [0.0] * 125, (0.6, 0.6, 14.0, 0.6, 0.6, 0.6, 0.6, 0.6, 0.6, 0.6)
    for number, stands_s in enumerate(times):
        way = np.linspace(0.0, 0.5, 250 if number in (0, 3, 6) else 125)
        way = way if number % 2 == 0 else way[::-1]
        x += [*way, *np.full(int(125 * stands_s), way[-1])]
    pose = pl.DataFrame({"timestamp": np.arange(len(x)) / 125} | {f"actual_TCP_pose_{i}": x for i in range(6)})
    pose.write_csv(tmp_path / "run.csv", separator=" ", float_precision=6)
    found = Dataset.open(ingest([tmp_path / "run.csv"], tmp_path / "dataset").dataset)
    known = found.samples().filter(pl.col("scaling").is_not_null())
    assert known.height > 0.6 * 10 * sum(1.0 + (number in (0, 3, 6)) for number in range(10))
    assert known["scaling"].min() > 0.1  # type: ignore[operator]


@pytest.mark.parametrize(("speed_m_s", "halted"), [(0.0, True), (0.003, True), (0.1, False)])
def test_a_robot_that_moves_is_not_halted(speed_m_s: float, halted: bool):
    speeds = np.full(500, 0.5)
    speeds[200:250] = speed_m_s
    assert goes(speeds)[200:250].all() != halted
    assert goes(speeds)[:200].all()


def test_a_motion_that_never_repeats_has_no_reference_and_that_is_said(tmp_path: Path, robot_log: Any):
    log = robot_log(tmp_path / "run.csv", [("stand", 1.0), ("move", 1.0), ("stand", 1.0)], scaling=False)
    found = Dataset.open(ingest([log], tmp_path / "dataset").dataset)
    assert found.tasks()["nominal_s"].to_list() == [None]
    assert found.tasks()["safety_loss_s"].to_list() == [None]
    assert found.samples()["scaling"].null_count() == found.samples().height
    assert found.card.scaling_origin is None
    assert any("cannot be inferred" in text for text in texts(found.card.warnings))


def test_a_speed_that_is_common_after_halts_and_seldom_else_tells_of_a_halt():
    after = ScalingsAfterStops(np.array([0.5] * 8 + [0.75] * 2 + [1.0] * 3), lowest=0.25)
    others = [1.0] * 60 + [0.75] * 20 + [0.5] * 5
    assert after.indicates_stop(0.5, others)
    assert not after.indicates_stop(0.75, others)
    assert not after.indicates_stop(1.0, [0.5] * 20)
    assert ScalingsAfterStops(np.empty(0), lowest=0.25).indicates_stop(0.25, others)


def test_what_follows_halts_in_mid_motion_is_looked_up_past_their_edge():
    motion = np.concatenate([np.ones(400), np.zeros(400), [0.1, 0.3], np.full(400, 0.5)])
    found = scalings_after_stops([motion, np.ones(400), np.zeros(3)])
    assert found.scaling.tolist() == [0.5]
    assert found.lowest == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("left_s", "halted_s"), [(5.5, 5.5), (10.9, 0.0)])
def test_a_robot_that_left_and_is_not_seen_to_move_is_halted(left_s: float, halted_s: float):
    """It stands from 5 s, and is seen to move at 11 s."""
    t_s = np.arange(200) / 10.0
    run = RobotRun(t_s, np.zeros((200, 3)), np.zeros(200), np.full(200, np.nan), is_inferred=True)
    visits = tuple(Visit(place, row, last) for place, row, last in (("a", 0, 20), ("b", 50, 110), ("c", 180, 199)))
    standstills = {(0, visit.first, visit.last): PlaceStandstill(5.0, 5.0, left_s, left_s) for visit in visits}
    (found,) = halts_at_places(
        [run], [Execution(0, visits, complete=True)], standstills, ScalingsAfterStops(np.empty(0), 1.0)
    )
    assert sum(len(part.scaling) for part in found) == pytest.approx(10.0 * halted_s + bool(halted_s))
    assert all((part.scaling == 0.0).all() for part in found)


@pytest.mark.parametrize(("way_m", "halted"), [(2e-4, True), (0.0, False)])
def test_a_robot_that_goes_the_last_hair_later_was_halted_short_of_its_place(way_m: float, halted: bool):
    """It is not seen to move from 5 s on, and goes the rest of its way at 8 s."""
    t_s = np.arange(2000) / 100.0
    xyz = np.random.default_rng(0).normal(0.0, 1e-5, (2000, 3))
    xyz[:800, 0] += way_m
    run = RobotRun(t_s, xyz, np.zeros(2000), np.full(2000, np.nan), is_inferred=True)
    visits = tuple(Visit(place, row, last) for place, row, last in (("a", 0, 200), ("b", 500, 850), ("c", 1800, 1999)))
    standstills = {
        (0, 0, 200): PlaceStandstill(0.0, 0.0, 2.0, 2.0),
        (0, 500, 850): PlaceStandstill(8.0, 8.0, 8.5, 8.5),
        (0, 1800, 1999): PlaceStandstill(18.0, 18.0, 19.9, 19.9),
    }
    (found,) = halts_at_places(
        [run], [Execution(0, visits, complete=True)], standstills, ScalingsAfterStops(np.empty(0), 1.0)
    )
    assert [(part.first, len(part.scaling)) for part in found] == ([(500, 300)] if halted else [])
