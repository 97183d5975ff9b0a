"""What is set aside is listed, and a dataset says which of its logs nothing protects."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
import pytest
from ingested import ROUND_TRIP

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.inspect.describe import describe
from cyclekit.schema import QUARANTINE
from cyclekit.storage.atomic import write_parquet

if TYPE_CHECKING:
    from simulated_cells import Cells


def test_every_row_set_aside_is_in_one_table_with_file_line_and_reason(logs: Path, tmp_path: Path):
    found = Dataset.open(ingest([logs], tmp_path / "dataset").dataset)
    table = found.quarantine()
    assert table.schema == pl.Schema({name: column.dtype for name, column in QUARANTINE.items()})
    last = len((logs / "b.csv").read_bytes().splitlines())
    assert table.rows() == [
        ("b", "b.csv", last, "line", "the last line has no line end: it was cut while being written")
    ]
    assert sorted(file.name for file in (found.path / "recordings" / "b").iterdir()) == ["robot.parquet"]
    assert sum(describe(found.path).set_aside.values()) == 1


def test_what_was_set_aside_stays_listed_when_its_log_is_not_read_again(logs: Path, tmp_path: Path, robot_log: Any):
    out = ingest([logs], tmp_path / "dataset").dataset
    before = Dataset.open(out).quarantine()
    robot_log(logs / "c.csv", ROUND_TRIP)
    assert ingest([logs], out).recordings_kept == 2
    assert Dataset.open(out).quarantine().equals(before)


def test_a_dataset_says_which_of_its_logs_have_no_checksum(logs: Path, tmp_path: Path):
    found = Dataset.open(ingest([logs], tmp_path / "dataset").dataset)
    assert {entry.facts["checksum"].partition(":")[0] for entry in found.recordings} == {"none"}


def test_a_table_that_polars_cannot_write_is_an_error_of_the_system(tmp_path: Path):
    (tmp_path / "a").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_parquet(pl.DataFrame({"x": [1.0]}), tmp_path / "a")


def test_a_bag_with_checksums_says_so_and_a_csv_says_that_it_has_none(cells: Cells):
    (protected,) = cells("laser-zones", 2, logs="mcap").dataset.recordings
    assert protected.facts["checksum"].startswith("CRC-32")
    assert all(r.facts["checksum"].startswith("none") for r in cells("laser-zones", 2).dataset.recordings)
