"""What the safety function does in time, read from logs of cells whose latency, ramps and hysteresis are known."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from staircases import LEVELS, commanded, followed

from cyclekit.scaling.agreement import LATENCIES_S
from cyclekit.scaling.levels import find_staircase
from cyclekit.scaling.response import Changes, LevelChange, at_speed, changes_of, error_of, rate_of, read_response
from cyclekit.scaling.short_ramps import by_counts

if TYPE_CHECKING:
    from simulated_cells import Cells

SAMPLES = Path(os.environ.get("CYCLEKIT_SAMPLES", "absent")) / "cnr-override"
SLOW = {"latency_s": 0.2, "ramp_down_per_s": 2.5, "ramp_up_per_s": 1.0, "hysteresis_m": 0.1}


@pytest.mark.slow  # quick: the series made by hand below
def test_latency_ramps_and_hysteresis_are_read_from_the_logs(cells: Cells):
    found = cells("pick-and-package", 4, **SLOW).dataset.card.dynamics
    assert found.latency_s == pytest.approx(0.2, abs=0.02)
    assert found.hysteresis_m == pytest.approx(0.1, abs=0.02)
    assert found.ramp_down_per_s == pytest.approx(2.5, rel=0.05)
    assert found.ramp_up_per_s == pytest.approx(1.0, rel=0.05)


def test_a_safety_system_that_reacts_at_once_has_no_latency_and_no_ramps(cells: Cells):
    found = cells("pick-and-package").dataset.card.dynamics
    assert found.latency_s == pytest.approx(0.0, abs=0.02)
    assert found.hysteresis_m == pytest.approx(0.0, abs=0.02)
    assert (found.ramp_down_per_s, found.ramp_up_per_s) == (None, None)


def test_where_zones_decide_their_edges_tell_the_reaction_time_and_no_distance_a_hysteresis(cells: Cells):
    found = cells("laser-zones", 6).dataset.card.dynamics
    assert found.latency_s == pytest.approx(0.0, abs=0.02)
    assert found.hysteresis_m is None


def test_an_inferred_scaling_says_nothing_of_levels_where_the_programmed_speed_is_low():
    programmed = np.array([0.0, 0.05, 0.15, 0.6, 1.0, 1.0, 1.0, 1.0, 0.1])
    scaling = np.array([np.nan, 0.7, 0.9, 1.0, 0.5, 0.0, 0.5, 1.0, 0.6])
    kept = at_speed(scaling, programmed * np.nan_to_num(scaling))
    assert np.isnan(kept).tolist() == [True, True, True, False, False, False, False, False, True]
    assert kept[3:8].tolist() == scaling[3:8].tolist()


def test_few_changes_say_nothing():
    t_s = np.arange(1000) / 125
    scaling = np.where((t_s > 2) & (t_s < 4), 0.5, 1.0)
    changes = changes_of(t_s, scaling, (0.5, 1.0))
    assert [(change.step, change.rises, change.rate_per_s) for change in changes] == [(0, False, None), (0, True, None)]
    assert changes[0].t_s == pytest.approx(2.0, abs=0.01)
    found = read_response([Changes.of(changes, t_s, np.zeros((1000, 3)), np.ones((1000, 3)))])
    assert (found.changes, found.latency_s, found.hysteresis_m) == (2, None, None)


def approaches(session_s: float, count: int = 40) -> tuple[list[LevelChange], np.ndarray, np.ndarray, np.ndarray]:
    """Return changes 0.3 s after an operator comes nearer than 1 m, every 10 s at another speed, and the places."""
    t_s = session_s + np.arange(0.0, 10.0 * count, 0.1)
    passed_s = t_s - session_s
    distance_m = 1.0 + (0.5 + 0.1 * (passed_s // 10.0 % 7)) * (4.0 - passed_s % 10.0)
    crossed_s = session_s + 10.0 * np.arange(count) + 4.0
    nowhere = np.zeros((len(t_s), 3))
    human_m = nowhere + distance_m[:, None] * (1.0, 0.0, 0.0)
    return [LevelChange(float(t) + 0.3, 0, False, None) for t in crossed_s], t_s, nowhere, human_m


def test_sessions_tell_together_what_one_is_too_short_for():
    (early, late) = (Changes.of(*approaches(begin, 12)) for begin in (0.0, 3.0))  # their times overlap
    assert read_response([early]).latency_s is None
    assert read_response([early, late]).latency_s == pytest.approx(0.3)


def test_of_very_many_changes_some_are_looked_at_and_all_are_counted():
    seen = Changes.of(*approaches(0.0, 500), max_changes=100)
    assert seen.positions.apart_m.shape == (100, len(LATENCIES_S))
    found = read_response([seen])
    assert (found.changes, found.latency_s) == (500, pytest.approx(0.3))


def test_an_unknown_scaling_ends_a_level():
    t_s = np.arange(600) / 125
    scaling = np.where(t_s < 2, 1.0, np.where(t_s < 2.2, np.nan, 0.5))
    assert changes_of(t_s, scaling, (0.5, 1.0)) == []  # when it began nobody saw
    assert changes_of(t_s, np.full(600, np.nan), (0.5, 1.0)) == []


def rates(t_s: np.ndarray, scaling: np.ndarray) -> tuple[float | None, float | None]:
    """Return the rates down and up that a log shows."""
    changes = changes_of(t_s, scaling, LEVELS)
    down, up = (rate_of([change for change in changes if change.rises is rises]) for rises in (False, True))
    return down, up


@settings(max_examples=12, deadline=None)
@given(st.sampled_from((10, 30, 125)), st.floats(0.05, 1.0), st.sampled_from(("clean", "percent", "noisy")))
def test_rates_are_read_from_slow_and_interrupted_ramps(rate_hz: int, up: float, log: str):
    t_s, level = commanded(rate_hz, seconds=300, shortest_s=1.0, seed=3)
    scaling = followed(level, rate_hz, 0.0, 1.0, up)
    if log == "percent":
        scaling = np.floor(100 * scaling + 1e-9) / 100
    if log == "noisy":
        scaling = scaling + np.random.default_rng(3).normal(0, 0.01, len(t_s))
    down_found, up_found = rates(t_s, scaling)
    assert up_found == pytest.approx(up, rel=0.05)
    assert down_found == pytest.approx(1.0, rel=0.06)


def test_a_rate_of_ten_percent_a_second_is_read_though_each_ramp_takes_seconds():
    t_s, level = commanded(125, seconds=400, shortest_s=6.0)
    assert rates(t_s, followed(level, 125, 0.0, 1.0, 0.1)) == pytest.approx((1.0, 0.1), rel=0.01)


@pytest.mark.parametrize("every", [1, 4])
def test_ramps_of_fewer_rows_than_a_slope_takes_are_timed(every: int):
    t_s, level = commanded(125, seconds=400, shortest_s=1.0)
    scaling = followed(level, 125, 0.0, 5.0, 5.0)
    repeated = np.repeat(scaling[::every], every)[: len(t_s)]  # a log that writes each value four times
    assert rates(t_s, repeated) == pytest.approx((5.0, 5.0), rel=0.15 if every > 1 else 0.02)


def test_a_log_of_whole_percents_has_the_levels_and_rates_of_its_safety_system():
    rate_hz = 30
    t_s, level = commanded(rate_hz, seconds=400, shortest_s=4.0)
    scaling = np.floor(100 * followed(level, rate_hz, 0.0, 1.0, 0.1) + 1e-9) / 100
    found = find_staircase(scaling, rate_hz=rate_hz)
    assert found.levels == pytest.approx(LEVELS, abs=0.002)
    assert found.is_staircase
    assert rates(t_s, scaling) == pytest.approx((1.0, 0.1), rel=0.05)


def test_a_ramp_is_no_level_however_slow_and_leaves_a_staircase():
    _, level = commanded(10, seconds=1200, shortest_s=3.0)
    found = find_staircase(followed(level, 10, 0.0, 1.0, 0.05), rate_hz=10)
    assert found.levels == pytest.approx(LEVELS, abs=0.002)
    assert (found.is_staircase, 1 - found.share.sum() > 0.4) == (True, True)


def test_a_scaling_that_follows_a_distance_is_said_to_be_continuous():
    t_s = np.arange(0.0, 1200.0, 0.1)
    distance_m = 1.5 + np.sin(0.31 * t_s) + 0.6 * np.sin(0.83 * t_s) + 0.3 * np.sin(1.7 * t_s)
    found = find_staircase(np.clip((distance_m - 0.4) / 2.2, 0.0, 1.0), rate_hz=10)
    assert not found.is_staircase
    assert any(warning.code == "scaling-continuous" for warning in found.warnings)


@pytest.mark.parametrize("hold_s", [0.4, 1.0, 2.0])
def test_a_hold_time_is_what_the_robot_speeds_up_later_than_it_slows_down(hold_s):
    down, t_s, robot_m, human_m = approaches(0.0)
    leaves = [LevelChange(change.t_s + 5.5 + hold_s, 0, True, None) for change in down]
    away = np.where((t_s % 10.0 > 4.6)[:, None], human_m * 0, human_m)
    for number, change in enumerate(down):  # walks out past 1 m 5.5 s after it came in, each time at another speed
        speed = 0.5 + 0.1 * (number * 3 % 7)
        rows = (t_s >= change.t_s + 4.3) & (t_s < change.t_s + 6.6)
        away[rows, 0] = 1.0 + speed * (t_s[rows] - (change.t_s - 0.3 + 5.5))
    changes = sorted([*down, *leaves], key=lambda change: change.t_s)
    found = read_response([Changes.of(changes, t_s, robot_m, away)])
    assert found.hold_s == pytest.approx(hold_s, abs=0.03)
    assert found.latency_s == pytest.approx(0.3, abs=0.02)


def test_a_distance_on_the_floor_shows_hysteresis_though_the_tool_is_at_many_heights():
    t_s = np.arange(0.0, 600.0, 0.1)
    number, passed_s = t_s // 10.0, t_s % 10.0
    speed, direction = 0.5 + 0.1 * (number % 7), 0.7 * number
    apart_m = 1.0 + speed * np.where(passed_s < 5.0, 4.0 - passed_s, passed_s - 6.0)  # in at 4 s, out at 6 s
    human_m = np.stack([apart_m * np.cos(direction), apart_m * np.sin(direction), np.full(len(t_s), 1.1)], axis=1)
    robot_m = np.stack([0 * t_s, 0 * t_s, 0.1 + 0.2 * (number % 5)], axis=1)
    changes = []
    for one in range(60):
        rises_s = 6.0 + 0.12 / (0.5 + 0.1 * (one % 7))
        changes += [
            LevelChange(10.0 * one + 4.3, 0, False, None),
            LevelChange(10.0 * one + rises_s + 0.3, 0, True, None),
        ]
    found = read_response([Changes.of(changes, t_s, robot_m, human_m)])
    assert found.latency_s == pytest.approx(0.3, abs=0.02)
    assert found.hysteresis_m == pytest.approx(0.12, abs=0.01)
    assert found.hold_s is None


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="CYCLEKIT_SAMPLES names no folder")
def test_the_override_of_a_research_cell_has_three_levels_and_two_rates():
    log = pl.read_csv(SAMPLES / "ovr_monitoring_safety_area.csv")
    t_s, override = log["Timestamp"].to_numpy(), log["Safe_Ovr"].to_numpy() / 100
    silent = np.diff(t_s) > 0.5
    found = find_staircase(override, run=np.cumsum(np.append(False, silent)), rate_hz=30)
    assert found.levels == pytest.approx((0.0, 0.5, 1.0), abs=0.001)
    assert (found.is_staircase, found.warnings) == (True, ())
    parts = zip(np.split(t_s, np.flatnonzero(silent) + 1), np.split(override, np.flatnonzero(silent) + 1), strict=True)
    changes = [change for part_s, part in parts for change in changes_of(part_s, part, found.levels.tolist())]
    down, up = (rate_of([change for change in changes if change.rises is rises]) for rises in (False, True))
    assert (down, up) == pytest.approx((1.0, 0.1), rel=0.01)


def stepped(
    up: float, down: float = 1.0, begins: np.ndarray | None = None, late: np.random.Generator | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times and scaling of a controller of 8 ms cycles, logged at 10 Hz, and when it began to change.

    With `late`, rows are stamped up to a cycle late by random, as by a receiver.
    """
    if begins is None:
        begins = np.arange(1, 500) * 1.508  # at every phase of the rows as often
    cycles = np.arange(0.0, begins[-1] + 1.0, 0.008)
    wanted = np.where(np.searchsorted(begins, cycles, side="right") % 2 == 0, 0.75, 0.5)
    scaling, now = np.empty(len(cycles)), 0.75
    for row, goal in enumerate(wanted.tolist()):
        now = min(goal, now + 0.008 * up) if goal > now else max(goal, now - 0.008 * down)
        scaling[row] = now
    rows = np.unique(np.searchsorted(cycles, np.arange(0.0, cycles[-1], 0.1)))
    late_s = 0.0 if late is None else late.uniform(0.0, 0.008, len(rows))
    return cycles[rows] + late_s, scaling[rows], begins


