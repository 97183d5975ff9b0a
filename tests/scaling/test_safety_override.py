"""The override that a safety system logged in a file of its own, as the scaling of a robot whose log has none."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.dataset.cards import texts
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.scaling.safety_override import AGREES, DIFFERS, TOO_LITTLE, SafetyOverride, match_of, taken
from cyclekit.segmentation.motion import InferredScaling, RobotRun

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from simulated_cells import Cells

    Vector = NDArray[np.float64]

SCENE = "scanner-visits"


def course(t_s: Vector, seed: int = 0) -> Vector:
    """A scaling that changes its level at random times."""
    rng = np.random.default_rng(seed)
    begins = np.concatenate([[0.0], np.cumsum(rng.uniform(2.0, 9.0, 400))])
    return np.asarray(rng.choice([0.0, 0.3, 0.7, 1.0], len(begins)))[np.searchsorted(begins, t_s, side="right") - 1]


def moved(scaling: Vector, t_s: Vector) -> list[tuple[RobotRun, list[InferredScaling]]]:
    """One run whose inferred scaling is this."""
    run = RobotRun(t_s, np.zeros((len(t_s), 3)), np.zeros(len(t_s)), np.full(len(t_s), np.nan))
    return [(run, [InferredScaling(0, scaling, np.full(len(t_s), 0.001), np.zeros(len(t_s), np.int8))])]


def logged(t_s: Vector, override: Vector, *, clock_known: bool) -> SafetyOverride:
    return SafetyOverride("safety.csv", t_s, np.round(override, 2), clock_known)


@at_most(6)
@given(st.floats(-40.0, 40.0), st.sampled_from([10.0, 30.0]))
def test_an_assumed_clock_is_put_right_by_the_motion(later_s: float, rate_hz: float):
    t_s, at_s = np.arange(0.0, 400.0, 0.02), np.arange(0.0, 400.0, 1.0 / rate_hz)
    found = match_of(logged(at_s - later_s, course(at_s), clock_known=False), moved(course(t_s), t_s))
    assert found.found == AGREES
    assert found.later_s == pytest.approx(later_s, abs=1.0 / rate_hz + 0.02)


def test_a_known_clock_is_not_moved_by_more_than_a_robot_can_lag():
    t_s = np.arange(0.0, 400.0, 0.02)
    mine = moved(course(t_s), t_s)
    assert match_of(logged(t_s - 0.3, course(t_s), clock_known=True), mine).later_s == pytest.approx(0.3, abs=0.02)
    assert match_of(logged(t_s - 20.0, course(t_s), clock_known=True), mine).found == DIFFERS


@pytest.mark.parametrize("clock_known", [True, False])
def test_the_override_of_another_robot_is_not_believed(clock_known: bool):
    t_s = np.arange(0.0, 400.0, 0.02)
    assert match_of(logged(t_s, course(t_s, 1), clock_known=clock_known), moved(course(t_s), t_s)).found == DIFFERS


def test_an_override_that_repeats_itself_does_not_tell_an_unknown_clock():
    t_s = np.arange(0.0, 400.0, 0.02)
    turns = np.where(t_s % 10.0 < 4.0, 0.5, 1.0)
    assert match_of(logged(t_s, turns, clock_known=False), moved(turns, t_s)).found == DIFFERS
    assert match_of(logged(t_s, turns, clock_known=True), moved(turns, t_s)).found == AGREES


def test_a_robot_that_was_never_slowed_tells_nothing():
    t_s = np.arange(0.0, 400.0, 0.02)
    assert match_of(logged(t_s, course(t_s), clock_known=True), moved(np.ones(len(t_s)), t_s)).found == TOO_LITTLE


def test_a_silent_log_holds_its_last_value_no_longer_than_a_second():
    t_s = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(50.0, 60.0, 0.1)])
    found = logged(t_s, np.full(len(t_s), 0.5), clock_known=True).at(np.array([-1.0, 5.0, 10.5, 30.0, 55.0]))
    assert np.isnan(found).tolist() == [True, False, False, True, False]


def test_a_run_that_is_read_in_blocks_has_the_same_scaling(monkeypatch: pytest.MonkeyPatch):
    t_s = np.arange(0.0, 400.0, 0.02)
    mine, (run, _) = logged(t_s[::2], course(t_s[::2]), clock_known=True), moved(course(t_s), t_s)[0]
    whole = taken(mine, 0.1, run).scaling
    monkeypatch.setattr("cyclekit.scaling.safety_override.AT_ONCE", 777)
    np.testing.assert_array_equal(taken(mine, 0.1, run).scaling, whole)
    assert np.isnan(whole[:5]).all()
    assert np.isfinite(whole[5:]).all()


@pytest.fixture(scope="module")
def apart(cells: Cells, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell whose override is logged by its safety system alone: whole percents at 30 Hz, on a clock of its own."""
    folder = tmp_path_factory.mktemp("apart") / "logs"
    shutil.copytree(cells.logs(SCENE, log_override=False), folder, ignore=shutil.ignore_patterns("truth"))
    for robot in sorted(folder.rglob("robot.csv")):
        with_override = cells.logs(SCENE) / robot.relative_to(folder)
        log = pl.read_csv(with_override, separator=" ").select("timestamp", "speed_scaling")
        rows = log.gather(np.unique(np.searchsorted(log["timestamp"], np.arange(log[0, 0], log[-1, 0], 1 / 30))))
        table = rows.select(
            timestamp=pl.col("timestamp") - log[0, 0] + 7.7, override=(pl.col("speed_scaling") * 100).round(0)
        )
        table.write_csv(robot.with_name("safety.csv"))
    return folder


def test_its_override_is_the_scaling_of_the_robot_that_follows_it(apart: Path, cells: Cells, tmp_path: Path):
    ingest([apart], tmp_path / "dataset")
    found, true = Dataset.open(tmp_path / "dataset"), cells(SCENE).dataset
    assert found.card.scaling_origin == "logged"
    assert [one.places for one in found.card.executions] == [one.places for one in true.card.executions]
    told, logs = "\n".join(texts(found.card.warnings)), len(list(apart.rglob("safety.csv")))
    assert (f"overrides of {logs} logs" if logs > 1 else "the override of") in told
    assert "inferred" not in told
    both = [one.samples().select("t_s", "execution", "scaling") for one in (found, true)]
    side = both[0].join(both[1], on=["execution", "t_s"], suffix="_true").drop_nulls()
    assert side.height > 0.95 * both[1].height
    assert (side["scaling"] - side["scaling_true"]).abs().mean() < 0.01  # type: ignore[operator]


def test_an_override_that_the_robot_does_not_follow_is_left_out_with_a_word(apart: Path, tmp_path: Path):
    logs = shutil.copytree(apart, tmp_path / "logs")
    for number, safety in enumerate(sorted(logs.rglob("safety.csv"))):
        table = pl.read_csv(safety)
        t_s = table["timestamp"].to_numpy()
        table.with_columns(override=pl.Series(100.0 * course(t_s - t_s[0], number))).write_csv(safety)
    ingest([logs], tmp_path / "dataset")
    found = Dataset.open(tmp_path / "dataset")
    assert found.card.scaling_origin == "inferred"
    assert "not taken for the robot's speed scaling" in "\n".join(texts(found.card.warnings))
