"""The lag at which where people are explains the robot's level: found, refined, tested against all other lags."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from cyclekit.alignment.clocks import explained
from cyclekit.alignment.clocks.explained import STEP_S, FoundLag, Instants, cells_of, find_lag
from cyclekit.alignment.clocks.response_lag import FINE_CELL_M, FINE_S, PlacesAndLevel, RefinedLag, refine_lag
from cyclekit.derive.clock_grids import MAX_PEOPLE, people_at_once
from cyclekit.derive.log_clocks import GRIDS
from cyclekit.people.tracks import PersonTrack

pytestmark = pytest.mark.tests_clocks

LENGTH_S, SLOW_M = 900.0, 1.5


class Walk(NamedTuple):
    """A person between stations at random, every FINE_S: position (N, 2), m."""

    xy_m: np.ndarray

    @classmethod
    def of(cls, seed: int, length_s: float = LENGTH_S) -> Walk:
        rng = np.random.default_rng(seed)
        at, parts, stations = np.zeros(2), [], rng.uniform(-4.0, 4.0, (6, 2))
        while sum(map(len, parts)) * FINE_S < length_s:
            goal = stations[rng.integers(6)] + rng.normal(0.0, 0.05, 2)
            steps = max(2, round(float(np.linalg.norm(goal - at)) / 1.2 / FINE_S))
            parts += [np.linspace(at, goal, steps), np.tile(goal, (round(rng.uniform(2.0, 12.0) / FINE_S), 1))]
            at = goal
        return cls(np.concatenate(parts)[: round(length_s / FINE_S)])

    def level(
        self, *, down_per_s: float = np.inf, up_per_s: float = np.inf, near_m: tuple[float, ...] = (SLOW_M,)
    ) -> np.ndarray:
        """The robot is the slower the nearer the person is to the origin; it slows and recovers at rates."""
        inside = np.sum([np.linalg.norm(self.xy_m, axis=1) < near for near in near_m], axis=0)
        followed, now = np.empty(len(inside)), 1.0
        for row, goal in enumerate((1.0 - 0.8 * inside / len(near_m)).tolist()):
            now = min(max(goal, now - down_per_s * FINE_S), now + up_per_s * FINE_S)
            followed[row] = now
        return followed


def found(people: Walk, level: np.ndarray, late_s: float) -> FoundLag:
    """The lag of a tracker that shows times later by late_s."""
    every = round(STEP_S / FINE_S)
    label = cells_of(people.xy_m[::every])[None]
    lag = find_lag([Instants(label, round(late_s / STEP_S), level[None, ::every], 0)])
    assert lag is not None
    return lag


@pytest.mark.parametrize("late_s", [0.0, 37.0, -1800.0, 3600.0])
def test_the_lag_is_found_wherever_it_is(late_s: float) -> None:
    walk = Walk.of(1)
    lag = found(walk, walk.level(), late_s)
    assert (lag.lag_s, lag.certain) == (-late_s, True)
    assert lag.explained > 0.8 > lag.next_best
    assert (lag.here is None) == (abs(late_s) > LENGTH_S)


@pytest.mark.parametrize(("late_s", "wrong"), [(0.0, False), (37.0, True), (-18.0, True)])
def test_a_clock_is_wrong_for_certain_though_a_cell_that_repeats_itself_does_not_tell_the_lag(
    late_s: float, *, wrong: bool
) -> None:
    cycle = Walk.of(1, 60.0)
    lag = found(Walk(np.tile(cycle.xy_m, (10, 1))), np.tile(cycle.level(), 10), late_s)
    assert lag.lag_s % 60.0 == -late_s % 60.0
    assert (lag.certain, lag.contradicts) == (False, wrong)


def test_people_of_another_day_contradict_no_clock() -> None:
    lags = [found(Walk.of(seed), Walk.of(100 + seed).level(), 0.0) for seed in range(12)]
    assert not any(lag.contradicts for lag in lags)


def test_weeks_without_a_change_cost_nothing_and_leave_the_lag_certain(monkeypatch: pytest.MonkeyPatch) -> None:
    every, weeks, walk, sizes = round(STEP_S / FINE_S), 1_000_000, Walk.of(1), list[int]()
    monkeypatch.setattr(
        explained.fft, "rfft", lambda x, n=None, **k: sizes.append(n or len(x)) or np.fft.rfft(x, n, **k)
    )
    label, level = cells_of(walk.xy_m[::every])[None], walk.level()[None, ::every]
    waiting = np.full((1, weeks), label[0, 0])
    lag = find_lag([Instants(np.concatenate([waiting, label, waiting], axis=1), 74 - weeks, level, 0)])
    assert lag is not None
    assert (lag.lag_s, lag.certain) == (-37.0, True)
    assert max(sizes) < 100_000


@pytest.mark.parametrize("seed", range(12))
def test_no_lag_is_certain_between_logs_of_different_days(seed: int) -> None:
    assert not found(Walk.of(seed), Walk.of(100 + seed).level(), 0.0).certain


def test_no_lag_is_certain_where_everything_repeats() -> None:
    once = Walk.of(3, 60.0)
    again = Walk(np.tile(once.xy_m, (15, 1)))
    assert not found(again, again.level(), 10.0).certain


def test_a_part_of_a_take_is_placed_in_it_and_nothing_is_said_of_a_robot_that_nobody_slows() -> None:
    walk = Walk.of(5)
    part = walk.level()[round(300 / FINE_S) :]
    assert found(walk, part, 0.0).lag_s == -300.0
    with_nothing = Instants(cells_of(walk.xy_m[::10])[None], 0, np.ones((1, 1800)), 0)
    assert find_lag([with_nothing]) is None
    assert find_lag([]) is None


def refined(walk: Walk, level: np.ndarray, lag_s: float) -> RefinedLag:
    robot = np.zeros(len(level), np.int64)
    cells = [cells_of(walk.xy_m, FINE_CELL_M, moved)[None] for moved in GRIDS]
    lag = refine_lag([[PlacesAndLevel(cell, 0, robot, level, 0)] for cell in cells], lag_s)
    assert lag is not None
    return lag


@pytest.mark.parametrize("up_per_s", [np.inf, 0.2])
def test_a_slow_recovery_does_not_move_the_refined_lag(up_per_s: float) -> None:
    walk = Walk.of(7)
    lag = refined(walk, walk.level(up_per_s=up_per_s), 1.0)
    assert lag.lag_s == pytest.approx(0.0, abs=0.1)
    assert lag.residual_s < 0.2
    assert lag.drift == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_slow_ramps_between_many_levels_do_not_move_the_refined_lag(seed: int) -> None:
    walk = Walk.of(20 + seed)
    level = walk.level(down_per_s=1.0, up_per_s=0.3, near_m=(0.9, 1.2, 1.5, 1.8))
    lag = refined(walk, level, 0.0)
    assert lag.lag_s == pytest.approx(0.0, abs=0.07)
    assert abs(lag.lag_s) < lag.bound_s


def test_a_reaction_time_stays_in_the_lag() -> None:
    walk = Walk.of(8)
    late = np.concatenate([np.ones(8), walk.level()[:-8]])
    assert refined(walk, late, 0.5).lag_s == pytest.approx(0.4, abs=0.1)


def test_a_drift_is_found_where_it_shows() -> None:
    walk = Walk.of(9, 3600.0)
    rows = np.arange(len(walk.xy_m)) * (1.0 + 150e-6)
    people = Walk(np.column_stack([np.interp(rows, np.arange(len(rows)), axis) for axis in walk.xy_m.T]))
    lag = refined(people, walk.level(), 0.0)
    assert lag.drift == pytest.approx(150e-6, abs=60e-6)


def test_people_who_come_after_each_other_share_a_course_and_a_crowd_tells_nothing() -> None:
    times = np.arange(0.0, 60.0, 0.1)
    tracks = [PersonTrack(str(n), times[60 * n : 60 * n + 50], np.full((50, 3), float(n))) for n in range(9)]
    (course,) = people_at_once(tracks, times)
    assert course[30].tolist() == [0.0, 0.0, 0.0]
    assert course[90].tolist() == [1.0, 1.0, 1.0]
    assert np.isnan(course[55]).all()
    crowd = [PersonTrack(str(n), times, np.full((600, 3), float(n))) for n in range(20)]
    assert len(people_at_once(crowd, times)) == MAX_PEOPLE + 1
