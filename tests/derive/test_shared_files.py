"""Many short sessions share a file of samples, and nothing but the files shows it."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ingested import only_bytes
from polars.testing import assert_frame_equal

from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.dataset.sessions import Session
from cyclekit.derive import sample_file
from cyclekit.derive.sample_file import MAX_SESSIONS, SHORT, shared_files
from cyclekit.ingest.ingest import ingest
from cyclekit.parallel.engine import Engine

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells, SimulatedCell


@pytest.fixture
def sharing_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let any two sessions share a file."""
    monkeypatch.setattr(sample_file, "FEW_SESSIONS", 1)
    monkeypatch.setattr(sample_file, "SHORT", 1 << 20)


@pytest.fixture
def visits(cells: Cells) -> SimulatedCell:
    """A cell of short sessions whose tracker is silent while nobody is there."""
    return cells("scanner-visits", 3, executions_per_session=1, silent_when_empty=True)


def test_sessions_that_share_a_file_have_the_samples_they_have_alone(
    visits: SimulatedCell, tmp_path: Path, sharing_all: None
):
    ingest([visits.logs], tmp_path / "shared")
    alone, shared = visits.dataset, Dataset.open(tmp_path / "shared")
    assert [len(list((one.path / "samples").iterdir())) for one in (alone, shared)] == [3, 1]
    assert_frame_equal(shared.samples(), alone.samples(), check_exact=True)
    assert_frame_equal(shared.tasks(), alone.tasks(), check_exact=True)
    cards = [json.loads((one.path / CARD).read_text(encoding="utf-8")) for one in (alone, shared)]
    parts = [entry.pop("part", None) for card in cards for entry in card["executions"]]
    assert parts == [None, None, None, None, "session_000", "session_000"]
    for name in ("executions", "recordings", "levels", "dynamics", "human_places", "places", "warnings", "rows"):
        assert cards[0][name] == cards[1][name], name


def test_of_a_shared_file_only_the_executions_asked_for_are_returned(
    visits: SimulatedCell, tmp_path: Path, sharing_all: None
):
    ingest([visits.logs], tmp_path / "shared")
    alone, shared = visits.dataset, Dataset.open(tmp_path / "shared")
    for name in shared.executions["execution"]:
        assert_frame_equal(shared.samples([name]), alone.samples([name]), check_exact=True)
        assert_frame_equal(shared.only([name]).samples(), alone.samples([name]), check_exact=True)
    assert shared.verify() == alone.verify() - 2


@pytest.mark.slow  # quick: two jobs in test_ingest
def test_workers_make_the_same_files(visits: SimulatedCell, tmp_path: Path, sharing_all: None):
    logs = tmp_path / "logs"
    for number in range(3):
        shutil.copytree(visits.logs / f"session_{number:03}", logs / f"session_{number:03}")
    ingest([logs], tmp_path / "here")
    ingest([logs], tmp_path / "workers", engine=Engine(jobs=2))
    assert only_bytes(tmp_path / "here") == only_bytes(tmp_path / "workers")


_SPANS = st.lists(st.one_of(st.floats(0.0, 300.0), st.floats(0.0, 1e6)), min_size=51, max_size=450)


@given(_SPANS, st.randoms(use_true_random=False))
def test_every_session_is_in_one_file_and_files_are_short(spans: list[float], chance: object):
    names = [f"s{number}-{'x' * (number % 3)}" for number in range(len(spans))]
    chance.shuffle(names)
    sessions = [Session(name, (), span_s=(0.0, span)) for name, span in zip(names, spans, strict=True)]
    files = shared_files(sessions, 10.0)
    inside = [number for numbers in files for number in numbers]
    assert [names[number] for number in inside] == sorted(names, key=lambda name: f"{name}.parquet")
    for numbers in files:
        assert len(numbers) <= MAX_SESSIONS
        counts = [10.0 * spans[number] + 1 for number in numbers]
        assert len(numbers) == 1 or (max(counts) <= SHORT and sum(counts) <= 8 * SHORT)


def test_few_sessions_have_files_of_their_own():
    sessions = [Session(f"s{number}", (), span_s=(0.0, 1.0)) for number in range(sample_file.FEW_SESSIONS)]
    assert {len(numbers) for numbers in shared_files(sessions, 10.0)} == {1}
