"""Steps of a controller's clock: a restart is counted, a single garbled time is none, wherever the blocks were cut."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats.ur_rtde import ADAPTER
from cyclekit_adapters.robots.controller_time import ClockRestarts


def steps_back(times: list[float], cuts: list[int] | None = None) -> int:
    repeats, edges = ClockRestarts("t"), [0, *sorted(cuts or []), len(times)]
    for begin, end in pairwise(edges):
        frame = pl.DataFrame({"t": times[begin:end], "source_row": range(begin, end)}, schema_overrides={"t": float})
        repeats.add(frame)
    assert bool(repeats.back) == any("steps back" in text for text in repeats.warnings())
    return repeats.back


@pytest.mark.parametrize(
    ("times", "restarts"),
    [
        ([1, 2, 3, 4, 5], 0),
        ([1, 2, 3, 0, 1, 2], 1),
        ([1, 2, 3, 0, 1, 0, 1], 2),
        ([1, 2, 0.5, 4, 5], 0),  # one row too low
        ([1, 2, 9, 3, 4], 0),  # one row too high
        ([1, 2, 3, 0], 1),  # the last row: nothing says that it does not fit
        ([5, 0, 1], 1),
        ([3, 3, 3, 0, 0, 1], 1),  # repeats are no steps
    ],
)
def test_a_restart_is_counted_and_a_single_time_that_does_not_fit_is_none(times: list[float], restarts: int):
    assert steps_back(times) == restarts


@given(st.lists(st.sampled_from([0.0, 1.0, 2.0, 3.0, 4.0, 9.0]), max_size=14), st.lists(st.integers(0, 14), max_size=4))
def test_it_does_not_matter_where_the_blocks_were_cut(times: list[float], cuts: list[int]):
    assert steps_back(times, [min(cut, len(times)) for cut in cuts]) == steps_back(times)


def test_a_single_time_too_low_is_set_aside_and_nobody_speaks_of_a_restart(tmp_path: Path, ur: Any):
    rows = [ur.row(10.0 + 0.008 * row, actual_TCP_pose_0=0.001 * row) for row in range(40)]
    rows[20] = ur.row(3.0, actual_TCP_pose_0=0.02)
    (tmp_path / "run.csv").write_text(ur.text(rows), encoding="utf-8")
    log = examined(ADAPTER.read(tmp_path / "run.csv", ReadOptions()))
    assert log.set_aside is not None
    assert log.set_aside.rows() == [(22, "its time does not fit between its neighbours")]
    assert not [text for text in log.warnings if "restarted" in text]
