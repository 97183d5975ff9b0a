"""Futures of a state: they begin as that state, part from each other later, and change nothing that was."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit_sim.choices import OPERATOR, legs_again, operator_legs, places_again, stream
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.futures import _legs, _until, scaling_of_futures
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.plan import prepare, run_alone
from cyclekit_sim.scenes import BUILT_IN


@pytest.fixture(scope="module")
def run():
    work = prepare(BUILT_IN["laser-zones"], 3, SimulationOptions(), executions=20)
    (trace,) = run_alone(work, work.executions[:1])
    return work, trace


def test_futures_begin_in_the_state_they_are_of_and_part_later(run):
    work, trace = run
    cycles = range(100, len(trace.scaling) - 300, 600)
    now, later = (scaling_of_futures(work, trace, cycles, after_s, 6) for after_s in (0.0, 2.0))
    np.testing.assert_array_equal(now, np.repeat(trace.scaling[list(cycles)][:, None], 6, axis=1))
    assert 0 < (np.ptp(later, axis=1) > 0).mean() < 1
    np.testing.assert_array_equal(later, scaling_of_futures(work, trace, cycles, 2.0, 6))


def test_a_dwell_that_goes_on_lasts_at_least_as_long_as_it_has_and_ends_when_it_must(run):
    work, trace = run
    legs = _legs(work, trace)
    past = next(legs[: i + 1] for i, leg in enumerate(legs) if i and len(leg.t_s) == 2)
    station = work.scene.stations[[leg.press for leg in past if leg.press][-1].goal]
    into_s = station.dwell_s[0] + 0.5
    ends = [next(legs_again(work.scene, past, into_s, np.random.default_rng(i))).t_s[-1] for i in range(50)]
    assert into_s <= min(ends) < max(ends) <= station.dwell_s[1]


@pytest.mark.parametrize("scene", ["box-picking", "laser-zones"])
def test_stations_after_those_that_are_done_are_the_others_each_once(scene):
    cell = BUILT_IN[scene]
    legs = list(operator_legs(cell, stream(1, cell, OPERATOR, 0)))
    every = [leg.press.goal for leg in legs if leg.press]
    for count in (1, len(legs) // 2, len(legs) - 2):
        past = legs[:count]
        again = list(legs_again(cell, past, 0.1, np.random.default_rng(5)))
        names = [leg.press.goal for leg in past if leg.press]
        assert sorted(names + [leg.press.goal for leg in again[1:] if leg.press]) == sorted(every)


def test_places_after_the_present_task_are_the_others_each_once():
    cell = BUILT_IN["box-picking"]
    work = prepare(cell, 1, SimulationOptions(), executions=1)
    places = work.executions[0].places
    drawn = {places_again(cell, places, 6, np.random.default_rng(i)) for i in range(8)}
    assert len(drawn) > 1
    assert all(each[:8] == places[:8] and sorted(each) == sorted(places) for each in drawn)


def test_no_future_is_drawn_where_the_state_is_more_than_what_is_seen():
    cell = BUILT_IN["scanner-visits"]
    legs = [leg for leg, _ in zip(operator_legs(cell, np.random.default_rng(0)), range(3), strict=False)]
    with pytest.raises(SimulationError, match="deliver or roam"):
        next(legs_again(cell, legs, 0.0, np.random.default_rng(1)))
    work = prepare(BUILT_IN["laser-zones"], 1, SimulationOptions(latency_s=0.1), executions=20)
    (trace,) = run_alone(work, work.executions[:1])
    assert _until(_legs(work, trace), 0.0)[1] == 0.0
    with pytest.raises(SimulationError, match="latency"):
        scaling_of_futures(work, trace, [10], 2.0, 2)
