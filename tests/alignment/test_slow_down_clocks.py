"""Clocks by the slow-downs: operators who come and go at different speeds, and a robot that slows by the distance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cyclekit.alignment.clocks import LagEvidence, fit_lags, rough_lag, speed_changes
from cyclekit.alignment.clocks.slow_downs import AROUND_S, FINE_S
from cyclekit.derive.slow_down_clocks import MAX_PEOPLE, people_at_once
from cyclekit.people.tracks import PersonTrack

STEP_S = 0.02


def walk(seed: int, seconds: float = 400.0) -> np.ndarray:
    """Distance of an operator who comes and goes, every STEP_S, m."""
    rng = np.random.default_rng(seed)
    at, where = [0.0], [3.0]
    while at[-1] < seconds:
        far = float(rng.uniform(2.2, 3.4)) if len(where) % 4 in (0, 3) else float(rng.uniform(0.3, 0.9))
        at += [at[-1] + float(rng.uniform(1.0, 5.0)), 0.0]
        where += [where[-1], far]
        at[-1] = at[-2] + abs(where[-1] - where[-2]) / float(rng.uniform(0.5, 1.3))
    return np.interp(np.arange(0.0, seconds, STEP_S), at, where)


def scaling_of(apart_m: np.ndarray, *, late_s: float = 0.0, per_s: float = 0.5) -> np.ndarray:
    """Half speed nearer than 1.5 m, until farther than 1.6 m; recovers slowly."""
    found = np.ones(len(apart_m))
    level, late = 1.0, round(late_s / STEP_S)
    for row in range(1, len(apart_m)):
        apart = apart_m[max(row - late, 0)]
        level = 0.5 if apart < 1.5 else 1.0 if apart > 1.6 else level
        found[row] = min(level, found[row - 1] + per_s * STEP_S) if level > found[row - 1] else level
    return found


def evidence(apart_m: np.ndarray, scaling: np.ndarray, rough_s: float) -> LagEvidence:
    """The slow-downs of a robot, and an operator whose clock started with the robot's."""
    t_s = np.arange(len(apart_m)) * STEP_S
    changes = speed_changes(t_s, scaling)
    lags_s = np.append(rough_s + np.arange(-AROUND_S, AROUND_S + FINE_S / 2, FINE_S), 0.0)
    asked = changes.t_s[None] - lags_s[:, None]
    apart = np.where((asked < 0) | (asked > t_s[-1]), np.nan, np.interp(asked, t_s, apart_m))
    people = np.column_stack([apart_m, np.zeros((len(apart_m), 2))])[:: round(0.1 / STEP_S)]
    some = slice(None, None, round(0.1 / STEP_S))
    rough = rough_lag([people], np.zeros_like(people), scaling[some], step_s=0.1)
    assert rough is not None
    return LagEvidence(rough._replace(lag_s=rough_s), lags_s, np.stack([apart, apart]), changes.kind)


def test_the_rough_lag_is_where_the_robot_is_slow_while_somebody_is_near():
    apart = walk(1)[::5]
    people = np.column_stack([apart, np.zeros((len(apart), 2))])
    robot = np.roll(np.where(apart < 1.5, 0.2, 1.0), 3)  # it reacts three samples late
    found = rough_lag([people[57:]], np.zeros_like(people), robot, step_s=0.1)
    assert found is not None
    assert found.lag_s == pytest.approx(6.0, abs=0.11)  # 5.7 s and the reaction time cannot be told apart
    assert found.second is not None
    assert found.second < 0.8 * found.peak


def test_there_is_no_rough_lag_where_the_robot_never_slows_or_nobody_is_seen():
    people = np.random.default_rng(2).normal(size=(500, 3))
    assert rough_lag([people], np.zeros((500, 3)), np.ones(500), step_s=0.1) is None
    assert rough_lag([], np.zeros((500, 3)), np.linspace(0.0, 1.0, 500), step_s=0.1) is None
    assert rough_lag([people], np.zeros((500, 3)), np.full(500, np.nan), step_s=0.1) is None


