"""When a robot arrived and left, where noise hides the slow beginning of a motion and halts lie next to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cyclekit.segmentation.arrivals import PlaceStandstill, standstill_at
from cyclekit.segmentation.dwell import Dwell
from cyclekit.segmentation.executions import Visit
from cyclekit.segmentation.motion import PAUSED, ProgramStop, RobotRun

JERK, TOP_S = 20.0, 0.4  # m/s^3; then it goes on at the speed that it has
NOISE_M = 8e-6
ARRIVES, LEAVES = 3.0, 5.0


def way(nominal_s: np.ndarray) -> np.ndarray:
    """Return how far a robot is, so long after (or before) it stood."""
    t = np.minimum(nominal_s, TOP_S)
    return np.where(nominal_s > 0, JERK * t**3 / 6 + 0.5 * JERK * TOP_S**2 * np.maximum(nominal_s - TOP_S, 0.0), 0.0)


def run(scaling, *, rate: int = 125, known=lambda t: True, noise_m: float = NOISE_M) -> tuple[RobotRun, Visit]:
    """Return a robot that comes to (1, 0, 0) along y, stands from ARRIVES to LEAVES, and goes on along z."""
    t = np.arange(0.0, 14.0, 1.0 / rate)
    s = np.array([scaling(now) for now in t])
    nominal = np.concatenate([[0.0], np.cumsum(s[:-1] / rate)])
    before = np.interp(ARRIVES, t, nominal) - nominal
    after = nominal - np.interp(LEAVES, t, nominal)
    xyz = np.column_stack(
        [np.ones(len(t)), way(np.where(t < ARRIVES, before, 0.0)), way(np.where(t > LEAVES, after, 0.0))]
    )
    xyz += np.random.default_rng(5).normal(0.0, noise_m, xyz.shape)
    seen = np.flatnonzero(np.linalg.norm(xyz - [1.0, 0.0, 0.0], axis=1) < 3e-4)  # as near as a place reaches
    told = np.where([known(now) for now in t], s, np.nan)
    return RobotRun(t, xyz, np.zeros(len(t)), told), Visit("table", int(seen[0]), int(seen[-1]))


def found(*args, **options) -> PlaceStandstill:
    return standstill_at(*run(*args, **options), np.array([1.0, 0.0, 0.0]))


@pytest.mark.parametrize("rate", [125, 500])
@pytest.mark.parametrize("scaling", [1.0, 0.25, 0.1])
def test_the_slow_beginning_and_end_of_a_motion_are_followed_into_the_noise(scaling: float, rate: int):
    standstill = found(lambda _: scaling, rate=rate)
    assert not standstill.halted
    assert (standstill.arrived_s, standstill.left_s) == pytest.approx(
        (ARRIVES, LEAVES), abs=0.03 if scaling > 0.1 else 0.08
    )


def test_a_robot_halted_a_hair_after_it_left_had_left():
    standstill = found(lambda t: 0.0 if 5.16 < t < 9.0 else 0.25)
    assert standstill.left_s == pytest.approx(LEAVES, abs=0.05)
    assert standstill.departed_earliest_s == standstill.left_s


def test_a_robot_halted_a_hair_before_its_goal_arrives_after_the_halt():
    standstill = found(lambda t: 0.0 if 0.5 < t < 2.84 else 0.25)
    assert standstill.arrived_s == pytest.approx(ARRIVES, abs=0.05)


def test_a_halt_a_hair_after_it_left_is_told_without_a_logged_scaling_too():
    standstill = found(lambda t: 0.0 if 5.16 < t < 9.0 else 0.25, known=lambda t: t < 2.5 or t > 9.5)
    assert standstill.left_s == pytest.approx(LEAVES, abs=0.1)


def test_in_a_halt_it_left_at_some_time_in_it_and_if_in_doubt_after_the_usual_process():
    standstill = found(lambda t: 0.0 if 4.0 < t < 9.0 else 1.0)
    assert standstill.halted
    assert (standstill.departed_earliest_s, standstill.left_s) == pytest.approx((4.0, 9.0), abs=0.02)
    assert standstill.times(1.7) == pytest.approx((ARRIVES, ARRIVES + 1.7), abs=0.03)
    assert standstill.times(0.2) == pytest.approx((ARRIVES, 4.0), abs=0.03)
    assert standstill.times(60.0) == pytest.approx((ARRIVES, 9.0), abs=0.03)


def test_on_a_slow_ramp_to_a_halt_it_may_have_left_though_nobody_saw_it_move():
    """A wait in front of the halt would count the whole halt as wait; the process itself ended on the ramp."""
    standstill = found(lambda t: min(max(5.1 - t, 0.0), 1.0) if t < 9.0 else min(t - 9.0, 1.0))
    assert standstill.departed_earliest_s == pytest.approx(LEAVES - 0.05, abs=0.06)
    assert standstill.left_s == pytest.approx(9.0, abs=0.02)
    process = Dwell(usual_s=LEAVES - ARRIVES, max_s=LEAVES - ARRIVES + 0.05)
    assert process.excess_from_s(standstill._replace(left_s=standstill.departed_earliest_s)) is None
    assert standstill.times(process.usual_s) == pytest.approx((ARRIVES, LEAVES), abs=0.03)


def test_in_a_halt_it_arrived_so_long_before_it_left_as_the_process_takes():
    standstill = PlaceStandstill(arrived_earliest_s=2.0, arrived_s=6.0, departed_earliest_s=7.0, left_s=7.0)
    assert standstill.times(1.5) == (5.5, 7.0)
    assert standstill.times(0.1) == (6.0, 7.0)
    assert standstill.times(9.0) == (2.0, 7.0)


def test_a_robot_stopped_and_then_paused_as_it_leaves_left_at_the_stop():
    log, visit = run(lambda t: 0.0 if 4.8 < t < 9.0 else 1.0, known=lambda t: not 6.0 < t < 9.0)
    pause = ProgramStop(*log.row_at(np.array([6.0, 9.0])).tolist(), PAUSED)
    standstill = standstill_at(replace(log, halts=(pause,)), visit, np.array([1.0, 0.0, 0.0]))
    assert (standstill.departed_earliest_s, standstill.left_s) == pytest.approx((4.8, 9.0), abs=0.03)
    assert standstill.pauses == (pytest.approx((6.0, 9.0), abs=0.02),)
    assert standstill.times(1.9) == pytest.approx((ARRIVES, ARRIVES + 1.9), abs=0.03)


def test_a_pause_prolongs_the_process_that_it_interrupts():
    standstill = PlaceStandstill(2.0, 2.0, 3.0, 12.0, pauses=((2.4, 6.4), (11.0, 12.0)))
    assert standstill.after(2.0, 0.3) == pytest.approx(2.3)
    assert standstill.after(2.0, 0.5) == pytest.approx(6.5)
    assert standstill.times(0.5) == pytest.approx((2.0, 6.5))
    stopped = PlaceStandstill(2.0, 9.0, 10.0, 10.0, pauses=((9.2, 9.8),))
    assert stopped.times(1.5) == pytest.approx((7.9, 10.0))


@pytest.mark.parametrize("rate", [50, 125, 500])
def test_a_motion_that_begins_at_its_full_speed_begins_at_the_last_row_at_rest(rate: int):
    t = np.arange(0.0, 6.0, 1.0 / rate)
    x = 0.5 * (np.maximum(1.0 - t, 0.0) + np.maximum(t - 4.0, 0.0))
    log = RobotRun(t, np.column_stack([x, 0.0 * t, 0.0 * t]), np.zeros(len(t)), np.ones(len(t)))
    still = np.flatnonzero(x < 1e-9)
    standstill = standstill_at(log, Visit("table", int(still[0]), int(still[-1])), np.zeros(3))
    assert (standstill.arrived_s, standstill.left_s) == pytest.approx((1.0, 4.0), abs=0.02 if rate == 500 else 1e-6)
