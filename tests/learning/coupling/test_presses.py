"""A log that holds the presses of a button, and not its releases."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.coupling.events.logged_visits import presses

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells


def test_a_signal_that_is_only_ever_on_is_set_by_every_row() -> None:
    at = np.array([3.0, 11.0, 24.0, 30.5])
    for on in (None, np.ones(4, np.bool_)):
        rises, falls = presses(at, on)
        assert rises.tolist() == [True] * 4
        assert not falls.any()


def test_a_signal_with_two_states_and_a_sampled_one_are_set_when_they_turn_on() -> None:
    at = np.array([3.0, 11.0, 24.0, 30.5])
    rises, falls = presses(at, np.array([True, False, True, True]))
    assert rises.tolist() == [True, False, True, False]
    assert falls.tolist() == [False, True, False, False]
    rises, _ = presses(np.arange(100) / 10.0, np.ones(100, np.bool_))
    assert np.flatnonzero(rises).tolist() == [0]
    rises, falls = presses(np.array([5.0]), np.zeros(1, np.bool_))
    assert not (rises | falls).any()


@pytest.mark.slow
def test_the_robot_waits_for_a_button_whose_releases_are_in_no_log(cells: Cells, tmp_path: Path) -> None:
    logs = cells.logs("shared-fixture", 16, seed=31)
    shutil.copytree(logs, tmp_path / "logs", ignore=shutil.ignore_patterns("truth"))
    for log in (tmp_path / "logs").rglob("events.csv"):
        pl.read_csv(log).filter(pl.col("value") == 1).write_csv(log)
    ingest([tmp_path / "logs"], tmp_path / "dataset")
    card = Dataset.open(tmp_path / "dataset").card.coupling
    assert card is not None
    (robot,) = (one for gate in card.gates if gate.agent == "robot" for one in gate.conditions)
    assert (robot.place, robot.signal, robot.back) == ("fixture", "release set", 1)