def test_rows_that_are_whole_cycles_apart_tell_a_short_ramp_exactly() -> None:
    begins = np.cumsum(np.random.default_rng(1).uniform(1.0, 2.0, 400))
    for up in (3.0, 5.0, 8.0):
        t_s, scaling, _ = stepped(up, begins=begins)
        rising = [one for one in changes_of(t_s, scaling, (0.5, 0.75, 1.0)) if one.rises]
        assert rate_of(rising) == pytest.approx(up, rel=1e-6)
    turned = LevelChange(0.0, 0, True, None, 0.23, 0.1, 1.0, 0.01, (0.0137,), (0.096, 0.104))  # one ramp that turned
    assert rate_of([*rising, turned]) == pytest.approx(8.0, rel=1e-6)


def test_a_controller_that_changes_the_scaling_in_every_second_cycle_is_not_read_as_twice_as_fast() -> None:
    t_s, scaling, _ = stepped(up=5.0)
    rising = [one for one in changes_of(t_s, scaling, (0.5, 0.75, 1.0)) if one.rises]
    twice = [one._replace(row_s=tuple(0.004 * round(each / 0.004) for each in one.row_s)) for one in rising]
    twice[0] = twice[0]._replace(row_s=(0.1, 0.1, 0.1, 0.1))  # these rows show a cycle of 4 ms
    twice[1] = twice[0]
    assert rate_of(twice) == pytest.approx(5.0, rel=1e-3)


