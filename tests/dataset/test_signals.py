"""Changes of a robot's outputs and register, read part by part, are those of the whole log."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st
from log_cards import log_card

from cyclekit.alignment.recording_clocks import FINE_S, _thinned
from cyclekit.dataset.signals import event_times
from cyclekit.schema import ROBOT, conform
from cyclekit.storage import parquet as tables
from cyclekit.storage.parquet import StoredTable, TableWriter

if TYPE_CHECKING:
    from pathlib import Path

ENTRY = log_card("r", "robot")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("robot") / "robot.parquet"


def stored(file: Path, group_rows: int, **columns: list[float | None]) -> None:
    known = {"t_s": pl.Series(columns["t_s"], dtype=pl.Float64)}
    known |= {name: pl.Series(values, dtype=ROBOT[name].dtype) for name, values in columns.items() if name != "t_s"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "GROUP_ROWS", group_rows)
        tables._decoded.clear()
        with TableWriter(file, ROBOT) as writer:
            writer.write(conform(pl.DataFrame(known), ROBOT))


def changes(file: Path, signal: str) -> list[float]:
    times = event_times(ENTRY, signal, lambda name, table: None, lambda name, columns: StoredTable(file, columns))
    return [float(time) for time in times]


def by_hand(times: list[float], values: list[int | None]) -> list[float]:
    """Row by row: in the middle between the rows of a change, the later one where rows are missing."""
    known = [(t, v) for t, v in zip(times, values, strict=True) if v is not None]
    both = {v for _, v in known} <= {0, 1}
    found = []
    for (before, a), (at, b) in itertools.pairwise(known):
        if a != b and (b == 1 or not both):
            found.append(at - (at - before) / 2 if at - before <= 0.1 else at)
    return found


@at_most(60)
@given(st.lists(st.tuples(st.sampled_from([0.008, 0.5]), st.sampled_from([0, 1, 4, 5, None])), min_size=1, max_size=24),
       st.integers(1, 9))  # fmt: skip
def test_changes_do_not_depend_on_the_parts_of_the_table(file: Path, rows, group_rows: int):
    times = np.cumsum([step for step, _ in rows]).tolist()
    values = [value for _, value in rows]
    stored(file, group_rows, t_s=times, register=values, digital_out_bits=values)
    assert changes(file, "register") == pytest.approx(by_hand(times, values))
    bits = [None if value is None else value >> 2 & 1 for value in values]
    assert changes(file, "digital-output 2") == pytest.approx(by_hand(times, bits))


def test_rows_for_a_clock_are_a_hundredth_of_a_second_apart_whatever_the_controller_logs(file: Path):
    times = np.concatenate([np.arange(0, 2, 0.002), np.arange(2, 4, 0.008), np.arange(4, 60, 0.04)])
    stored(file, 250, t_s=times.tolist(), tcp_x_m=times.tolist())
    t_s, xyz = _thinned(StoredTable(file, ["t_s", "tcp_x_m"]))
    assert t_s[0] == 0.0
    assert np.array_equal(t_s, xyz[:, 0])
    assert len(t_s) == len(times) - 800  # of the first thousand rows every fifth
    steps = np.diff(t_s[t_s < 4.0])
    assert (np.median(steps), steps.max()) == pytest.approx((FINE_S, FINE_S), abs=3e-3)
    assert np.diff(t_s[t_s > 4.1]) == pytest.approx(0.04)
