"""The rate of a log: the usual step, the mean rate and the samples lost, whoever shares the table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.cli.facts import page
from cyclekit.config import Cell, Source
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.rates import Rates
from cyclekit.ingest.ingest import ingest
from cyclekit.inspect.describe import describe

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.dataset.rates import Rate

TABLE = {"time": "t", "x": "x", "y": "y", "z": "z"}
MAP = '[[sources]]\npath = "log.csv"\nadapter = "csv"\nrole = "{role}"\n[sources.map]\n'


def rate_of(t_s: np.ndarray | list[float], person: list[str] | None = None, part: int = 1000) -> Rate | None:
    frame = pl.DataFrame({"t_s": np.asarray(t_s, float)} | ({} if person is None else {"person": person}))
    rates = Rates()
    for rows in frame.iter_slices(part):
        rates.add(rows)
    return rates.found()


def logged(folder: Path, role: str, columns: dict[str, object]) -> Path:
    pl.DataFrame({**columns, "x": 0.5, "y": 0.1, "z": 0.9}).write_csv(folder / "log.csv")
    keys = "".join(f'{key} = "{name}"\n' for key, name in TABLE.items())
    person = 'person = "who"\n' if "who" in columns else ""
    (folder / "cell.toml").write_text(MAP.format(role=role) + keys + person, encoding="utf-8")
    return folder


def test_several_people_in_one_table_are_sampled_at_the_rate_of_each(tmp_path: Path):
    frames, people = np.arange(50) / 25, 40
    t = np.round((frames[:, None] + 0.0005 * np.arange(people)[None]).ravel(), 6)  # each body has a stamp of its own
    folder = logged(tmp_path, "people", {"t": t, "who": [str(i) for i in range(people)] * 50})
    (log,) = describe(folder).logs
    facts = log.tables["people"]
    assert facts.rate_hz == pytest.approx(25, rel=1e-6)
    assert facts.step_s == pytest.approx(0.04)
    source = Source("log.csv", "csv", "people", map={**TABLE, "person": "who"})
    made = ingest([folder / "log.csv"], tmp_path / "out", cell=Cell(sources=(source,)))
    assert Dataset.open(made.dataset).recordings[0].rate_hz == 25.0


def test_alternating_steps_are_a_mean_rate_and_lost_samples_not_the_rate_of_the_shorter_step(tmp_path: Path):
    t = np.concatenate([[0.0], np.cumsum(np.tile([0.0082, 0.0245], 200))])
    text = page(describe(logged(tmp_path, "robot", {"t": np.round(t, 6)})))
    assert "401 rows, 61.16 Hz, 6.5 s" in text
    assert "steps: 8.2 ms (median), 400 samples lost (50 %)" in text


def test_an_even_log_needs_no_more_than_its_rate(tmp_path: Path):
    text = page(describe(logged(tmp_path, "robot", {"t": np.arange(100) / 125})))
    assert "100 rows, 125 Hz, 0.8 s" in text
    assert "steps" not in text


def test_stamps_a_nanosecond_apart_are_of_one_instant():
    t = np.repeat(np.arange(100) / 10, 2) + np.tile([0.0, 1e-9], 100)
    rate = rate_of(t)
    assert rate is not None
    assert rate.mean_hz == pytest.approx(10, rel=1e-6)


def test_ids_that_a_tracker_gives_anew_with_every_frame_do_not_hide_its_rate():
    rate = rate_of(np.repeat(np.arange(100) / 30, 2), [str(i) for i in range(200)])
    assert rate is not None
    assert rate.mean_hz == pytest.approx(30)


def test_steps_of_any_length_do_not_tell_what_was_lost():
    rate = rate_of(np.cumsum(np.random.default_rng(1).exponential(0.05, 500)))
    assert rate is not None
    assert rate.lost is None


def test_events_have_no_rate(tmp_path: Path):
    (tmp_path / "buttons.csv").write_text("time_s,signal,value\n1.0,goal,a\n1.000000001,goal,b\n2.0,goal,a\n")
    found = describe(tmp_path)
    assert found.logs[0].tables["events"].rate_hz is None
    assert "Hz" not in page(found)


@given(st.sets(st.integers(20, 78), max_size=20), st.integers(1, 4), st.integers(80, 400))
def test_lost_samples_are_counted_wherever_the_log_was_cut(lost: set[int], people: int, part: int):
    kept = [row for row in range(80) if row not in lost]
    rate = rate_of(np.repeat(np.array(kept) / 100, people), [str(i) for i in range(people)] * len(kept), part)
    assert rate is not None
    assert rate.step_s == pytest.approx(0.01)
    assert rate.lost == people * len(lost)
    assert rate.mean_hz == pytest.approx(100 * (len(kept) - 1) / 79)
