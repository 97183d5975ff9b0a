"""From logs to an answer by commands alone, on one small simulated cell."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from stated_clocks import clocks

from cyclekit.dataset.dataset import Dataset

if TYPE_CHECKING:
    from .conftest import Shell


@pytest.mark.slow  # of the simulator alone
def test_the_same_simulation_twice_gives_the_same_bytes(cyclekit: Shell, tmp_path: Path) -> None:
    for name in ("a", "b"):
        done = cyclekit("simulate", "box-picking", "--out", tmp_path / name, "--executions", "1", "--seed", "7")
        assert done.code == 0
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert files
    assert all((tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes() for file in files)


def test_ingest_says_what_it_made_and_the_second_time_that_nothing_changed(
    cyclekit: Shell, logs: Path, tmp_path: Path
) -> None:
    first = cyclekit("ingest", logs, "--out", tmp_path / "d", "--json")
    assert (first.code, first.document["executions"], first.document["unchanged"]) == (0, 6, False)
    again = cyclekit("ingest", logs, "--out", tmp_path / "d")
    assert again.code == 0
    assert "up to date" in again.out


def test_inspect_of_a_folder_of_logs_tells_adapter_rate_and_gaps(cyclekit: Shell, logs: Path) -> None:
    shown = cyclekit("inspect", logs, "--json").document
    robot = next(entry for entry in shown["logs"] if "robot" in entry["tables"])
    assert robot["adapter"] == "ur-rtde"
    assert robot["tables"]["robot"]["rate_hz"] == pytest.approx(125, rel=0.01)
    assert robot["levels"] == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0], abs=0.01)
    assert len(robot["tables"]["robot"]["gaps"]) == 5  # six executions, the logger paused between them


def test_inspect_of_a_dataset_tells_executions_places_and_levels_in_80_columns(cyclekit: Shell, dataset: Path) -> None:
    shown = cyclekit("inspect", dataset)
    assert "executions  6" in shown.out
    assert "conveyor->left_1" in shown.out
    assert max(map(len, shown.out.replace(str(dataset), "").splitlines())) <= 80
    document = cyclekit("inspect", dataset, "--json").document
    assert document["places"]["conveyor"]["inferred"] is False
    assert sum(document["level_share"]) == pytest.approx(1, abs=0.01)
    (heads,) = [line for line in shown.out.splitlines() if line.startswith("scaling level")]
    assert heads.split("  ")[1:] == ["of those on a level", "of all samples"]
    samples = Dataset.open(dataset).samples(columns=["step"])["step"]
    full = document["levels"].index(1.0)
    assert document["on_level"] * document["level_share"][full] == pytest.approx((samples == full).sum() / len(samples))


def test_the_cell_file_that_inspect_prints_gives_the_same_dataset(
    cyclekit: Shell, logs: Path, dataset: Path, tmp_path: Path
) -> None:
    printed = cyclekit("inspect", logs, "--write-cell")
    (tmp_path / "cell.toml").write_text(printed.out, encoding="utf-8")
    done = cyclekit("ingest", logs, "--out", tmp_path / "d", "--cell", tmp_path / "cell.toml")
    assert done.code == 0, done.err
    ours, theirs = (cyclekit("inspect", path, "--json").document for path in (tmp_path / "d", dataset))
    assert {**ours, "path": ""} == {**theirs, "path": ""}


def test_estimates_are_ranked_and_their_parts_add_up(
    cyclekit: Shell, dataset: Path, model: Path, sequences: Path, tmp_path: Path
) -> None:
    out = tmp_path / "new" / "estimates.json"
    words = ["estimate", model, sequences, "--dataset", dataset, "--extrapolate"]
    done = cyclekit(*words, "--out", out, "--json")
    assert done.code == 0, done.err
    found = done.document["sequences"]
    assert [entry["name"] for entry in found] == ["one way", "two boxes"]
    for entry in found:
        parts = sum(entry[name] for name in ("nominal_s", "safety_loss_s", "dwell_s", "wait_s"))
        assert parts == pytest.approx(entry["expected_s"], rel=1e-6)
        assert set(entry["quantiles_s"]) == {"0.05", "0.5", "0.95"}
    assert json.loads(out.read_text(encoding="utf-8")) == done.document
    assert cyclekit(*words, "--out", tmp_path / "x.csv").code == 0
    with (tmp_path / "x.csv").open(encoding="utf-8", newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert [float(row["expected_s"]) for row in rows] == [entry["expected_s"] for entry in found]


def test_the_estimate_s_table_is_readable_in_80_columns(
    cyclekit: Shell, dataset: Path, model: Path, sequences: Path
) -> None:
    shown = cyclekit("estimate", model, sequences, "--dataset", dataset, "--extrapolate")
    assert shown.code == 0
    assert max(map(len, shown.out.splitlines())) <= 80
    assert "one way " in shown.out
    assert "90 % of cycles" in shown.out


def test_a_replay_of_an_execution_is_written_where_it_was_asked_for(
    cyclekit: Shell, dataset: Path, model: Path, tmp_path: Path
) -> None:
    out = tmp_path / "new" / "x.rrd"
    done = cyclekit("replay", dataset, "--execution", "2", "--out", out, "--model", model, "--json")
    assert done.code == 0, done.err
    assert out.read_bytes()[:4] == b"RRF2"
    assert done.document["execution"].endswith("2")


def test_an_execution_that_is_not_there_is_named_with_those_that_are(
    cyclekit: Shell, dataset: Path, tmp_path: Path
) -> None:
    failed = cyclekit("replay", dataset, "--execution", "99", "--out", tmp_path / "x.rrd")
    assert failed.code == 1
    assert "from 1 to 6" in failed.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow  # a kill; quick: test_failing_writes
@pytest.mark.skipif(os.name == "nt", reason="kills with SIGKILL")
def test_a_killed_ingest_leaves_the_old_dataset_whole(cyclekit: Shell, logs: Path, tmp_path: Path) -> None:
    target = tmp_path / "dataset"
    assert cyclekit("ingest", logs / "session_000" / "robot.csv", "--out", target, "--quiet").code == 0
    before = cyclekit("inspect", target, "--json").document
    words = ["ingest", str(logs), "--out", str(target), "--quiet"]
    started = subprocess.Popen([sys.executable, "-c", f"from cyclekit.cli import main; main({words!r})"])
    limit_s = time.monotonic() + 120
    while not list(tmp_path.glob(".dataset.new-*")) and started.poll() is None and time.monotonic() < limit_s:
        time.sleep(0.005)
    started.send_signal(signal.SIGKILL)
    started.wait(timeout=120)
    after = cyclekit("inspect", target, "--json").document
    with clocks():  # as the killed process does
        assert cyclekit(*words).code == 0
    assert after in (before, cyclekit("inspect", target, "--json").document)
    assert [path.name for path in tmp_path.iterdir()] == ["dataset"]
