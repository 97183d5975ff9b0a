"""A log read window by window is the log: whatever its size, its rows, times and speeds are the same."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st
from tcp_speed import tcp_speed

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.schema import ROBOT, conform
from cyclekit.segmentation import stored_run
from cyclekit.segmentation.motion import COLUMNS, NEVER_FULL, STANDING, InferredScaling, RobotRun, median
from cyclekit.segmentation.stored_run import pieces, runs_of, sampled
from cyclekit.storage import parquet as tables
from cyclekit.storage import parquet_layout as table_layout
from cyclekit.storage.parquet import StoredTable, TableWriter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from simulated_cells import Cells


def stored(folder: Path, frame: pl.DataFrame) -> StoredTable:
    with TableWriter(folder / "robot.parquet", ROBOT) as table:
        for begin in range(0, max(frame.height, 1), 37):
            table.write(frame[begin : begin + 37])
    return StoredTable(folder / "robot.parquet", COLUMNS)


def robot(t_s: np.ndarray, *, speed: bool = True) -> pl.DataFrame:
    t = np.asarray(t_s, float)
    frame = pl.DataFrame({"t_s": t, "tcp_x_m": np.sin(t), "tcp_y_m": np.cos(3 * t), "tcp_z_m": 0.1 * t})
    frame = frame.with_columns(scaling=pl.when(pl.col("t_s") > 1.0).then(pl.col("tcp_x_m").abs()))
    return conform(frame.with_columns(tcp_speed_m_s=0.2) if speed else frame, ROBOT)


def in_memory(frame: pl.DataFrame, offset_s: float) -> RobotRun:
    t_s = frame["t_s"].to_numpy() + offset_s
    xyz = frame.select("tcp_x_m", "tcp_y_m", "tcp_z_m").to_numpy()
    speed = frame["tcp_speed_m_s"]
    return RobotRun(
        t_s, xyz, tcp_speed(t_s, xyz) if speed.has_nulls() else speed.to_numpy(), frame["scaling"].to_numpy()
    )


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Row groups of 100 rows, blocks of 64; nothing is small enough to be kept as a whole."""
    monkeypatch.setattr(tables, "GROUP_ROWS", 100)
    monkeypatch.setattr(table_layout, "SMALL_BYTES", 0)
    monkeypatch.setattr(stored_run, "SHORT_ROWS", 0)
    monkeypatch.setattr(stored_run, "BLOCK_ROWS", 64)


@pytest.mark.parametrize("inferred", [True, False])
@pytest.mark.parametrize("slider", [True, False])
@pytest.mark.parametrize("speed", [True, False])
def test_a_short_run_put_together_once_has_the_windows_of_a_long_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, speed: bool, slider: bool, inferred: bool
):
    frame = robot(np.arange(120) / 125, speed=speed).with_columns(slider=pl.col("t_s"))
    table = stored(tmp_path, frame)
    more = StoredTable(tmp_path / "robot.parquet", ["slider"]) if slider else None
    (run,) = runs_of(table, -0.5, gap_s=2.0, more=more)
    if inferred:
        run = run.with_scaling([InferredScaling(10, np.full(20, 0.5), np.full(20, 0.1), np.zeros(20, np.int8))])
    spans = [(0, 119), (0, 0), (119, 119), (3, 40), (25, 26)]
    short = [run.window(*span) for span in spans]
    rows = run.row_at(np.array([-1.0, 0.0, 0.2, 9.0]))
    monkeypatch.setattr(stored_run, "SHORT_ROWS", 0)
    for span, found in zip(spans, short, strict=True):
        for name, values in vars(run.window(*span)).items():
            np.testing.assert_array_equal(getattr(found, name), values, err_msg=f"{name} of {span}")
    assert rows.tolist() == [0, 62, 87, 119]


@pytest.mark.parametrize("speed", [True, False])
def test_a_window_of_a_stored_log_is_that_part_of_it(tmp_path: Path, small: None, speed: bool):
    frame = robot(np.arange(450) / 125, speed=speed)
    (run,) = runs_of(stored(tmp_path, frame), -0.5, gap_s=2.0)
    whole = in_memory(frame, -0.5)
    assert (run.rows, run.period_s) == (450, pytest.approx(0.008))
    for first, last in [(0, 449), (0, 0), (449, 449), (95, 205), (99, 100), (300, 310)]:
        part, same = run.window(first, last), whole.window(first, last)
        for name in ("t_s", "xyz_m", "speed_m_s", "scaling"):
            np.testing.assert_allclose(getattr(part, name), getattr(same, name), atol=1e-12, err_msg=name)
    rows = [(begin, part.rows) for begin, part in pieces(run, 10, 200)]
    assert rows == [(10, 64), (74, 64), (138, 63)]
    times = np.array([-9.0, -0.5, -0.4999, 0.0, 1.2345, 3.0919, 3.092, 99.0])
    assert run.row_at(times).tolist() == whole.row_at(times).tolist()
    assert run.time_at(200) == whole.time_at(200)


def test_a_clock_that_jumps_ahead_or_back_cuts_the_log(tmp_path: Path, small: None):
    t_s = np.concatenate([np.arange(120) / 100, 9 + np.arange(110) / 100, 4 + np.arange(3) / 100])
    runs = runs_of(stored(tmp_path, robot(t_s)), 0.0, gap_s=2.0)
    assert [(run.first, run.end) for run in runs] == [(0, 120), (120, 230), (230, 233)]
    assert [run.time_at(0) for run in runs] == [0.0, 9.0, 4.0]
    assert runs[1].row_at(np.array([8.0, 9.0, 9.505, 11.0])).tolist() == [0, 0, 50, 109]
    assert [run.rows for run in runs_of(stored(tmp_path, robot(t_s)), 0.0, gap_s=np.inf)] == [230, 3]


