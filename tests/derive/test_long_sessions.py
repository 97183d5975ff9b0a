"""A session that lasts longer than its samples may take memory is made in parts, and nothing of it depends on them."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import pyarrow.parquet as pq
import pytest
from polars.testing import assert_frame_equal

from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.storage import parquet as tables

if TYPE_CHECKING:
    from pathlib import Path

    import polars as pl
    from simulated_cells import SimulatedCell

AT_ONCE, GROUP = 150, 800
sample, sample_file, last_pass = (
    sys.modules[f"cyclekit.derive.{name}"] for name in ("second_pass", "sample_file", "last_pass")
)


@pytest.fixture
def heights(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Make samples few at a time, and tell how many came to the file at once."""
    seen: list[int] = []

    class Watched(tables.TableWriter):
        def write(self, frame: pl.DataFrame) -> None:
            seen.append(frame.height)
            super().write(frame)

    for module in (sample, last_pass):
        monkeypatch.setattr(module, "AT_ONCE", AT_ONCE)
    monkeypatch.setattr(tables, "GROUP_ROWS", GROUP)
    monkeypatch.setattr(sample_file, "GROUP_ROWS", GROUP)
    monkeypatch.setattr(sample_file, "TableWriter", Watched)
    return seen


@pytest.mark.slow
def test_samples_made_in_parts_are_those_made_at_once(boxes: SimulatedCell, tmp_path: Path, heights: list[int]):
    ingest([boxes.logs], tmp_path / "parts")
    parts, once = Dataset.open(tmp_path / "parts"), boxes.dataset
    assert_frame_equal(parts.samples(), once.samples(), check_exact=True)
    assert_frame_equal(parts.tasks(), once.tasks(), check_exact=True)
    cards = [json.loads((dataset.path / CARD).read_text(encoding="utf-8")) for dataset in (parts, once)]
    assert cards[0]["executions"] == cards[1]["executions"]
    assert [entry.get("operator") for entry in cards[0]["recordings"]] == [
        entry.get("operator") for entry in cards[1]["recordings"]
    ]
    for file in (tmp_path / "parts" / "samples").iterdir():
        assert pq.ParquetFile(file).num_row_groups > 2
    assert 0 < max(heights) <= AT_ONCE


def test_one_execution_that_lasts_as_long_as_its_log_is_made_in_parts_too(
    boxes: SimulatedCell, tmp_path: Path, heights: list[int]
):
    people = sorted(boxes.logs.glob("session_*/operator.csv"))[0]  # without a robot nothing divides the time
    ingest([people], tmp_path / "parts")
    found = Dataset.open(tmp_path / "parts").samples()
    assert found.height > 5 * GROUP
    assert found["execution"].n_unique() == 1
    assert found["t_s"].diff().drop_nulls().is_between(0.0999, 0.1001).all()
    assert found["human_x_m"].is_not_null().mean() > 0.9
    assert 0 < max(heights) <= AT_ONCE
