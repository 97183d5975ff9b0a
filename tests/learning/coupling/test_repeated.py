"""A button that is pressed twice releases once; parts that come close together by chance, and double signals, stay."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.coupling.events.repeated import without_repeats

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells

    from cyclekit.dataset.cards import CouplingCard

BIT = 1
"""Digital input of the robot that the operator presses at the fixture."""


def kept(*sessions: np.ndarray) -> list[list[float]]:
    found = without_repeats({str(n): {("press", "set"): at} for n, at in enumerate(sessions)})
    return [found[str(n)]["press", "set"].tolist() for n in range(len(sessions))]


def test_a_second_press_within_seconds_is_left_out_in_every_log() -> None:
    regular = np.arange(20) * 30.0
    assert kept(np.sort(np.append(regular, [31.0, 60.8, 301.2])), np.array([5.0, 6.1])) == [regular.tolist(), [5.0]]


def test_parts_that_come_at_all_intervals_all_count() -> None:
    parts = np.cumsum(np.random.default_rng(1).exponential(8.0, 200))
    assert kept(parts) == [parts.tolist()]


def test_a_signal_that_always_comes_twice_means_it_so() -> None:
    twice = np.sort(np.concatenate([np.arange(20) * 30.0, np.arange(20) * 30.0 + 1.0]))
    assert kept(twice) == [twice.tolist()]


def test_few_changes_show_no_repetition() -> None:
    assert kept(np.array([0.0, 30.0, 31.0, 60.0])) == [[0.0, 30.0, 31.0, 60.0]]


def pressed_twice(log: Path, rng: np.random.Generator) -> int:
    """Let one in five presses of an input of a robot's log be repeated; return how many."""
    rows = pl.read_csv(log, separator=" ")
    name, t_s = "actual_digital_input_bits", rows["timestamp"].to_numpy()
    bits, count = rows[name].to_numpy().copy(), 0
    on = (bits >> BIT) & 1
    for row in np.flatnonzero(np.diff(on) < 0) + 1:
        if rng.random() < 0.2:
            again = (t_s >= t_s[row] + 0.4) & (t_s < t_s[row] + 0.7)
            bits[again] |= 1 << BIT
            count += 1
    rows.with_columns(pl.Series(name, bits)).write_csv(log, separator=" ")
    return count


def conditions(folder: Path) -> list[tuple[str, str, int]]:
    """Return what the robot waits for, and before which place."""
    ingest([folder], folder.with_name("dataset"))
    card: CouplingCard | None = Dataset.open(folder.with_name("dataset")).card.coupling
    assert card is not None
    (source,) = card.sources
    assert [one.event for one in source.after] == ["leaves"]  # the operator comes when the robot has gone
    assert source.gap_s[-1] < 1.0
    return [(gate.place, one.place, one.back) for gate in card.gates for one in gate.conditions]


def test_a_robot_that_waits_for_a_button_goes_on_at_its_first_press(cells: Cells, tmp_path: Path) -> None:
    logs = cells.logs("shared-fixture", 16, seed=31, people="none")
    shutil.copytree(logs, tmp_path / "logs", ignore=shutil.ignore_patterns("truth"))
    rng = np.random.default_rng(3)
    assert sum(pressed_twice(log, rng) for log in (tmp_path / "logs").rglob("robot.csv")) > 5
    ((place, signal, back),) = conditions(tmp_path / "logs")
    assert (signal, back) == (f"digital-input {BIT}", 1)
    assert place
