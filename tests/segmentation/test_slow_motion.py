"""Slow motion is motion and standing is standing, told from the noise and the quantum of the log itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from examples import at_most
from hypothesis import example, given
from hypothesis import strategies as st
from tcp_speed import tcp_speed

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.segmentation.motion import RobotRun
from cyclekit.segmentation.standstills import find_standstills

if TYPE_CHECKING:
    from pathlib import Path

STAND_S = 2.5


def run_of(xyz_m: np.ndarray, rate_hz: float) -> RobotRun:
    t_s = np.arange(len(xyz_m)) / rate_hz
    return RobotRun(t_s, xyz_m, tcp_speed(t_s, xyz_m), np.full(len(t_s), np.nan))


def there(t_s: np.ndarray, speed_m_s: float, way_s: float) -> np.ndarray:
    """Position on a line in x: it stands, goes for `way_s`, and stands."""
    x = speed_m_s * np.clip(t_s - STAND_S, 0.0, way_s)
    return np.column_stack([0.4 + 0.8 * x, 0.1 + 0.6 * x, np.full(len(t_s), 0.3)])


@at_most(60)
@given(
    speed_m_s=st.floats(5e-4, 5e-2),
    quantum_m=st.sampled_from([0.0, 1e-6, 1e-5, 5e-5, 1e-4]),
    rate_hz=st.sampled_from([10.0, 30.0, 83.3, 125.0, 500.0]),
    noise_m=st.sampled_from([0.0, 2e-6, 1e-5, 2e-5]),
    seed=st.integers(0, 1000),
)
@example(3.4e-3, 1e-4, 83.3, 0.0, 0)
@example(5e-4, 1e-4, 83.3, 0.0, 0)
@example(2.9e-3, 0.0, 125.0, 0.0, 0)
def test_a_robot_that_goes_slowly_between_two_stands_stands_twice(
    speed_m_s: float, quantum_m: float, rate_hz: float, noise_m: float, seed: int
):
    way_s = 6.0
    t_s = np.arange(int((2 * STAND_S + way_s) * rate_hz)) / rate_hz
    xyz = there(t_s, speed_m_s, way_s) + noise_m * np.random.default_rng(seed).standard_normal((len(t_s), 3))
    if quantum_m:
        xyz = np.round(xyz / quantum_m) * quantum_m
    stops = find_standstills(run_of(xyz, rate_hz), 0)
    spans = [(t_s[stop.first], t_s[stop.last]) for stop in stops if stop.last > stop.first]
    slack_s = 0.15 + 2.0 / rate_hz + 8 * (noise_m + quantum_m) / speed_m_s
    before, after = [(a, b) for a, b in spans if a < STAND_S], [(a, b) for a, b in spans if a >= STAND_S]
    assert before[-1][1] < STAND_S + slack_s
    assert after[0][0] > STAND_S + way_s - slack_s
    if not (noise_m and quantum_m):  # noise that now and then reaches the next value may cut or divide a stand
        assert spans == [
            pytest.approx((0.0, STAND_S), abs=slack_s),
            pytest.approx((STAND_S + way_s, t_s[-1]), abs=slack_s),
        ]


def test_a_robot_that_settles_or_drifts_stands_all_the_while():
    t_s = np.arange(0, 60, 0.008)
    settling = 1e-4 * np.exp(-t_s) + 2e-6 * t_s
    stops = find_standstills(run_of(np.column_stack([settling, 0 * t_s, 0 * t_s]), 125.0), 0)
    assert [(stop.first, stop.last) for stop in stops] == [(0, len(t_s) - 1)]


def test_the_way_of_a_gluing_robot_is_a_task(tmp_path: Path):
    """3.4 mm/s at 12 ms with positions to a tenth of a millimetre: half of the rows repeat the one before."""
    t_s = np.arange(0, 36, 0.012)
    x = 0.5 + 0.0034 * np.clip(t_s - 5, 0, 26)
    y = np.clip(0.5 * (t_s - 2), 0, 0.4) - np.clip(0.5 * (t_s - 33), 0, 0.4)  # fast: to the seam, and away from it
    pose = (x, y, *(0 * t_s for _ in range(4)))
    columns = {"timestamp": t_s} | {f"actual_TCP_pose_{i}": np.round(axis, 4) for i, axis in enumerate(pose)}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv", separator=" ", float_precision=6)
    dataset = Dataset.open(ingest([tmp_path / "log.csv"], tmp_path / "dataset").dataset)
    ways = dataset.tasks().select(pl.col("end_s") - pl.col("start_s") - pl.col("dwell_s") - pl.col("wait_s"))
    assert ways.to_series().to_list() == pytest.approx([0.8, 26.0, 0.8], abs=0.3)