def test_large_changes_tell_more_by_their_number_of_rows() -> None:
    """With rows at any time only their number counts; each of 27 changes by half takes nearly one row."""
    found, plain = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        row_s, sizes = 0.1, np.array([0.25] * 110 + [0.48] * 27)
        rows = rng.random(len(sizes)) < sizes / 5.0 / row_s
        changes = [
            LevelChange(
                0.0, 0, True, None, size, row_s * row, 1.0 if row else None, 0.0,
                tuple(rng.uniform(0.0, size, int(row))), (row_s,) * (1 + row),
            )
            for size, row in zip(sizes.tolist(), rows.tolist(), strict=True)
        ]  # fmt: skip
        found.append(by_counts(changes, None) / 5.0 - 1.0)
        plain.append(sizes.sum() / (row_s * rows.sum()) / 5.0 - 1.0)
    assert float(np.std(found)) < 0.8 * float(np.std(plain))
    assert abs(float(np.mean(found))) < 0.02


def test_a_ramp_shorter_than_a_row_is_read_without_the_step_of_its_controller() -> None:
    t_s, scaling, _ = stepped(up=5.0)
    rise = rate_of([one for one in changes_of(t_s, scaling, (0.5, 0.75, 1.0)) if one.rises])
    assert rise == pytest.approx(5.0, rel=0.05)


