"""The commanded level, read back from a scaling that followed it late and slowly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from staircases import LEVELS, commanded, followed

from cyclekit.scaling.commanded import commanded_levels
from cyclekit.scaling.response import SafetyResponse


def response(latency_s: float | None, down: float | None, up: float | None) -> SafetyResponse:
    return SafetyResponse(latency_s, down, up, None, 0, None)


@settings(max_examples=15, deadline=None)
@given(st.sampled_from((10, 30, 125)), st.floats(0.05, 5.0), st.floats(0.0, 0.4), st.integers(0, 99))
def test_the_command_is_read_back_through_ramps_and_reaction_time(rate_hz: int, up: float, latency_s: float, seed: int):
    t_s, level = commanded(rate_hz, seconds=60 / up, shortest_s=0.5 + 0.6 / up, seed=seed)
    scaling = followed(level, rate_hz, round(latency_s * rate_hz) / rate_hz, 1.0, up)
    found = commanded_levels(t_s, scaling, LEVELS, response(round(latency_s * rate_hz) / rate_hz, 1.0, up))
    known = found.level >= 0
    changes = 1 + np.count_nonzero(np.diff(level))
    assert known.mean() > 0.4
    assert (found.level[known] != level[known]).sum() <= 2 * changes  # a row or two where one ends
    assert ((found.at_least > level) | (found.at_most < level)).sum() <= 2 * changes


@pytest.mark.parametrize("up", [0.05, 0.1, 0.25])
def test_no_command_is_told_before_it_was_given_where_ramps_turn_and_pass_levels(up: float):
    t_s, level = commanded(125, seconds=600, shortest_s=0.3, seed=1)  # commands change within a ramp
    scaling = followed(level, 125, 0.0, 1.0, up)
    rows = np.rint(np.arange(0, 600, 0.1) * 125).astype(int)
    found = commanded_levels(t_s[rows], scaling[rows], LEVELS, response(None, 1.0, up))
    known = found.level >= 0
    assert known.mean() > 0.15
    assert (found.level[known] != level[rows][known]).mean() < 0.07


def test_a_fall_that_pauses_at_a_level_begins_where_it_left_the_first_one():
    scaling = np.concatenate([np.full(10, 1.0), [0.99, 0.89, 0.79, 0.75, 0.75, 0.65, 0.55], np.full(9, 0.5)])
    found = commanded_levels(np.arange(26) / 10, scaling, LEVELS, response(None, 1.0, 0.1))
    assert (found.level[:9] == 4).all()
    assert not (found.level[10:13] == 4).any()
    assert (found.level[16:] == 2).all()


def test_a_ramp_that_turns_tells_of_no_level_before_it_turned():
    level = np.repeat([0, 4, 0], [100, 300, 300])
    scaling = followed(level, 100, 0.0, 1.0, 0.1)  # gets up to 0.3
    found = commanded_levels(np.arange(700) / 100, scaling, LEVELS, response(None, 1.0, 0.1))
    rising = slice(110, 390)
    assert (found.level[rising] == -1).all()
    assert (found.at_least[rising] >= 1).all()
    assert (found.level[440:] == 0).all()
    assert (found.level[:99] == 0).all()


def test_what_a_slow_rise_hides_is_unknown_until_only_one_level_is_left():
    level = np.repeat([0, 1, 2, 3, 4, 4], [200, 20, 20, 20, 1200, 300])  # walks away within 0.6 s
    scaling = followed(level, 100, 0.0, 1.0, 0.1)
    found = commanded_levels(np.arange(len(level)) / 100, scaling, LEVELS, response(None, 1.0, 0.1))
    known = found.level >= 0
    assert (found.level[known] == level[known]).all()
    assert found.level[600] == -1
    assert found.at_least[600] == 2  # 0.39 and rising
    assert found.level[1000] == 4


def test_a_step_without_response_is_what_is_logged():
    t_s, level = commanded(50, seconds=60, shortest_s=1.0)
    found = commanded_levels(t_s, followed(level, 50), LEVELS, response(None, None, None))
    assert (found.level == level).mean() == pytest.approx(1.0, abs=1e-9)


def test_an_unknown_scaling_tells_nothing():
    scaling = np.where(np.arange(400) // 100 % 2 == 1, np.nan, 0.5)
    found = commanded_levels(np.arange(400) / 100, scaling, LEVELS, response(None, None, None))
    assert (found.level[scaling == 0.5] == 2).all()
    assert (found.level[np.isnan(scaling)] == -1).all()
    assert (found.at_most[np.isnan(scaling)] == 4).all()


def test_a_slow_ramp_may_have_headed_farther_than_where_it_ends():
    level = np.repeat([2, 4, 3, 2], [200, 150, 300, 100])  # walks out, and half way back before the robot is at 75 %
    scaling = followed(level, 100, 0.0, 1.0, 0.1)
    found = commanded_levels(np.arange(len(level)) / 100, scaling, LEVELS, response(None, 1.0, 0.1))
    assert (found.level[202:400] == -1).all()
    assert (found.at_least[202:400] == 3).all()
    assert (found.level[460:640] == 3).all()


def test_a_slow_ramp_cut_off_near_a_level_does_not_hold_it():
    level = np.repeat([2, 4, 4], [200, 1200, 100])
    scaling = followed(level, 10, 0.0, 1.0, 0.1)
    for cut in (slice(0, 226), slice(223, None)):  # the log ends, or begins, near 0.75 on the way to 1
        found = commanded_levels(np.arange(len(level))[cut] / 10, scaling[cut], LEVELS, response(None, 1.0, 0.1))
        known = found.level >= 0
        assert known.any()
        assert (found.level[known] == level[cut][known]).all()


def test_without_ramps_each_row_on_a_level_is_commanded_that() -> None:
    steps = np.repeat([4, 3, 2, 1, 0, 1, 2, 3, 4] * 6, [9, 1, 1, 3, 6, 3, 1, 2, 9] * 6)
    levels = (0.0, 0.25, 0.5, 0.75, 1.0)
    found = commanded_levels(np.arange(len(steps)) / 10, np.array(levels)[steps], levels, response(None, None, None))
    assert found.level.tolist() == steps.tolist()


def test_while_a_level_may_only_be_held_the_command_is_unknown() -> None:
    steps = np.repeat([2, 1, 0, 1, 2], [50, 30, 40, 30, 60])
    held = SafetyResponse(None, None, None, None, 0, None, 1.0)
    found = commanded_levels(np.arange(len(steps)) / 10, steps / 2, (0.0, 0.5, 1.0), held)
    known = found.level >= 0
    assert (found.level[known] == steps[known]).all()
    assert np.flatnonzero(~known).tolist() == [*range(110, 120), *range(140, 150)]


def test_a_scaling_beyond_the_highest_level_is_at_most_that_level() -> None:
    t_s = np.arange(0.0, 12.0, 0.1)
    scaling = np.interp(t_s, [0.0, 4.0, 4.3, 6.0, 6.3, 9.0], [0.8, 0.8, 1.0, 1.0, 0.8, 0.8])
    found = commanded_levels(t_s, scaling, (0.0, 0.4, 0.8), response(None, 1.0, 1.0))
    assert found.level.max() == 2
    assert found.level[:35].tolist() == [2] * 35
