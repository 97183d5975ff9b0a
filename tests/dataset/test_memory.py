"""A dataset that claims more rows than memory takes: one message before it is read, never an abort."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING

import polars as pl
import pyarrow.parquet as pq
import pytest
from fabricated import fabricate_dataset

from cyclekit.dataset import checksums
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import DatasetError
from cyclekit.storage import memory
from cyclekit.text.numbers import count

if TYPE_CHECKING:
    from pathlib import Path

PART_ROWS, PARTS = 100_000, 80


@pytest.fixture(scope="module")
def forged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of eight million samples in less than a megabyte, whose card speaks of as many."""
    folder = tmp_path_factory.mktemp("forged") / "dataset"
    fabricate_dataset(folder, 2, rounds=1)
    file = folder / "samples" / "session-1.parquet"
    part = pl.read_parquet(file).head(1).select(pl.all().repeat_by(PART_ROWS).explode()).to_arrow()
    with pq.ParquetWriter(file, part.schema, compression="zstd") as table:
        for _ in range(PARTS):
            table.write_table(part)
    card = json.loads((folder / "dataset.json").read_text(encoding="utf-8"))
    card["executions"][0]["end_s"] += PART_ROWS * PARTS / 10
    (folder / "dataset.json").write_text(json.dumps(card), encoding="utf-8")
    return folder


_LIMITED = """
import resource, sys
from cyclekit.cli import main
import polars, pyarrow.parquet
polars.DataFrame({"a": [1]}).lazy().select("a").collect()
taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + (700 << 20),) * 2)
sys.argv = ["cyclekit", "inspect", sys.argv[1]]
main()
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the limit is set as Linux does")
def test_more_samples_than_memory_takes_are_one_message_and_no_abort(forged: Path):
    ended = subprocess.run([sys.executable, "-c", _LIMITED, str(forged)], capture_output=True, text=True, check=False)
    assert ended.returncode == 1, ended.stderr[-500:]
    assert ended.stderr.startswith(f"error: {forged / 'samples'}: 8 0")
    assert "of memory, and this process may take 0." in ended.stderr
    assert "Ingest fewer logs into one dataset" in ended.stderr


@pytest.mark.parametrize("read", [lambda d: d.samples(), lambda d: d.samples(d.executions["execution"].to_list()[:1])])
def test_all_samples_and_one_long_execution_are_measured(forged: Path, read, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("cyclekit.dataset.files.memory_limit_bytes", lambda: 1_000_000_000)
    with pytest.raises(DatasetError, match=r"8 000 \d+ rows of \d+ columns need \d.\d GB of memory"):
        read(Dataset.open(forged))


def test_a_short_execution_of_a_long_dataset_is_read(forged: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("cyclekit.dataset.files.memory_limit_bytes", lambda: 1_000_000_000)
    dataset = Dataset.open(forged)
    assert 10 < dataset.samples([dataset.executions["execution"][1]]).height < 10_000


def test_long_texts_are_measured_as_they_unpack(tmp_path: Path, monkeypatch):
    dataset = fabricate_dataset(tmp_path / "dataset", 2, rounds=1)
    for file in (dataset.path / "samples").iterdir():
        rows = pl.read_parquet(file).with_columns(
            robot_task=pl.format("{}{}", pl.int_range(pl.len()), pl.lit("x" * 30_000))
        )
        rows.write_parquet(file, compression="uncompressed")
    monkeypatch.setattr("cyclekit.dataset.files.memory_limit_bytes", lambda: 10_000_000)
    with pytest.raises(DatasetError, match=r"GB of memory, and this process may take 0\.0 GB"):
        dataset.samples()


@pytest.mark.parametrize(
    "read",
    [
        lambda d, name: d.recorded(name, "robot"),
        lambda d, name: d.recorded_between(name, "robot", 0.0, 1.0),
        lambda d, name: list(d.times(name, "robot")),
        lambda d, name: d.native_robot(d.executions["execution"][0]),
    ],
)
def test_a_recording_with_more_rows_than_the_card_says_is_refused(tmp_path: Path, read):
    dataset = fabricate_dataset(tmp_path / "dataset", 2, rounds=1)
    record = dataset.recordings[0].id
    file = dataset.path / "recordings" / record / "robot.parquet"
    rows = pl.read_parquet(file)
    pl.concat([rows, rows]).write_parquet(file)
    with pytest.raises(
        DatasetError, match=rf"holds {count(2 * rows.height)} rows, but dataset\.json states {count(rows.height)}"
    ):
        read(dataset, record)


def test_the_least_of_the_limits_counts(monkeypatch: pytest.MonkeyPatch):
    for name, most in {"_machine": 8_000, "_container": None, "_process": 3_000}.items():
        monkeypatch.setattr(memory, name, lambda most=most: most)
    assert memory.memory_limit_bytes() == 3_000


def test_a_limit_of_a_container_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "max").write_text("max\n")
    (tmp_path / "some").write_text("1073741824\n")
    monkeypatch.setattr(memory, "_CGROUPS", (str(tmp_path / "none"), str(tmp_path / "max"), str(tmp_path / "some")))
    assert memory._container() == 1 << 30


def test_the_cache_of_digests_is_limited(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(checksums, "_MAX_KNOWN", 3)
    monkeypatch.setattr(checksums, "_known", {})
    for number in range(5):
        file = tmp_path / str(number)
        file.write_bytes(bytes(number))
        os.utime(file, (1.0, 1.0))  # a digest of a file written just now is not cached
    first = checksums.file_cards(tmp_path)
    assert 0 < len(checksums._known) <= 3
    assert checksums.file_cards(tmp_path) == first