def test_two_rows_in_a_ramp_tell_its_rate_and_one_row_when_it_began() -> None:
    t_s, scaling, begins = stepped(up=1.0)
    changes = changes_of(t_s, scaling, (0.5, 0.75, 1.0))
    for rises in (False, True):
        mine = [one for one in changes if one.rises is rises]
        assert rate_of(mine) == pytest.approx(1.0, rel=0.01)
        assert np.median([np.abs(begins - one.t_s).min() for one in mine]) < 0.01


def test_the_standard_error_of_a_rate_is_what_rates_differ_by() -> None:
    found, errors = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        t_s, scaling, _ = stepped(up=5.0, begins=np.cumsum(rng.uniform(1.0, 2.0, 200)), late=rng)
        rising = [one for one in changes_of(t_s, scaling, (0.5, 0.75, 1.0)) if one.rises]
        found.append(rate_of(rising) or 0.0)
        errors.append(error_of(rising) or 0.0)
    assert 0.6 < float(np.mean(errors)) / float(np.std(found)) < 1.6
    assert np.mean(np.abs(np.array(found) - 5.0) < 2.0 * np.array(errors)) >= 0.75
    t_s, scaling, _ = stepped(up=1.0)
    assert (error_of([one for one in changes_of(t_s, scaling, (0.5, 0.75, 1.0)) if one.rises]) or 1.0) < 0.01


def test_few_changes_tell_no_standard_error() -> None:
    assert error_of([LevelChange(1.0, 0, True, 1.0, 0.5)] * 9) is None


def test_ways_that_happen_to_have_two_rows_count_where_ramps_are_timed() -> None:
    """Left out, the rest would be too short: 10 per second."""
    single = [LevelChange(float(i), 0, True, None, 1.0, 0.1, 10.0, row_s=(0.1, 0.1)) for i in range(12)]
    double = [LevelChange(20.0 + i, 0, True, rate, 1.0, 0.2, 9.0) for i, rate in enumerate((7.0, 8.0, 9.5, 8.3))]
    assert rate_of([*single, *double]) == pytest.approx(8.0, rel=0.01)


def test_three_slopes_that_agree_tell_the_rate() -> None:
    single = [LevelChange(float(i), 0, True, None, 1.0, 0.1, 10.0, row_s=(0.1, 0.1)) for i in range(12)]
    double = [LevelChange(20.0 + i, 0, True, 8.4, 1.0, 0.2, 9.0) for i in range(3)]
    assert rate_of([*single, *double]) == pytest.approx(8.4)