def test_a_log_without_rows_has_no_runs(tmp_path: Path):
    assert runs_of(stored(tmp_path, robot(np.empty(0))), 0.0, gap_s=2.0) == []


def test_scaling_put_in_place_of_the_logged_one_is_unknown_elsewhere(tmp_path: Path, small: None):
    (run,) = runs_of(stored(tmp_path, robot(np.arange(300) / 125)), 0.0, gap_s=2.0)
    new = run.with_scaling([part(200, 0.5), part(90, 0.25)])
    found = new.window(85, 215)
    window = found.scaling
    assert np.flatnonzero(np.isfinite(window)).tolist() == [*range(5, 25), *range(115, 131)]
    assert set(window[np.isfinite(window)].tolist()) == {0.25, 0.5}
    assert set(found.gap[~np.isfinite(window)].tolist()) == {STANDING}  # type: ignore[index]
    np.testing.assert_allclose(found.deviation[np.isfinite(window)], 0.01)  # type: ignore[index]
    assert new.knows_scaling
    assert new.is_inferred
    assert not run.with_scaling([]).knows_scaling


def part(first: int, value: float) -> InferredScaling:
    return InferredScaling(first, np.full(20, value), np.full(20, 0.01), np.zeros(20, np.int8))


def test_a_window_is_found_among_parts_of_any_length_and_order():
    none = np.full(300, np.nan)
    long = InferredScaling(0, none, none, np.full(300, NEVER_FULL, np.int8))
    t_s = np.arange(400) / 125
    run = RobotRun(t_s, np.zeros((400, 3)), np.zeros(400), np.full(400, np.nan))
    found = run.with_scaling([part(290, 0.5), long, part(350, 0.25)])
    assert found.gap.tolist()[:5] == [NEVER_FULL] * 5  # type: ignore[union-attr]
    assert found.scaling[290:310].tolist() == [0.5] * 20
    assert found.gap[320] == STANDING  # type: ignore[index]
    assert found.scaling[355] == 0.25


@at_most(40)
@given(st.lists(st.floats(0.0, 3.5), min_size=1, max_size=30), st.integers(0, 200), st.integers(0, 80))
def test_samples_do_not_depend_on_how_a_log_is_stored(tmp_path_factory, times: list[float], hole: int, wide: int):
    frame = robot(np.delete(np.arange(450) / 125, slice(100 + hole, 100 + hole + wide)))
    folder = tmp_path_factory.mktemp("log")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "GROUP_ROWS", 100)
        patch.setattr(stored_run, "BLOCK_ROWS", 64)
        (run,) = runs_of(stored(folder, frame), 0.0, gap_s=2.0)
        found = sampled(run, np.sort(times))
    same = sampled(in_memory(frame, 0.0), np.sort(times))
    for name in ("t_s", "xyz_m", "scaling", "row"):
        np.testing.assert_allclose(getattr(found, name), getattr(same, name), atol=1e-12, err_msg=name)


@pytest.mark.slow  # quick: how a log is stored, above
@pytest.mark.parametrize("override", [True, False])
def test_a_dataset_does_not_depend_on_how_much_is_read_at_once(
    cells: Cells, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, override: bool
):
    cell = cells("pick-and-package", 2, log_override=override)
    monkeypatch.setattr(tables, "GROUP_ROWS", 3000)
    monkeypatch.setattr(stored_run, "BLOCK_ROWS", 2000)
    monkeypatch.setattr("cyclekit_adapters.text.text_blocks.BLOCK_BYTES", 1 << 18)
    in_pieces = Dataset.open(ingest([cell.logs], tmp_path / "dataset").dataset)
    assert in_pieces.tasks().equals(cell.dataset.tasks())
    assert in_pieces.samples().equals(cell.dataset.samples())
    assert in_pieces.card.places == cell.dataset.card.places


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32), min_size=1, max_size=9), st.booleans())
def test_the_median_is_numpys(values: list[float], unknown: bool):
    some = np.array([*values, np.nan] if unknown else values)
    np.testing.assert_equal(median(some), np.median(some))
    many = np.resize(some, 501)
    np.testing.assert_equal(median(many), np.median(many))


def test_pauses_of_many_runs_are_looked_through_once(tmp_path: Path) -> None:
    class States(list[tuple[int, int, str]]):
        looked = 0

        def __iter__(self) -> Iterator[tuple[int, int, str]]:
            for state in super().__iter__():
                States.looked += 1
                yield state

    t_s = np.arange(800) * 0.1 + 10.0 * (np.arange(800) // 10)
    pauses = States((10 * run + 8, 10 * run + 11, "paused") for run in range(79))  # over the gap, into the next run
    runs = runs_of(stored(tmp_path, robot(t_s)), 0.0, gap_s=2.0, states=pauses)
    assert States.looked <= 2 * len(pauses)
    assert [[(halt.first, halt.last) for halt in run.halts] for run in runs] == [
        [(8, 9)],
        *[[(0, 1), (8, 9)]] * 78,
        [(0, 1)],
    ]
