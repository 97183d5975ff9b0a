"""One clock and one base frame: a tracker that is turned, in millimetres or y-up still gives the true positions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from cyclekit.alignment.clocks import ClockStart, fit_clock
from cyclekit.alignment.frames import to_base
from cyclekit.config import Frame, Source
from cyclekit.dataset.cards import texts
from cyclekit.errors import ShapeError

if TYPE_CHECKING:
    from simulated_cells import Cells, SimulatedCell

pytestmark = pytest.mark.tests_clocks

HUMAN = ["human_x_m", "human_y_m", "human_z_m"]
YAW_90 = Frame((1.0, 2.0, -0.8), ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))


def distance_to_truth_m(cell: SimulatedCell) -> np.ndarray:
    """Distance between x_h of the samples and where the operator really was at that instant (interpolated)."""
    first = cell.executions["start_s"][0]
    t, truth = (cell.samples["t_s"] - first).to_numpy(), cell.samples.select(HUMAN).to_numpy()
    found = cell.dataset.samples().filter(pl.col("human_x_m").is_not_null())
    at = np.column_stack([np.interp(found["t_s"].to_numpy(), t, truth[:, k]) for k in range(3)])
    return np.linalg.norm(found.select(HUMAN).to_numpy() - at, axis=1)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"millimetres": True, "tracker_yaw_deg": -130.0, "tracker_xyz_m": (-2.0, 3.0, -0.5)},
        {"tracker_rate_hz": 100, "tracker_yaw_deg": 0.0, "tracker_xyz_m": (0.0, 0.0, 0.0)},
    ],
)
def test_a_turned_tracker_in_its_own_units_gives_the_true_positions(cells: Cells, options: dict[str, Any]):
    apart = distance_to_truth_m(cells("laser-zones", 2, **options))
    assert np.quantile(apart, 0.99) < 0.01  # one control cycle of walking, and the roundness of the truth's grid
    assert apart.max() < 0.05


def test_a_clock_offset_that_the_cell_file_does_not_tell_shows_as_late_positions(cells: Cells):
    late = distance_to_truth_m(cells("laser-zones", 2, clock_offset_s=0.5))
    assert 0.2 < np.quantile(late, 0.9) < 0.7  # half a second at walking speed


def test_noise_of_the_tracker_is_that_of_the_mean_of_the_six_frames_of_a_sample(cells: Cells):
    apart = distance_to_truth_m(cells("laser-zones", 2, delta_m=0.05))
    assert np.sqrt(np.mean(apart**2)) == pytest.approx(0.05 * np.sqrt(3) / np.sqrt(6), rel=0.1)


def test_a_frame_turned_by_90_degrees_turns_points_and_then_moves_them():
    assert_allclose(to_base(np.array([[1.0, 0.0, 0.5]]), YAW_90), [[1.0, 3.0, -0.3]], atol=1e-12)


def test_a_y_up_tracker_is_stood_up_before_it_is_placed():
    assert_allclose(to_base(np.array([[1.0, 2.0, 3.0]]), None, up="y"), [[1.0, -3.0, 2.0]])
    assert_allclose(to_base(np.array([[1.0, 0.5, 0.0]]), YAW_90, up="y"), [[1.0, 3.0, -0.3]], atol=1e-12)


@given(arrays(float, st.tuples(st.integers(0, 6), st.just(3)), elements=st.floats(-50, 50)), st.sampled_from("yz"))
def test_no_frame_changes_the_distance_between_two_points(points: np.ndarray, up: Any):
    before, after = points.copy(), to_base(points, YAW_90, up=up)
    assert (points == before).all()
    apart = [np.linalg.norm(np.diff(some, axis=0), axis=1) for some in (points, after)]
    assert_allclose(apart[1], apart[0], atol=1e-9)


def test_a_position_nobody_saw_stays_unknown():
    assert np.isnan(to_base(np.full((1, 3), np.nan), YAW_90)).all()


def test_points_that_are_not_three_wide_are_refused():
    with pytest.raises(ShapeError, match=r"must be \(N, 3\)"):
        to_base(np.zeros((4, 2)), None)


EPOCH, ROBOT = ClockStart("epoch", 1.75e9), ClockStart("uptime", 152.5)


def session_time(fit: Any, t_log: float) -> float:
    return fit.rate * t_log + fit.offset_s


def test_an_offset_of_the_cell_file_maps_onto_the_time_since_the_robot_log_began():
    fit = fit_clock(ClockStart("relative", 0.0), ROBOT, Source("t.csv", clock_offset_s=147.5, clock_rate=1.0001))
    assert (fit.method, fit.warnings) == ("cell-file", ())
    assert session_time(fit, 5.0) == pytest.approx(5.0005 + 147.5 - 152.5)


def test_two_clocks_that_count_since_1970_need_nothing_else():
    fit = fit_clock(ClockStart("epoch", 1.75e9 - 3), EPOCH, None)
    assert (fit.method, fit.warnings) == ("epoch", ())
    assert session_time(fit, 1.75e9 + 2) == pytest.approx(2.0)


def test_tables_of_one_log_share_its_clock():
    assert session_time(fit_clock(ROBOT, ROBOT, Source("r.csv", clock_offset_s=9.0), same_log=True), 152.5) == 0.0


@pytest.mark.parametrize("log", [ClockStart("relative", 3.0), ClockStart("uptime", 3.0), ClockStart("epoch", 3.0)])
def test_clocks_that_nothing_relates_are_taken_to_start_together_and_that_is_said(log: ClockStart):
    fit = fit_clock(log, ROBOT, Source("t.csv"))
    assert fit.method == "assumed-common-start"
    assert session_time(fit, 3.0) == 0.0
    assert "clock_offset_s" in "; ".join(texts(fit.warnings))