@pytest.mark.parametrize("step_s", [0.002, 0.02, 0.1])
@pytest.mark.parametrize("per_s", [0.05, 0.15, 5.0])
def test_changes_of_speed_start_where_the_ramp_does(step_s: float, per_s: float):
    t_s = np.arange(0.0, 60.0, step_s)
    aim = np.where((t_s >= 5.0) & (t_s < 12.3), 0.6, np.where((t_s >= 30.0) & (t_s < 38.3), 0.15, 1.0))
    scaling = np.ones(len(t_s))
    for row in range(1, len(t_s)):
        up, down = scaling[row - 1] + per_s * step_s, scaling[row - 1] - 1.2 * step_s
        scaling[row] = min(aim[row], up) if aim[row] > scaling[row - 1] else max(aim[row], down)
    noisy = scaling + np.random.default_rng(1).normal(0.0, 0.001, len(t_s))
    found = speed_changes(t_s, noisy)
    at_s = found.t_s.tolist()
    assert at_s == pytest.approx([5.0, 12.3, 30.0, 38.3], abs=0.1 + step_s)
    assert found.kind.tolist() == [25, 24, 7, 6]


def test_a_change_next_to_a_gap_is_left_out():
    t_s = np.arange(0.0, 10.0, STEP_S)
    scaling = np.where(t_s < 5.0, 1.0, 0.5)
    scaling[(t_s > 4.0) & (t_s < 5.1)] = np.nan
    assert len(speed_changes(t_s, scaling).t_s) == 0
    assert len(speed_changes(t_s[:3], scaling[:3]).t_s) == 0


def test_a_lag_with_another_one_almost_as_good_is_not_certain():
    apart = walk(50)
    one = evidence(apart, scaling_of(np.roll(apart, round(5.0 / STEP_S))), 5.2)
    assert one.rough is not None
    doubtful = replace(one, rough=one.rough._replace(second=0.9 * one.rough.peak, second_s=9.0))
    clear, unclear = fit_lags([one]), fit_lags([doubtful])
    assert clear[0] is not None
    assert unclear[0] is not None
    assert (clear[0].certain, unclear[0].certain) == (True, False)
    assert clear[0].lag_s == unclear[0].lag_s == pytest.approx(5.0, abs=0.06)


def test_lags_of_sessions_are_found_together_within_hundredths_of_a_second():
    true_s = [2.5, -1.34, 31.0, 0.4]
    sessions = []
    for seed, lag_s in enumerate(true_s):
        apart = walk(seed + 10)
        shifted = np.interp(np.arange(len(apart)) * STEP_S - lag_s, np.arange(len(apart)) * STEP_S, apart)
        rough_s = lag_s + float(np.random.default_rng(seed).uniform(0.2, 0.9))  # slow recovery makes it late
        sessions.append(evidence(apart, scaling_of(shifted), rough_s))
    found = fit_lags(sessions)
    lags = [one.lag_s for one in found if one is not None]
    assert lags == pytest.approx(true_s, abs=0.06)
    assert all(one is not None and one.certain and one.spread_m is not None and one.spread_m < 0.05 for one in found)


def test_a_reaction_time_is_no_offset_of_the_clock():
    apart = walk(30)
    (found,) = fit_lags([evidence(apart, scaling_of(apart, late_s=0.3), 0.5)])
    assert found is not None
    assert found.lag_s == pytest.approx(0.3, abs=0.06)
    assert not found.certain


def test_slow_downs_that_the_distance_does_not_explain_leave_the_rough_lag():
    apart = walk(40)
    other = evidence(apart, scaling_of(walk(41)), 5.0)
    (found,) = fit_lags([other])
    assert found is not None
    assert (found.lag_s, found.spread_m, found.certain) == (5.0, None, False)
    few = replace(other, apart_m=other.apart_m[..., :5], kind=other.kind[:5])
    (same,) = fit_lags([few])
    assert same == found
    assert fit_lags([replace(few, rough=None)]) == [None]


def test_people_who_come_after_each_other_share_a_course_and_a_crowd_tells_nothing():
    times = np.arange(0.0, 60.0, 0.1)
    tracks = [PersonTrack(str(n), times[60 * n : 60 * n + 50], np.full((50, 3), float(n))) for n in range(9)]
    (course,) = people_at_once(tracks, times)
    assert course[30].tolist() == [0.0, 0.0, 0.0]
    assert course[90].tolist() == [1.0, 1.0, 1.0]
    assert np.isnan(course[55]).all()
    crowd = [PersonTrack(str(n), times, np.full((600, 3), float(n))) for n in range(20)]
    assert len(people_at_once(crowd, times)) == MAX_PEOPLE + 1
