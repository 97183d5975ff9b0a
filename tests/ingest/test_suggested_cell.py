"""The cell file suggested for logs: one source for logs of a kind, and the places of a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from ingested import ROUND_TRIP

from cyclekit.ingest.discover import suggest_cell

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import SimulatedCell


def test_the_cell_file_suggested_for_logs_names_those_of_a_kind_once_with_their_adapter(three_runs: Path):
    cell = suggest_cell([three_runs]).cell
    assert [(source.path, source.adapter) for source in cell.sources] == [("run_*.csv", "ur-rtde")]


def test_the_path_suggested_for_numbered_logs_matches_the_next_ones_too(tmp_path: Path, robot_log: Any):
    for name in ("run_008.csv", "run_009.csv", "day/0701.csv", "day/0702.csv"):
        robot_log(tmp_path / name, ROUND_TRIP)
    paths = {source.path for source in suggest_cell([tmp_path]).cell.sources}
    assert paths == {"run_*.csv", "day/070*.csv"}  # a name of digits alone keeps the common ones
    (tmp_path / "run_notes.csv").write_text("of no adapter\n")  # and of no source either
    paths = {source.path for source in suggest_cell([tmp_path]).cell.sources}
    assert paths == {"run_00*.csv", "day/070*.csv"}


def test_the_cell_file_suggested_for_a_dataset_names_the_places_found(boxes: SimulatedCell):
    cell = suggest_cell([boxes.dataset.path]).cell
    assert set(cell.places) == set(boxes.dataset.places)
    assert cell.places["conveyor"].xyz_m == pytest.approx((0.6, 0.0, 0.1), abs=1e-3)
