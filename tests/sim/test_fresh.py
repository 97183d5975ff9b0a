"""Fresh executions, the truth of the benchmarks, come from the cell that was logged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl
import pytest

from benchmarks.cells import durations_of, fresh
from cyclekit_sim import SimulationOptions, random_sequence, simulate, simulate_sequence
from cyclekit_sim.scenes import BUILT_IN

if TYPE_CHECKING:
    from pathlib import Path


def test_fresh_executions_have_the_response_of_their_scene(tmp_path: Path) -> None:
    scene = BUILT_IN["light-curtain"]
    told = SimulationOptions(
        latency_s=scene.latency_s, ramp_down_per_s=scene.ramp_down_per_s, ramp_up_per_s=scene.ramp_up_per_s
    )
    places = random_sequence(scene.name, 1)[:4]
    left_open = durations_of(fresh(tmp_path / "left open", scene.name, places, 3))
    assert (left_open == durations_of(fresh(tmp_path / "told", scene.name, places, 3, options=told))).all()


def test_people_with_habits_log_one_file_an_execution_and_can_be_run_again_in_another_order(tmp_path: Path) -> None:
    """Chance: execution n of another order has the person of logged execution n; a person is recorded several times."""
    options = SimulationOptions(executions_per_session=1)
    logs = simulate("bench-crew", tmp_path / "logs", executions=3, seed=4, options=options)
    truth = pl.read_parquet(logs / "truth" / "executions.parquet")
    assert truth["session"].n_unique() == len(list(logs.glob("session_*/operator.csv"))) == 3
    parts = truth.select(pl.sum_horizontal("nominal_s", "safety_loss_s", "dwell_s", "wait_s")).to_series()
    assert (truth["duration_s"] - parts).abs().max() < 1e-3
    for number in (0, 2):
        places = truth["sequence"][number].split(",")
        again = simulate_sequence("bench-crew", places, executions=3, seed=4, options=options, logged=True)
        assert again["duration_s"][number] == pytest.approx(truth["duration_s"][number], abs=1e-6)
    others = simulate_sequence("bench-crew", places, executions=3, seed=4, options=options)
    assert (others["duration_s"] - again["duration_s"]).abs().min() > 1e-3
